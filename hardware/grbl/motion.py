"""How long a straight move takes, and the deadline that follows (hardware notes, 1.10)."""

import math
from collections.abc import Sequence

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
