"""The settings a gantry must have, and the comparison made at every connect.

GRBL's EEPROM check sum is weak: a half-written EEPROM passes it with absurd settings. So the host compares all of
`$$` and refuses to move on a difference.
"""

import math
from collections.abc import Mapping, Sequence
from types import MappingProxyType

from pydantic import Field, model_validator

from fast.hardware.grbl.messages import Vector
from fast.models.errors import ConfigError
from fast.models.records import Record

MAX_STEP_RATE_HZ = 30_000.0  # beyond it GRBL on an 8-bit board loses steps
RELATIVE_TOLERANCE = 1e-6
ABSOLUTE_TOLERANCE = 5e-4  # `$$` prints three decimals
SECONDS_PER_MINUTE = 60.0
SOFT_LIMITS, HARD_LIMITS = 20, 21  # numbers of the settings that a search for the switches turns off

FIRST_AXIS_SETTING = 100  # from here on one number an axis, above 0
FIRST_TRAVEL_SETTING = 130
Z_AXIS = 2

# Number, value on GRBL, value on grblHAL, what it is for or what goes wrong without. None: it is not compared there,
# since it is unknown, or does no harm. grblHAL is GRBL's successor on 32-bit boards: it has GRBL's numbers, some with
# another meaning, and dozens of its own for spindles, networks and the like.
_TABLE: tuple[tuple[int, float | None, float | None, str], ...] = (
    (0, 10, 10, "step pulse, us"),
    (1, 255, 255, "motors stay on: Z must not sink"),
    (2, 0, 0, "polarity of the step pins"),
    (3, 0, 0, "directions: a wrong one drives away from the home switch"),
    (4, 0, 0, "polarity of the motor enable; a bit an axis on grblHAL"),
    (5, 0, 0, "polarity of the limit switches; a bit an axis on grblHAL"),
    (6, 0, None, "polarity of the probe, which is not used"),
    (10, 3, 123, "reports tell place and buffer; grblHAL must be asked for speed, switches, offsets and overrides too"),
    (11, 0.010, None, "speed in corners; the bench stops at each"),
    (12, 0.002, None, "arcs, which are not used"),
    (13, 0, 0, "reports in mm"),
    (20, 1, 1, "soft limits"),
    (21, 1, 1, "hard limits"),
    (22, 1, 5, "homing; grblHAL must be told that nothing moves before it after power-on"),
    (23, 0, 0, "ends to which the axes home"),
    (24, 200, 200, "homing, slow approach, mm/min"),
    (25, 3000, 3000, "homing, search, mm/min: a dead switch drives into the far end at this rate"),
    (26, 100, 100, "homing debounce, ms"),
    (27, 3, 3, "pull-off from the switches, mm"),
    (30, 1000, None, "spindle, unused"),
    (31, 0, None, "spindle, unused"),
    (32, 0, None, "laser mode, unused"),
    (39, None, 1, "`?`, `!` and `~` are obeyed: else there is no feed hold"),
    (40, None, 0, "a jog beyond the travel is refused, not shortened without a word"),
    (44, None, 4, "homing: Z first, clear of what stands on the bench"),
    (45, None, 3, "homing: then X and Y"),
    (46, None, 0, "homing: nothing else"),
    (62, None, 0, "no sleep, in which the motors go off"),
    (100, 80, 80, "steps/mm"),
    (101, 80, 80, "steps/mm"),
    (102, 400, 400, "steps/mm"),
    (110, 12_000, 12_000, "fastest, mm/min"),
    (111, 12_000, 12_000, "fastest, mm/min"),
    (112, 3000, 3000, "fastest, mm/min"),
    (120, 500, 500, "acceleration, mm/s2"),
    (121, 500, 500, "acceleration, mm/s2"),
    (122, 200, 200, "acceleration, mm/s2"),
    (130, 1506, 1506, "travel, mm: workspace and a pull-off at each end"),
    (131, 1506, 1506, "travel, mm"),
    (132, 186, 186, "travel, mm"),
    (481, None, 0, "no report that nobody asked for: it would pass for an answer"),
    (676, None, 15, "a reset in motion costs the homing, and overrides end"),
)
LAB_SETTINGS: Mapping[int, float] = MappingProxyType({row[0]: row[1] for row in _TABLE if row[1] is not None})
SAFE_SETTINGS = frozenset({1, 10, 13, 20, 21, 22, 32})  # of the same value on every machine: the driver relies on them
MACHINE_SETTINGS = frozenset({3, 23, *range(100, 133)}) & LAB_SETTINGS.keys()  # of how a machine is built
_ONLY_HAL = frozenset({row[0] for row in _TABLE} - set(LAB_SETTINGS))
HAL_BUILD = "FIRMWARE:grblHAL"  # in the answer to `$I`


class GrblProfile(Record):
    """Expected `$$` settings, by number. Three axes; vectors below are in the order x, y, z."""

    settings: dict[int, float] = Field(default_factory=lambda: dict(LAB_SETTINGS))
    max_step_rate_hz: float = MAX_STEP_RATE_HZ
    """Steps a second that the controller can make."""

    @model_validator(mode="after")
    def _check(self) -> "GrblProfile":
        settings = self.settings
        missing = sorted(LAB_SETTINGS.keys() - settings.keys())
        if missing:
            raise ConfigError(f"GRBL profile lacks setting ${missing[0]}; list every setting the controller has.")
        for axis in range(3):
            rate_hz = settings[100 + axis] * settings[110 + axis] / SECONDS_PER_MINUTE
            if rate_hz >= self.max_step_rate_hz:
                raise ConfigError(
                    f"GRBL profile asks {rate_hz:.0f} steps/s of axis {'xyz'[axis]}, limit {self.max_step_rate_hz:g}; "
                    f"lower ${110 + axis}, or give a faster board its max_step_rate_hz."
                )
        return self

    def wanted(self, build: Sequence[str] = ()) -> dict[int, float]:
        """Return what is compared on a controller that says `build` of itself (`$I`); nothing said counts as GRBL.

        On grblHAL a setting that the profile has changed is wanted as the profile says.
        """
        if HAL_BUILD not in build:
            return {number: value for number, value in self.settings.items() if number not in _ONLY_HAL}
        own = {number: value for number, value in self.settings.items() if value != LAB_SETTINGS.get(number)}
        return {number: own.get(number, hal) for number, _, hal, _ in _TABLE if hal is not None}

    def differences(self, found: Mapping[int, float], build: Sequence[str] = ()) -> list[str]:
        """Return one short text for each setting that is missing or different on the controller."""
        return [text for text, _ in self.corrections(found, build)]

    def corrections(self, found: Mapping[int, float], build: Sequence[str] = ()) -> list[tuple[str, str]]:
        """Return the differences, each with the line that corrects it; empty if only another profile or build helps.

        Of GRBL all is compared, of grblHAL what decides where, how fast and when the machine moves (`_TABLE`). What a
        controller has beside is no difference, nor is a setting of grblHAL alone that its build has not.
        """
        pairs = []
        for number, want in sorted(self.wanted(build).items()):
            have = found.get(number)
            if have is None and number not in _ONLY_HAL:
                pairs.append((f"${number} is absent", ""))
            elif have is not None and abs(want - have) > max(ABSOLUTE_TOLERANCE, RELATIVE_TOLERANCE * abs(want)):
                pairs.append((f"${number} is {have:g}, profile {want:g}", f"${number}={want:g}"))
        return pairs

    def limits_off(self, found: Mapping[int, float], build: Sequence[str] = ()) -> list[int]:
        """Return numbers of the limits that the profile has on and the controller off, if nothing else differs."""
        off = [number for number in (SOFT_LIMITS, HARD_LIMITS) if self.settings[number] and found.get(number) == 0]
        is_all = not self.differences({**found, **{number: self.settings[number] for number in off}}, build)
        return off if is_all else []

    def with_settings(self, changes: Mapping[int, float]) -> "GrblProfile":
        """Return a copy with some settings changed."""
        return GrblProfile(settings={**self.settings, **changes}, max_step_rate_hz=self.max_step_rate_hz)

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
        return self._vector(FIRST_TRAVEL_SETTING)

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
        """Return whether axis 0, 1, 2 homes to its + end (bit of `$23` clear)."""
        return not int(self.settings[23]) >> axis & 1


CONTROLLER_DELAY_S = 1.0  # parsing, dwell and polling around one move
DEADLINE_FACTOR = 1.5  # wall time slips on a loaded host


def limit_along(direction: Sequence[float], limits: Sequence[float]) -> float:
    """Return the largest speed (or acceleration) along a unit direction within all axis limits; unit as in `limits`.

    >>> limit_along((0.6, 0.8, 0.0), (30.0, 80.0, 10.0))
    50.0
    """
    return min(limit / abs(part) for part, limit in zip(direction, limits, strict=True) if part)


def move_duration_s(distance_mm: float, speed_mm_per_s: float, acceleration_mm_per_s2: float) -> float:
    """Return the ideal time of a move from rest to rest: trapezoid, or triangle if too short to reach the speed."""
    if distance_mm * acceleration_mm_per_s2 < speed_mm_per_s**2:
        return 2 * math.sqrt(distance_mm / acceleration_mm_per_s2)
    return distance_mm / speed_mm_per_s + speed_mm_per_s / acceleration_mm_per_s2


def move_deadline_s(distance_mm: float, speed_mm_per_s: float, acceleration_mm_per_s2: float) -> float:
    """Return the time after which a move counts as stuck."""
    ideal_s = move_duration_s(distance_mm, speed_mm_per_s, acceleration_mm_per_s2)
    return (ideal_s + CONTROLLER_DELAY_S) * DEADLINE_FACTOR
