"""Forces that a lab's own simulator predicts, from a CSV file: a curve for each tool on each object."""

from pathlib import Path

import numpy as np

from fast.models.errors import UsageError
from fast.models.gap.grasps import Grasps
from fast.models.traces.step_features import N_STEPS, STEP_MM
from fast.tasks.campaign.csv_file import read_rows

COLUMNS = ("tool_id", "object_id", "lift_mm", "force_n")
_FINER = 10  # points of a step over which a curve is averaged
_MOST_FORCE_N, _MOST_LIFT_MM = 2000.0, 1000.0
_FEWEST_POINTS = 10
_MOST_NAMED = 3
_MOST_ROWS = 2_000_000


def read_simulated(path: Path, grasps: Grasps) -> np.ndarray:
    """Step means (n x 120, N) of measured grasps as a file has their tools and objects; behind its end a force is 0.

    Raises:
        UsageError: the file cannot be read, a value is no force, or a tool on an object is missing.
    """
    points = _read_points(path)
    curves = {key: _average(np.array(sorted(rows))) for key, rows in points.items() if len(rows) >= _FEWEST_POINTS}
    wanted = [
        (grasps.tools[tool], grasps.objects[obj])
        for tool, obj in zip(grasps.tool.tolist(), grasps.obj.tolist(), strict=True)
    ]
    missing = [f"{tool} on object {obj}" for tool, obj in dict.fromkeys(wanted) if (tool, obj) not in curves]
    if missing:
        more = f" and {len(missing) - _MOST_NAMED} more" if len(missing) > _MOST_NAMED else ""
        raise UsageError(
            f"{path} lacks the curve of {', '.join(missing[:_MOST_NAMED])}{more}; give {_FEWEST_POINTS} points or more "
            f"({', '.join(COLUMNS)}) for each of the {len(set(wanted))} pairs that were measured."
        )
    return np.array([curves[key] for key in wanted])


def _read_points(path: Path) -> dict[tuple[str, int], list[tuple[float, float]]]:
    found: dict[tuple[str, int], list[tuple[float, float]]] = {}
    for row in read_rows(path, COLUMNS, (), ignored=[], most_rows=_MOST_ROWS):
        lift_mm, force_n = row.number("lift_mm"), row.number("force_n")
        if not (0.0 <= lift_mm <= _MOST_LIFT_MM and abs(force_n) <= _MOST_FORCE_N):
            raise UsageError(
                f"{row.place}: lift_mm is {lift_mm:g} and force_n is {force_n:g}; lifts go from 0 to "
                f"{_MOST_LIFT_MM:g} mm, forces to {_MOST_FORCE_N:g} N; correct it."
            )
        found.setdefault((row["tool_id"], row.integer("object_id")), []).append((lift_mm, force_n))
    return found


def _average(points: np.ndarray) -> np.ndarray:
    """Means over steps of the lift (120) of a curve (m x 2), straight between its points."""
    at_mm = STEP_MM * (np.arange(N_STEPS * _FINER) + 0.5) / _FINER
    return np.asarray(np.interp(at_mm, points[:, 0], points[:, 1], right=0.0).reshape(N_STEPS, _FINER).mean(axis=1))
