"""Keeping a lake healthy: check and quarantine files, merge small ones, count what is there."""

import logging
import os
import time
from collections.abc import Iterator
from datetime import datetime
from pathlib import Path
from typing import Literal, NamedTuple

import duckdb
import pyarrow as pa
import pyarrow.parquet as pq

from lake.engine import Signature, list_files
from lake.files import (
    FILE_PREFIX,
    FILE_SUFFIX,
    LOCK_NAME,
    TEMPORARY_PREFIX,
    fault_of,
    file_name,
    locked,
    make_folder,
    publish,
    schema_fault,
    stage,
    sync_folder,
    writing_failed,
)
from lake.schema import schema_of
from lake.store import MARKER, Lake
from lake.tables import TABLE_BY_NAME, TABLES, GraspRow, Row, SimTraceRow, SimulationRow, TraceRow
from models.errors import LakeError

_LOG = logging.getLogger(__name__)
QUARANTINE = "quarantine"
_OF_FAST = frozenset({"outputs", ".state"})  # what people read, and what can be made again; no rows
TARGET_BYTES = 16 * 2**20  # of a merged file, some thousand traces; files over half of it are left alone
_REMOVED_AT_ONCE = 100  # writers wait meanwhile
_LEFTOVER_AGE_S = 3600.0  # a temporary file this old belongs to a process that died

Kind = Literal["torn", "wrong_schema", "foreign", "leftover", "incomplete"]


class Finding(NamedTuple):
    """One thing that `check` found; `moved_to` is where a file was set aside."""

    kind: Kind
    path: Path
    message: str
    moved_to: Path | None = None


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

    Kinds: `torn` (not a whole Parquet file, or a wrong checksum), `wrong_schema`, `foreign` (not a file of
    the lake), `leftover` (temporary file of a process that died), `incomplete` (a good grasp or simulation
    without trace). With `quarantine`, files are moved to `quarantine/` in the lake; nothing is deleted.

    Raises:
        UsageError: files are to be moved and the lake cannot be written.
    """
    findings = [*_foreign_entries(lake.root)]
    for row_type in TABLES:
        findings += _file_findings(lake.root / row_type.table, row_type)
    if quarantine:
        findings = [_set_aside(lake.root, finding) for finding in findings]
    if not any(finding.kind in ("torn", "wrong_schema") and finding.moved_to is None for finding in findings):
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
    n_before = len(list_files(folder))
    n_rows = 0
    for group in _groups(list_files(folder), target_bytes):
        n_rows += _merge(lake.root, row_type, group)
    return Compaction(row_type.table, n_before, len(list_files(folder)), n_rows)


def stats(lake: Lake) -> list[TableStats]:
    """Files, rows, size and age of every table."""
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
    """Small files in groups of about the target size; a group of one is left alone."""
    group: dict[str, Signature] = {}
    size = 0
    for name, signature in sorted(files.items(), key=lambda item: item[1]):
        if signature[1] >= target_bytes // 2:
            continue
        group[name] = signature
        size += signature[1]
        if size >= target_bytes:
            yield group
            group, size = {}, 0
    if len(group) > 1:
        yield group


def _merge(root: Path, row_type: type[Row], group: dict[str, Signature]) -> int:
    """Replace the files of a group by one; returns its number of rows, 0 if another process was faster."""
    folder = root / row_type.table
    try:
        merged = _read_merged(folder, row_type, sorted(group))
    except FileNotFoundError:
        _LOG.info("another process is merging %s; left to it", folder)
        return 0
    final = folder / file_name(merged)
    publish(stage(folder, merged, row_type.table), final)
    merged_away = [name for name in group if name != final.name]
    for first in range(0, len(merged_away), _REMOVED_AT_ONCE):
        _remove(root, folder, {name: group[name] for name in merged_away[first : first + _REMOVED_AT_ONCE]})
    return merged.num_rows


def _remove(root: Path, folder: Path, files: dict[str, Signature]) -> None:
    """Remove files that were merged, but for those that were written again since."""
    with locked(root, exclusive=True):
        now = list_files(folder)
        for name, signature in files.items():
            if now.get(name) == signature:
                (folder / name).unlink(missing_ok=True)
        sync_folder(folder)


def _read_merged(folder: Path, row_type: type[Row], names: list[str]) -> pa.Table:
    """All rows of the files by id and time, exact copies once, columns that a file lacks empty."""
    schema, key = schema_of(row_type), row_type.id_column()
    tables = []
    for name in names:
        try:
            with pq.ParquetFile(folder / name, page_checksum_verification=True) as file:
                fault = schema_fault(file.schema_arrow, row_type)
                tables.append(file.read(use_threads=False))
        except FileNotFoundError:
            raise
        except (OSError, pa.ArrowException) as error:
            fault = f"is not a whole Parquet file ({str(error).splitlines()[0]})"
        if fault:
            raise LakeError(f"{folder / name} {fault}; run `fast lake check --quarantine`, then compact again.")
    rows = pa.concat_tables([schema.empty_table(), *tables], promote_options="default")
    with duckdb.connect(":memory:") as connection:
        connection.register("merged_rows", rows.select([key, "created_at"]).append_column("place", _places(rows)))
        places = connection.sql(
            f"SELECT min(place) AS place FROM merged_rows GROUP BY {key}, created_at ORDER BY {key}, created_at"
        ).to_arrow_table()
    return rows.take(places["place"]).select(schema.names).cast(schema).combine_chunks()


def _places(rows: pa.Table) -> pa.Array:
    return pa.array(range(rows.num_rows), type=pa.int64())


def _foreign_entries(root: Path) -> Iterator[Finding]:
    known = {MARKER, LOCK_NAME, QUARANTINE, *_OF_FAST, *TABLE_BY_NAME}
    for entry in sorted(root.iterdir()):
        if entry.name not in known and not entry.name.startswith(f".{MARKER}."):
            yield Finding("foreign", entry, f"{entry} is not part of the lake; move it elsewhere.")


def _file_findings(folder: Path, row_type: type[Row]) -> Iterator[Finding]:
    for path in sorted(folder.iterdir()) if folder.is_dir() else []:
        if path.name.startswith(TEMPORARY_PREFIX):
            if _age_s(path) > _LEFTOVER_AGE_S:
                yield Finding("leftover", path, f"{path} was left by a process that died; its rows were never visible.")
        elif not path.is_file() or not (path.name.startswith(FILE_PREFIX) and path.name.endswith(FILE_SUFFIX)):
            yield Finding("foreign", path, f"{path} was not written by the lake, readers ignore it; move it elsewhere.")
        else:
            fault = fault_of(path, row_type, whole=True)
            if fault:
                kind: Kind = "torn" if fault[0] == "torn" else "wrong_schema"
                yield Finding(kind, path, f"{path} {fault[1]}; set it aside with --quarantine, then redo its work.")


def _age_s(path: Path) -> float:
    try:
        return time.time() - path.stat().st_mtime
    except FileNotFoundError:
        return 0.0  # it was given its name meanwhile


def _set_aside(root: Path, finding: Finding) -> Finding:
    if finding.kind == "incomplete":
        return finding
    target = root / QUARANTINE / finding.path.relative_to(root)
    try:
        make_folder(target.parent)
        while target.exists():
            target = target.with_name(f"{target.name}.again")
        os.replace(finding.path, target)
        sync_folder(target.parent)
        sync_folder(finding.path.parent)
    except OSError as error:
        raise writing_failed(root, error) from error
    return finding._replace(moved_to=target)


def _incomplete(lake: Lake) -> Iterator[Finding]:
    pairs: tuple[tuple[type[Row], type[Row]], ...] = ((GraspRow, TraceRow), (SimulationRow, SimTraceRow))
    for scalars, samples in pairs:
        for row_id in sorted(lake.ids(scalars, status="ok") - lake.ids(samples)):
            folder = lake.root / scalars.table
            yield Finding(
                "incomplete", folder, f"`{row_id}` of `{scalars.table}` has no row in `{samples.table}`; redo it."
            )
