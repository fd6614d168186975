"""The file in which a person says how a testing machine writes: which column is what, and what a file's name means."""

import re
from pathlib import Path
from typing import Literal

from pydantic import Field, field_validator, model_validator

from fast.models.errors import ConfigError
from fast.models.records import Record
from fast.models.validation import load_record
from fast.tasks.bench.machine_files.words import USUAL_UNITS, Quantity, scale_of
from fast.tasks.campaign.config import read_toml

_FIELDS = {
    "tool": r"(?P<tool>(?:[A-Za-z0-9-]+_)?[Bb]\d{2,6}[Tt]\d)",
    "object": r"(?P<object>\d{1,10})",
    "repeat": r"(?P<repeat>\d{1,4})",
}
# File names that programs give by default, from the public manuals of the programs.
PROGRAMS = {"bluehill": "{tool}_{object}_{repeat}.is_tens_RawData/Specimen_RawData_1.csv"}


class Column(Record):
    """A column of the files: its name or its number, its unit, and what its zero is."""

    name: str | None = Field(default=None, min_length=1)
    number: int | None = Field(default=None, ge=1, le=1000, description="from the left, where columns have no names")
    unit: str | None = Field(default=None, description="empty: as the file says")
    sign: Literal[1, -1] = 1
    zero: Literal["as given", "first sample"] = "as given"

    @model_validator(mode="after")
    def _check(self) -> "Column":
        if (self.name is None) == (self.number is None):
            raise ValueError("give `name`, or `number` where columns have no names; one of the two")
        return self


class MachineFormat(Record):
    """How a testing machine writes pulls; what is not said is found in each file."""

    program: Literal["bluehill"] | None = Field(default=None, description="whose usual names of files are meant")
    file_name: str = Field(
        default="{tool}_{object}_{repeat}.csv",
        description="end of the path, with {tool}, {object}, and {repeat} unless a file has several pulls",
    )
    separator: Literal[",", ";", "\t", "|"] | None = None
    decimal: Literal[".", ","] | None = None
    encoding: str | None = None
    skip_lines: int = Field(default=0, ge=0, le=1000, description="not needed: the names of the columns are looked for")
    skip_after_header: int = Field(default=0, ge=0, le=100, description="not needed: units are known as such")
    time: Column | None = Field(default=None, description="none: from the lift and its speed")
    lift: Column
    force: Column
    cycle: Column | None = Field(default=None, description="counts the pulls of a file; none: where the lift goes back")
    lift_speed_mm_per_s: float | None = Field(default=None, gt=0, le=100, description="where there is no time")

    @field_validator("file_name")
    @classmethod
    def _check_name(cls, name: str) -> str:
        for field in _FIELDS:
            n = name.count(f"{{{field}}}")
            if n > 1 or (n == 0 and field != "repeat"):
                raise ValueError(f"{{{field}}} must stand in it once; change it")
        return name

    @property
    def wanted_name(self) -> str:
        """What the end of a path must look like."""
        is_usual = self.file_name == MachineFormat.model_fields["file_name"].default
        return PROGRAMS[self.program] if self.program and is_usual else self.file_name

    @property
    def pattern(self) -> re.Pattern[str]:
        """What the end of a path must match."""
        parts = re.split(r"\{(tool|object|repeat)\}", self.wanted_name)
        found = "".join(_FIELDS[part] if place % 2 else re.escape(part) for place, part in enumerate(parts))
        return re.compile(f"(?:.*/)?{found}")

    def columns(self) -> dict[Quantity, Column]:
        """Columns of the samples by quantity."""
        given: dict[Quantity, Column] = {"lift": self.lift, "force": self.force}
        return given if self.time is None else {"time": self.time, **given}


def read_format(path: Path) -> MachineFormat:
    """Read and check the file that says how a machine writes.

    Raises:
        ConfigError: it is missing, or has a wrong value, key or unit.
    """
    found = load_record(MachineFormat, read_toml(path, "format file"), str(path))
    for name, column in found.columns().items():
        if column.unit is not None and scale_of(name, column.unit) is None:
            raise ConfigError(f"{path}: {name}.unit is `{column.unit}`; change it to one of {USUAL_UNITS[name]}.")
    if found.time is not None and found.lift_speed_mm_per_s is not None:
        raise ConfigError(f"{path}: give [time], or lift_speed_mm_per_s where the files have no time; one of the two.")
    return found
