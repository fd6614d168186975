"""Sharp edges and corners of a mesh: planes in place of a grid's spline, which would round them.

A spline of degree 2 rounds an edge by a third of its spacing. In the cell of a grid point that an edge passes, the
solid is what lies behind a few planes, or all that does not lie before each of them. A cell takes its planes where
they are nearer to the triangles than the spline is; all others keep the spline.
"""

from typing import NamedTuple

import numpy as np
from numba import njit
from scipy.ndimage import binary_dilation

from fast.models.objects.cores import spline, wedge
from fast.models.objects.primitives import EDGE_COLUMNS, EDGE_COUNT, EDGE_PLANES, EDGE_SIGN, MOST_PLANES, SPACING
from fast.models.objects.triangles import triangle_distance

_NEAR = 1.5  # spacings from the surface: all that touches is nearer
_SHARP = 0.02  # of a spacing, that the spline is off at least in a cell with an edge
_GOOD = 0.001  # of a spacing, that the spline may be off next to one
_REACH = 3  # cells; the error of a spline falls by 6 from one to the next
_SAMPLE = 0.45  # of a spacing, from the middle of a cell to the points at which it is tried
_SIGN_KNOWN = 0.3  # spacings from the surface: nowhere is the spline as far off
_SAME_SHEET = 0.9986  # cosine of 3 deg
_MOST_NEAR = 64


class Near(NamedTuple):
    """Buffers for the triangles next to a grid point: their numbers (n), and how far away they are in spacings (n)."""

    number: np.ndarray
    away: np.ndarray


def with_edges(
    rows: np.ndarray, triangles: np.ndarray, values: np.ndarray, closest: np.ndarray, beside: np.ndarray
) -> np.ndarray:
    """Return the row (1, columns) of a GRID with the planes of its edges.

    `triangles` (t, 3, 3), `values` and `closest` (nx, ny, nz), `beside` (t, 3): as of `MeshGrid`. What an edge does to
    the spline reaches some cells further: these are told by planes as well.
    """
    error, number = np.zeros(values.shape), np.zeros(values.shape, dtype=np.int64)
    _measure_spline(rows, triangles, values, closest, error)
    is_near = binary_dilation(error > _SHARP, np.ones((3, 3, 3)), iterations=_REACH)
    found = _fit_cells(rows, triangles, values, closest, beside, np.where(is_near, error, 0.0), number)
    planes, which = np.unique(found, axis=0, return_inverse=True)  # along an edge they are the same
    i, j, k = np.nonzero(number)
    ends = np.cumsum(np.bincount(i * values.shape[1] + j, minlength=values.shape[0] * values.shape[1]))
    begin = rows.shape[1] + 2 * len(k)
    cells = np.stack([k, begin + EDGE_COLUMNS * which.ravel()[number[i, j, k] - 1]], axis=1)
    filled = np.concatenate([rows[0], cells.ravel(), planes.ravel()])
    filled[rows.shape[1] - len(ends) : rows.shape[1]] = ends
    return filled[None]


@njit(nogil=True, cache=True, error_model="numpy")
def _measure_spline(
    rows: np.ndarray, triangles: np.ndarray, values: np.ndarray, closest: np.ndarray, error: np.ndarray
) -> None:
    """Put how far off the spline is, in spacings, into `error` (nx, ny, nz) for the cells next to the surface."""
    near, samples = Near(np.zeros(_MOST_NEAR, np.int64), np.zeros(_MOST_NEAR)), np.zeros((14, 5))
    for i in range(1, values.shape[0] - 1):
        for j in range(1, values.shape[1] - 1):
            for k in range(1, values.shape[2] - 1):
                if abs(values[i, j, k]) < _NEAR:
                    n_near = _gather(triangles, closest, i, j, k, near)
                    error[i, j, k] = _sample(rows, triangles, near.number[:n_near], i, j, k, samples)


@njit(nogil=True, cache=True, error_model="numpy")
def _fit_cells(
    rows: np.ndarray,
    triangles: np.ndarray,
    values: np.ndarray,
    closest: np.ndarray,
    beside: np.ndarray,
    error: np.ndarray,
    number: np.ndarray,
) -> np.ndarray:
    """Fit planes (n, EDGE_COLUMNS) of the cells where the spline has an `error` (nx, ny, nz) and planes half of it.

    Which planes a cell has, from 1 on, goes into `number` (nx, ny, nz).
    """
    nx, ny, nz = values.shape
    n_found = 0
    found, best = np.zeros((64, EDGE_COLUMNS)), np.zeros((1, EDGE_COLUMNS))
    near, samples = Near(np.zeros(_MOST_NEAR, np.int64), np.zeros(_MOST_NEAR)), np.zeros((14, 5))
    for i in range(1, nx - 1):
        for j in range(1, ny - 1):
            for k in range(1, nz - 1):
                if error[i, j, k] < _GOOD:
                    continue
                n_near = _gather(triangles, closest, i, j, k, near)
                for m in range(n_near):  # of two triangles that share an edge, the grid knows one
                    for t in beside[near.number[m]]:
                        n_near = _insert(triangles, t, i, j, k, near, n_near)
                numbers = near.number[:n_near]
                _sample(rows, triangles, numbers, i, j, k, samples)
                if not _fit(triangles, numbers, values[i, j, k], (i, j, k), samples, 0.5 * error[i, j, k], best):
                    continue
                if n_found == len(found):
                    found = np.concatenate((found, np.zeros_like(found)))
                found[n_found] = best[0]
                n_found += 1
                number[i, j, k] = n_found
    return found[:n_found]


@njit(nogil=True, cache=True, error_model="numpy")
def _gather(triangles: np.ndarray, closest: np.ndarray, i: int, j: int, k: int, near: Near) -> int:
    """Put the triangles nearest to a grid point and its 26 neighbours into `near`, nearest to it first; how many."""
    n = 0
    for p in range(i - 1, i + 2):
        for q in range(j - 1, j + 2):
            for r in range(k - 1, k + 2):
                n = _insert(triangles, closest[p, q, r], i, j, k, near, n)
    return n


@njit(nogil=True, cache=True, error_model="numpy")
def _insert(triangles: np.ndarray, t: int, i: int, j: int, k: int, near: Near, n: int) -> int:
    """Put a triangle into its place of the first `n`, unless it is there or `near` is full; how many there are now."""
    if t < 0 or n == len(near.number):
        return n
    for m in range(n):
        if near.number[m] == t:
            return n
    d, m = triangle_distance(triangles, t, i, j, k), n
    while m > 0 and near.away[m - 1] > d:
        near.number[m], near.away[m] = near.number[m - 1], near.away[m - 1]
        m -= 1
    near.number[m], near.away[m] = t, d
    return n + 1


@njit(nogil=True, cache=True, error_model="numpy")
def _sample(
    rows: np.ndarray, triangles: np.ndarray, near: np.ndarray, i: int, j: int, k: int, samples: np.ndarray
) -> float:
    """Sample points of a cell (14, 3), their distance to the triangles and what the spline says, all in spacings.

    Returns how far off the spline is at most; its sign is not looked at.
    """
    worst, n = 0.0, 0
    for p in range(-1, 2):
        for q in range(-1, 2):
            for r in range(-1, 2):
                n_off = abs(p) + abs(q) + abs(r)
                if n_off != 1 and n_off != 3:
                    continue
                x, y, z = i + _SAMPLE * p, j + _SAMPLE * q, k + _SAMPLE * r
                d = np.inf
                for t in near:
                    d = min(d, triangle_distance(triangles, t, x, y, z))
                said = spline(rows, 0, x, y, z)[0] / rows[0, SPACING]
                samples[n, 0], samples[n, 1], samples[n, 2], samples[n, 3], samples[n, 4] = x, y, z, d, said
                worst = max(worst, abs(abs(said) - d))
                n += 1
    return worst


@njit(nogil=True, cache=True, error_model="numpy")
def _fit(
    triangles: np.ndarray,
    near: np.ndarray,
    value: float,
    cell: tuple[int, int, int],
    samples: np.ndarray,
    most: float,
    best: np.ndarray,
) -> bool:
    """Put the planes of the nearest triangles that fit best into `best` (1, EDGE_COLUMNS); False if none is as good.

    `value`: the distance at the grid point; `most`: how far off the planes may be at it and at the samples, spacings.
    """
    trial, n, is_good = np.zeros((1, EDGE_COLUMNS)), 0, False
    for t in near:
        if not _add_plane(triangles, t, trial, n):
            continue
        n += 1
        trial[0, EDGE_COUNT] = n
        for sign in (1.0, -1.0):
            if n == 1 and sign < 0.0:
                continue
            trial[0, EDGE_SIGN] = sign
            error = abs(wedge(trial, 0, 0, float(cell[0]), float(cell[1]), float(cell[2]))[0] - value)
            for x, y, z, d, said in samples:
                found = wedge(trial, 0, 0, x, y, z)[0]
                error = max(error, abs(abs(found) - d))
                if found * said < 0.0 and d > _SIGN_KNOWN:
                    error = np.inf
            if error < most:
                most, is_good = error, True
                best[:] = trial
        if n == MOST_PLANES:
            break
    return is_good


@njit(nogil=True, cache=True, error_model="numpy")
def _add_plane(triangles: np.ndarray, t: int, trial: np.ndarray, n: int) -> bool:
    """Write the plane of a triangle after the first `n`; False if it has none, or one of these is the same sheet."""
    ax, ay, az = triangles[t, 0, 0], triangles[t, 0, 1], triangles[t, 0, 2]
    bx, by, bz = triangles[t, 1, 0] - ax, triangles[t, 1, 1] - ay, triangles[t, 1, 2] - az
    cx, cy, cz = triangles[t, 2, 0] - ax, triangles[t, 2, 1] - ay, triangles[t, 2, 2] - az
    x, y, z = by * cz - bz * cy, bz * cx - bx * cz, bx * cy - by * cx
    size = np.sqrt(x * x + y * y + z * z)
    if size == 0.0:
        return False
    x, y, z = x / size, y / size, z / size
    for a in range(n):
        at = EDGE_PLANES + 4 * a
        if trial[0, at] * x + trial[0, at + 1] * y + trial[0, at + 2] * z > _SAME_SHEET:
            return False
    at = EDGE_PLANES + 4 * n
    trial[0, at], trial[0, at + 1], trial[0, at + 2], trial[0, at + 3] = x, y, z, x * ax + y * ay + z * az
    return True
