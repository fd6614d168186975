"""In which order to visit objects: the shortest way over the grid, and what another order costs."""

import math
from collections.abc import Callable, Sequence
from functools import lru_cache

from fast.hardware.grbl.profile import GrblProfile, limit_along, move_duration_s
from fast.hardware.parts.layout import BenchLayout

Point = tuple[float, float]

_TIE_S_PER_MM = 1e-6  # a diagonal step takes as long as a straight one: of equal times the shorter way
_LEAST_GAIN_S = 1e-9  # rounding must not let two orders swap for ever


def shortest_tour(object_ids: Sequence[int], layout: BenchLayout | None = None) -> tuple[int, ...]:
    """Order the objects for a short round trip from the middle of the dock and back.

    From nearest neighbours, and from columns up and down, stretches are reversed (2-opt, Croes 1958) and single objects
    moved until neither shortens the way; the better of both is taken. Deterministic, the same for every tool, and
    independent of the order of `object_ids`. On the full 6 x 6 grid it is the optimum: one pitch from object to object.
    """
    return _tour(tuple(sorted(object_ids)), layout or BenchLayout())


def travel_s(points: Sequence[Point], profile: GrblProfile | None = None) -> float:
    """Compute the time to visit the places in order, at rest in each, at the profile's full speed."""
    profile = profile or GrblProfile()
    return sum(_leg_s(a, b, profile) for a, b in zip(points, points[1:], strict=False))


@lru_cache(maxsize=32)
def _tour(object_ids: tuple[int, ...], layout: BenchLayout) -> tuple[int, ...]:
    first, last = layout.dock_xy_mm(0), layout.dock_xy_mm(layout.n_slots - 1)
    dock = ((first[0] + last[0]) / 2, first[1])
    places = [dock, *(layout.object_xy_mm(object_id) for object_id in object_ids)]
    profile = GrblProfile()
    leg_s = [[_leg_s(a, b, profile) + _TIE_S_PER_MM * math.dist(a, b) for b in places] for a in places]
    best = min((_improve(order, leg_s) for order in (_nearest_first(leg_s), _up_and_down(places))), key=_length(leg_s))
    tour = tuple(object_ids[place - 1] for place in best[1:])
    return tour if tour[:1] <= tour[-1:] else tour[::-1]  # both ways round are as long


def _improve(order: list[int], leg_s: list[list[float]]) -> list[int]:
    while _reverse_a_stretch(order, leg_s) or _move_one(order, leg_s):
        pass
    return order


def _length(leg_s: list[list[float]]) -> Callable[[list[int]], float]:
    return lambda order: sum(leg_s[a][b] for a, b in zip(order, [*order[1:], order[0]], strict=True))


def _leg_s(a: Point, b: Point, profile: GrblProfile) -> float:
    distance_mm = math.dist(a, b)
    if distance_mm == 0:
        return 0.0
    direction = [(q - p) / distance_mm for p, q in zip(a, b, strict=True)]
    speed = limit_along(direction, profile.max_speed_mm_per_s[:2])
    return move_duration_s(distance_mm, speed, limit_along(direction, profile.acceleration_mm_per_s2[:2]))


def _nearest_first(leg_s: list[list[float]]) -> list[int]:
    order, left = [0], list(range(1, len(leg_s)))
    while left:
        nearest = min(left, key=lambda place: (leg_s[order[-1]][place], place))
        order.append(nearest)
        left.remove(nearest)
    return order


def _up_and_down(places: Sequence[Point]) -> list[int]:
    """Order the places column by column, away from the dock and back."""
    columns = sorted({x for x, _ in places[1:]})

    def rank(place: int) -> tuple[float, float]:
        x, y = places[place]
        return x, y if columns.index(x) % 2 else -y

    return [0, *sorted(range(1, len(places)), key=rank)]


def _reverse_a_stretch(order: list[int], leg_s: list[list[float]]) -> bool:
    """Reverse the first stretch whose reversal shortens the round trip; place 0 (the dock) stays first."""
    n = len(order)
    for i in range(1, n - 1):
        for j in range(i + 1, n):
            before, first, last, after = order[i - 1], order[i], order[j], order[(j + 1) % n]
            gain_s = leg_s[before][first] + leg_s[last][after] - leg_s[before][last] - leg_s[first][after]
            if gain_s > _LEAST_GAIN_S:
                order[i : j + 1] = order[i : j + 1][::-1]
                return True
    return False


def _move_one(order: list[int], leg_s: list[list[float]]) -> bool:
    """Move the first place that is better visited elsewhere."""
    n = len(order)
    for i in range(1, n):
        place, before, after = order[i], order[i - 1], order[(i + 1) % n]
        saved_s = leg_s[before][place] + leg_s[place][after] - leg_s[before][after]
        rest = order[:i] + order[i + 1 :]
        for k in range(len(rest)):
            a, b = rest[k], rest[(k + 1) % len(rest)]
            if saved_s - (leg_s[a][place] + leg_s[place][b] - leg_s[a][b]) > _LEAST_GAIN_S:
                order[:] = [*rest[: k + 1], place, *rest[k + 1 :]]
                return True
    return False
