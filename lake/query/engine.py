"""An in-memory DuckDB kept in step with the files of a lake.

Scalar tables are held in memory; of the tables of traces only the index (id, time, file, row) is, the
samples are read in place. A table is made when it is first asked for. `sync` looks at the names, sizes and
times of the files and reads only what is new, so asking again costs milliseconds however many files there are.

Rows that a later row with the same id supersedes are listed per table in `superseded_<table>` and left
out of the view `<table>`, which is what queries see. Files without such rows are read as they are: leaving rows out
hides from DuckDB how many there are, and a join then holds all samples instead of the few rows it should.
"""

from __future__ import annotations

import logging
import os
import pickle
import re
import shutil
import tempfile
import uuid
import weakref
from collections import OrderedDict
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache, lru_cache
from importlib.resources import files
from itertools import count
from pathlib import Path
from typing import Any, NamedTuple

import duckdb
import pyarrow as pa

from fast.lake.order import CLOCK, LATEST_FIRST
from fast.lake.storage.files import FILE_PREFIX, FILE_SUFFIX, fault_of, newer_fault, unusable, version_number
from fast.lake.tables.campaign import TABLE_BY_NAME, TABLES, Row
from fast.lake.tables.schema import SCHEMA_VERSION, VERSION_KEY, has_samples, schema_of, sql_columns
from fast.models.errors import LakeError, UsageError

_LOG = logging.getLogger(__name__)
_READ_ATTEMPTS = 50  # a file may be merged into another between listing and reading
_N_RESULTS, _RESULT_BYTES = 128, 100_000  # that are kept: how many, and how large at most
_LOOSE_ROWS = 5_000  # merged files bring their rows again: 33 MB at 3,200 grasps, where 50,000 may be loose
_MEMORY_LIMIT = "1500MB"  # tables held and queries at work; what is over goes to temporary files
_TIMES_VIEW = {"traces": "trace_times"}  # views.sql says what it is for
Signature = tuple[int, int, int]  # time, size, inode
_ENGINES = count()  # numbers of engines: their file numbers are their own


class Mark(NamedTuple):
    """How far an engine has read a table: files by number, and how often some that it had read went away.

    The same mark again says that nothing came to the table since, and nothing went.
    """

    engine: int
    next_number: int
    n_losses: int


@dataclass
class _TableFiles:
    """What the engine has read of one table."""

    signatures: dict[str, Signature] = field(default_factory=dict)
    numbers: dict[str, int] = field(default_factory=dict)
    next_number: int = 0
    partial: set[str] = field(default_factory=set)  # of traces: files that lack a column
    n_losses: int = 0


class Engine:
    """One DuckDB connection over one lake folder. Not thread-safe; `lake.store` holds the lock."""

    def __init__(self, root: Path) -> None:
        self._root, self._number = root, next(_ENGINES)
        self._temporary = Path(tempfile.gettempdir()).resolve() / f"fast-lake-{uuid.uuid4().hex}"
        weakref.finalize(self, _remove_own, self._temporary, os.getpid())
        self._files = {row_type.table: _TableFiles() for row_type in TABLES}
        self._made: set[str] = set()  # tables that the connection has
        self._old_views: set[str] = set()  # tables whose view does not show all that was read
        self._defined = set(_TIMES_VIEW.values())  # names of `views.sql` that the connection has
        self._n_loose = 0  # rows held that are not compressed yet
        self._results: OrderedDict[tuple[str, bytes], tuple[list[Mark], pa.Table]] = OrderedDict()  # last asked last
        self.connection = duckdb.connect(":memory:")
        self.connection.execute("ATTACH ':memory:' AS held (COMPRESS)")
        self.connection.execute("USE held")
        self.connection.execute("SET TimeZone = 'UTC'")
        self.connection.execute(f"SET memory_limit = '{_MEMORY_LIMIT}'")
        self.connection.execute(f"SET temp_directory = {_quote(self._temporary)}")
        readable = [root.resolve() / row_type.table for row_type in TABLES] + [self._temporary]
        self.connection.execute(f"SET allowed_directories = {_quoted_list(readable)}")
        self.connection.execute("SET enable_external_access = false")
        self.connection.execute("SET lock_configuration = true")

    def sync(self, tables: Collection[str], views: Collection[str]) -> None:
        """Read what is new or changed in these tables, forget what is gone.

        Only the views of `views` are up to date then: a view of traces names all its files, a millisecond for 50.
        What a row refers to is written before the row and read after it, so that it is found.

        Raises:
            LakeError: a file cannot be read; the message names it.
        """
        self._make_tables(tables)
        for row_type in reversed(TABLES):
            if row_type.table in tables:
                self._sync_table(row_type, row_type.table in views)

    def define_views(self, names: Collection[str] | None = None) -> None:
        """Create the views and macros of `views.sql` with these names, or all of them, unless they are there.

        All take as long as a dozen queries, and most queries use none. Where all are, all tables are too.
        """
        if names is None:
            self._make_tables(TABLE_BY_NAME)
        for name, statement in _view_statements().items():
            if (names is None or name in names) and name not in self._defined:
                self.connection.execute(statement)
                self._defined.add(name)

    def read(self, sql: str, params: Sequence[Any] | dict[str, Any] | None = None) -> pa.Table:
        """Read the result of a query over what was last synced, in a read-only transaction."""
        used = _names_used(sql)
        self.define_views(used if used & set(TABLE_BY_NAME) else None)  # all, to a question about the tables
        try:
            return self._read(sql, params)
        except duckdb.CatalogException:  # says which name is nearly the one that is not there
            self.define_views()
            return self._read(sql, params)

    def read_kept(self, sql: str, params: Sequence[Any] | dict[str, Any] | None, tables: Collection[str]) -> pa.Table:
        """Read the same as `read`, for an answer that follows from these tables alone: kept until one changes."""
        question, marks = (sql, pickle.dumps(params)), [self.mark(table) for table in sorted(tables)]
        known_marks, answer = self._results.pop(question, (None, None))
        if answer is None or known_marks != marks:
            answer = self.read(sql, params)
        if answer.nbytes <= _RESULT_BYTES:
            self._results[question] = marks, answer
        if len(self._results) > _N_RESULTS:
            self._results.popitem(last=False)
        return answer

    def _read(self, sql: str, params: Sequence[Any] | dict[str, Any] | None) -> pa.Table:
        self.connection.execute("BEGIN TRANSACTION READ ONLY")
        try:
            return self.connection.sql(sql, params=params).to_arrow_table()
        finally:
            self.connection.execute("ROLLBACK")

    def files(self, table: str) -> list[Path]:
        """List files of a table as of the last `sync`."""
        known = self._files[table]
        return [self._root / table / name for name in sorted(known.signatures)]

    def mark(self, table: str) -> Mark:
        """Return how far a table was read by the last `sync`."""
        known = self._files[table]
        return Mark(self._number, known.next_number, known.n_losses)

    def place_of(self, row_type: type[Row], row_id: str) -> tuple[Path, int] | None:
        """Find file and row number of the valid row with this id in a table of traces, as of the last `sync`."""
        table, key = row_type.table, row_type.id_column()
        found = self.connection.execute(
            f"SELECT _file, _row FROM raw_{table} WHERE _hash = hash($1) AND {key} = $1 "
            f"ORDER BY {LATEST_FIRST}, _file DESC, _row DESC LIMIT 1",
            [row_id],
        ).fetchall()
        if not found:
            return None
        ((file_number, row),) = found
        names = {number: name for name, number in self._files[table].numbers.items()}
        return self._root / table / names[file_number], row

    def has_superseded(self, table: str) -> bool:
        """Return whether some row of the table has been superseded, as of the last `sync`."""
        return bool(self.connection.execute(f"SELECT 1 FROM superseded_{table} LIMIT 1").fetchall())

    def _make_tables(self, tables: Collection[str]) -> None:
        """Make those of these tables that are not there yet."""
        if self._made.issuperset(tables):
            return
        self.connection.execute("BEGIN TRANSACTION")  # one for all: each would take as long as its statements
        try:
            for row_type in TABLES:
                if row_type.table in tables and row_type.table not in self._made:
                    self._create_table(row_type)
                    if row_type.table in _TIMES_VIEW:
                        self._point_views(row_type)
            self.connection.execute("COMMIT")
        except BaseException:
            self.connection.execute("ROLLBACK")
            raise
        self._made.update(tables)

    def _create_table(self, row_type: type[Row]) -> None:
        table, key, columns = row_type.table, row_type.id_column(), sql_columns(row_type)
        # Of a table of traces only the first two are read here: a file of something else must not pass for one.
        held = {name: f"{columns[name]} NOT NULL" for name in (key, "created_at")}
        index = {"sequence": columns["sequence"], "_hash": "UBIGINT"}
        held = held | index if has_samples(row_type) else columns | held
        place = {"_file": "INTEGER", "_row": "BIGINT"}
        for name, own in {
            f"raw_{table}": held | place,
            f"superseded_{table}": {"_id": columns[key]} | place | {"_name": "VARCHAR"},
            f"empty_{table}": columns,
        }.items():
            self.connection.execute(create_table(name, own))
        rows = f"* FROM empty_{table}" if has_samples(row_type) else f"* EXCLUDE (_file, _row) FROM raw_{table}"
        self.connection.execute(f"CREATE VIEW {table} AS SELECT {rows}")

    def _point_views(self, row_type: type[Row]) -> None:
        """Define what queries see of a table: the rows read, but for those that are superseded."""
        table = row_type.table
        old = self.connection.execute(f"SELECT DISTINCT _name FROM superseded_{table}").fetchall()
        without_old = f"ANTI JOIN superseded_{table} USING (_file, _row)" if old else ""
        if not has_samples(row_type):
            rows = f"SELECT * EXCLUDE (_file, _row) FROM raw_{table} {without_old}"
            self.connection.execute(f"CREATE OR REPLACE VIEW {table} AS {rows}")
            return
        rows = self._sql_of_samples(table, {name for (name,) in old})
        self.connection.execute(f"CREATE OR REPLACE VIEW {table} AS {rows}")
        if table in _TIMES_VIEW:
            times = f"SELECT {row_type.id_column()}, created_at, sequence FROM raw_{table} {without_old}"
            self.connection.execute(f"CREATE OR REPLACE VIEW {_TIMES_VIEW[table]} AS {times}")

    def _sql_of_samples(self, table: str, with_old: set[str]) -> str:
        """Write the SELECT of rows of a table of traces; the files in `with_old` hold superseded rows too."""
        known, folder = self._files[table], self._root.resolve() / table
        parts = [f"SELECT * FROM empty_{table}"]
        if plain := _places(folder, set(known.signatures) - with_old - known.partial):
            parts.append(f"SELECT * FROM read_parquet({_quoted_list(plain)})")
        if partial := _places(folder, known.partial - with_old):
            parts.append(f"SELECT * FROM read_parquet({_quoted_list(partial)}, union_by_name = true)")
        if with_old:
            paths = _quoted_list(_places(folder, with_old))
            parts.append(
                "SELECT * EXCLUDE (_name, file_row_number) FROM (SELECT * REPLACE (parse_filename(_name) AS _name) "
                f"FROM read_parquet({paths}, union_by_name = true, filename = '_name', file_row_number = true)) AS new "
                f"ANTI JOIN superseded_{table} AS old ON new._name = old._name AND new.file_row_number = old._row"
            )
        return " UNION ALL BY NAME ".join(parts)

    def _sync_table(self, row_type: type[Row], with_views: bool) -> None:
        """Bring one table up to date; the same listing failing twice is a fault, another one is tried."""
        table = row_type.table
        failed: dict[str, Signature] | None = None
        for attempt in range(_READ_ATTEMPTS):
            known = self._files[table]
            found = _settled_listing(self._root / table, known.signatures)
            is_new, is_view_old = found != known.signatures, with_views and table in self._old_views
            if not is_new and not is_view_old:
                return
            self.connection.execute("BEGIN TRANSACTION")
            try:
                if is_new:
                    self._files[table] = self._take_in(row_type, known, found)
                    self._find_superseded(row_type, known)
                    self._old_views.add(table)
                if with_views:
                    self._point_views(row_type)
                self.connection.execute("COMMIT")
                if with_views:
                    self._old_views.discard(table)
                self._compress()
                return
            except (duckdb.Error, FileNotFoundError, LakeError) as error:
                self.connection.execute("ROLLBACK")
                self._files[table] = known
                if isinstance(error, LakeError):
                    raise
                if found == failed or attempt + 1 == _READ_ATTEMPTS:
                    raise _unreadable(self._root / table, error) from error
                failed = found
                _LOG.debug("reading %s again: %s", table, error)

    def _take_in(self, row_type: type[Row], known: _TableFiles, found: dict[str, Signature]) -> _TableFiles:
        """Read the new files, forget the rows of those that are gone or were written again."""
        changed = sorted(name for name, signature in found.items() if known.signatures.get(name) != signature)
        CLOCK.see(changed)
        stale = [known.numbers[name] for name, signature in known.signatures.items() if found.get(name) != signature]
        numbers = {name: known.next_number + place for place, name in enumerate(changed)}
        table, key = row_type.table, row_type.id_column()
        gone = f"FROM raw_{table} WHERE _file IN (SELECT unnest(?))"
        if stale:
            self.connection.execute(f"CREATE OR REPLACE TEMP TABLE touched AS SELECT {key} AS _id {gone}", [stale])
            self.connection.execute(f"DELETE {gone}", [stale])
        kept = {name: number for name, number in known.numbers.items() if name in found}
        if changed:
            self._refuse_newer(row_type, _places(self._root.resolve() / row_type.table, changed))
        partial = known.partial & set(found) - set(numbers)
        n_losses = known.n_losses + bool(stale)
        taken = _TableFiles(found, kept | numbers, known.next_number + len(changed), partial, n_losses)
        if changed:
            self._read_rows(row_type, taken, numbers)
        return taken

    def _refuse_newer(self, row_type: type[Row], paths: Sequence[Path]) -> None:
        """Raise LakeError for the first file that a newer program wrote."""
        found = self.connection.execute(
            "SELECT file_name, decode(value) FROM parquet_kv_metadata(?) WHERE decode(key) = ? ORDER BY 1",
            [[str(path) for path in paths], VERSION_KEY],
        )
        for name, text in found.fetchall():
            if version_number(text) > SCHEMA_VERSION:
                raise unusable(Path(name), newer_fault(version_number(text), row_type))

    def _read_rows(self, row_type: type[Row], taken: _TableFiles, numbers: dict[str, int]) -> None:
        """Add the rows (of traces: the index, and which files lack a column) of the files with these numbers."""
        table = row_type.table
        self._hold_numbers(numbers)
        places = _places(self._root.resolve() / table, numbers)
        held = "rows.* EXCLUDE (filename, file_row_number) REPLACE (coalesce(rows.sequence, 0) AS sequence)"
        if has_samples(row_type):
            key = row_type.id_column()
            held = f"{key}, created_at, coalesce(sequence, 0) AS sequence, hash({key}) AS _hash"
            taken.partial |= self._partial_files(row_type, places)
        inserted = self.connection.execute(
            f"INSERT INTO raw_{table} BY NAME SELECT {held}, _file, file_row_number AS _row "
            f"FROM (SELECT * FROM empty_{table} UNION ALL BY NAME SELECT * FROM read_parquet({_quoted_list(places)}, "
            "union_by_name = true, filename = true, file_row_number = true)) AS rows "
            "JOIN new_files ON new_files._name = parse_filename(rows.filename)"
        )
        self._n_loose += inserted.fetchall()[0][0]

    def _hold_numbers(self, numbers: dict[str, int]) -> None:
        """Hold names and numbers of files for a join; not as an Arrow table, which would import pandas."""
        self.connection.execute(
            "CREATE OR REPLACE TEMP TABLE new_files AS SELECT unnest(?::VARCHAR[]) AS _name, "
            "unnest(?::INTEGER[]) AS _file",
            [list(numbers), list(numbers.values())],
        )

    def _partial_files(self, row_type: type[Row], paths: list[Path]) -> set[str]:
        """Name files that lack a column: only for their sake need DuckDB compare the columns of all files."""
        columns = schema_of(row_type).names
        found = self.connection.execute(
            "SELECT parse_filename(file_name) FROM parquet_schema(?) GROUP BY file_name "
            "HAVING count(DISTINCT name) FILTER (list_contains(?, name)) < ?",
            [[str(path) for path in paths], columns, len(columns)],
        )
        return {name for (name,) in found.fetchall()}

    def _compress(self) -> None:
        """Compress what is held once there is much of it: a seventh of the memory, and faster to group."""
        if self._n_loose >= _LOOSE_ROWS:
            self.connection.execute("CHECKPOINT held")
            self._n_loose = 0

    def _find_superseded(self, row_type: type[Row], known: _TableFiles) -> None:
        """Bring the list of superseded rows up to date: it can have changed for ids of rows that came or went."""
        table, key = row_type.table, row_type.id_column()
        came = f"SELECT {key} AS _id FROM raw_{table} WHERE _file >= ?"
        if self._files[table].n_losses > known.n_losses:
            self.connection.execute(f"INSERT INTO touched {came}", [known.next_number])
        elif self._are_new(row_type, known):
            return
        else:
            self.connection.execute(f"CREATE OR REPLACE TEMP TABLE touched AS {came}", [known.next_number])
        self.connection.execute(f"DELETE FROM superseded_{table} WHERE _id IN (SELECT _id FROM touched)")
        self._hold_numbers(self._files[table].numbers)
        repeated = (
            f"SELECT {key} FROM raw_{table} WHERE {key} IN (SELECT _id FROM touched) GROUP BY {key} HAVING count(*) > 1"
        )
        self.connection.execute(
            f"INSERT INTO superseded_{table} SELECT {key}, _file, _row, _name FROM ("
            f"SELECT {key}, _file, _row FROM raw_{table} WHERE {key} IN ({repeated}) "
            f"QUALIFY row_number() OVER (PARTITION BY {key} ORDER BY {LATEST_FIRST}, _file DESC, _row DESC) > 1"
            ") JOIN new_files USING (_file)"
        )

    def _are_new(self, row_type: type[Row], known: _TableFiles) -> bool:
        """Return whether no id of the rows that came was there before or comes twice: nothing is superseded."""
        table, key = row_type.table, row_type.id_column()
        rows = f"FROM raw_{table} WHERE _file"
        sql = f"""SELECT count(*) = count(DISTINCT {key})
            AND NOT bool_or({key} IN (SELECT {key} {rows} < $1)) {rows} >= $1"""
        found = self.connection.execute(sql, [known.next_number]).fetchall()
        return bool(found[0][0])


def list_files(folder: Path) -> dict[str, Signature]:
    """List files of a table that readers look at, with what tells a rewritten one (time, size, inode).

    Raises:
        LakeError: the folder cannot be read.
    """
    found = {}
    try:
        with os.scandir(folder) as entries:
            for entry in entries:
                if is_rows(entry.name):
                    status = entry.stat()
                    found[entry.name] = status.st_mtime_ns, status.st_size, status.st_ino
    except FileNotFoundError:
        return found  # the table has no rows yet, or a file was merged while we looked: the caller looks again
    except OSError as error:
        raise LakeError(
            f"{folder} cannot be read ({error.strerror}): change its permissions or repair the disk."
        ) from error
    return found


def is_rows(name: str) -> bool:
    """Return whether this is the name of a file that readers look at."""
    return name.startswith(FILE_PREFIX) and name.endswith(FILE_SUFFIX)


def load_views(connection: duckdb.DuckDBPyConnection) -> None:
    """Create the views and macros of `views.sql` on a connection that has the tables."""
    connection.execute(_view_text())


def tables_used(sql: str) -> set[str]:
    """Find tables that a query may read, directly or through a view: every table whose name is a word of it."""
    return _names_used(sql) & set(TABLE_BY_NAME)


def views_used(sql: str) -> set[str]:
    """Return those of `tables_used` that are not read as `raw_` tables alone."""
    return tables_used(re.sub(r"\braw_\w+", "", sql.lower()))


@cache
def _view_text() -> str:
    return files("fast.lake").joinpath("views.sql").read_text(encoding="utf-8")


def _names_used(sql: str) -> set[str]:
    """Find words of a query, and of the views and macros that it uses directly or through others."""
    used: set[str] = set()
    words = _words(sql)
    while words:
        used |= words
        words = set().union(*(_view_words()[name] for name in words & set(_view_words()))) - used
    return used


@cache
def _view_statements() -> dict[str, str]:
    """Return the statement of each view and macro, in the order of `views.sql`."""
    statements = re.findall(r"^CREATE (?:VIEW|MACRO) \w+.*?;$", _view_text(), flags=re.DOTALL | re.MULTILINE)
    return {statement.split(maxsplit=2)[2].partition("(")[0].split()[0]: statement for statement in statements}


@cache
def _view_words() -> dict[str, set[str]]:
    """Return the words in the definition of each view and macro."""
    return {name: _words(statement) - {name} for name, statement in _view_statements().items()}


def _words(sql: str) -> set[str]:
    return {word.removeprefix("raw_").removeprefix("superseded_") for word in re.findall(r"\w+", sql.lower())}


def _settled_listing(folder: Path, known: dict[str, Signature]) -> dict[str, Signature]:
    """Return a listing that misses no row.

    One scan may miss a merged file that appears while it passes, and the small ones that then go; two
    equal scans in a row cannot have. One that equals what is known is at worst a moment old.
    """
    found = list_files(folder)
    before = known
    while found != before:
        found, before = list_files(folder), found
    return found


def create_table(name: str, columns: Mapping[str, str]) -> str:
    """Write the statement that makes an empty table with columns of these types."""
    listed = ", ".join(f'"{column}" {sql_type}' for column, sql_type in columns.items())
    return f"CREATE TABLE {name} ({listed})"


def _places(folder: Path, names: Iterable[str]) -> list[Path]:
    """Return the paths of files of a folder, in the order of their names."""
    return [folder / name for name in sorted(names)]


def _remove_own(folder: Path, process_id: int) -> None:
    """Remove a temporary folder, but not from a process that was forked by its owner."""
    if os.getpid() == process_id:
        shutil.rmtree(folder, ignore_errors=True)


def _quoted_list(paths: list[Path]) -> str:
    return "[" + ", ".join(_quote(path) for path in paths) + "]"


def _quote(path: Path) -> str:
    return "'" + str(path).replace("'", "''") + "'"


def _unreadable(folder: Path, error: Exception) -> LakeError:
    """Make the sentence for a table that cannot be read, naming the file at fault."""
    for name in sorted(list_files(folder)):
        fault = fault_of(folder / name, TABLE_BY_NAME[folder.name], whole=False)
        if fault:
            return LakeError(
                f"{folder / name} {fault.sentence}, so the table `{folder.name}` cannot be read: {fault.remedy}."
            )
    first_line = str(error).splitlines()[0]
    return LakeError(
        f"The table `{folder.name}` in {folder.parent} cannot be read ({first_line}): "
        "run `fast lake check` to find the file at fault."
    )


_READING = {duckdb.StatementType.SELECT}


@lru_cache(maxsize=256)
def check_reads_only(sql: str) -> None:
    """Refuse anything but one statement that reads.

    Raises:
        UsageError: the statement writes, loads, attaches or sets something, or there is not exactly one.
    """
    try:
        statements = duckdb.extract_statements(sql)
    except duckdb.Error as error:
        bare_order = re.search(r"(?<!\.)\border\b(?!\s+by\b)", sql, flags=re.IGNORECASE)
        hint = "; `order` is a word of SQL: write g.order, with the table named g" if bare_order else ""
        raise UsageError(f"This is not SQL that DuckDB understands{hint}: {error}") from error
    if len(statements) != 1:
        raise UsageError(f"Give exactly one SELECT statement, not {len(statements)}.")
    if statements[0].type not in _READING:
        raise UsageError(
            f"{_first_word(statements[0].query)} is not allowed here, the lake is read-only to SQL: "
            "use a SELECT statement."
        )


def _first_word(sql: str) -> str:
    """Return what the statement does, by its own first word; skip comments before it."""
    match = re.match(r"(?:\s|--[^\n]*\n|/\*.*?\*/)*(\w+)", sql, flags=re.DOTALL)
    return match[1].upper() if match else "This statement"
