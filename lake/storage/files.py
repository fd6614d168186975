"""Whole files or none: Parquet files are written under a temporary name, synced and renamed."""

import errno
import hashlib
import os
import re
import uuid
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, Literal, NamedTuple

import pyarrow as pa

from fast.lake.tables.campaign import TABLE_BY_NAME, Row
from fast.lake.tables.schema import SCHEMA_VERSION, VERSION_KEY, has_samples, schema_of
from fast.models.errors import FastError, LakeError, UsageError, describe_cause

FILE_PREFIX = "rows-"  # what readers look at; temporary and foreign files are named otherwise
FILE_SUFFIX = ".parquet"
_NUMBERED = re.compile(rf"{FILE_PREFIX}([0-9a-f]{{12}})-[0-9a-f]+{re.escape(FILE_SUFFIX)}")
TEMPORARY_PREFIX = ".writing-"
LEFTOVER_AGE_S = 3600.0  # a temporary file this old belongs to a process that died
NOT_CONTENT = frozenset({"created_at", "sequence", "code_version", "code_dirty"})  # how rows came, not what they say
_ROW_GROUP_OF_TRACES = 512  # dictionaries of samples are shared by many grasps, one trace is still decoded in 15 ms
_ROW_GROUP = 122_880  # of scalars: what one thread of DuckDB takes at a time
_FALSE_HITS = 1e-3  # rows are in the order of time: an id is found by Bloom filter, a kilobyte for 512 of them
_ZSTD_LEVEL = 3
FORBIDDEN = {errno.EACCES, errno.EPERM, errno.EROFS, errno.ENOTDIR, errno.EEXIST, errno.ENOENT}


def file_name(table: pa.Table, ignore: frozenset[str] = frozenset()) -> str:
    """Name a file: the largest number of the rows (`lake.order`), a digest of the columns not in `ignore`."""
    kept = table.select([name for name in table.column_names if name not in ignore])
    digest = hashlib.sha256()
    with pa.ipc.new_stream(_Hasher(digest), kept.schema.remove_metadata()) as stream:
        stream.write_table(kept)
    import pyarrow.compute as pc  # as with Parquet: only who writes pays for it

    number = pc.max(table["sequence"]).as_py() or 0
    return f"{FILE_PREFIX}{number:012x}-{digest.hexdigest()[:24]}{FILE_SUFFIX}"


def number_of(name: str) -> int:
    """Read the number in the name of a file of rows; 0 in one of an older program."""
    found = _NUMBERED.fullmatch(name)
    return int(found[1], 16) if found else 0


def older_copies(name: str, others: Iterable[str]) -> list[str]:
    """List those of `others` whose name says that they hold the same rows as `name`, appended before."""
    digest = name.rpartition("-")[2]
    return [other for other in others if other != name and other.rpartition("-")[2] == digest]


def stage(folder: Path, table: pa.Table, table_name: str) -> Path:
    """Write `table` to a synced temporary file in `folder`, which is made if missing.

    Raises:
        UsageError: the folder cannot be written.
        LakeError: the disk is full or broken; the partial file is removed.
    """
    temporary = folder / f"{TEMPORARY_PREFIX}{os.getpid()}-{uuid.uuid4().hex}"
    try:
        make_folder(folder)
        with temporary.open("xb") as file:
            _write_parquet(table, file, table_name)
            file.flush()
            os.fsync(file.fileno())
    except OSError as error:
        discard([temporary])
        raise writing_failed(folder, error) from error
    return temporary


def publish(staged: Path, final: Path) -> None:
    """Give a staged file its name, at once for every reader, and make that last.

    Raises:
        LakeError: the rename failed, and the staged file is removed; or it may not survive a power cut.
    """
    try:
        os.replace(staged, final)
        sync_folder(final.parent)
    except OSError as error:
        discard([staged])
        raise LakeError(
            f"A file of {final.parent} could not be given its name for good ({error.strerror}); earlier rows are "
            "untouched, those of this call may be missing: free disk space or repair the disk, then run the same "
            "command again, which duplicates nothing."
        ) from error


def read_row(path: Path, row: int, columns: list[str]) -> dict[str, Any] | None:
    """Read columns of one row of a file, of which only the row group is read; None if the file has fewer rows.

    Raises:
        OSError: the file is gone or cannot be read.
    """
    import pyarrow.parquet as pq  # 40 ms that a command which asks DuckDB alone does not need

    with pq.ParquetFile(path) as file:
        for group in range(file.num_row_groups):
            n_rows = file.metadata.row_group(group).num_rows
            if row < n_rows:
                rows = file.read_row_group(group, columns=columns, use_threads=False)
                (found,) = rows.slice(row, 1).to_pylist()
                return dict(found)
            row -= n_rows
    return None


FaultKind = Literal["torn", "unreadable", "wrong_schema", "newer"]
_REMEDIES: Mapping[FaultKind, str] = {
    "torn": "run `fast lake check --quarantine` to set the file aside",
    "unreadable": "change its permissions or repair the disk",
    "wrong_schema": "run `fast lake check --quarantine` to set the file aside",
    "newer": "update the program",
}


class Fault(NamedTuple):
    """What is wrong with a file; `sentence` follows its path."""

    kind: FaultKind
    sentence: str

    @property
    def remedy(self) -> str:
        """What to do about it."""
        return _REMEDIES[self.kind]


def fault_of(path: Path, row_type: type[Row], *, whole: bool) -> Fault | None:
    """Say what is wrong with a file of a table, or None.

    Looks at the footer alone, or with `whole` at every page and its checksum.
    """
    import pyarrow.parquet as pq

    try:
        with pq.ParquetFile(path, page_checksum_verification=True) as file:
            schema = file.schema_arrow
            if whole:
                for _ in file.iter_batches(batch_size=_ROW_GROUP_OF_TRACES):
                    continue
    except FileNotFoundError:
        return None  # merged into another file since it was listed
    except (OSError, pa.ArrowException) as error:
        return reading_fault(error)
    return schema_fault(schema, row_type)


def reading_fault(error: OSError | pa.ArrowException) -> Fault:
    """Return the fault behind an error of reading: the system refused, or what is there is no whole file."""
    first_line = str(error).splitlines()[0]
    if isinstance(error, OSError) and error.errno is not None:
        return Fault("unreadable", f"cannot be read ({os.strerror(error.errno)})")
    return Fault("torn", f"is not a whole Parquet file ({first_line})")


def schema_fault(schema: pa.Schema, row_type: type[Row]) -> Fault | None:
    """Say how the schema of a file differs from its table's, or None; a nullable column may be missing."""
    version = version_number((schema.metadata or {}).get(VERSION_KEY.encode(), b"").decode())
    if version > SCHEMA_VERSION:
        return newer_fault(version, row_type)
    sentence = _column_fault(schema, schema_of(row_type))
    return Fault("wrong_schema", sentence) if sentence else None


def newer_fault(version: int, row_type: type[Row]) -> Fault:
    """Make the fault of a file that a newer program wrote."""
    known = f"this program reads up to {SCHEMA_VERSION}"
    return Fault("newer", f"has schema version {version} of the table `{row_type.table}`, {known}")


def version_number(text: str | None) -> int:
    """Read the version in the metadata of a file; 1 where there is none."""
    return int(text) if text and text.isdigit() else 1


def unusable(path: Path, fault: Fault) -> LakeError:
    """Make the error of a file that cannot be used."""
    return LakeError(f"{path} {fault.sentence}: {fault.remedy}.")


def read_rows(path: Path, row_type: type[Row]) -> pa.Table:
    """Read all rows of a file with today's columns; a nullable column that it lacks is empty.

    Raises:
        LakeError: the file cannot be read, or its columns are not those of the table; the message names it.
        FileNotFoundError: it is gone.
    """
    import pyarrow.parquet as pq  # 40 ms that a command which asks DuckDB alone does not need

    schema = schema_of(row_type)
    try:
        with pq.ParquetFile(path, page_checksum_verification=True) as file:
            fault = schema_fault(file.schema_arrow, row_type)
            if fault:
                raise unusable(path, fault)
            rows = file.read(use_threads=False)
    except FileNotFoundError:
        raise
    except (OSError, pa.ArrowException) as error:
        raise unusable(path, reading_fault(error)) from error
    if rows.schema.equals(schema):  # else a tenth of the time is spent on changing nothing
        return rows.replace_schema_metadata(schema.metadata)
    return pa.concat_tables([schema.empty_table(), rows], promote_options="default").select(schema.names).cast(schema)


def _column_fault(held: pa.Schema, wanted: pa.Schema) -> str | None:
    for field in wanted:
        if field.name not in held.names and not field.nullable:
            return f"lacks the column `{field.name}`"
        if field.name in held.names and held.field(field.name).type != field.type:
            return f"has `{field.name}` as {held.field(field.name).type}, it must be {field.type}"
    unknown = [name for name in held.names if name not in wanted.names]
    return f"has the unknown column `{unknown[0]}`" if unknown else None


def write_file(path: Path, content: bytes) -> None:
    """Write a file so that readers see it whole, or the older one of its name; a device or a pipe is written to.

    Raises:
        OSError: the disk is full or broken, or the folder closed.
    """
    if path.exists() and not path.is_file():
        path.write_bytes(content)
        return
    final = path.resolve()  # a link stays one
    staged = final.with_name(f"{TEMPORARY_PREFIX}{os.getpid()}-{final.name}")
    try:
        staged.write_bytes(content)
        os.replace(staged, final)
    except OSError:
        discard([staged])
        raise


def discard(files: list[Path]) -> None:
    """Remove files that may not exist; one that cannot be removed is left for `fast lake check`."""
    for file in files:
        try:
            file.unlink(missing_ok=True)
        except OSError:
            continue


def make_folder(folder: Path) -> None:
    """Make a folder and its parents, durably."""
    if folder.is_dir():
        return
    make_folder(folder.parent)
    folder.mkdir(exist_ok=True)
    sync_folder(folder.parent)


def write_synced(path: Path, text: str) -> None:
    """Write a text file durably, or none."""
    try:
        with path.open("w", encoding="utf-8") as file:
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
    except OSError:
        discard([path])
        raise


def sync_folder(folder: Path) -> None:
    """Force the names in a folder to disk."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def writing_failed(folder: Path, error: OSError) -> FastError:
    """Make the sentence for a folder that could not be written."""
    if error.errno in FORBIDDEN:
        return UsageError(
            f"{folder} cannot be written ({describe_cause(error)}); nothing was written: "
            "give another folder with --lake, or change its permissions."
        )
    return LakeError(
        f"Writing to {folder} failed ({error.strerror}); no row of this call is visible, earlier rows are "
        "untouched: free disk space or repair the disk, then run the same command again."
    )


def _write_parquet(table: pa.Table, file: object, table_name: str) -> None:
    import pyarrow.parquet as pq

    row_type = TABLE_BY_NAME[table_name]
    layout: dict[str, Any] = {"row_group_size": _ROW_GROUP}
    if has_samples(row_type):
        n_ids = max(min(table.num_rows, _ROW_GROUP_OF_TRACES), 1)
        bloom_filter = {row_type.id_column(): {"ndv": n_ids, "fpp": _FALSE_HITS}}
        layout = {"row_group_size": _ROW_GROUP_OF_TRACES, "bloom_filter_options": bloom_filter}
    pq.write_table(table, file, compression="zstd", compression_level=_ZSTD_LEVEL, write_page_checksum=True, **layout)


class _Hasher:
    """File-like object that hashes what is written to it."""

    closed = False

    def __init__(self, digest: "hashlib._Hash") -> None:
        self._digest = digest

    def write(self, data: bytes) -> int:
        self._digest.update(data)
        return len(data)

    def flush(self) -> None:
        return

    def close(self) -> None:
        return
