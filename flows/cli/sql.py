"""`fast sql`: read-only questions to the lake."""

import io
import json
import os
import sys
import textwrap
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter
from cyclopts.validators import Number

from fast.flows.cli.campaign import open_lake
from fast.flows.cli.common import DEFAULT_LAKE, AsJson, LakePath, say, say_progress, show, table_text, write_out
from fast.models.errors import UsageError
from fast.models.units import spell_count

if TYPE_CHECKING:
    import pyarrow as pa

    from fast.lake.query.catalogue import Entry

_WIDTH = 110
_STDIN = "-"

Format = Literal["table", "csv", "json", "parquet"]


def sql(
    query: Annotated[
        str | None,
        Parameter(
            help='One SELECT statement, e.g. "FROM tool_quality"; - reads it from standard input; '
            "without one: lists views, tables and macros.",
            allow_leading_hyphen=True,
        ),
    ] = None,
    *,
    lake: LakePath = DEFAULT_LAKE,
    format: Annotated[
        Format | None, Parameter(help="How rows are written; default: what the suffix of --out says, else table.")
    ] = None,
    out: Annotated[
        Path | None, Parameter(help="File to write, or to replace, instead of the screen; needed for parquet.")
    ] = None,
    limit_s: Annotated[float, Parameter(help="Seconds that the query may take.", validator=Number(gt=0))] = 120.0,
    limit_mb: Annotated[
        float, Parameter(help="Memory that the whole command may hold, in MB.", validator=Number(gt=0))
    ] = 4000.0,
    json: AsJson = False,
) -> None:
    """Run one SELECT over the lake's tables, views and macros; without a query, list them."""
    from fast.lake.query.limits import Limits
    from fast.lake.query.sql import run_sql

    if query is None:
        if format or out:
            raise UsageError("--format and --out need a query; give one, or `-` to read it from standard input.")
        _list_names(json)
        return
    if json and format not in (None, "json"):
        raise UsageError(f"--json and --format {format} contradict each other; give one of them.")
    chosen: Format = "json" if json else format or _format_of(out)
    if chosen == "parquet" and out is None:
        raise UsageError("--format parquet is binary and needs a file; add --out FILE.parquet.")
    limits = Limits(limit_s, limit_mb)
    table = run_sql(open_lake(lake), sys.stdin.read() if query == _STDIN else query, limits, _end_at_once)
    content = _formatted(table, chosen)
    if out is None:
        say(content.decode().rstrip("\n"))
        return
    write_out("--out", out, content)
    say_progress(f"{spell_count(table.num_rows, 'row')} written to {out}")


def _end_at_once(sentence: str) -> None:
    """End the command from beside a query that hears nothing; there is nothing to tidy up."""
    say_progress(f"fast: {sentence}")
    os._exit(1)


def _format_of(out: Path | None) -> Format:
    """Format that the suffix of a file stands for; a table for the screen and for other suffixes."""
    by_suffix: dict[str, Format] = {".csv": "csv", ".json": "json", ".parquet": "parquet"}
    return by_suffix.get(out.suffix.lower(), "table") if out else "table"


def _list_names(as_json: bool) -> None:
    from fast.lake.query.catalogue import catalogue

    entries = catalogue()
    groups = [
        "\n".join([f"{kind}s", *(_entry_text(entry) for entry in group)])
        for kind, group in groupby(entries, key=lambda entry: entry.kind)
    ]
    groups.append("Every table also has code_version, code_dirty, config_hash, seed, parents, created_at, sequence.")
    show([entry.model_dump() for entry in entries], "\n\n".join(groups), as_json)


def _entry_text(entry: "Entry") -> str:
    columns = ", ".join(entry.columns)
    name = f"{entry.name}({columns})" if entry.kind == "macro" else entry.name
    lines = [f"  {name}: {entry.comment}"]
    if entry.kind != "macro":
        lines += textwrap.wrap(columns, _WIDTH, initial_indent=" " * 6, subsequent_indent=" " * 6)
    return "\n".join(lines)


def _formatted(table: "pa.Table", chosen: Format) -> bytes:
    from fast.lake.query.sql import csv_bytes, exact

    if chosen == "csv":
        return csv_bytes(table)
    if chosen == "parquet":
        from pyarrow import parquet

        buffer = io.BytesIO()
        parquet.write_table(table, buffer)
        return buffer.getvalue()
    rows = table.to_pylist()
    text = json.dumps(exact(rows), indent=2) if chosen == "json" else table_text(rows, table.column_names)
    return text.encode()
