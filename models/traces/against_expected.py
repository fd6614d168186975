"""Measured grasps held against what is expected of their tool and object, over the whole trace.

Expected is the simulated trace, or where there is none the middle of what other tools do on the same object; `expected`
puts it right and says how far chance goes. Three things are looked at: whether the gripper closed, whether the object
is still held late in the lift, and whether it is pressed down at its start. Repeats that all went wrong alike show
here.
"""

from typing import NamedTuple

import numpy as np

from fast.models.traces.batch import TraceFeatures
from fast.models.traces.expected import LEAST_CELLS, Chance, find_shortfalls
from fast.models.traces.names import DIP_MM, NOISE_N, PROFILE_STEP_MM

LEAST_SCALE = 0.03  # of ln force, and of a force over that of the cell: no simulator and no gauge is better than 3 %
LATE = (0.75, 0.95)  # of the lift over which the object should be held
# Chance of fewer cells than `LEAST_CELLS`: of 288 sound cells of the world `lab`, 24 at a time, none was as far out as
# p = 1e-4 of these. A push cannot be told so: its tails are too wide.
USUAL_CHANCE = {"grip": Chance(0.19, 30.0, 0.01), "late": Chance(0.12, 30.0, 0.01), "press": Chance(100.0, 30.0, 0.01)}
_HELD = 0.05  # of the largest force, and at least `_HELD_N`: less is not held
_HELD_N = 0.1
_MOST_SIZE = 3.0  # scales: what is farther out says nothing of how the forces of the start go together


class Short(NamedTuple):
    """Shortfalls of n grasps of what is expected, their p-values, what was measured; 0, 1, 0 where nothing is expected.

    `measured_n`: the force late in the lift, or before it, in N.
    """

    shortfall: np.ndarray
    p_value: np.ndarray
    measured_n: np.ndarray


def grip_n(features: TraceFeatures) -> np.ndarray:
    """Return the largest force (n), of either sign, that shows that the gripper closed, before 2 mm of lift."""
    shown = [features.column(name) for name in ("initial_force_n", "closing_lowest_n")]
    return np.asarray(np.max(np.abs([*shown, features.profile_n[:, 0]]), axis=0))


def hold_against(
    measured: TraceFeatures,
    simulated: TraceFeatures,
    tool: np.ndarray,
    object_id: np.ndarray,
    fewest: int = LEAST_CELLS,
) -> dict[str, Short]:
    """Find shortfalls of n grasps by what they are of: `grip` and `late` of ln(force + 0.5 N), `press` in N.

    Args:
        measured: of n grasps, usable.
        simulated: of the same tools and objects, n rows; NaN where there is none.
        tool: n, any labels.
        object_id: n.
        fewest: cells with a simulated trace that are enough; of fewer than `LEAST_CELLS` chance is `USUAL_CHANCE`.
    """
    n = len(tool)
    found = {name: Short(np.zeros(n), np.ones(n), np.zeros(n)) for name in ("grip", "late", "press")}
    for is_simulated in (True, False):
        part = np.flatnonzero(simulated.is_usable == is_simulated)
        cells, cell = np.unique(np.stack([_number(tool)[part], object_id[part]]), axis=1, return_inverse=True)
        least = fewest if is_simulated else LEAST_CELLS
        if cells.shape[1] < least or min(len(np.unique(row)) for row in cells) < 2:
            continue
        own = _take(measured, part)
        expected = _take(simulated, part) if is_simulated else _like_others(own, cells, cell.ravel())
        for name, short in _hold(own, expected, cells, cell.ravel()).items():
            for column, values in zip(found[name], short, strict=True):
                column[part] = values
    return found


def late_n(profile_n: np.ndarray, expected_n: np.ndarray) -> np.ndarray:
    """Average the force (n) over the part of the lift in which the object should still be held, but not long, N."""
    edges_mm = PROFILE_STEP_MM * np.arange(expected_n.shape[1] + 1)
    is_held = expected_n > np.maximum(_HELD * expected_n.max(axis=1), _HELD_N)[:, None]
    held_mm = edges_mm[-1] - PROFILE_STEP_MM * is_held[:, ::-1].argmax(axis=1)
    low_mm, high_mm = ((share * held_mm * is_held.any(axis=1))[:, None] for share in LATE)
    weight = np.clip(np.minimum(high_mm, edges_mm[1:]) - np.maximum(low_mm, edges_mm[:-1]), 0.0, None)
    return np.asarray((profile_n * weight).sum(axis=1) / np.maximum(weight.sum(axis=1), 1e-9))


def _number(labels: np.ndarray) -> np.ndarray:
    return np.asarray(np.unique(labels, return_inverse=True)[1])


def _take(features: TraceFeatures, part: np.ndarray) -> TraceFeatures:
    return TraceFeatures(features.values[part], features.profile_n[part])


def _like_others(measured: TraceFeatures, cells: np.ndarray, cell: np.ndarray) -> TraceFeatures:
    """Return what the middle tool does on each grasp's object, its own left out where there are others."""
    values, profile_n = np.zeros_like(measured.values), np.zeros_like(measured.profile_n)
    for number, (tool, object_id) in enumerate(cells.T):
        others = (cells[1] == object_id) & (cells[0] != tool)
        rows = np.isin(cell, np.flatnonzero(others)) if others.any() else cell == number
        here = cell == number
        values[here] = np.median(np.nan_to_num(measured.values[rows]), axis=0)
        profile_n[here] = np.median(measured.profile_n[rows], axis=0)
    return TraceFeatures(values, profile_n)


def _hold(measured: TraceFeatures, expected: TraceFeatures, cells: np.ndarray, cell: np.ndarray) -> dict[str, Short]:
    def log_n(force_n: np.ndarray) -> np.ndarray:
        return np.asarray(np.log(np.maximum(force_n, 0.0) + NOISE_N))

    late = [late_n(features.profile_n, expected.profile_n) for features in (measured, expected)]
    grip = [grip_n(features) for features in (measured, expected)]
    level_n = np.maximum(expected.column("peak_force_n"), 0.0) + 2.0 * NOISE_N
    starts = _start_n(measured) - _start_n(expected)
    return {
        "grip": Short(*_short("grip", log_n(grip[0]) - log_n(grip[1]), cells, cell)[:2], grip[0]),
        "late": Short(*_short("late", log_n(late[0]) - log_n(late[1]), cells, cell)[:2], late[0]),
        "press": Short(*_press(starts / level_n, level_n, cells, cell), measured.column("initial_force_n")),
    }


def _start_n(features: TraceFeatures) -> np.ndarray:
    """Return force just before the lift and over its first two steps, 3 x n: where an object pressed down shows it."""
    return np.stack([features.column("initial_force_n"), features.profile_n[:, 0], features.profile_n[:, 1]])


def _press(
    starts: np.ndarray, level_n: np.ndarray, cells: np.ndarray, cell: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return how much harder the object is pressed down than expected, N, and p-values (n each).

    It is the push that explains the start of the lift best. A push dies away by exp(-lift / `DIP_MM`). Its size is that
    of generalised least squares (Aitken 1935) on the three forces of the start, whose errors go together as those of
    all cells do.
    """
    rests = np.stack([_short("press", start, cells, cell)[2] for start in starts])
    sizes = np.maximum(np.median(np.abs(rests), axis=1) / 0.6745, 1e-3)
    together = np.cov(np.clip(rests / sizes[:, None], -_MOST_SIZE, _MOST_SIZE)) * np.outer(sizes, sizes)
    edges = np.exp(-PROFILE_STEP_MM * np.arange(3) / DIP_MM)
    push = np.array([1.0, *(DIP_MM / PROFILE_STEP_MM * (edges[:-1] - edges[1:]))])
    weight = np.linalg.solve(together + 1e-4 * np.eye(3), push)
    shortfall, p, _ = _short("press", (weight / (weight @ push)) @ starts, cells, cell)
    return shortfall * level_n, p


def _short(
    name: str, difference: np.ndarray, cells: np.ndarray, cell: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return each grasp's shortfall and p, against what other cells say of its own; shortfall of each cell's middle."""
    order = np.argsort(cell, kind="stable")
    parts = np.split(order, np.flatnonzero(np.diff(cell[order])) + 1)
    middle = np.array([np.median(difference[part]) for part in parts])
    shortfall, own, chance = find_shortfalls(middle, cells[0], cells[1], LEAST_SCALE, USUAL_CHANCE[name])
    of_grasp = (middle + shortfall)[cell] - difference
    return of_grasp, chance.p_of(of_grasp / own[cell]), shortfall
