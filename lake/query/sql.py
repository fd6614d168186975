"""Read-only SQL over a lake for people (`fast sql`), and its results as CSV.

Three locks, each enough for its part: only SELECT-like statements are taken, they run in a read-only
transaction (a WITH clause can hide an INSERT), and the connection has no access to network or files, but for those
of the tables. Time and memory are limited.
"""

import io
import json
import math
import re
from collections.abc import Callable
from datetime import date, time
from decimal import Decimal
from difflib import get_close_matches
from typing import Any

import duckdb
import pyarrow as pa
from pyarrow import csv

from fast.lake.query.engine import check_reads_only
from fast.lake.query.limits import Limits, limited
from fast.lake.store import Lake
from fast.models.errors import UsageError
from fast.models.validation import closest

_ATTEMPTS = 5  # files of traces may be merged while a query runs


# What DuckDB says, and what it means in this lake
_HINTS = {
    "More than one row returned by a subquery": (
        "A subquery gave more than one row where one value is needed; trace(...) takes one grasp, for example add "
        "`AND repeat = 0`."
    ),
    "Could not convert string 'B": "A batch is a number: write batch = 3 for B03.",
}


def run_sql(
    lake: Lake, sql: str, limits: Limits | None = None, on_deaf: Callable[[str], object] | None = None
) -> pa.Table:
    """Run one SELECT (also FROM, WITH, VALUES, DESCRIBE, SUMMARIZE, SHOW) and return its result.

    `on_deaf`: see `lake.query.limits`.

    Raises:
        OverLimitError: it took more time or memory than `limits`.
        UsageError: the text is not one reading statement, or DuckDB cannot make sense of it.
        LakeError: a file of the lake cannot be read.
    """
    check_reads_only(sql)
    for attempt in range(_ATTEMPTS):
        with lake.reading(sql) as engine:
            try:
                with limited(engine.connection, limits or Limits(), on_deaf):
                    return engine.read(sql)
            except duckdb.Error as error:
                if not isinstance(error, duckdb.IOException) or attempt + 1 == _ATTEMPTS:
                    raise UsageError(_sentence(engine.connection, error)) from error
    raise UsageError("The query was not answered; run it again.")


def _sentence(connection: duckdb.DuckDBPyConnection, error: duckdb.Error) -> str:
    """Say what is wrong with the query, where possible in the lake's own words instead of DuckDB's."""
    text = str(error)
    if isinstance(error, duckdb.PermissionException):
        match = re.search(r'"([^"]+)"', text)
        place = f" and not `{match[1]}`" if match else ""
        return f"SQL reads the tables and views of the lake only{place}; `fast sql` alone lists them."
    if isinstance(error, duckdb.TransactionException) or re.search(r"base table|is not an? table", text):  # but a view
        return "A statement that writes is not allowed here, the lake is read-only to SQL: use a SELECT statement."
    if match := re.search(r"Table with name (\S+) does not exist", text):
        return f"There is no table or view `{match[1]}`; {closest(match[1], _known_tables(connection))}"
    if match := re.search(r'(?:Referenced|have a) column (?:named )?"([^"]+)"', text):
        near = re.search(r"Candidate bindings: (.+)", text)
        candidates = re.findall(r'"([^"]+)"', near[1]) if near else []
        found = candidates or get_close_matches(match[1], _columns(connection), cutoff=0.4)
        names = ", ".join(found)
        hint = f"near names: {names}" if names else "`fast sql` alone lists the columns"
        return f"There is no column `{match[1]}` in what is queried (text would be '{match[1]}'); {hint}."
    return next((hint for part, hint in _HINTS.items() if part in text), f"The query failed: {text}")


def _known_tables(connection: duckdb.DuckDBPyConnection) -> list[str]:
    return [name for (name,) in connection.sql("SELECT view_name FROM duckdb_views() WHERE NOT internal").fetchall()]


def _columns(connection: duckdb.DuckDBPyConnection) -> list[str]:
    columns = connection.sql("SELECT DISTINCT column_name FROM duckdb_columns() WHERE NOT internal").fetchall()
    return [name for (name,) in columns if not name.startswith("_")]


def csv_bytes(table: pa.Table) -> bytes:
    """Write the table as CSV with a header; lists and structs as JSON text, since a CSV has plain values only."""
    buffer = io.BytesIO()
    csv.write_csv(_flat(table), buffer)
    return buffer.getvalue()


def exact(value: Any) -> Any:
    """Return a value as JSON has it: numbers with all digits, None for none (NaN), times as ISO 8601."""
    if value is None or isinstance(value, bool | int | str):
        return value
    if isinstance(value, float | Decimal):
        return float(value) if math.isfinite(value) else None
    if isinstance(value, list | tuple):
        return [exact(one) for one in value]
    if isinstance(value, dict):
        return {str(name): exact(one) for name, one in value.items()}
    return value.isoformat() if isinstance(value, date | time) else str(value)


def _flat(table: pa.Table) -> pa.Table:
    for place, field in enumerate(table.schema):
        if pa.types.is_nested(field.type):
            texts = [None if value is None else json.dumps(exact(value)) for value in table[place].to_pylist()]
            table = table.set_column(place, field.name, pa.array(texts, pa.string()))
    return table
