"""The lake: append-only Parquet tables, written atomically to a folder or object store, queried through DuckDB."""

import json
import logging
import os
import shlex
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

import duckdb
import pyarrow as pa

from fast.lake.leases import require_owned
from fast.lake.order import CLOCK, LATEST_FIRST, OLDEST_FIRST
from fast.lake.provenance import Provenance, stamped
from fast.lake.query.engine import Engine, Mark, check_reads_only, load_views, tables_used, views_used
from fast.lake.storage.base import MARKER, Storage
from fast.lake.storage.files import discard, older_copies, read_row, stage
from fast.lake.storage.open import storage_at
from fast.lake.tables.campaign import TABLE_BY_NAME, TABLES, ObjectRow, Row, SimTraceRow, TraceRow
from fast.lake.tables.schema import has_samples, schema_of, to_arrow
from fast.models.errors import FastError, LakeError, UsageError
from fast.models.objects.catalogue import add_source
from fast.models.objects.rigid import RigidObject
from fast.models.records import Trace
from fast.models.validation import plain

_LOG = logging.getLogger(__name__)
LAYOUT_VERSION = 1  # of folders and files; the columns of a table have their own version in each file
_QUERY_ATTEMPTS = 50  # a file of samples may be merged into another while a query runs

R = TypeVar("R", bound=Row)


class Lake:
    """A lake at `address`, a folder or `s3://bucket/prefix`.

    Safe to use from several threads and, opened in each, several processes.
    `root` is the folder on this machine with its locks, caches and outputs: of a lake in a folder that folder, of one
    in an object store the working folder, which has copies of the objects.
    """

    def __init__(self, address: Path | str) -> None:
        self.storage: Storage = storage_at(address)
        self.address = self.storage.address
        self.root = self.storage.root
        self._lock = threading.RLock()
        self._engine: Engine | None = None
        self._pid = os.getpid()
        self._of_parent: list[object] = []
        add_source(self)  # the own objects of its rows are then known by number, in every process that has the lake

    def __repr__(self) -> str:
        return f"Lake({self.address!r})"

    def __reduce__(self) -> tuple[type["Lake"], tuple[str]]:
        """Pickle as the address; the connection is opened again in the other process."""
        return Lake, (self.address,)

    @classmethod
    def open(cls, address: Path | str, create: bool = False) -> "Lake":
        """Open the lake at `address`; with `create`, make one there if there is none.

        Raises:
            UsageError: there is no lake, the place holds something else, or it cannot be written.
            LakeError: the marker is damaged or of a newer program, or the object store does not answer.
        """
        lake = cls(address)
        marker = lake.storage.marker()
        if marker is not None:
            _check_marker(lake.address, marker)
        elif create:
            lake.storage.make(json.dumps({"format": "fast-lake", "schema_version": LAYOUT_VERSION}) + "\n")
        else:
            there = f"--lake {shlex.quote(lake.address)}"
            raise UsageError(
                f"{lake.address} is not a lake: give another --lake (or FAST_LAKE), or make one there with `fast "
                f"campaign run CONFIG.toml {there}` or `fast lake import DIR {there}`."
            )
        return lake

    @classmethod
    def exists(cls, address: Path | str) -> bool:
        """Return whether there is a lake at `address`.

        Raises:
            FastError: the place cannot be read.
        """
        return storage_at(address).marker() is not None

    def append(self, rows: Sequence[Row], provenance: Provenance) -> None:
        """Append rows of one or several tables, durably: when this returns, they survive a power cut.

        Each table's rows become visible at once or not at all, samples before the rows that announce them.
        Appending the same rows again replaces them; a row with a known id and other content supersedes it. Which row is
        the later one `lake.order` decides.

        Raises:
            UsageError: the lake cannot be written; nothing was.
            LakeError: two different rows share an id or the disk is full, and no row is visible; or a file could
                not be named, or the object store does not answer, and rows of the first tables may be: append the
                same rows again.
            LostLeaseError: this process no longer owns what it took over in the lake; no row is visible.
        """
        groups = _by_table(rows)
        names = {row_type.table: self.storage.names(row_type.table) for row_type, _ in groups}
        for known in names.values():
            CLOCK.see(known)
        columns = stamped(provenance, CLOCK.next())
        staged: list[tuple[Path, Path]] = []
        try:
            for row_type, group in groups:
                table = to_arrow(group, columns)
                folder = self.root / row_type.table
                staged.append((stage(folder, table, row_type.table), folder / self.storage.file_name(table)))
            require_owned(self.storage)
            for temporary, final in staged:
                self.storage.publish(temporary, final)
        finally:
            discard([temporary for temporary, _ in staged])
        for _, final in staged:
            if copies := older_copies(final.name, names[final.parent.name]):
                self.storage.remove(final.parent, copies)

    def query(self, sql: str, params: Sequence[Any] | dict[str, Any] | None = None) -> pa.Table:
        """Return the result of one SELECT over the tables, views and macros, with the rows of this moment.

        Raises:
            UsageError: it is not one reading statement.
            LakeError: the query is wrong, or a file cannot be read.
        """
        check_reads_only(sql)
        if isinstance(params, dict):
            params = {name: plain(value) for name, value in params.items()}
        elif params is not None:
            params = [plain(value) for value in params]
        return self._query(sql, params, tables_used(sql), views_used(sql))

    def rows(self, table: type[Row], **equals: Any) -> list[dict[str, Any]]:
        """Return rows of a table as dicts with all columns, oldest first; `equals` are column = value filters.

        A value may be a list or tuple: any of these. None finds empty values.

        Raises:
            LakeError: the table has no such column.
        """
        return self._rows(table, "*", equals)

    def query_kept(self, sql: str, params: Sequence[Any] | dict[str, Any]) -> pa.Table:
        """Return the same as `query` where the answer follows from the rows: answered once until they change.

        Raises:
            UsageError: it is not one reading statement.
            LakeError: the query is wrong, or a file cannot be read.
        """
        check_reads_only(sql)
        return self._query(sql, params, tables_used(sql), views_used(sql), is_kept=True)

    def records(self, table: type[R], **equals: Any) -> list[R]:
        """Return the same as `rows`, as row records, without provenance."""
        columns = ", ".join(f'"{name}"' for name in table.model_fields)  # provenance names the rows behind a fit: all
        return [table.model_validate(row) for row in self._rows(table, columns, equals)]

    def _rows(self, table: type[Row], columns: str, equals: dict[str, Any]) -> list[dict[str, Any]]:
        where, values = _conditions(table, equals)
        sql = f"SELECT {columns} FROM {table.table} {where} ORDER BY {OLDEST_FIRST}, {table.id_column()}"
        return self._query(sql, values, {table.table}, is_kept=True).to_pylist()

    def ids(self, table: type[Row], **equals: Any) -> set[Any]:
        """Return ids of the rows that `rows` would give; the cheap way to ask what is there."""
        where, values = _conditions(table, equals)
        key = table.id_column()
        found = self._query(f"SELECT {key} FROM {_index(table, where)} {where}", values, {table.table}, is_kept=True)
        return set(found.column(0).to_pylist())

    def has(self, table: type[Row] | str, row_id: str | int) -> bool:
        """Return whether the table has a row with this id."""
        row_type = TABLE_BY_NAME[table] if isinstance(table, str) else table
        sql = f"SELECT 1 FROM raw_{row_type.table} WHERE {row_type.id_column()} = ? LIMIT 1"
        return self._query(sql, [row_id], {row_type.table}).num_rows > 0

    def trace(self, row_id: str, table: type[TraceRow] | type[SimTraceRow] = TraceRow) -> Trace:
        """Read the samples of one grasp (or simulation) from its file alone.

        Raises:
            LakeError: there is no such trace.
        """
        for _ in range(_QUERY_ATTEMPTS):
            with self._synced({table.table}) as engine:
                place = engine.place_of(table, row_id)
            if place is None:
                raise LakeError(
                    f"The lake {self.address} has no trace of `{row_id}`; check the id, or how the grasp ended."
                )
            try:
                found = read_row(*place, list(table.model_fields))
            except OSError as error:
                _LOG.debug("%s was merged while reading: %s", place, error)
                continue
            if found is not None and found[table.id_column()] == row_id:
                return table.model_validate(found).trace
        raise LakeError(f"The trace of `{row_id}` could not be read from {self.address}; run `fast lake check`.")

    @contextmanager
    def reading(self, sql: str) -> Iterator[Engine]:
        """Lend what answers this query, in step with the tables that it reads; others wait until it is given back."""
        with self._synced(tables_used(sql)) as engine:
            engine.define_views()  # people ask what there is, and for what is nearly its name
            yield engine

    def find_object(self, object_id: int) -> RigidObject | None:
        """Find the own object with this number, if the lake has it."""
        try:
            rows = self.records(ObjectRow, object_id=object_id)
        except FastError:  # a lake that is gone or cannot be read has no objects
            return None
        return rows[-1].own_object if rows else None

    def mark(self, table: type[Row]) -> Mark:
        """Return how far the table goes now: the cheap way to ask whether anything came to it since the last mark.

        Raises:
            LakeError: the lake cannot be read.
        """
        with self._synced({table.table}, views=set()) as engine:
            return engine.mark(table.table)

    def connect(self) -> duckdb.DuckDBPyConnection:
        """Return a DuckDB connection to the rows of this moment, with all views and macros.

        It has no access to files, network or extensions, and its configuration is locked; what is
        created on it stays in its memory. Traces are read from the files when asked for; connect again
        after a compaction. All other tables are copied, 80 bytes a grasp in the files: `query` copies nothing.
        """
        with self._synced(set(TABLE_BY_NAME)) as engine:
            connection = duckdb.connect(":memory:")
            connection.execute("SET TimeZone = 'UTC'")
            for row_type in TABLES:
                self._copy_table(engine, connection, row_type)
        load_views(connection)
        connection.execute("SET enable_external_access = false")
        connection.execute("SET lock_configuration = true")
        return connection

    def close(self) -> None:
        """Give the memory back; the lake opens again when next asked."""
        self._leave_parent()
        with self._lock:
            if self._engine is not None:
                self._engine.connection.close()
            self._engine = None

    def _leave_parent(self) -> None:
        """Set the parent's connection and lock aside in a forked process: using or closing them would hang."""
        if self._pid != os.getpid():
            self._of_parent += [self._engine, self._lock]
            self._lock, self._engine, self._pid = threading.RLock(), None, os.getpid()

    def _query(
        self,
        sql: str,
        params: Sequence[Any] | dict[str, Any] | None,
        tables: set[str],
        views: set[str] | None = None,
        *,
        is_kept: bool = False,
    ) -> pa.Table:
        for attempt in range(_QUERY_ATTEMPTS):
            with self._synced(tables, views) as engine:
                try:
                    return engine.read_kept(sql, params, tables) if is_kept else engine.read(sql, params)
                except duckdb.IOException as error:
                    if attempt + 1 == _QUERY_ATTEMPTS:
                        raise LakeError(f"{str(error).splitlines()[0]}; run `fast lake check`.") from error
                except duckdb.Error as error:
                    raise LakeError(f"The query cannot be answered: {error}") from error
        raise LakeError(f"The lake {self.address} could not be read; run `fast lake check`.")

    @contextmanager
    def _synced(self, tables: set[str], views: set[str] | None = None) -> Iterator[Engine]:
        """Yield the engine with these tables read; `views`: those whose view is used, None is all of them."""
        self._leave_parent()
        with self._lock:
            if self._engine is None:
                self._engine = Engine(self.root)
            self.storage.refresh(tables)
            self._engine.sync(tables, tables if views is None else views)
            yield self._engine

    def _copy_table(self, engine: Engine, connection: duckdb.DuckDBPyConnection, row_type: type[Row]) -> None:
        table, key = row_type.table, row_type.id_column()
        if not has_samples(row_type):
            rows = engine.connection.sql(f"SELECT * FROM {table}").to_arrow_table()
            connection.register("rows_now", rows)
            connection.execute(f"CREATE TABLE {table} AS SELECT * FROM rows_now")
            connection.unregister("rows_now")
            return
        import pyarrow.dataset as pads  # half a second of imports (pandas), which no other question needs

        files = [str(path) for path in engine.files(table)]
        schema = schema_of(row_type)
        connection.register(f"{table}_files", pads.dataset(files, schema=schema) if files else schema.empty_table())
        latest = f"QUALIFY row_number() OVER (PARTITION BY {key} ORDER BY {LATEST_FIRST}) = 1"
        only_latest = latest if engine.has_superseded(table) else ""
        connection.execute(f"CREATE TEMP VIEW {table} AS SELECT * FROM {table}_files {only_latest}")


def _index(table: type[Row], where: str) -> str:
    """Return where ids are read from: of the traces the index does, if no other column is asked for."""
    return f"raw_{table.table}" if has_samples(table) and not where else table.table


def _by_table(rows: Sequence[Row]) -> list[tuple[type[Row], list[Row]]]:
    """Group rows by table in the order of `TABLES`, each id once."""
    groups: dict[type[Row], list[Row]] = {}
    for row in rows:
        groups.setdefault(type(row), []).append(row)
    return [(row_type, _without_copies(groups[row_type])) for row_type in TABLES if row_type in groups]


def _without_copies(rows: list[Row]) -> list[Row]:
    """Return rows of one table, each id once.

    Raises:
        LakeError: two rows with one id differ.
    """
    by_id: dict[Any, Row] = {}
    for row in rows:
        row_id = row.__dict__[row.id_column()]
        if row_id in by_id and by_id[row_id].model_dump_json() != row.model_dump_json():
            raise LakeError(f"Two different rows of `{row.table}` share the id `{row_id}`; nothing was written.")
        by_id[row_id] = row
    return list(by_id.values())


def _conditions(table: type[Row], equals: dict[str, Any]) -> tuple[str, list[Any]]:
    known = schema_of(table).names
    conditions, values = [], []
    for name, value in equals.items():
        if name not in known:
            raise LakeError(f"The table `{table.table}` has no column `{name}`; it has {', '.join(known)}.")
        if isinstance(value, list | tuple):
            conditions.append(f'"{name}" IN (SELECT unnest(?))')
            values.append(list(value))
        else:
            conditions.append(f'"{name}" IS NOT DISTINCT FROM ?')
            values.append(value)
    return ("WHERE " + " AND ".join(conditions) if conditions else ""), values


def _check_marker(address: str, marker: str) -> None:
    try:
        version = int(json.loads(marker)["schema_version"])
    except (ValueError, KeyError, TypeError) as error:
        raise LakeError(
            f"{address}/{MARKER} is not readable as the marker of a lake; restore it from another lake."
        ) from error
    if version > LAYOUT_VERSION:
        raise LakeError(
            f"The lake {address} has schema version {version}, this program reads up to {LAYOUT_VERSION}: "
            "update the program."
        )
