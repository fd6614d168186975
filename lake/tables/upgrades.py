"""Copies, with today's columns, of the files that an older program wrote.

Readers use the copy in place of the file. Copies are made when first asked for, and hold nothing that the file does
not: they are kept in `.state/upgraded/` of the lake, which may be removed at any time, or in a temporary folder where
the lake cannot be written. `fast lake compact` rewrites the files themselves, so that no copy is needed any more.
"""

import os
import shutil
import tempfile
import uuid
import weakref
from pathlib import Path

import duckdb
import pyarrow as pa

from fast.lake.storage.files import FILE_PREFIX, FILE_SUFFIX, Fault, publish, reading_fault, schema_fault, stage
from fast.lake.tables.migrations import VERSION_KEY, file_version, migrated, table_version, version_number
from fast.lake.tables.row import Row
from fast.lake.tables.schema import schema_of
from fast.models.errors import FastError, LakeError

_COPIES = Path(".state", "upgraded")


class Upgrades:
    """Where one reader of the lake in the folder `root` finds the copies."""

    def __init__(self, root: Path) -> None:
        self._kept = root.resolve() / _COPIES
        self.temporary = Path(tempfile.gettempdir()).resolve() / f"fast-lake-{uuid.uuid4().hex}"
        weakref.finalize(self, _remove_own, self.temporary, os.getpid())

    @property
    def folders(self) -> list[Path]:
        """Where copies are."""
        return [self._kept, self.temporary]

    def copies(self, connection: duckdb.DuckDBPyConnection, row_type: type[Row], paths: list[Path]) -> dict[str, Path]:
        """Copy to read in place of a file, by file name; files of today's version need none.

        Raises:
            LakeError: a newer program wrote a file, or the rows of an older one cannot be read.
            duckdb.Error: a file is damaged, or gone.
            FileNotFoundError: a file is gone.
        """
        today = table_version(row_type.table)
        other = [path for path, version in _versions(connection, paths) if version != today]
        return {path.name: self._copy(path, row_type) for path in other}

    def _copy(self, path: Path, row_type: type[Row]) -> Path:
        place = Path(row_type.table, f"v{table_version(row_type.table)}", path.name)
        copy = self._kept / place
        if copy.is_file() and copy.stat().st_mtime_ns > path.stat().st_mtime_ns:
            return copy
        rows = read_upgraded(path, row_type)
        try:
            return _write(copy, rows, row_type)
        except FastError:
            return _write(self.temporary / place, rows, row_type)


def read_upgraded(path: Path, row_type: type[Row]) -> pa.Table:
    """All rows of a file with today's columns; a nullable column that it lacks is empty.

    Raises:
        LakeError: the file cannot be read, or its columns are not those of the table; the message names it.
        FileNotFoundError: it is gone.
    """
    import pyarrow.parquet as pq  # 40 ms that a command which asks DuckDB alone does not need

    schema = schema_of(row_type)
    try:
        with pq.ParquetFile(path, page_checksum_verification=True) as file:
            if _is_of_today(file.schema_arrow, row_type):
                return file.read(use_threads=False).replace_schema_metadata(schema.metadata)
            fault = schema_fault(file.schema_arrow, row_type)
            rows = file.schema_arrow.empty_table() if fault else file.read(use_threads=False)
    except FileNotFoundError:
        raise
    except (OSError, pa.ArrowException) as error:
        raise _unusable(path, reading_fault(error)) from error
    if fault:
        raise _unusable(path, fault)
    full = pa.concat_tables([schema.empty_table(), migrated(rows, row_type.table)], promote_options="default")
    return full.select(schema.names).cast(schema)


def _is_of_today(schema: pa.Schema, row_type: type[Row]) -> bool:
    """True when nothing need be changed: to find that out takes a tenth of the time of changing nothing."""
    return file_version(schema) == table_version(row_type.table) and bool(schema.equals(schema_of(row_type)))


def older_files(folder: Path, row_type: type[Row]) -> set[str]:
    """Names of the files that an older program wrote; damaged ones are not looked into."""
    today = table_version(row_type.table)
    found: set[str] = set()
    if today == 1:
        return found
    import pyarrow.parquet as pq

    for path in folder.glob(f"{FILE_PREFIX}*{FILE_SUFFIX}"):
        try:
            if file_version(pq.read_schema(path)) < today:
                found.add(path.name)
        except (OSError, pa.ArrowException):
            continue
    return found


def forget_copies(root: Path, row_type: type[Row]) -> None:
    """Remove the copies of a table whose files have been rewritten; a reader that still has one looks again."""
    shutil.rmtree(root / _COPIES / row_type.table, ignore_errors=True)


def _remove_own(folder: Path, process_id: int) -> None:
    """Remove a temporary folder, but not from a process that was forked by its owner."""
    if os.getpid() == process_id:
        shutil.rmtree(folder, ignore_errors=True)


def _unusable(path: Path, fault: Fault) -> LakeError:
    return LakeError(f"{path} {fault.sentence}: {fault.remedy}.")


def _write(copy: Path, rows: pa.Table, row_type: type[Row]) -> Path:
    publish(stage(copy.parent, rows, row_type.table), copy)
    return copy


def _versions(connection: duckdb.DuckDBPyConnection, paths: list[Path]) -> list[tuple[Path, int]]:
    """Schema version of each file."""
    by_name = {path.name: path for path in paths}
    sql = (
        "SELECT parse_filename(file_name), max(CASE WHEN decode(key) = ? THEN decode(value) END) "
        "FROM parquet_kv_metadata(?) GROUP BY 1"
    )
    found = dict(connection.execute(sql, [VERSION_KEY, [str(path) for path in paths]]).fetchall())
    return [(path, version_number(found.get(name))) for name, path in by_name.items()]
