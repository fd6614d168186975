"""Files of another format: a reader gives the tables of the hand-off format, which are checked like its files.

A reader is a function that takes the path given to `fast lake import` and returns `HandoffTables`;
`--reader FILE.py:FUNCTION` names it. Nothing has to be registered or installed.
"""

import importlib.util
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.csv as pacsv
import pyarrow.parquet as pq

from fast.lake.handoff.tables import HandoffError
from fast.models.errors import UsageError


@dataclass(frozen=True)
class HandoffTables:
    """The hand-off format as tables: Arrow, or what `pyarrow.table` takes (data frames, dicts of columns).

    Columns and units are those of `designs.csv`, `grasps.csv`, `traces.parquet` and `simulations.csv`; empty
    cells are null. `traces` has one row per sample, those of a grasp in order of time.
    """

    designs: Any
    grasps: Any
    traces: Any
    simulations: Any = None


Reader = Callable[[Path], HandoffTables]


def load_reader(name: str) -> Reader:
    """Load the function of `FILE.py:FUNCTION`.

    Raises:
        UsageError: there is no such file or function, or the file does not run.
    """
    file, _, function = name.rpartition(":")
    path = Path(file)
    if not file or path.suffix != ".py" or not path.is_file():
        raise UsageError(f"--reader `{name}` names no Python file; give FILE.py:FUNCTION.")
    spec = importlib.util.spec_from_file_location(path.stem, path)
    if spec is None or spec.loader is None:
        raise UsageError(f"--reader `{name}` cannot be loaded; give FILE.py:FUNCTION.")
    module = importlib.util.module_from_spec(spec)
    try:
        spec.loader.exec_module(module)
    except Exception as error:  # whatever the file of another lab raises
        raise UsageError(f"{path} does not run ({_short(error)}); nothing was imported: correct it.") from error
    reader = vars(module).get(function)
    if not callable(reader):
        raise UsageError(f"{path} has no function `{function}`; nothing was imported: give FILE.py:FUNCTION.")
    return reader


@contextmanager
def handoff_folder(source: Path, reader: Reader | None) -> Iterator[Path]:
    """Yield a hand-off folder with what the reader makes of `source`; `source` itself where there is no reader.

    Faults found in the folder are told as faults of `source`.

    Raises:
        UsageError: the reader fails, or what it returns is no set of tables.
    """
    if reader is None:
        yield source
        return
    with tempfile.TemporaryDirectory(prefix="fast-import-") as name:
        folder = Path(name)
        _write(_tables(source, reader), folder)
        try:
            yield folder
        except HandoffError as error:
            raise HandoffError(source, error.faults) from error


def _tables(source: Path, reader: Reader) -> dict[str, pa.Table]:
    """Return tables by the name of their file."""
    try:
        given = reader(source)
        tables = {
            "designs.csv": given.designs,
            "grasps.csv": given.grasps,
            "traces.parquet": given.traces,
            "simulations.csv": given.simulations,
        }
        return {
            name: table if isinstance(table, pa.Table) else pa.table(table)
            for name, table in tables.items()
            if table is not None
        }
    except Exception as error:  # whatever the function of another lab raises
        raise UsageError(
            f"The reader failed on {source} ({_short(error)}); nothing was imported: correct it, it must return "
            "fast.lake.handoff.HandoffTables."
        ) from error


def _write(tables: dict[str, pa.Table], folder: Path) -> None:
    for name, table in tables.items():
        if name.endswith(".csv"):
            pacsv.write_csv(table, folder / name)
        else:
            pq.write_table(table, folder / name)


def _short(error: Exception) -> str:
    return " ".join(f"{type(error).__name__}: {error}".split())
