"""The grasps of a testing machine's files: each pull a trace, whatever else the file holds left out and counted."""

import re
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

import numpy as np

from fast.models.errors import UsageError
from fast.models.records import Trace
from fast.tasks.bench.machine_files.channels import Channels, find_columns, read_channels
from fast.tasks.bench.machine_files.format import MachineFormat
from fast.tasks.bench.machine_files.grid import Grid, read_grids
from fast.tasks.bench.machine_files.head import LEAST_PULL, Block, BrokenRow, choose_columns, find_blocks, is_pull
from fast.tasks.bench.machine_files.numbers import Marks, read_number
from fast.tasks.bench.machine_files.split import split_pulls
from fast.tasks.bench.machine_files.words import Quantity
from fast.tasks.bench.told import ToldGrasp
from fast.tasks.bench.told_files import read_object
from fast.tasks.campaign.csv_file import read_rows

LIST_NAME = "files.csv"
_LONGEST_WAIT_S = 3600.0  # before the first sample: a later one is a time of the day, or since 1970
_SPEED = re.compile(r"speed|geschwindigkeit|vitesse|velocit|velocidad|速度", re.IGNORECASE)
_PER_S = {"mm/s": 1.0, "mm/min": 1 / 60.0, "in/min": 25.4 / 60.0, "m/s": 1000.0, "cm/min": 10.0 / 60.0}
_UNIT = "(" + "|".join(_PER_S) + ")"
_SAID_SPEED = re.compile(rf"(?P<a>[\d.,]+)\s*[(\[]?{_UNIT}|{_UNIT}[)\]]?\D*?(?P<b>[\d.,]+)")


class Pulls(NamedTuple):
    """Grasps of files, and sentences about what was left out."""

    grasps: list[ToldGrasp]
    notes: list[str]


class Named(NamedTuple):
    """A file and the grasp that it is of; `repeat` is None where the file has several."""

    path: Path
    tool_id: str
    object_id: int
    repeat: int | None


def read_pulls(paths: Sequence[Path], machine: MachineFormat, tool_names: Iterable[str] = ()) -> Pulls:
    """Read the grasps of files of a machine, or of folders with them; a `files.csv` says which file is which grasp.

    tool_names: how tools may be called beside `B01T0`.

    Raises:
        UsageError: a name says no grasp, or a file cannot be read or lacks a column; nothing was written.
    """
    grasps: list[ToldGrasp] = []
    notes: list[str] = []
    for named in find_files(paths, machine, tool_names):
        more, said = _read_file(named, machine)
        grasps += more
        notes += [f"{named.path.name}: {text}" for text in said]
    return Pulls(grasps, _join(notes))


def find_files(paths: Sequence[Path], machine: MachineFormat, tool_names: Iterable[str] = ()) -> list[Named]:
    """Find the files of a machine with the grasps that they are of.

    Raises:
        UsageError: a name says no grasp, or a folder has no file of a grasp.
    """
    pattern = machine.pattern(tool_names)
    found: list[Named] = []
    for path in paths:
        if path.is_dir() and not (path / LIST_NAME).exists():
            inside = [file for file in sorted(path.rglob("*")) if file.is_file() and pattern.fullmatch(_posix(file))]
            if not inside:
                raise UsageError(f"{path} has no file like `{machine.wanted_name}`; {_how_named(machine)}.")
            found += [_find_name(file, machine, pattern) for file in inside]
        elif path.is_dir() or path.name == LIST_NAME:
            found += _read_list(path / LIST_NAME if path.is_dir() else path)
        else:
            found.append(_find_name(path, machine, pattern))
    return found


def _posix(path: Path) -> str:
    return path.absolute().as_posix()


def _find_name(path: Path, machine: MachineFormat, pattern: re.Pattern[str]) -> Named:
    match = pattern.fullmatch(_posix(path))
    if match is None:
        raise UsageError(f"{path}: the name is not like `{machine.wanted_name}`, {_how_named(machine)}.")
    given = match.groupdict()
    repeat = int(given["repeat"]) - machine.first_repeat if "repeat" in given else None
    if repeat is not None and repeat < 0:
        raise UsageError(
            f"{path}: the repeat is {given['repeat']}, the first one is {machine.first_repeat}; nothing was written: "
            "correct first_repeat of the format file."
        )
    is_id = re.search(r"[Bb]\d{2,6}[Tt]\d$", given["tool"]) is not None
    return Named(path, given["tool"].replace("_", "/") if is_id else given["tool"], int(given["object"]), repeat)


def _how_named(machine: MachineFormat) -> str:
    name = re.sub(r"\.\*$", ".csv", machine.wanted_name)
    example = name.format(tool="B01T0", object=14, repeat=machine.first_repeat)
    remedy = f"rename it, change file_name, or give a {LIST_NAME} with the columns file, tool, object, repeat"
    return f"e.g. {example}; {remedy}"


def _read_list(path: Path) -> list[Named]:
    """Read the rows of a table that says which file is which grasp; files are beside it."""
    return [
        Named(
            path.parent / row["file"],
            row["tool"],
            read_object(row, "object"),
            row.integer("repeat") if row.get("repeat") else None,
        )
        for row in read_rows(path, ("file", "tool", "object"), ("repeat",))
    ]


def _read_file(named: Named, machine: MachineFormat) -> tuple[list[ToldGrasp], list[str]]:
    path = named.path
    notes: list[str] = []
    traces: list[Trace] = []
    tables = list(_find_tables(path, machine, notes))
    for grid, block, columns in tables:
        for places in columns:
            with _saying_where(grid, block, len(tables)):
                channels = read_channels(path, block, places, machine)
                parts, n_back = split_pulls(channels.lift_mm, channels.cycle, channels.starts)
                traces += _make_traces(path, grid, block, channels, parts, machine)
            notes += [f"{channels.n_empty} samples lack a number and were left out"] if channels.n_empty else []
            notes += [f"{n_back} samples of the way back were left out"] if n_back else []
        notes += [f"{block.n_left_out} rows below the samples were left out"] if block.n_left_out else []
    if named.repeat is not None and len(traces) > 1:
        raise UsageError(
            f"{path} has {len(traces)} pulls, its name says that it is one; nothing was written: leave `{{repeat}}` "
            "out of file_name, or give a file for each pull."
        )
    return [
        ToldGrasp(str(path), named.tool_id, named.object_id, number + (named.repeat or 0), trace=trace)
        for number, trace in enumerate(traces)
    ], notes


def find_table(path: Path, machine: MachineFormat) -> tuple[Grid, Block, dict[Quantity, int]]:
    """Find the first table of samples in a file, with the place of each quantity.

    Raises:
        UsageError: there is none, or a column cannot be found.
    """
    grid, block, columns = next(_find_tables(path, machine))
    return grid, block, columns[0]


def _find_tables(
    path: Path, machine: MachineFormat, notes: list[str] | None = None
) -> Iterator[tuple[Grid, Block, list[dict[Quantity, int]]]]:
    """Yield the longest table of samples, and the other pulls of the file and its sheets.

    notes: a list that takes a sentence about each sheet of samples that has no head.
    """
    wanted = [column.name for column in machine.columns().values() if column.name]
    found: list[tuple[Grid, Block]] = []
    for grid in read_grids(path, machine.separator, machine.encoding):
        try:
            found += [(grid, block) for block in find_blocks(grid.rows, machine.decimal, wanted)]
        except BrokenRow as error:
            raise UsageError(f"{path}: {error}; nothing was written: correct it.") from error
    if not found:
        raise UsageError(
            f"{path} has no samples, which are rows of numbers; nothing was written: export the samples of the pull, "
            "or correct separator, decimal and encoding of the format file."
        )
    _, main = max(found, key=lambda table: len(table[1].rows))
    pulls = [
        (grid, block)
        for grid, block in found
        if block is main or (main.names and block.names == main.names) or is_pull(block, wanted)
    ]
    if notes is not None:
        headless = [one for one in found if one not in pulls and not (one[1].names or any(one[1].units))]
        notes += [
            f"{len(block.rows)} rows of numbers of sheet `{grid.sheet}` have no head and were left out"
            for grid, block in headless
            if len(block.rows) >= LEAST_PULL
        ]
    for grid, block in pulls:
        with _saying_where(grid, block, len(pulls)):
            columns = find_columns(path, block, machine)
            _check_numbers(path, block, main, machine)
        yield grid, block, columns


def _check_numbers(path: Path, block: Block, main: Block, machine: MachineFormat) -> None:
    """Refuse columns that a person has counted where another head has others in these places."""
    for quantity, column in machine.columns().items():
        if column.number is None or not (main.names or any(main.units)):
            continue
        names = [part.names[column.number - 1 : column.number] for part in (block, main)]
        chosen = [choose_columns(part).get(quantity) for part in (block, main)]
        if names[0] != names[1] or chosen[0] != chosen[1]:
            raise UsageError(
                f"{path} has heads that differ, and the format file counts columns (number {column.number} is the "
                f"{quantity}); nothing was written: leave [{quantity}] out, or give a file for each head."
            )


@contextmanager
def _saying_where(grid: Grid, block: Block, n_blocks: int) -> Iterator[None]:
    """Add to a refusal which samples of several it is about, and the head above them."""
    try:
        yield
    except UsageError as error:
        if n_blocks == 1:
            raise
        sheet = f"of sheet `{grid.sheet}` " if grid.sheet else ""
        heads = [name + (f" ({unit})" if unit else "") for name, unit in zip(block.names, block.units, strict=False)]
        below = f" below `{', '.join(filter(None, heads))}`" if heads else ""
        raise UsageError(
            f"{error} These are the samples {sheet}from row {block.numbers[0]} on{below}; where heads differ, give a "
            "format file without [time], [lift] and [force], or a file for each head."
        ) from error


def _make_traces(
    path: Path, grid: Grid, block: Block, channels: Channels, parts: Sequence[slice], machine: MachineFormat
) -> Iterator[Trace]:
    speed = None
    if channels.time_s is None:
        speed = machine.lift_speed_mm_per_s or _find_speed(path, grid.rows[: block.numbers[0] - 1], block.marks)
    for part in parts:
        lift_mm, force_n = channels.lift_mm[part], channels.force_n[part]
        if channels.time_s is None:
            time_s = np.maximum.accumulate(lift_mm - lift_mm[0]) / speed
        else:
            time_s = channels.time_s[part]
            if len(parts) > 1 or time_s[0] > _LONGEST_WAIT_S:
                time_s = time_s - time_s[0]
        lift_mm = lift_mm - lift_mm[0] if machine.lift is None or machine.lift.zero == "first sample" else lift_mm
        force_n = force_n - force_n[0] if machine.force and machine.force.zero == "first sample" else force_n
        yield Trace(time_s=time_s, lift_mm=lift_mm, force_n=force_n)


def _find_speed(path: Path, rows: Sequence[Sequence[str]], marks: Marks) -> float:
    """Find the speed of the lift from the lines above the samples, mm/s."""
    for row in rows:
        text = " ".join(row)
        for match in _SAID_SPEED.finditer(text) if _SPEED.search(text) else ():
            value = read_number(match["a"] or match["b"], marks)
            if value:
                return value * _PER_S[match[2] or match[3]]
    raise UsageError(
        f"{path} says neither times nor the speed of the lift; nothing was written: give [time] or "
        "lift_speed_mm_per_s in the format file."
    )


def _join(notes: Sequence[str]) -> list[str]:
    """Join what was left out of many files, in a line for each kind."""
    if len(notes) <= 6:
        return list(notes)
    kinds = Counter(re.sub(r"^.*?: \d+ ", "", note) for note in notes)
    total = {
        kind: sum(int(note.rsplit(": ", 1)[1].split()[0]) for note in notes if note.endswith(kind)) for kind in kinds
    }
    return [f"in {n} files: {total[kind]} {kind}" for kind, n in kinds.items()]
