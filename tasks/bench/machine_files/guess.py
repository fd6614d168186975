"""A format file made from an example: what the columns are is guessed, shown, and written for the next time."""

import re
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from fast.models.errors import UsageError
from fast.models.validation import parse_toml
from fast.tasks.bench.machine_files.channels import Channels, read_channels
from fast.tasks.bench.machine_files.format import PROGRAMS, MachineFormat, make_format
from fast.tasks.bench.machine_files.grid import Grid
from fast.tasks.bench.machine_files.head import Block, unit_of
from fast.tasks.bench.machine_files.numbers import read_number
from fast.tasks.bench.machine_files.pulls import LIST_NAME, find_files, find_table
from fast.tasks.bench.machine_files.split import split_pulls
from fast.tasks.bench.machine_files.words import Quantity, quantity_of_name

_CYCLES = ("cycle", "zyklus", "pull", "versuch", "specimen", "essai", "ciclo", "サイクル", "循环")
_LEAST_PULL = 10  # samples
_ASSUMED: dict[Quantity, str] = {"time": "s", "lift": "mm", "force": "N"}


def guess_format(paths: Sequence[Path], tool_names: Iterable[str] = ()) -> str:
    """Guess the text of the format file (TOML) for files like the first of these.

    tool_names: how tools may be called beside `B01T0`.

    Raises:
        UsageError: there is no file, or what lift and force are cannot be told.
    """
    path, is_listed = _find_example(paths, tool_names)
    grid, block, places = find_table(path, MachineFormat())
    assumed = {q: _ASSUMED[q] for q in places if unit_of(block, places[q], q) is None}
    if "time" in assumed and _is_in_ms(block, places["time"]):
        assumed["time"] = "ms"
    machine = make_format(
        {q: {"number": places[q] + 1, "unit": unit_of(block, places[q], q) or assumed[q]} for q in places}, str(path)
    )
    channels = read_channels(path, block, places, machine)
    cycle = _find_cycle(block)
    is_down = _points_down(channels.lift_mm - channels.lift_mm[0])
    parts, _ = split_pulls(-channels.lift_mm if is_down else channels.lift_mm, None, channels.starts)
    lines = [f"# Guessed from {path.name}: look at it, and correct what is wrong."]
    lines += [f"# {LIST_NAME} says which file is which grasp."] if is_listed else [_name_line(path, tool_names, parts)]
    lines += _separator_lines(grid, block)
    for quantity, place in sorted(places.items(), key=lambda one: list(_ASSUMED).index(one[0])):
        lines += ["", f"[{quantity}]", _say_column(block, place) + _say_others(block, place, quantity)]
        unit = unit_of(block, place, quantity)
        lines.append(f"unit = {_quote(unit or assumed[quantity])}" + ("" if unit else "  # the file does not say it"))
        lines += _sign_lines(quantity, channels, parts, is_down)
    lines += [] if cycle is None else ["", "[cycle]", _say_column(block, cycle)]
    return "\n".join(lines) + "\n"


def parse_format(text: str, where: str) -> MachineFormat:
    """Return the format that a text says, as `read_format` reads it from a file."""
    return make_format(parse_toml(text, where), where)


def _find_example(paths: Sequence[Path], tool_names: Iterable[str]) -> tuple[Path, bool]:
    """Find the first file of a machine, and whether a table says which grasp it is."""
    for path in paths:
        if path.name == LIST_NAME or (path / LIST_NAME).exists():
            return find_files([path], MachineFormat())[0].path, True
        if not path.is_dir():
            return path, False
        for inside in sorted(path.rglob("*")):
            if inside.is_file() and _name_of(inside, tool_names) is not None:
                return inside, False
    raise UsageError("there is no file of a machine to guess the format from; nothing was written: give one.")


def _separator_lines(grid: Grid, block: Block) -> list[str]:
    lines = [f"separator = {_quote(grid.separator)}"] if grid.separator else []
    lines += [f"decimal = {_quote(block.marks.decimal)}"]
    is_usual = grid.encoding in ("", "utf-8", "utf-8-sig", "utf-16", "cp1252")
    return lines if is_usual else [*lines, f"encoding = {_quote(grid.encoding)}"]


def _say_column(block: Block, place: int) -> str:
    is_named = block.names and block.names[place]
    return f"name = {_quote(block.names[place])}" if is_named else f"number = {place + 1}"


def _say_others(block: Block, place: int, quantity: Quantity) -> str:
    """Tell which columns could be meant as well."""
    names = {name for p, name in enumerate(block.names) if p != place and quantity_of_name(name) == quantity}
    names -= {block.names[place]} if block.names else set()
    return f"  # or {', '.join(sorted(names))}" if names else ""


def _sign_lines(quantity: Quantity, channels: Channels, parts: Sequence[slice], is_down: bool) -> list[str]:
    if quantity == "lift":
        return ['zero = "first sample"', *(["sign = -1  # the file counts the lift downwards"] if is_down else [])]
    if quantity == "force" and _points_down(np.concatenate([channels.force_n[part] for part in parts])):
        return ["sign = -1  # the file counts the pull as negative"]
    return []


def _points_down(values: np.ndarray) -> bool:
    """Return whether the largest value is negative."""
    return bool(-values.min() > 2 * max(values.max(), 0.0))


def _is_in_ms(block: Block, place: int) -> bool:
    """Return whether times of whole numbers last so long that they are milliseconds."""
    cells = [row[place] for row in block.rows if place < len(row)]
    return all(cell.isdigit() for cell in cells) and float(cells[-1]) > 1000


def _find_cycle(block: Block) -> int | None:
    """Find the column that counts pulls: whole numbers that grow by one, each for some samples."""
    for place, name in enumerate(block.names):
        if not name.lower().startswith(_CYCLES):
            continue
        values = [read_number(row[place], block.marks) if place < len(row) else None for row in block.rows]
        counts = [value for value in values if value is not None]
        changes = [b - a for a, b in zip(counts, counts[1:], strict=False) if a != b]
        if changes and all(change == 1 for change in changes) and len(changes) * _LEAST_PULL < len(counts):
            return place
    return None


def _name_line(path: Path, tool_names: Iterable[str], parts: Sequence[slice]) -> str:
    for program in PROGRAMS:
        if MachineFormat(program=program).pattern(tool_names).fullmatch(path.absolute().as_posix()):  # type: ignore[arg-type]
            return f'program = "{program}"'
    name = _name_of(path, tool_names) or f"{{tool}}_{{object}}_{{repeat}}{path.suffix}"
    if len(parts) > 1 and "{repeat}" in name:
        return (
            f"file_name = {_quote(name.replace('{repeat}', '*'))}  # the file has {len(parts)} pulls: repeats 0, 1, ..."
        )
    return f"file_name = {_quote(name)}"


def _name_of(path: Path, tool_names: Iterable[str]) -> str | None:
    """Return the end of a path, with the tool, object and repeat in it replaced, other digits by `*`."""
    tool = MachineFormat(file_name="{tool}_{object}").pattern(tool_names).pattern
    tool = tool[tool.index("(?P<tool>") : tool.index("_(?P<object>")]
    for depth in (1, 2):
        end = "/".join(path.absolute().parts[-depth:])
        if match := re.search(rf"(?<![A-Za-z0-9]){tool}", end, re.IGNORECASE):
            rest, n_objects = re.subn(r"\d+", "{object}", end[match.end() :], count=1)
            head, _, tail = rest.partition("{object}")
            stem, dot, suffix = tail.partition(".")
            stem = re.sub(r"\d+", "{repeat}", stem, count=1)
            stem, before = (re.sub(r"\d+", "*", text) for text in (stem, end[: match.start()]))
            return f"{before}{{tool}}{head}{{object}}{stem}{dot}{suffix}" if n_objects else None
    return None


def _quote(text: str) -> str:
    return '"' + text.replace("\\", "\\\\").replace('"', '\\"').replace("\t", "\\t") + '"'
