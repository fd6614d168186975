"""The file in which a person says how a testing machine writes: which column is what, and what a file's name means."""

import re
from collections.abc import Iterable
from pathlib import Path
from typing import Any, Literal

from pydantic import Field, field_validator, model_validator

from fast.models.errors import ConfigError
from fast.models.records import Record
from fast.models.validation import load_record
from fast.tasks.bench.machine_files.words import USUAL_UNITS, Quantity, scale_of
from fast.tasks.campaign.config import read_toml

_TOOL = r"(?:[A-Za-z0-9.-]+_)?[Bb]\d{2,6}[Tt]\d"
_FIELDS = {"object": r"(?P<object>\d{1,10})", "repeat": r"(?P<repeat>\d{1,4})"}
_DEFAULT_NAME = "{tool}_{object}_{repeat}.*"
# Names of files that programs give by themselves; the public pages that say so are in docs/reference/configuration.md.
PROGRAMS = {
    "bluehill": "{tool}_{object}_{repeat}.is_*_RawData/Specimen_RawData_*.csv",
    "mts-793": "{tool}_{object}_{repeat}/specimen.dat",
}


class Column(Record):
    """A column of the files: its name or its number, its unit, and what its zero is."""

    name: str | None = Field(default=None, min_length=1)
    number: int | None = Field(default=None, ge=1, le=1000, description="from the left, where columns have no names")
    unit: str | None = Field(default=None, description="none: as the file says")
    sign: Literal[1, -1] = 1
    zero: Literal["as given", "first sample"] = "as given"

    @model_validator(mode="after")
    def _check(self) -> "Column":
        if (self.name is None) == (self.number is None):
            raise ValueError("give `name`, or `number` where columns have no names; one of the two")
        return self


class MachineFormat(Record):
    """How a testing machine writes pulls; what is not said is found in each file."""

    program: Literal["bluehill", "mts-793"] | None = Field(default=None, description="whose usual file names are meant")
    file_name: str = Field(
        default=_DEFAULT_NAME,
        description="end of the path: {tool}, {object}, {repeat} unless a file has several pulls; * is any text",
    )
    first_repeat: int = Field(default=0, ge=0, le=1000, description="number of the first repeat in file names")
    separator: Literal[",", ";", "\t", "|", " "] | None = None
    """Of cells; None: found."""
    decimal: Literal[".", ","] | None = None
    """Of numbers; None: found."""
    encoding: str | None = None
    """Of the text; None: found."""
    skip_lines: int = Field(default=0, ge=0, le=1000, description="not needed: the names of the columns are looked for")
    skip_after_header: int = Field(default=0, ge=0, le=100, description="not needed: units are known as such")
    time: Column | None = Field(default=None, description="none: found, or from the lift and its speed")
    lift: Column | None = Field(default=None, description="none: found by its name or unit")
    force: Column | None = Field(default=None, description="none: found by its name or unit")
    cycle: Column | None = Field(default=None, description="counts the pulls of a file; none: where the lift goes back")
    lift_speed_mm_per_s: float | None = Field(default=None, gt=0, le=100, description="where there is no time")

    @field_validator("file_name")
    @classmethod
    def _check_name(cls, name: str) -> str:
        for field in ("tool", *_FIELDS):
            n = name.count(f"{{{field}}}")
            if n > 1 or (n == 0 and field != "repeat"):
                raise ValueError(f"{{{field}}} must stand in it once; change it")
        return name

    @property
    def wanted_name(self) -> str:
        """What the end of a path must look like."""
        return PROGRAMS[self.program] if self.program and self.file_name == _DEFAULT_NAME else self.file_name

    def pattern(self, tool_names: Iterable[str] = ()) -> re.Pattern[str]:
        """Return what the end of a path must match; `tool_names`: how tools may be called beside `B01T0`."""
        tools = "|".join([_TOOL, *(re.sub(r"\\ |_", "[ _]", re.escape(name)) for name in tool_names)])
        fields = {"{tool}": f"(?P<tool>{tools})", "*": "[^/]*"}
        fields |= {f"{{{name}}}": found for name, found in _FIELDS.items()}
        parts = re.split(r"(\{tool\}|\{object\}|\{repeat\}|\*)", self.wanted_name)
        return re.compile("(?:.*/)?" + "".join(fields.get(part) or re.escape(part) for part in parts), re.IGNORECASE)

    def columns(self) -> dict[Quantity, Column]:
        """Return the columns that are said, by quantity."""
        given = {"time": self.time, "lift": self.lift, "force": self.force}
        return {name: column for name, column in given.items() if column is not None}  # type: ignore[misc]


def read_format(path: Path) -> MachineFormat:
    """Read and check the file that says how a machine writes.

    Raises:
        ConfigError: it is missing, or has a wrong value, key or unit.
    """
    return make_format(read_toml(path, "format file"), str(path))


def make_format(data: dict[str, Any], where: str) -> MachineFormat:
    """Check what a format file says; `where`: its name, for messages.

    Raises:
        ConfigError: it has a wrong value, key or unit.
    """
    found = load_record(MachineFormat, data, where)
    for name, column in found.columns().items():
        if column.unit is not None and scale_of(name, column.unit) is None:
            raise ConfigError(f"{where}: {name}.unit is `{column.unit}`; change it to one of {USUAL_UNITS[name]}.")
    if found.time is not None and found.lift_speed_mm_per_s is not None:
        raise ConfigError(f"{where}: give [time], or lift_speed_mm_per_s where the files have no time; one of the two.")
    return found
