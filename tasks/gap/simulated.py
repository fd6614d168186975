"""Forces that a lab's own simulator predicts, from a CSV file: a curve for each tool on each object."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TypeVar

import numpy as np

from fast.models.errors import UsageError
from fast.models.gap.grasps import Grasps
from fast.models.records import Trace
from fast.models.traces.step_features import DIP_MM, N_STEPS, STEP_MM
from fast.tasks.bench.told_files import read_object
from fast.tasks.campaign.csv_file import CsvRow, read_rows
from fast.tasks.gap.data import has_other_sign, is_cut

COLUMNS = ("tool_id", "object_id", "lift_mm", "force_n")
_FINER = 10  # points of a step over which a curve is averaged
_MOST_FORCE_N, _MOST_LIFT_MM = 2000.0, 1000.0
_FEWEST_POINTS = 10
_MOST_FACTOR = 100.0  # between its forces and those measured: no constants differ by as much, units do
_MOST_NAMED = 3
_MOST_ROWS = 2_000_000
_WIDEST_MM = 10.0  # of lift between two points while the fingers hold the object
_Name = TypeVar("_Name")


def read_simulated(path: Path, grasps: Grasps) -> np.ndarray:
    """Read step means (n x 120, N) of measured grasps from a file by tool and object; behind its end a force is 0.

    Objects are numbers, or names that this process knows (`tasks.objects.own_objects` for own ones).

    Raises:
        UsageError: the file cannot be read, a value is no force, a tool on an object is missing, a curve ends while
            the fingers hold the object or has a hole there, or forces are of another unit or sign than those measured.
    """
    objects: dict[str, int] = {}  # by what the file calls them

    def name(row: CsvRow) -> tuple[str, int]:
        if (text := row["object_id"]) not in objects:
            objects[text] = read_object(row, "object_id")
        return row["tool_id"], objects[text]

    curves = read_curves(path, COLUMNS, name)
    points = {key: curve for key, curve in curves.items() if len(curve) >= _FEWEST_POINTS}
    wanted = [
        (grasps.tools[tool], grasps.objects[obj])
        for tool, obj in zip(grasps.tool.tolist(), grasps.obj.tolist(), strict=True)
    ]
    missing = [f"{tool} on object {obj}" for tool, obj in dict.fromkeys(wanted) if (tool, obj) not in points]
    if missing:
        more = f" and {len(missing) - _MOST_NAMED} more" if len(missing) > _MOST_NAMED else ""
        raise UsageError(
            f"{path} lacks the curve of {', '.join(missing[:_MOST_NAMED])}{more}; give {_FEWEST_POINTS} points or more "
            f"({', '.join(COLUMNS)}) for each of the {len(set(wanted))} pairs that were measured."
        )
    what = {(tool, obj): f"{path}: the curve of {tool} on object {obj}" for tool, obj in wanted}
    for key in what:
        _check_lift(what[key], points[key])
    averages = {key: _average(points[key]) for key in what}
    steps_n = np.array([averages[key] for key in wanted])
    if has_other_sign(steps_n, grasps.steps_n):
        raise UsageError(
            f"{path}: its forces have the other sign than the measured ones; a force is positive where the object "
            "pulls the gripper down."
        )
    for key in what:
        _check_end(what[key], points[key])
    _check_unit(path, steps_n, grasps.steps_n)
    return steps_n


def _check_lift(what: str, points: np.ndarray) -> None:
    lift_mm = points[:, 0]
    if lift_mm[0] > DIP_MM or lift_mm[-1] < DIP_MM:
        raise UsageError(
            f"{what} begins at {lift_mm[0]:g} mm and ends at {lift_mm[-1]:g} mm of lift; give it in mm, from 0 until "
            "the fingers let go."
        )


def _check_end(what: str, points: np.ndarray) -> None:
    lift_mm, force_n = points.T
    holes = np.flatnonzero((np.diff(lift_mm) > _WIDEST_MM) & (lift_mm[:-1] > 0.0))
    for last in [*holes.tolist(), len(points) - 1]:
        known = slice(last + 1)
        if is_cut(Trace(np.arange(last + 1, dtype=float), lift_mm[known], force_n[known])):
            raise UsageError(
                f"{what} stops at {lift_mm[last]:g} mm of lift with {force_n[last]:.3g} N on the fingers, and what "
                "comes next is not known; give it without a hole, until the fingers let go."
            )


def _check_unit(path: Path, steps_n: np.ndarray, measured_n: np.ndarray) -> None:
    factor = float(np.abs(steps_n).sum() / np.abs(measured_n).sum())
    if not 1.0 / _MOST_FACTOR < factor < _MOST_FACTOR:
        raise UsageError(f"{path}: its forces are {factor:.2g} times the measured ones; give them in N.")


def read_curves(path: Path, columns: Sequence[str], name: Callable[[CsvRow], _Name]) -> dict[_Name, np.ndarray]:
    """Read curves (m x 2, `lift_mm` and `force_n` in mm and N) of a CSV file, by what `name` says of their rows.

    Raises:
        UsageError: the file is of another form, a value is no lift or force, or the lift of a curve goes back.
    """
    found: dict[_Name, list[tuple[float, float]]] = {}
    for row in read_rows(path, columns, (), ignored=[], most_rows=_MOST_ROWS):
        lift_mm, force_n = row.number("lift_mm"), row.number("force_n")
        if not (0.0 <= lift_mm <= _MOST_LIFT_MM and abs(force_n) <= _MOST_FORCE_N):
            raise UsageError(
                f"{row.place}: lift_mm is {lift_mm:g} and force_n is {force_n:g}; lifts go from 0 to "
                f"{_MOST_LIFT_MM:g} mm, forces to {_MOST_FORCE_N:g} N; correct it."
            )
        curve = found.setdefault(name(row), [])
        if curve and lift_mm < curve[-1][0]:
            raise UsageError(
                f"{row.place}: the lift goes back from {curve[-1][0]:g} to {lift_mm:g} mm; give one curve of each "
                "grasp, its lifts rising from row to row."
            )
        curve.append((lift_mm, force_n))
    return {key: np.array(curve) for key, curve in found.items()}


def _average(points: np.ndarray) -> np.ndarray:
    """Compute means over steps of the lift (120) of a curve (m x 2), straight between its points."""
    at_mm = STEP_MM * (np.arange(N_STEPS * _FINER) + 0.5) / _FINER
    return np.asarray(np.interp(at_mm, points[:, 0], points[:, 1], right=0.0).reshape(N_STEPS, _FINER).mean(axis=1))
