"""Keeping a lake healthy: check and quarantine files, merge small ones, count what is there."""

import logging
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from datetime import UTC, datetime
from pathlib import Path
from typing import Literal, NamedTuple, get_args

import duckdb
import numpy as np
import pyarrow as pa

from fast.lake.order import OLDEST_FIRST
from fast.lake.query.engine import Signature, list_files
from fast.lake.storage.base import LEASES, MARKER, QUARANTINE, STAGED_MARKER, Entry, Storage
from fast.lake.storage.files import (
    FILE_PREFIX,
    FILE_SUFFIX,
    LEFTOVER_AGE_S,
    TEMPORARY_PREFIX,
    Fault,
    FaultKind,
    fault_of,
    file_name,
    number_of,
    read_rows,
    stage,
)
from fast.lake.store import Lake
from fast.lake.tables.campaign import TABLE_BY_NAME, TABLES, Row
from fast.lake.tables.schema import has_samples, schema_of

_LOG = logging.getLogger(__name__)
_OF_FAST = frozenset({"outputs", ".state", LEASES, ".lock"})  # no rows; the last is a lock of version 0.1
_OLD_TABLES = frozenset({"diagnostics", "simulation_branches"})  # of version 0.2: nothing reads them, their files stay
TARGET_BYTES = 64 * 2**20  # of a merged file, 14,000 traces; files over half of it are left alone
# Of a merged file before its stage ends: those of four tools. What is read at once stays small in memory.
LOOSE_BYTES = 2 * 2**20
_ALWAYS_MERGED = 16  # files below this part of the target are merged whatever the others are
_READ_AT_ONCE, _READERS = 50, 2
_NEEDS_SAMPLES = (
    # A peak that a person read off an instrument has no trace, and so no work.
    ("grasps", "traces", "grasp_id", "AND work_j IS NOT NULL"),
    ("simulations", "sim_traces", "simulation_id", ""),
    ("calibrations", "posterior_draws", "calibration_id", ""),
)

Kind = Literal[FaultKind, "foreign", "leftover", "incomplete"]
_STAYS = frozenset({"unreadable", "newer", "incomplete"})  # what a person or another program can still read, or no file


class Finding(NamedTuple):
    """One thing that `check` found; `moved_to` is where a file was set aside. Objects are named by their address."""

    kind: Kind
    path: Path | str
    message: str
    moved_to: Path | str | None = None

    @property
    def line(self) -> str:
        """The message, and where the file is now."""
        return f"{self.message} Now set aside: {self.moved_to}." if self.moved_to else self.message


class TableStats(NamedTuple):
    """What a table holds; `n_superseded` rows are kept but no query sees them."""

    table: str
    n_files: int
    n_rows: int
    n_superseded: int
    size_mb: float
    oldest: datetime | None
    newest: datetime | None


class Compaction(NamedTuple):
    """What `compact` did to a table."""

    table: str
    n_files_before: int
    n_files_after: int
    n_rows: int


def check(lake: Lake, *, quarantine: bool = False) -> list[Finding]:
    """Read every page of every file and name what does not belong.

    Kinds: `torn` (not a whole Parquet file, or a wrong checksum), `wrong_schema`, `unreadable` (the system
    refuses), `newer` (a newer program wrote it), `foreign` (not a file of the lake), `leftover` (temporary file
    of a process that died), `incomplete` (a good grasp or simulation without trace, a calibration without draws).

    With `quarantine`, files are moved to `quarantine/` in the lake, each beside a `.reason.json`; nothing is
    deleted. What is `unreadable` or `newer` may be whole, and stays.

    Raises:
        UsageError: files are to be moved and the lake cannot be written.
        LakeError: files are to be moved and the disk is full or broken; what was not moved is where it was.
    """
    findings = [*_foreign_entries(lake.storage)]
    for row_type in TABLES:
        findings += _file_findings(lake.storage, row_type)
    if quarantine:
        findings = [finding if finding.kind in _STAYS else _set_aside(lake.storage, finding) for finding in findings]
    if not any(finding.kind in get_args(FaultKind) and finding.moved_to is None for finding in findings):
        findings += _incomplete(lake)
    return findings


def compact(lake: Lake, table: type[Row] | str, target_bytes: int = TARGET_BYTES) -> Compaction:
    """Merge the small files of a table; every row stays, superseded ones too.

    The merged file is complete before the first small one goes, and rows that are in both count once, so
    a reader or a crash at any moment sees the same rows. Runs beside writers and readers.

    Raises:
        UsageError: the lake cannot be written.
        LakeError: the disk is full, or a file cannot be read; the small files are untouched.
    """
    row_type = TABLE_BY_NAME[table] if isinstance(table, str) else table
    folder = lake.root / row_type.table
    lake.storage.refresh([row_type.table])
    n_before = len(list_files(folder))
    n_rows = 0
    for group in _groups(list_files(folder), target_bytes):
        n_rows += _merge(lake.storage, row_type, group)
    pa.default_memory_pool().release_unused()  # all samples of the merged files went through it
    return Compaction(row_type.table, n_before, len(list_files(folder)), n_rows)


def compact_all(lake: Lake) -> None:
    """Merge the small files of every table, as `compact` does with one."""
    for row_type in TABLES:
        compact(lake, row_type)


def stats(lake: Lake) -> list[TableStats]:
    """List files, rows, size and age of every table."""
    return [_table_stats(lake, row_type) for row_type in TABLES]


def _table_stats(lake: Lake, row_type: type[Row]) -> TableStats:
    table = row_type.table
    held = lake.query(f"SELECT count(*) AS n, min(created_at) AS oldest, max(created_at) AS newest FROM raw_{table}")
    (row,) = held.to_pylist()
    (old,) = lake.query(f"SELECT count(*) AS n FROM superseded_{table}").to_pylist()
    files = list_files(lake.root / table)
    size_mb = sum(size for _, size, _ in files.values()) / 2**20
    return TableStats(table, len(files), row["n"] - old["n"], old["n"], size_mb, row["oldest"], row["newest"])


def _groups(files: dict[str, Signature], target_bytes: int) -> Iterator[dict[str, Signature]]:
    """Yield small files in groups of at most the target size; leave one file alone as it is."""
    chosen = _small_files(files, target_bytes)
    group: dict[str, Signature] = {}
    size = 0
    for name, signature in sorted(files.items(), key=lambda item: (number_of(item[0]), item[1])):
        if name not in chosen:
            continue
        if size + signature[1] > target_bytes and len(group) > 1:
            yield group
            group, size = {}, 0
        group[name] = signature
        size += signature[1]
    if len(group) > 1:
        yield group


def _small_files(files: dict[str, Signature], target_bytes: int) -> set[str]:
    """Find files worth merging, the largest no larger than all others together, so a row is written few times."""
    names = sorted((name for name in files if files[name][1] < target_bytes // 2), key=lambda name: files[name][1])
    n_chosen = total = 0
    for n_smaller, name in enumerate(names):
        size = files[name][1]
        if size <= max(total, target_bytes // _ALWAYS_MERGED):
            n_chosen = n_smaller + 1
        total += size
    return set(names[:n_chosen])


def _merge(storage: Storage, row_type: type[Row], group: dict[str, Signature]) -> int:
    """Replace the files of a group by one; returns its number of rows, 0 if another process was faster."""
    folder = storage.root / row_type.table
    try:
        merged = _read_merged(folder, row_type, list(group))
    except FileNotFoundError:
        _LOG.info("another process is merging %s; left to it", folder)
        return 0
    final = folder / file_name(merged, ignore=_samples_of(row_type))
    storage.publish(stage(folder, merged, row_type.table), final)
    storage.remove(folder, [name for name in group if name != final.name])
    return merged.num_rows


def _read_merged(folder: Path, row_type: type[Row], names: list[str]) -> pa.Table:
    """Read all rows of the files in their order and by id, with today's columns, exact copies once.

    Rows of one tool, batch and campaign stay together, so that a question about one of them reads few row groups.
    """
    schema, key = schema_of(row_type), row_type.id_column()
    parts = [schema.empty_table()]
    with ThreadPoolExecutor(_READERS) as pool:
        for first in range(0, len(names), _READ_AT_ONCE):
            paths = [folder / name for name in names[first : first + _READ_AT_ONCE]]
            read = list(pool.map(lambda path: read_rows(path, row_type), paths))
            # A thousand chunks of a row each take longer to write than to copy together.
            parts.append(pa.concat_tables(read).combine_chunks())
    rows = pa.concat_tables(parts)
    index = rows.select([key, "sequence", "created_at"]).append_column("place", pa.array(np.arange(rows.num_rows)))
    with duckdb.connect(":memory:") as connection:
        connection.register("merged_rows", index)
        copies = f"SELECT min(place) AS place FROM merged_rows GROUP BY {key}, sequence, created_at"
        places = connection.sql(f"{copies} ORDER BY {OLDEST_FIRST}, {key}").to_arrow_table()["place"].to_numpy()
    if np.array_equal(places, np.arange(rows.num_rows)):
        return rows  # as they mostly come: no second copy of the samples in memory
    return rows.take(pa.array(places))


def _samples_of(row_type: type[Row]) -> frozenset[str]:
    """Return columns of samples: ids and numbers tell merged files apart; hashing all takes as long as writing."""
    lists = frozenset(field.name for field in schema_of(row_type) if pa.types.is_list(field.type))
    return lists if has_samples(row_type) else frozenset()


def _foreign_entries(storage: Storage) -> Iterator[Finding]:
    known = {MARKER, QUARANTINE, *_OF_FAST, *_OLD_TABLES, *TABLE_BY_NAME}
    for entry in storage.entries():
        if entry.name.startswith(STAGED_MARKER):
            yield from _leftover(entry)
        elif entry.name not in known:
            yield Finding("foreign", entry.place, f"{entry.place} is not part of the lake; move it elsewhere.")


def _file_findings(storage: Storage, row_type: type[Row]) -> Iterator[Finding]:
    folder = storage.root / row_type.table
    try:
        storage.refresh([row_type.table], anew=True)
        entries = storage.entries(row_type.table)
    except OSError as error:
        fault = Fault("unreadable", f"cannot be read ({error.strerror})")
        yield Finding(fault.kind, folder, f"{folder} {fault.sentence}; {fault.remedy}.")
        return
    for entry in entries:
        place = entry.place
        if entry.name.startswith(TEMPORARY_PREFIX):
            yield from _leftover(entry)
        elif not entry.is_file or not (entry.name.startswith(FILE_PREFIX) and entry.name.endswith(FILE_SUFFIX)):
            sentence = f"{place} was not written by the lake, readers ignore it; move it elsewhere."
            yield Finding("foreign", place, sentence)
        elif found := fault_of(folder / entry.name, row_type, whole=True):
            then = "" if found.kind in _STAYS else ", then redo its work"
            yield Finding(found.kind, place, f"{place} {found.sentence}; {found.remedy}{then}.")


def _leftover(entry: Entry) -> Iterator[Finding]:
    if time.time() - entry.modified_s > LEFTOVER_AGE_S:
        yield Finding(
            "leftover", entry.place, f"{entry.place} was left by a process that died; its rows were never visible."
        )


def _set_aside(storage: Storage, finding: Finding) -> Finding:
    """Move a file to the quarantine, its reason first: what is there always says why."""
    reason = {
        "kind": finding.kind,
        "message": finding.message,
        "moved_from": str(finding.path),
        "moved_at": datetime.now(UTC).isoformat(timespec="seconds"),
    }
    return finding._replace(moved_to=storage.set_aside(finding.path, reason))


def _incomplete(lake: Lake) -> Iterator[Finding]:
    for scalars, samples, key, unless in _NEEDS_SAMPLES:
        # Of traces the index has the ids, and need not be read.
        held = f"raw_{samples}" if TABLE_BY_NAME[samples].id_column() == key else samples
        sql = f"SELECT {key} FROM {scalars} WHERE status = 'ok' {unless} EXCEPT SELECT {key} FROM {held} ORDER BY {key}"
        for row_id in lake.query(sql).column(0).to_pylist():
            path = lake.storage.place(scalars)
            yield Finding("incomplete", path, f"`{row_id}` of `{scalars}` has no row in `{samples}`; redo it.")
