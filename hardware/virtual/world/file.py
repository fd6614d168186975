"""The world file: what a virtual bench hides."""

import math
from typing import Any

from pydantic import Field, field_validator, model_validator

from fast.hardware.virtual.world.hidden import check_hidden
from fast.models.errors import ConfigError
from fast.models.ids import content_id
from fast.models.records import EffectValue, Record, Theta
from fast.models.validation import load_record, parse_toml

# Keys that the first world files did not have: without them, a lake would take an old file for another world.
_LATER_KEYS = (
    ("mesh", "layers"),
    ("scatter", "thickness_sd_mm"),
    ("scatter", "offset_y_sd_mm"),
    ("scatter", "yaw_sd_deg"),
    ("scatter", "roll_sd_deg"),
)


class WorldMesh(Record):
    """How finely the world computes its truth."""

    edge_mm: float = Field(default=5.0, ge=1.0, le=20)
    """Longest edge of the mesh of the truth."""
    layers: int = Field(default=2, ge=1, le=4, description="quadratic layers over the half width")


class Scatter(Record):
    """What differs between prints, mountings and grasps that should be alike."""

    tool_modulus_sd: float = Field(default=0.0, ge=0, le=0.5, description="print to print, relative")
    thickness_sd_mm: float = Field(default=0.0, ge=0, le=0.3, description="of the walls, print to print")
    placement_sd_mm: float = Field(default=0.0, ge=0, le=5, description="object position in x and z, per mounting")
    offset_y_sd_mm: float = Field(default=0.0, ge=0, le=5, description="object position in y, per mounting")
    yaw_sd_deg: float = Field(default=0.0, ge=0, le=10, description="object about its vertical axis, per mounting")
    roll_sd_deg: float = Field(default=0.0, ge=0, le=10, description="fingers about their long axes, per tool")
    repeat_sd: float = Field(default=0.0, ge=0, le=0.5, description="grasp to grasp, relative")


class Sensor(Record):
    """The load-cell chain."""

    rate_hz: float = Field(default=80.0, ge=5, le=300, description="readings of the transmitter")
    noise_sd_n: float = Field(default=0.0, ge=0, le=5, description="per reading, AR(1)")
    noise_correlation_s: float = Field(default=0.05, ge=0, le=10)
    """How long the noise is correlated."""


class World(Record):
    """Hidden truth of a virtual bench: theta, mesh, scatter, sensor and hidden effects."""

    seed: int = Field(default=0, ge=0)
    """All noise and scatter follow from it, per tool, object and repeat."""
    theta: Theta = Theta()
    mesh: WorldMesh = WorldMesh()
    scatter: Scatter = Scatter()
    sensor: Sensor = Sensor()
    hidden: tuple[EffectValue, ...] = ()
    """`[[hidden]]` tables with `effect` and its parameters."""

    @field_validator("hidden", mode="before")
    @classmethod
    def _fold_parameters(cls, tables: Any) -> Any:
        """Fold each `[[hidden]]` table, which names its effect and lists the parameters beside it."""
        return tuple(_fold(table) for table in tables) if isinstance(tables, list | tuple) else tables

    @model_validator(mode="after")
    def _check_hidden(self) -> "World":
        check_hidden(self.hidden, "world")
        return self

    @property
    def world_hash(self) -> str:
        """Id derived from the whole content, `W` and 12 hex digits; `_LATER_KEYS` count where they change a world."""
        content = self.model_dump(mode="json")
        for section, key in _LATER_KEYS:
            if content[section][key] == type(getattr(self, section)).model_fields[key].default:
                del content[section][key]
        return content_id("W", content)


def load_world(text: str, source: str) -> World:
    """Load a world from the text of its TOML file; `source` names the file in messages.

    Raises:
        ConfigError: no TOML, an unknown key or effect, or a value outside its limits.
    """
    data = parse_toml(text, f"world file `{source}`")
    tables = data.get("hidden", [])
    if not isinstance(tables, list):
        raise ConfigError(f"{source}: `hidden` is one table; write it as [[hidden]], once per effect.")
    for table in tables:
        _check_table(table, source)
    check_hidden([load_record(EffectValue, _fold(table), source) for table in tables], source)
    return load_record(World, data, source)


def _check_table(table: Any, source: str) -> None:
    if not isinstance(table, dict) or not isinstance(table.get("effect"), str):
        raise ConfigError(f"{source}: a [[hidden]] table has no effect; add effect = with one of its names.")
    for name, value in table.items():
        is_number = isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < math.inf
        if name != "effect" and not is_number:
            raise ConfigError(
                f"{source}: `{name}` of hidden effect `{table['effect']}` is {value!r}, it must be a finite number; "
                "change it."
            )


def _fold(table: Any) -> Any:
    if not isinstance(table, dict) or "parameters" in table:
        return table
    return {"effect": table.get("effect"), "parameters": {k: v for k, v in table.items() if k != "effect"}}
