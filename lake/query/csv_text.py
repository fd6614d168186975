"""Query results as CSV."""

import io
import json
from decimal import Decimal

import pyarrow as pa
from pyarrow import csv


def csv_bytes(table: pa.Table) -> bytes:
    """The table as CSV with a header; lists and structs as JSON text, since a CSV has plain values only."""
    buffer = io.BytesIO()
    csv.write_csv(_flat(table), buffer)
    return buffer.getvalue()


def plain(value: object) -> float | str:
    """What JSON knows for a value that it does not: a number for a decimal, text for a time."""
    return float(value) if isinstance(value, Decimal) else str(value)


def _flat(table: pa.Table) -> pa.Table:
    for place, field in enumerate(table.schema):
        if pa.types.is_nested(field.type):
            texts = [None if value is None else json.dumps(value, default=plain) for value in table[place].to_pylist()]
            table = table.set_column(place, field.name, pa.array(texts, pa.string()))
    return table
