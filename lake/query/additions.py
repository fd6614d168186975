"""What came to a table since one last looked: for what is derived from many rows, and asked for after each."""

from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

from lake.query.engine import Mark
from lake.store import Lake
from lake.tables.campaign import Row


class Additions(NamedTuple):
    """Rows of a table that came since a mark, oldest first, each with when it came (us since 1970) before its columns.

    A row with a known id supersedes it, unless it is older. `is_all`: these are all rows there are, since there was no
    mark, or since files went away (they were merged, say) and what is held must be made anew.
    """

    mark: Mark
    rows: Iterable[tuple[Any, ...]]
    is_all: bool


def mark_of(lake: Lake, table: type[Row]) -> Mark:
    """How far the lake goes now: the same mark again says that nothing came to the table, and nothing went.

    Raises:
        LakeError: the lake cannot be read.
    """
    with lake.reading_raw(table) as engine:
        return engine.mark(table.table)


def additions(lake: Lake, table: type[Row], columns: Sequence[str], since: Mark | None) -> Additions:
    """The columns of all rows that came since `since`; of a table of traces only the id can be had.

    Raises:
        LakeError: the lake cannot be read.
    """
    raw = f"raw_{table.table}"
    with lake.reading_raw(table) as engine:
        mark = engine.mark(table.table)
        if mark == since:
            return Additions(mark, (), False)
        is_all = since is None or not mark.follows(since)
        first = 0 if is_all or since is None else since.next_number
        chosen = ", ".join(f'"{name}"' for name in columns)
        found = engine.read(
            f"SELECT epoch_us(created_at) AS created_us, {chosen} FROM {raw} WHERE _file >= $1 "
            "ORDER BY created_at, _file, _row",
            [first],
        )
    return Additions(mark, zip(*(column.to_pylist() for column in found.columns), strict=True), is_all)
