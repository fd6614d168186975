"""CSV files of a universal testing machine, one a pull; a small TOML file says how they are written."""

import re
from pathlib import Path
from typing import Literal

import numpy as np
import pyarrow as pa
import pyarrow.csv as pacsv
from pydantic import Field, field_validator

from fast.models.errors import ConfigError, UsageError
from fast.models.records import Record, Trace
from fast.models.validation import closest, load_record
from fast.tasks.bench.told import ToldGrasp
from fast.tasks.campaign.config import read_toml

_FIELDS = {
    "tool": r"(?P<tool>(?:[A-Za-z0-9-]+_)?B\d{2,6}T\d)",
    "object": r"(?P<object>\d{1,4})",
    "repeat": r"(?P<repeat>\d{1,4})",
}
_TIME = {"s": 1.0, "ms": 1e-3, "min": 60.0}
_LENGTH = {"mm": 1.0, "um": 1e-3, "cm": 10.0, "m": 1000.0, "in": 25.4}
_FORCE = {"N": 1.0, "mN": 1e-3, "cN": 1e-2, "kN": 1000.0, "gf": 9.80665e-3, "kgf": 9.80665, "lbf": 4.4482216152605}
_LARGEST_MB = 200


class Column(Record):
    """A column of the files: its header, its unit, and what its zero is."""

    name: str = Field(min_length=1)
    unit: str
    sign: Literal[1, -1] = 1
    zero: Literal["as given", "first sample"] = "as given"


class MachineFormat(Record):
    """How a testing machine writes a pull."""

    file_name: str = Field(
        default="{tool}_{object}_{repeat}.csv", description="of a pull; {tool}, {object} and {repeat} stand in it once"
    )
    separator: Literal[",", ";", "\t", "|"] = ","
    decimal: Literal[".", ","] = "."
    encoding: str = "utf-8"
    skip_lines: int = Field(default=0, ge=0, le=1000, description="lines before the one with the names of the columns")
    skip_after_header: int = Field(default=0, ge=0, le=100, description="lines below it, such as one of units")
    time: Column | None = Field(default=None, description="none: from the lift and lift_speed_mm_per_s")
    lift: Column
    force: Column
    lift_speed_mm_per_s: float | None = Field(default=None, gt=0, le=100, description="where there is no time")

    @field_validator("file_name")
    @classmethod
    def _check_name(cls, name: str) -> str:
        for field in _FIELDS:
            if name.count(f"{{{field}}}") != 1:
                raise ValueError(f"{{{field}}} must stand in it once; change it")
        return name

    @property
    def pattern(self) -> re.Pattern[str]:
        """What a file name must match."""
        parts = re.split(r"\{(tool|object|repeat)\}", self.file_name)
        return re.compile("".join(_FIELDS[part] if place % 2 else re.escape(part) for place, part in enumerate(parts)))


def read_format(path: Path) -> MachineFormat:
    """Read and check the file that says how a machine writes.

    Raises:
        ConfigError: it is missing, or has a wrong value, key or unit.
    """
    found = load_record(MachineFormat, read_toml(path, "format file"), str(path))
    for name, units in (("time", _TIME), ("lift", _LENGTH), ("force", _FORCE)):
        column = getattr(found, name)
        if column is not None and column.unit not in units:
            raise ConfigError(f"{path}: {name}.unit is `{column.unit}`; change it to one of {', '.join(units)}.")
    if found.separator == found.decimal:
        raise ConfigError(f"{path}: separator and decimal are both `{found.decimal}`; change one.")
    if (found.time is None) == (found.lift_speed_mm_per_s is None):
        raise ConfigError(f"{path}: give [time], or lift_speed_mm_per_s where the files have no time; one of the two.")
    return found


def read_pull(path: Path, machine: MachineFormat) -> ToldGrasp:
    """The grasp of one file.

    Raises:
        UsageError: its name says no grasp, it cannot be read, or lacks a column.
    """
    match = machine.pattern.fullmatch(path.name)
    if match is None:
        raise UsageError(
            f"{path}: the name is not like `{machine.file_name}`, e.g. "
            f"{machine.file_name.format(tool='B01T0', object=14, repeat=0)}; rename it, or change file_name."
        )
    table = _read_table(path, machine)
    lift_mm = _channel(path, table, machine.lift, _LENGTH)
    if machine.time is not None:
        time_s = _channel(path, table, machine.time, _TIME)
    else:
        time_s = np.maximum.accumulate(np.maximum(lift_mm, 0.0)) / (machine.lift_speed_mm_per_s or 1.0)
    trace = Trace(time_s=time_s, lift_mm=lift_mm, force_n=_channel(path, table, machine.force, _FORCE))
    tool_id = match["tool"].replace("_", "/")
    return ToldGrasp(str(path), tool_id, int(match["object"]), int(match["repeat"]), trace=trace)


def _read_table(path: Path, machine: MachineFormat) -> pa.Table:
    try:
        if path.stat().st_size > _LARGEST_MB * 1e6:
            raise UsageError(f"{path} is larger than {_LARGEST_MB} MB, which no pull is; give one file for each pull.")
        columns = [column.name for column in (machine.time, machine.lift, machine.force) if column is not None]
        return pacsv.read_csv(
            path,
            read_options=pacsv.ReadOptions(
                use_threads=False,
                encoding=machine.encoding,
                skip_rows=machine.skip_lines,
                skip_rows_after_names=machine.skip_after_header,
            ),
            parse_options=pacsv.ParseOptions(delimiter=machine.separator),
            convert_options=pacsv.ConvertOptions(
                decimal_point=machine.decimal, column_types=dict.fromkeys(columns, pa.float64())
            ),
        )
    except OSError as error:
        raise UsageError(f"{path} cannot be read ({error.strerror}); give an existing file.") from error
    except (pa.ArrowException, LookupError, UnicodeError) as error:
        what = " ".join(str(error).split())[:160]
        raise UsageError(
            f"{path} is not written as the format file says ({what}); nothing was written: correct separator, decimal, "
            "encoding, skip_lines or skip_after_header."
        ) from error


def _channel(path: Path, table: pa.Table, column: Column, units: dict[str, float]) -> np.ndarray:
    names = [name.strip() for name in table.column_names]
    if column.name not in names:
        raise UsageError(f"{path} has no column `{column.name}`; {closest(column.name, names)}")
    values = table.column(names.index(column.name))
    if not pa.types.is_floating(values.type):
        raise UsageError(f"{path}: the column `{column.name}` has spaces around its name; name it as in the file.")
    found = column.sign * units[column.unit] * values.to_numpy().astype(float)
    return found - found[0] if column.zero == "first sample" and len(found) else found
