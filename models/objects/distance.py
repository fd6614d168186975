"""Signed distance of an object, and its normal, at many points: one compiled loop over points and primitives.

Distances are in mm, negative inside. They are exact outside the solid and inside convex primitives. Inside, behind a
concave crease (waists of diabolos and hourglasses) and in the overlap of two primitives (jack, spiral), the depth is
a lower bound: at 2 mm depth it may be 0.4 mm short behind a waist. The zero surface itself is exact everywhere.
"""

import math

import numpy as np
from numba import njit

from models.objects.primitives import (
    BOX,
    CENTRE,
    CIRCLE,
    ELLIPSOID,
    KIND,
    LATHE,
    LENGTH,
    N_VERTICES,
    POINT,
    PRISM,
    RADIUS,
    ROTATION,
    SEGMENT,
    VALUES,
)

_DIFFERENCE_STEP_MM = 1e-4
_ELLIPSOID_ITERATIONS = 60


def distance(primitives: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Signed distance (n) in mm at `points` (n, 3) to the union of `primitives` (see `models.objects.primitives`)."""
    return _distances(np.ascontiguousarray(primitives), np.ascontiguousarray(points, dtype=np.float64))


def distance_and_normal(primitives: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Signed distance (n) in mm and unit outward normal (n, 3) at `points` (n, 3).

    Normals are central differences of the distance. Where there is none (deep inside, equally far from two sides)
    the normal is +z.
    """
    return _distances_and_normals(np.ascontiguousarray(primitives), np.ascontiguousarray(points, dtype=np.float64))


@njit(nogil=True, cache=True)
def _distances(rows: np.ndarray, points: np.ndarray) -> np.ndarray:
    result = np.zeros(len(points))
    for i in range(len(points)):
        result[i] = _union(rows, points[i, 0], points[i, 1], points[i, 2])
    return result


@njit(nogil=True, cache=True)
def _distances_and_normals(rows: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    h = _DIFFERENCE_STEP_MM
    result = np.zeros(len(points))
    normals = np.zeros((len(points), 3))
    for i in range(len(points)):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        result[i] = _union(rows, x, y, z)
        nx = _union(rows, x + h, y, z) - _union(rows, x - h, y, z)
        ny = _union(rows, x, y + h, z) - _union(rows, x, y - h, z)
        nz = _union(rows, x, y, z + h) - _union(rows, x, y, z - h)
        size = math.sqrt(nx * nx + ny * ny + nz * nz)
        if size > 0.01 * h:
            normals[i, 0], normals[i, 1], normals[i, 2] = nx / size, ny / size, nz / size
        else:
            normals[i, 2] = 1.0
    return result, normals


@njit(nogil=True, cache=True)
def _union(rows: np.ndarray, x: float, y: float, z: float) -> float:
    best = np.inf
    for i in range(len(rows)):
        row = rows[i]
        dx, dy, dz = x - row[CENTRE], y - row[CENTRE + 1], z - row[CENTRE + 2]
        u = row[ROTATION] * dx + row[ROTATION + 3] * dy + row[ROTATION + 6] * dz
        v = row[ROTATION + 1] * dx + row[ROTATION + 4] * dy + row[ROTATION + 7] * dz
        w = row[ROTATION + 2] * dx + row[ROTATION + 5] * dy + row[ROTATION + 8] * dz
        best = min(best, _core(row, u, v, w) - row[RADIUS])
    return best


@njit(nogil=True, cache=True)
def _core(row: np.ndarray, x: float, y: float, z: float) -> float:
    """Signed distance to the core of one row, in its own frame."""
    kind = int(row[KIND])
    if kind == POINT:
        return math.sqrt(x * x + y * y + z * z)
    if kind == SEGMENT:
        w = max(abs(z) - row[LENGTH], 0.0)
        return math.sqrt(x * x + y * y + w * w)
    if kind == CIRCLE:
        return math.hypot(math.hypot(x, y) - row[LENGTH], z)
    if kind == BOX:
        return _box(abs(x) - row[VALUES], abs(y) - row[VALUES + 1], abs(z) - row[VALUES + 2])
    if kind == ELLIPSOID:
        return _ellipsoid(row[VALUES], row[VALUES + 1], row[VALUES + 2], abs(x), abs(y), abs(z))
    n = int(row[N_VERTICES])
    profile = row[VALUES : VALUES + 2 * n]
    if kind == LATHE:
        return _polygon(profile, math.hypot(x, y), z, True)
    if kind == PRISM:
        return _box(_polygon(profile, x, y, False), abs(z) - row[LENGTH], -np.inf)
    return _square_lathe(profile, max(abs(x), abs(y)), min(abs(x), abs(y)), z)


@njit(nogil=True, cache=True)
def _box(x: float, y: float, z: float) -> float:
    """Combine signed distances along three perpendicular directions."""
    inside = min(max(x, y, z), 0.0)
    x, y, z = max(x, 0.0), max(y, 0.0), max(z, 0.0)
    return inside + math.sqrt(x * x + y * y + z * z)


@njit(nogil=True, cache=True)
def _ellipsoid(a: float, b: float, c: float, x: float, y: float, z: float) -> float:
    """Distance to an ellipsoid from a point of the first octant.

    The closest point is (a^2 x / (t + a^2), ...) with t the largest root of
    g(t) = (a x / (t + a^2))^2 + (b y / (t + b^2))^2 + (c z / (t + c^2))^2 - 1. g is convex and falls on the
    interval, so Newton's steps from its left part approach the root from one side (Eberly, Distance from a point
    to an ellipse, an ellipsoid, or a hyperellipsoid).
    """
    tiny = 1e-9  # keeps the start off the poles of g
    x, y, z = max(x, tiny), max(y, tiny), max(z, tiny)
    t = max(a * (x - a), b * (y - b), c * (z - c))
    for _ in range(_ELLIPSOID_ITERATIONS):
        p, q, r = 1.0 / (t + a * a), 1.0 / (t + b * b), 1.0 / (t + c * c)
        pa, qb, rc = (a * x * p) ** 2, (b * y * q) ** 2, (c * z * r) ** 2
        step = (pa + qb + rc - 1.0) / (2.0 * (pa * p + qb * q + rc * r))
        t += step
        if abs(step) < 1e-10 * (abs(t) + 1.0):
            break
    p, q, r = 1.0 / (t + a * a), 1.0 / (t + b * b), 1.0 / (t + c * c)
    # The closest point is off by t times (x p, y q, z r), so t also carries the sign.
    return t * math.sqrt((x * p) ** 2 + (y * q) ** 2 + (z * r) ** 2)


@njit(nogil=True, cache=True)
def _segment(ax: float, ay: float, bx: float, by: float, x: float, y: float) -> float:
    """Squared distance of (x, y) to the segment a-b in the plane."""
    ex, ey = bx - ax, by - ay
    s = ((x - ax) * ex + (y - ay) * ey) / max(ex * ex + ey * ey, 1e-30)
    s = min(max(s, 0.0), 1.0)
    return (x - ax - s * ex) ** 2 + (y - ay - s * ey) ** 2


@njit(nogil=True, cache=True)
def _polygon(profile: np.ndarray, x: float, y: float, has_axis: bool) -> float:
    """Signed distance to a polygon (flat array of vertices); edges on the axis x = 0 are no surface."""
    n = len(profile) // 2
    best = np.inf
    is_inside = False
    ax, ay = profile[2 * n - 2], profile[2 * n - 1]
    for i in range(n):
        bx, by = profile[2 * i], profile[2 * i + 1]
        if not (has_axis and ax == 0.0 and bx == 0.0):
            best = min(best, _segment(ax, ay, bx, by, x, y))
        if (ay > y) != (by > y) and x < ax + (bx - ax) * (y - ay) / (by - ay):
            is_inside = not is_inside
        ax, ay = bx, by
    return -math.sqrt(best) if is_inside else math.sqrt(best)


@njit(nogil=True, cache=True)
def _square_lathe(profile: np.ndarray, x: float, y: float, z: float) -> float:
    """Signed distance to a body of square sections; the point is folded into x >= y >= 0 beforehand.

    The body is symmetric under the folds, so the closest point lies in the same wedge: on one of the trapezoids
    that the edges of the profile (half side, z) sweep while y goes from minus to plus the half side.
    """
    n = len(profile) // 2
    best = np.inf
    is_inside = False
    ax, az = profile[2 * n - 2], profile[2 * n - 1]
    for i in range(n):
        bx, bz = profile[2 * i], profile[2 * i + 1]
        if not (ax == 0.0 and bx == 0.0):
            best = min(best, _trapezoid(ax, az, bx, bz, x, y, z))
        if (az > z) != (bz > z) and x < ax + (bx - ax) * (z - az) / (bz - az):
            is_inside = not is_inside
        ax, az = bx, bz
    return -math.sqrt(best) if is_inside else math.sqrt(best)


@njit(nogil=True, cache=True)
def _trapezoid(ax: float, az: float, bx: float, bz: float, x: float, y: float, z: float) -> float:
    """Squared distance to the trapezoid from (ax, +-ax, az) to (bx, +-bx, bz)."""
    length = math.hypot(bx - ax, bz - az)
    ux, uz = (bx - ax) / length, (bz - az) / length
    along = (x - ax) * ux + (z - az) * uz
    off_plane = (x - ax) * uz - (z - az) * ux
    if 0.0 <= along <= length and y <= ax + ux * along:
        return off_plane**2
    sides = min(_segment(0.0, 0.0, 0.0, ax, along, y), _segment(length, 0.0, length, bx, along, y))
    return off_plane**2 + min(sides, _segment(0.0, ax, length, bx, along, y))
