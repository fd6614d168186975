"""Pyarrow schemas derived from the row records: types, units, versions, and rows as Arrow tables.

Text -> string, int -> int64, float -> float64, bool -> bool, datetime -> timestamp[us, UTC], a channel or a
tuple -> list. `X | None` is nullable. Unit (by name suffix) and description are field metadata.
"""

import types
from collections.abc import Sequence
from datetime import datetime
from functools import cache
from typing import Any, Literal, Union, get_args, get_origin

import numpy as np
import pyarrow as pa
from pydantic import BaseModel

from fast.lake.provenance import ProvenanceColumns
from fast.lake.tables.campaign import Row
from fast.models.units import unit_of

VERSION_KEY = "fast.schema_version"  # of a file's metadata; one that says nothing holds version 1
SCHEMA_VERSION = 1  # of the columns of every table; columns that may be empty came and come without a new one
_SCALARS: dict[Any, pa.DataType] = {
    str: pa.string(),
    int: pa.int64(),
    float: pa.float64(),
    bool: pa.bool_(),
    datetime: pa.timestamp("us", tz="UTC"),
    np.ndarray: pa.list_(pa.float64()),
}
_SQL_TYPES = {
    pa.string(): "VARCHAR",
    pa.int64(): "BIGINT",
    pa.float64(): "DOUBLE",
    pa.bool_(): "BOOLEAN",
    pa.timestamp("us", tz="UTC"): "TIMESTAMP WITH TIME ZONE",
}


@cache
def schema_of(row_type: type[Row]) -> pa.Schema:
    """Return the Arrow schema of a table: id, the other columns, then the provenance columns.

    A column that the row itself names (`seed` of a fit) is the row's, not the provenance's.
    """
    own = row_type.model_fields
    fields = [_field(row_type, row_type.id_column())]
    fields += [_field(row_type, name) for name in own if name != row_type.id_column()]
    fields += [_field(ProvenanceColumns, name) for name in ProvenanceColumns.model_fields if name not in own]
    metadata = {"fast.table": row_type.table, VERSION_KEY: str(SCHEMA_VERSION)}
    return pa.schema(fields, metadata=metadata)


@cache
def sql_columns(row_type: type[Row]) -> dict[str, str]:
    """Return the DuckDB types of the columns of a table, in its order."""
    return {field.name: _sql_type(field.type) for field in schema_of(row_type)}


def has_samples(row_type: type[Row]) -> bool:
    """Return whether this is a table of traces, which are too big to hold in memory."""
    return any(field.annotation is np.ndarray for field in row_type.model_fields.values())


def to_arrow(rows: Sequence[Row], provenance: ProvenanceColumns) -> pa.Table:
    """Return rows of one table as an Arrow table with `schema_of` its type, ordered by id."""
    row_type = type(rows[0])
    key = row_type.id_column()
    ordered = sorted(rows, key=lambda row: row.__dict__[key])
    shared = {name: value for name, value in provenance if name not in row_type.model_fields}
    columns = []
    schema = schema_of(row_type)
    for field in schema:
        values = [shared[field.name] if field.name in shared else row.__dict__[field.name] for row in ordered]
        columns.append(pa.array(values, type=field.type))
    return pa.Table.from_arrays(columns, schema=schema)


def _sql_type(data_type: pa.DataType) -> str:
    return f"{_SQL_TYPES[data_type.value_type]}[]" if pa.types.is_list(data_type) else _SQL_TYPES[data_type]


def _field(record_type: type[BaseModel], name: str) -> pa.Field:
    info = record_type.model_fields[name]
    data_type, nullable = _arrow_type(info.annotation)
    unit = unit_of(name)
    metadata = {"unit": unit} if unit else {}
    if info.description:
        metadata["description"] = info.description
    return pa.field(name, data_type, nullable=nullable, metadata=metadata or None)


def _arrow_type(annotation: Any) -> tuple[pa.DataType, bool]:
    origin, arguments = get_origin(annotation), get_args(annotation)
    if origin in (Union, types.UnionType):
        (inner,) = [argument for argument in arguments if argument is not types.NoneType]
        return _arrow_type(inner)[0], True
    if origin is Literal:
        return _arrow_type(type(arguments[0]))
    if origin is tuple:
        return pa.list_(_arrow_type(arguments[0])[0]), False
    return _SCALARS[annotation], False
