"""Signed distance of an object, and its normal, at many points: one compiled loop over points and primitives.

Distances are in mm, negative inside. They are exact outside the solid and inside convex primitives. Inside, behind a
concave crease (waists of diabolos and hourglasses) and in the overlap of two primitives (jack, spiral), the depth is
a lower bound: at 2 mm depth it may be 0.4 mm short behind a waist. The zero surface itself is exact everywhere.
"""

import numpy as np
from numba import njit

from fast.models.objects.cores import Gradient3, core_distance
from fast.models.objects.primitives import CENTRE, RADIUS, REACH, ROTATION

_MARGIN_MM = 1e-9  # far above rounding


def distance(primitives: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return signed distance (n), mm, at `points` (n, 3) to the union of `primitives` (`models.objects.primitives`)."""
    return _distances(_prepare(primitives), _prepare(points))


def distance_and_normal(primitives: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Compute the signed distance (n) in mm and unit outward normal (n, 3) at `points` (n, 3).

    Normals are exact gradients of the distance (see `models.objects.cores` for where there is none).
    """
    return _distances_and_normals(_prepare(primitives), _prepare(points))


def _prepare(values: np.ndarray) -> np.ndarray:
    """Prepare values as the kernels take them: for a read-only array, all that they call would be compiled again."""
    return np.require(values, np.float64, ["C", "W", "E"])


@njit(nogil=True, cache=True, error_model="numpy")
def _distances(rows: np.ndarray, points: np.ndarray) -> np.ndarray:
    result = np.zeros(len(points))
    for i in range(len(points)):
        result[i] = solid_distance(rows, points[i, 0], points[i, 1], points[i, 2])[0]
    return result


@njit(nogil=True, cache=True, error_model="numpy")
def _distances_and_normals(rows: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    result = np.zeros(len(points))
    normals = np.zeros((len(points), 3))
    for i in range(len(points)):
        result[i], normals[i, 0], normals[i, 1], normals[i, 2] = solid_distance(
            rows, points[i, 0], points[i, 1], points[i, 2]
        )
    return result, normals


@njit(nogil=True, cache=True, error_model="numpy")
def solid_distance(rows: np.ndarray, x: float, y: float, z: float) -> Gradient3:
    """Compute the signed distance and outward normal (x, y, z) at one point; for compiled callers.

    A row out of reach is left out: no point of it is nearer than its centre less `REACH`. The row whose ball of that
    radius is nearest goes first, which leaves two or three rows of many.
    """
    first, least = len(rows) - 1, np.inf  # for the constant 0, all that is called would be compiled once more
    if first == 0:
        return _row_distance(rows, first, x, y, z)
    for i in range(len(rows)):
        power = _square_to_centre(rows, i, x, y, z) - rows[i, REACH] ** 2
        if power < least:
            first, least = i, power
    best = _row_distance(rows, first, x, y, z)
    for i in range(len(rows)):
        reach = best[0] + rows[i, REACH]
        if i != first and reach > 0.0 and _square_to_centre(rows, i, x, y, z) < reach * reach:
            other = _row_distance(rows, i, x, y, z)
            if other[0] < best[0]:
                best = other
    return best


@njit(nogil=True, cache=True, error_model="numpy")
def choose_rows(rows: np.ndarray, x: float, y: float, z: float, radius: float, chosen: np.ndarray) -> tuple[float, int]:
    """Put the numbers of the rows that can be nearest to any point within `radius` of (x, y, z) into `chosen`.

    Returns the signed distance at (x, y, z) and how many rows there are: those less than twice the radius further
    away there than the nearest one.
    """
    gap, n = solid_distance(rows, x, y, z)[0], 0
    limit = gap + 2.0 * radius + _MARGIN_MM
    for i in range(len(rows)):
        reach = limit + rows[i, REACH]
        if reach > 0.0 and _square_to_centre(rows, i, x, y, z) < reach * reach:
            chosen[n] = i
            n += 1
    return gap, n


@njit(nogil=True, cache=True, error_model="numpy")
def chosen_distance(rows: np.ndarray, chosen: np.ndarray, n: int, x: float, y: float, z: float) -> Gradient3:
    """Do as `solid_distance` for the first `n` rows that `chosen` numbers."""
    best = _row_distance(rows, chosen[0], x, y, z)
    for j in range(1, n):
        other = _row_distance(rows, chosen[j], x, y, z)
        if other[0] < best[0]:
            best = other
    return best


@njit(nogil=True, cache=True, error_model="numpy")
def _square_to_centre(rows: np.ndarray, i: int, x: float, y: float, z: float) -> float:
    return (x - rows[i, CENTRE]) ** 2 + (y - rows[i, CENTRE + 1]) ** 2 + (z - rows[i, CENTRE + 2]) ** 2


@njit(nogil=True, cache=True, error_model="numpy")
def _row_distance(rows: np.ndarray, i: int, x: float, y: float, z: float) -> Gradient3:
    x, y, z = x - rows[i, CENTRE], y - rows[i, CENTRE + 1], z - rows[i, CENTRE + 2]
    d, u, v, w = core_distance(
        rows,
        i,
        rows[i, ROTATION] * x + rows[i, ROTATION + 3] * y + rows[i, ROTATION + 6] * z,
        rows[i, ROTATION + 1] * x + rows[i, ROTATION + 4] * y + rows[i, ROTATION + 7] * z,
        rows[i, ROTATION + 2] * x + rows[i, ROTATION + 5] * y + rows[i, ROTATION + 8] * z,
    )
    return (
        d - rows[i, RADIUS],
        rows[i, ROTATION] * u + rows[i, ROTATION + 1] * v + rows[i, ROTATION + 2] * w,
        rows[i, ROTATION + 3] * u + rows[i, ROTATION + 4] * v + rows[i, ROTATION + 5] * w,
        rows[i, ROTATION + 6] * u + rows[i, ROTATION + 7] * v + rows[i, ROTATION + 8] * w,
    )
