"""The settings a gantry must have, and the comparison made at every connect.

GRBL's EEPROM check sum is weak: a half-written EEPROM passes it with absurd settings. So the host compares all of
`$$` and refuses to move on a difference.
"""

import math
from collections.abc import Mapping, Sequence
from types import MappingProxyType

from pydantic import Field, field_validator

from fast.hardware.grbl.messages import Vector
from fast.models.errors import ConfigError
from fast.models.records import Record

MAX_STEP_RATE_HZ = 30_000  # beyond it GRBL loses steps
RELATIVE_TOLERANCE = 1e-6
ABSOLUTE_TOLERANCE = 5e-4  # `$$` prints three decimals
SECONDS_PER_MINUTE = 60.0
SOFT_LIMITS, HARD_LIMITS = 20, 21  # numbers of the settings that a search for the switches turns off

LAB_SETTINGS: Mapping[int, float] = MappingProxyType(
    {
        0: 10,  # step pulse, us
        1: 255,  # keep motors on: Z must not sink
        2: 0,
        3: 0,
        4: 0,
        5: 0,
        6: 0,
        10: 3,  # report MPos and buffer
        11: 0.010,
        12: 0.002,
        13: 0,  # mm
        20: 1,  # soft limits
        21: 1,  # hard limits
        22: 1,  # homing
        23: 0,  # all axes home to their + ends
        24: 200,  # homing locate rate, mm/min
        25: 3000,  # homing seek rate, mm/min
        26: 100,  # debounce, ms
        27: 3,  # pull-off, mm
        30: 1000,
        31: 0,
        32: 0,  # no laser mode
        100: 80,  # steps/mm
        101: 80,
        102: 400,
        110: 12_000,  # mm/min
        111: 12_000,
        112: 3000,
        120: 500,  # mm/s2
        121: 500,
        122: 200,
        130: 1506,  # travel, mm: workspace and a pull-off at each end
        131: 1506,
        132: 186,
    }
)


class GrblProfile(Record):
    """Expected `$$` settings, by number. Three axes; vectors below are in the order x, y, z."""

    settings: dict[int, float] = Field(default_factory=lambda: dict(LAB_SETTINGS))

    @field_validator("settings")
    @classmethod
    def _check(cls, settings: dict[int, float]) -> dict[int, float]:
        missing = sorted(LAB_SETTINGS.keys() - settings.keys())
        if missing:
            raise ConfigError(f"GRBL profile lacks setting ${missing[0]}; list every setting the controller has.")
        for axis in range(3):
            rate_hz = settings[100 + axis] * settings[110 + axis] / SECONDS_PER_MINUTE
            if rate_hz >= MAX_STEP_RATE_HZ:
                raise ConfigError(
                    f"GRBL profile asks {rate_hz:.0f} steps/s of axis {'xyz'[axis]}, limit {MAX_STEP_RATE_HZ}; "
                    f"lower ${110 + axis}."
                )
        return settings

    def differences(self, found: Mapping[int, float]) -> list[str]:
        """One short text for each setting that is missing, extra or different on the controller."""
        return [text for text, _ in self.corrections(found)]

    def corrections(self, found: Mapping[int, float]) -> list[tuple[str, str]]:
        """The differences, each with the line that corrects it; empty where only another profile or build helps.

        A setting that GRBL does not have is no difference: successors of GRBL have dozens, for spindles, networks and
        the like. All that decides where and how fast the machine moves is among GRBL's own, which are all compared.
        """
        pairs = []
        for number, want in sorted(self.settings.items()):
            have = found.get(number)
            if have is None:
                pairs.append((f"${number} is absent", ""))
            elif abs(want - have) > max(ABSOLUTE_TOLERANCE, RELATIVE_TOLERANCE * abs(want)):
                pairs.append((f"${number} is {have:g}, profile {want:g}", f"${number}={want:g}"))
        return pairs

    def limits_off(self, found: Mapping[int, float]) -> list[int]:
        """Numbers of the limits that the profile has on and the controller off, if nothing else differs."""
        off = [number for number in (SOFT_LIMITS, HARD_LIMITS) if self.settings[number] and found.get(number) == 0]
        is_all = not self.differences({**found, **{number: self.settings[number] for number in off}})
        return off if is_all else []

    def with_settings(self, changes: Mapping[int, float]) -> "GrblProfile":
        """A copy with some settings changed."""
        return GrblProfile(settings={**self.settings, **changes})

    def _vector(self, first: int) -> Vector:
        return tuple(self.settings[first + axis] for axis in range(3))

    @property
    def max_speed_mm_per_s(self) -> Vector:
        """`$110..112` in mm/s."""
        return tuple(rate / SECONDS_PER_MINUTE for rate in self._vector(110))

    @property
    def acceleration_mm_per_s2(self) -> Vector:
        """`$120..122`."""
        return self._vector(120)

    @property
    def travel_mm(self) -> Vector:
        """`$130..132`."""
        return self._vector(130)

    @property
    def pull_off_mm(self) -> float:
        """`$27`."""
        return self.settings[27]

    @property
    def seek_mm_per_s(self) -> float:
        """`$25` in mm/s."""
        return self.settings[25] / SECONDS_PER_MINUTE

    @property
    def locate_mm_per_s(self) -> float:
        """`$24` in mm/s."""
        return self.settings[24] / SECONDS_PER_MINUTE

    def homes_to_plus_end(self, axis: int) -> bool:
        """Whether axis 0, 1, 2 homes to its + end (bit of `$23` clear)."""
        return not int(self.settings[23]) >> axis & 1


CONTROLLER_DELAY_S = 1.0  # parsing, dwell and polling around one move
DEADLINE_FACTOR = 1.5  # wall time slips on a loaded host


def limit_along(direction: Sequence[float], limits: Sequence[float]) -> float:
    """Largest speed (or acceleration) along a unit direction that breaks no axis limit; same unit as `limits`.

    >>> limit_along((0.6, 0.8, 0.0), (30.0, 80.0, 10.0))
    50.0
    """
    return min(limit / abs(part) for part, limit in zip(direction, limits, strict=True) if part)


def move_duration_s(distance_mm: float, speed_mm_per_s: float, acceleration_mm_per_s2: float) -> float:
    """Ideal time of a move from rest to rest: trapezoid, or triangle when too short to reach the speed."""
    if distance_mm * acceleration_mm_per_s2 < speed_mm_per_s**2:
        return 2 * math.sqrt(distance_mm / acceleration_mm_per_s2)
    return distance_mm / speed_mm_per_s + speed_mm_per_s / acceleration_mm_per_s2


def move_deadline_s(distance_mm: float, speed_mm_per_s: float, acceleration_mm_per_s2: float) -> float:
    """Time after which a move counts as stuck."""
    ideal_s = move_duration_s(distance_mm, speed_mm_per_s, acceleration_mm_per_s2)
    return (ideal_s + CONTROLLER_DELAY_S) * DEADLINE_FACTOR
