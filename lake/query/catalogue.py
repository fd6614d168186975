"""What `fast sql` can ask: every view, table and macro with its columns, without opening a lake."""

import re
from importlib.resources import files
from typing import Literal

import duckdb

from fast.lake.provenance import ProvenanceColumns
from fast.lake.query.engine import create_table, load_views
from fast.lake.tables.campaign import TABLE_BY_NAME, TABLES
from fast.lake.tables.schema import sql_columns
from fast.models.records import Record


class Entry(Record):
    """A name that SQL over the lake knows; `columns` of a macro are its parameters."""

    kind: Literal["view", "table", "macro"]
    name: str
    columns: tuple[str, ...]
    comment: str


def catalogue() -> list[Entry]:
    """List views, tables, macros, each by name, without the columns of provenance, which every table has."""
    comments = view_comments() | {name: row.__doc__ or "" for name, row in TABLE_BY_NAME.items()}
    with duckdb.connect(":memory:") as connection:
        for row_type in TABLES:
            connection.execute(create_table(row_type.table, sql_columns(row_type)))
        load_views(connection)
        found = connection.execute(
            "SELECT CASE WHEN table_name IN (SELECT view_name FROM duckdb_views()) THEN 'view' ELSE 'table' END, "
            "table_name, list(column_name ORDER BY column_index) FROM duckdb_columns() WHERE NOT internal GROUP BY ALL "
            "UNION ALL SELECT 'macro', function_name, parameters FROM duckdb_functions() WHERE NOT internal"
        ).fetchall()
    hidden = set(ProvenanceColumns.model_fields)
    entries = [
        Entry(
            kind=kind,
            name=name,
            columns=tuple(c for c in columns if c not in hidden),
            comment=_first_sentence(comments.get(name, "")),
        )
        for kind, name, columns in found
    ]
    return sorted(entries, key=lambda entry: (("view", "table", "macro").index(entry.kind), entry.name))


def view_comments() -> dict[str, str]:
    """Return the comment above each view and macro in `views.sql`."""
    text = files("fast.lake").joinpath("views.sql").read_text(encoding="utf-8")
    found = re.findall(r"((?:^-- .*\n)+)CREATE (?:VIEW|MACRO) (\w+)", text, flags=re.MULTILINE)
    return {name: " ".join(comment.replace("-- ", "").split()) for comment, name in found}


def _first_sentence(text: str) -> str:
    return re.split(r"(?<=[.;])(?<!Fig\.)\s", text.strip(), maxsplit=1)[0].rstrip(".;")
