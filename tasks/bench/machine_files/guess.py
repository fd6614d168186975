"""A format file made from an example: what the columns are is guessed, shown, and written for the next time."""

import re
from pathlib import Path

from fast.models.errors import UsageError
from fast.tasks.bench.machine_files.cells import Grid, read_grid
from fast.tasks.bench.machine_files.head import Block, choose_columns, find_block, read_column
from fast.tasks.bench.machine_files.words import Quantity, quantity_of_name

_TOOL = re.compile(r"(?:[A-Za-z0-9-]+_)?[Bb]\d{2,6}[Tt]\d")
_CYCLES = ("cycle", "zyklus", "pull", "versuch", "specimen", "essai", "ciclo")


def guess_format(path: Path) -> str:
    """Text of the format file (TOML) for files like this one.

    Raises:
        UsageError: what time, lift and force are cannot be told.
    """
    grid = read_grid(path)
    block = find_block(grid.rows)
    columns = choose_columns(block) if block is not None else {}
    if block is None or not {"lift", "force"} <= set(columns):
        names = f" (the columns are {', '.join(block.names)})" if block is not None and block.names else ""
        raise UsageError(
            f"{path}: what is the lift and what the force cannot be told{names}; nothing was written: write the format "
            "file by hand, or export the columns with their names and units."
        )
    return _write(path, grid, block, dict(columns))


def _write(path: Path, grid: Grid, block: Block, columns: dict[Quantity, int]) -> str:
    cycle = next((place for place, name in enumerate(block.names) if name.lower().startswith(_CYCLES)), None)
    lines = [
        f"# Guessed from {path.name}: look at it, and correct what is wrong.",
        f"file_name = {_quote(_name_of(path))}",
    ]
    if grid.separator:
        lines.append(f"separator = {_quote(grid.separator)}")
    lines.append(f"decimal = {_quote(block.marks.decimal)}")
    for quantity in ("time", "lift", "force"):
        if quantity in columns:
            place = columns[quantity]
            lines += ["", f"[{quantity}]", _say_column(block, place)]
            if unit := block.units[place]:
                lines.append(f"unit = {_quote(unit)}")
            elif not block.names:
                usual = {"time": "ms" if _is_in_ms(block, place) else "s", "lift": "mm", "force": "N"}[quantity]
                lines.append(f"unit = {_quote(usual)}  # the file does not say it")
            if quantity == "lift":
                lines.append('zero = "first sample"')
            if quantity == "force" and _points_down(block, place):
                lines.append("sign = -1  # the file counts the pull as negative")
    if cycle is not None and quantity_of_name(block.names[cycle]) is None and _counts(block, cycle):
        lines += ["", "[cycle]", _say_column(block, cycle)]
    return "\n".join(lines) + "\n"


def _say_column(block: Block, place: int) -> str:
    return f"name = {_quote(block.names[place])}" if block.names else f"number = {place + 1}"


def _points_down(block: Block, place: int) -> bool:
    """Whether the largest force of the file is negative."""
    values = [value for value in read_column(block, place) if value is not None]
    return -min(values) > 2 * max(*values, 0.0)


def _is_in_ms(block: Block, place: int) -> bool:
    """Whether times of whole numbers last so long that they are milliseconds."""
    last = block.rows[-1][place]
    return all("." not in row[place] and "," not in row[place] for row in block.rows) and float(last) > 1000


def _counts(block: Block, place: int) -> bool:
    """Whether a column counts from one value to another."""
    return len({row[place] for row in block.rows if place < len(row)}) > 1


def _name_of(path: Path) -> str:
    """The end of a path with the tool, object and repeat that stand in it replaced."""
    for depth in (1, 2):
        end = "/".join(path.parts[-depth:])
        if match := _TOOL.search(end):
            rest = re.sub(r"\d+", "{object}", end[match.end() :], count=1)
            head, found, tail = rest.partition("{object}")
            if found:
                stem, dot, suffix = tail.partition(".")
                tail = re.sub(r"\d+", "{repeat}", stem, count=1) + dot + suffix
            return f"{end[: match.start()]}{{tool}}{head}{found}{tail}"
    return "{tool}_{object}_{repeat}" + path.suffix


def _quote(text: str) -> str:
    return '"' + text.replace("\\", "\\\\").replace('"', '\\"').replace("\t", "\\t") + '"'
