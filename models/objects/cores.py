"""Signed distance and its gradient, in closed form, of the cores of `models.objects.primitives` in their own frame.

Every function returns (distance, gradient x, y, z). The gradient is the outward normal of the nearest feature: of a
face where the closest point lies within one (exact also on the surface), else the direction from the closest point on
an edge or corner. Where there is none (medial axes, where two features are equally far) the first feature counts.
"""

import math

import numpy as np
from numba import njit

from fast.models.objects.primitives import (
    BOX,
    CIRCLE,
    EDGE_COUNT,
    EDGE_PLANES,
    EDGE_SIGN,
    ELLIPSOID,
    GRID,
    GRID_VALUES,
    KIND,
    LATHE,
    LENGTH,
    N_VERTICES,
    POINT,
    PRISM,
    SEGMENT,
    VALUES,
)

Gradient2 = tuple[float, float, float]
Gradient3 = tuple[float, float, float, float]

_ELLIPSOID_ITERATIONS = 60
_FLAT = 1e-9  # of three normals: they lie in one plane, and two of them do
_TINY_MM = 1e-12  # a point this near to an edge or corner has no direction from it


@njit(nogil=True, cache=True, error_model="numpy")
def core_distance(rows: np.ndarray, i: int, x: float, y: float, z: float) -> Gradient3:
    """Compute the distance to the core of row `i` of (n, N_COLUMNS)."""
    kind = int(rows[i, KIND])
    if kind == POINT:
        return _from_closest(x, y, z)
    if kind == SEGMENT:
        return _from_closest(x, y, z - min(max(z, -rows[i, LENGTH]), rows[i, LENGTH]))
    if kind == CIRCLE:
        rho, cosine, sine = _polar(x, y)
        d, g_rho, _, g_z = _from_closest(rho - rows[i, LENGTH], 0.0, z)
        return d, g_rho * cosine, g_rho * sine, g_z
    if kind == BOX:
        return _box(rows[i, VALUES], rows[i, VALUES + 1], rows[i, VALUES + 2], x, y, z)
    if kind == ELLIPSOID:
        return _ellipsoid(rows[i, VALUES], rows[i, VALUES + 1], rows[i, VALUES + 2], x, y, z)
    if kind == LATHE:
        rho, cosine, sine = _polar(x, y)
        d, g_rho, g_z = _polygon(rows, i, rho, z, True)
        return d, g_rho * cosine, g_rho * sine, g_z
    if kind == PRISM:
        return _prism(rows, i, x, y, z)
    if kind == GRID:
        return _grid(rows, i, x, y, z)
    return _square_lathe(rows, i, x, y, z)


@njit(nogil=True, cache=True, error_model="numpy")
def _from_closest(x: float, y: float, z: float) -> Gradient3:
    """Compute the distance from a closest point that is (x, y, z) away."""
    d = math.sqrt(x * x + y * y + z * z)
    if d < _TINY_MM:
        return d, 0.0, 0.0, 1.0
    return d, x / d, y / d, z / d


@njit(nogil=True, cache=True, error_model="numpy")
def _polar(x: float, y: float) -> tuple[float, float, float]:
    """Compute the distance from the z axis and its direction (cosine, sine)."""
    rho = math.sqrt(x * x + y * y)
    if rho < _TINY_MM:
        return rho, 1.0, 0.0
    return rho, x / rho, y / rho


@njit(nogil=True, cache=True, error_model="numpy")
def _box(a: float, b: float, c: float, x: float, y: float, z: float) -> Gradient3:
    sx, sy, sz = math.copysign(1.0, x), math.copysign(1.0, y), math.copysign(1.0, z)
    u, v, w = abs(x) - a, abs(y) - b, abs(z) - c
    if max(u, v, w) <= 0.0:
        if u >= v and u >= w:
            return u, sx, 0.0, 0.0
        return (v, 0.0, sy, 0.0) if v >= w else (w, 0.0, 0.0, sz)
    u, v, w = max(u, 0.0), max(v, 0.0), max(w, 0.0)
    d = math.sqrt(u * u + v * v + w * w)
    return d, sx * u / d, sy * v / d, sz * w / d


@njit(nogil=True, cache=True, error_model="numpy")
def _ellipsoid(a: float, b: float, c: float, x: float, y: float, z: float) -> Gradient3:
    """Compute the distance to an ellipsoid.

    In the first octant the closest point is (a^2 x / (t + a^2), ...) with t the largest root of
    g(t) = (a x / (t + a^2))^2 + (b y / (t + b^2))^2 + (c z / (t + c^2))^2 - 1. g is convex and falls on the
    interval, so Newton's steps from its left part approach the root from one side (Eberly, Distance from a point
    to an ellipse, an ellipsoid, or a hyperellipsoid). The normal there is along (x / (t + a^2), ...).
    """
    tiny = 1e-9  # keeps the start off the poles of g
    u, v, w = max(abs(x), tiny), max(abs(y), tiny), max(abs(z), tiny)
    t = max(a * (u - a), b * (v - b), c * (w - c))
    for _ in range(_ELLIPSOID_ITERATIONS):
        p, q, r = 1.0 / (t + a * a), 1.0 / (t + b * b), 1.0 / (t + c * c)
        pa, qb, rc = (a * u * p) ** 2, (b * v * q) ** 2, (c * w * r) ** 2
        step = (pa + qb + rc - 1.0) / (2.0 * (pa * p + qb * q + rc * r))
        t += step
        if abs(step) < 1e-10 * (abs(t) + 1.0):
            break
    u, v, w = u / (t + a * a), v / (t + b * b), w / (t + c * c)
    size = math.sqrt(u * u + v * v + w * w)
    u, v, w = math.copysign(u / size, x), math.copysign(v / size, y), math.copysign(w / size, z)
    # The closest point is off by t times (u, v, w) before it got length 1, so t also carries the sign.
    return t * size, u, v, w


@njit(nogil=True, cache=True, error_model="numpy")
def _polygon(rows: np.ndarray, row: int, x: float, y: float, has_axis: bool) -> Gradient2:
    """Compute the distance to a row's polygon (vertices anticlockwise); edges on the axis x = 0 are no surface."""
    n = int(rows[row, N_VERTICES])
    best, best_x, best_y, edge_x, edge_y, is_face = np.inf, 0.0, 0.0, 0.0, 1.0, False
    is_inside = False
    ax, ay = rows[row, VALUES + 2 * n - 2], rows[row, VALUES + 2 * n - 1]
    for i in range(n):
        bx, by = rows[row, VALUES + 2 * i], rows[row, VALUES + 2 * i + 1]
        if (ay > y) != (by > y) and x < ax + (bx - ax) * (y - ay) / (by - ay):
            is_inside = not is_inside
        if not (has_axis and ax == 0.0 and bx == 0.0):
            ex, ey = bx - ax, by - ay
            s = ((x - ax) * ex + (y - ay) * ey) / (ex * ex + ey * ey)
            clamped = min(max(s, 0.0), 1.0)
            u, v = x - ax - clamped * ex, y - ay - clamped * ey
            square = u * u + v * v
            if square < best:
                best, best_x, best_y, edge_x, edge_y, is_face = square, u, v, ex, ey, s == clamped
        ax, ay = bx, by
    d = math.sqrt(best)
    sign = -1.0 if is_inside else 1.0
    if is_face or d < _TINY_MM:
        size = math.sqrt(edge_x * edge_x + edge_y * edge_y)
        return sign * d, edge_y / size, -edge_x / size
    return sign * d, sign * best_x / d, sign * best_y / d


@njit(nogil=True, cache=True, error_model="numpy")
def _prism(rows: np.ndarray, row: int, x: float, y: float, z: float) -> Gradient3:
    side, g_x, g_y = _polygon(rows, row, x, y, False)
    g_z, end = math.copysign(1.0, z), abs(z) - rows[row, LENGTH]
    if max(side, end) <= 0.0:
        return (side, g_x, g_y, 0.0) if side >= end else (end, 0.0, 0.0, g_z)
    across, along = max(side, 0.0), max(end, 0.0)
    d = math.sqrt(across * across + along * along)
    across, along = across / d, along / d
    return d, g_x * across, g_y * across, g_z * along


@njit(nogil=True, cache=True, error_model="numpy")
def _square_lathe(rows: np.ndarray, row: int, x: float, y: float, z: float) -> Gradient3:
    """Compute the distance to a body of square sections.

    The body is symmetric under folds into x >= y >= 0, so the closest point lies in the same wedge: on one of the
    trapezoids that the edges of the profile (half side, z) sweep while y goes from minus to plus the half side.
    """
    u, v = max(abs(x), abs(y)), min(abs(x), abs(y))
    n = int(rows[row, N_VERTICES])
    best, best_u, best_v, best_z, edge_u, edge_z, is_face = np.inf, 0.0, 0.0, 0.0, 0.0, 1.0, False
    is_inside = False
    au, az = rows[row, VALUES + 2 * n - 2], rows[row, VALUES + 2 * n - 1]
    for i in range(n):
        bu, bz = rows[row, VALUES + 2 * i], rows[row, VALUES + 2 * i + 1]
        if (az > z) != (bz > z) and u < au + (bu - au) * (z - az) / (bz - az):
            is_inside = not is_inside
        if not (au == 0.0 and bu == 0.0):
            off_u, off_v, off_z, is_within = _to_trapezoid(au, az, bu, bz, u, v, z)
            square = off_u * off_u + off_v * off_v + off_z * off_z
            if square < best:
                best, best_u, best_v, best_z = square, off_u, off_v, off_z
                edge_u, edge_z, is_face = bu - au, bz - az, is_within
        au, az = bu, bz
    d = math.sqrt(best)
    sign = -1.0 if is_inside else 1.0
    if is_face or d < _TINY_MM:
        size = math.sqrt(edge_u * edge_u + edge_z * edge_z)
        g_u, g_v, g_z = edge_z / size, 0.0, -edge_u / size
    else:
        g_u, g_v, g_z = sign * best_u / d, sign * best_v / d, sign * best_z / d
    g_x, g_y = (g_u, g_v) if abs(x) >= abs(y) else (g_v, g_u)
    return sign * d, math.copysign(1.0, x) * g_x, math.copysign(1.0, y) * g_y, g_z


@njit(nogil=True, cache=True, error_model="numpy")
def _to_trapezoid(
    ax: float, az: float, bx: float, bz: float, x: float, y: float, z: float
) -> tuple[float, float, float, bool]:
    """Find the vector from the closest point of trapezoid (ax, +-ax, az) - (bx, +-bx, bz), and if that lies in it.

    The trapezoid is convex: a point beyond an end but between the slanted sides is closest to that end, any other
    point beyond a slanted side (y > 0 here) to that side.
    """
    ex, ez = bx - ax, bz - az
    square = ex * ex + ez * ez
    s = ((x - ax) * ex + (z - az) * ez) / square
    clamped = min(max(s, 0.0), 1.0)
    if y <= ax + clamped * ex:
        return x - ax - clamped * ex, 0.0, z - az - clamped * ez, s == clamped
    s = ((x - ax) * ex + (y - ax) * ex + (z - az) * ez) / (square + ex * ex)
    clamped = min(max(s, 0.0), 1.0)
    return x - ax - clamped * ex, y - ax - clamped * ex, z - az - clamped * ez, False


@njit(nogil=True, cache=True, error_model="numpy")
def _grid(rows: np.ndarray, row: int, x: float, y: float, z: float) -> Gradient3:
    """Compute the distance to a solid on a grid: a degree-2 spline, or planes, in the grid, a lower bound outside.

    From a point outside a box that holds the solid, the way to the solid is at least the hypotenuse of the way to the
    nearest point of the box and the distance there, since the box lies behind that point. The normal is that from
    what is nearest to that point.
    """
    h = rows[row, VALUES + 3]
    u, v, w = (x - rows[row, VALUES + 4]) / h, (y - rows[row, VALUES + 5]) / h, (z - rows[row, VALUES + 6]) / h
    a = min(max(u, 1.0), rows[row, VALUES] - 2.0)
    b = min(max(v, 1.0), rows[row, VALUES + 1] - 2.0)
    c = min(max(w, 1.0), rows[row, VALUES + 2] - 2.0)
    edge = _edge_at(rows, row, a, b, c)
    if edge > 0:
        d, g_x, g_y, g_z = wedge(rows, row, edge, a, b, c)
        d *= h
    else:
        d, g_x, g_y, g_z = spline(rows, row, a, b, c)
    size = max(math.sqrt(g_x * g_x + g_y * g_y + g_z * g_z), _TINY_MM)
    g_x, g_y, g_z = g_x / size, g_y / size, g_z / size
    if u == a and v == b and w == c:
        return d, g_x, g_y, g_z
    d = max(d, 0.0)
    u, v, w = (u - a) * h, (v - b) * h, (w - c) * h
    _, g_x, g_y, g_z = _from_closest(u + d * g_x, v + d * g_y, w + d * g_z)
    return math.sqrt(u * u + v * v + w * w + d * d), g_x, g_y, g_z


@njit(nogil=True, cache=True, error_model="numpy")
def _edge_at(rows: np.ndarray, row: int, u: float, v: float, w: float) -> int:
    """Find the column where a GRID's planes begin that hold at (u, v, w) spacings; 0 where the spline does."""
    nx, ny, nz = int(rows[row, VALUES]), int(rows[row, VALUES + 1]), int(rows[row, VALUES + 2])
    first = GRID_VALUES + 3 * int(rows[row, N_VERTICES]) + nx * ny * nz
    at = first + int(u + 0.5) * ny + int(v + 0.5)
    low, high = int(rows[row, at]), int(rows[row, at + 1])
    first += nx * ny + 1
    k = int(w + 0.5)
    while low < high:
        middle = (low + high) // 2
        found = int(rows[row, first + 2 * middle])
        if found == k:
            return int(rows[row, first + 2 * middle + 1])
        low, high = (middle + 1, high) if found < k else (low, middle)
    return 0


@njit(nogil=True, cache=True, error_model="numpy")
def wedge(rows: np.ndarray, row: int, edge: int, u: float, v: float, w: float) -> Gradient3:
    """Compute the distance in spacings to what planes bound; their numbers begin at column `edge` of the row.

    The way to what lies behind all planes is a sum of steps l_a >= 0 along the normals of some of them, at most three,
    whose distances it brings to 0. It is the longest one of that kind, as the way to fewer planes is no longer.
    """
    sign, n = rows[row, edge + EDGE_SIGN], int(rows[row, edge + EDGE_COUNT])
    best, x, y, z = -np.inf, 0.0, 0.0, 1.0
    for a in range(n):
        d = _to_plane(rows, row, edge, a, u, v, w)
        if d > best:
            at = edge + EDGE_PLANES + 4 * a
            best, x, y, z = d, sign * rows[row, at], sign * rows[row, at + 1], sign * rows[row, at + 2]
    if best <= 0.0:
        return sign * best, sign * x, sign * y, sign * z
    square = best * best
    for a in range(n):
        p = edge + EDGE_PLANES + 4 * a
        d_a = _to_plane(rows, row, edge, a, u, v, w)
        for b in range(a):
            q = edge + EDGE_PLANES + 4 * b
            d_b = _to_plane(rows, row, edge, b, u, v, w)
            ab = _dot(rows, row, p, q)
            rest = 1.0 - ab * ab
            l_a, l_b = (d_a - ab * d_b) / rest, (d_b - ab * d_a) / rest
            if l_a > 0.0 and l_b > 0.0 and l_a * d_a + l_b * d_b > square:
                square = l_a * d_a + l_b * d_b
                x = sign * (l_a * rows[row, p] + l_b * rows[row, q])
                y = sign * (l_a * rows[row, p + 1] + l_b * rows[row, q + 1])
                z = sign * (l_a * rows[row, p + 2] + l_b * rows[row, q + 2])
            for c in range(b):
                r = edge + EDGE_PLANES + 4 * c
                d_c = _to_plane(rows, row, edge, c, u, v, w)
                bc, ca = _dot(rows, row, q, r), _dot(rows, row, r, p)
                rest = 1.0 + 2.0 * ab * bc * ca - ab * ab - bc * bc - ca * ca
                if rest < _FLAT:
                    continue
                l_a = ((1.0 - bc * bc) * d_a + (ca * bc - ab) * d_b + (ab * bc - ca) * d_c) / rest
                l_b = ((ca * bc - ab) * d_a + (1.0 - ca * ca) * d_b + (ab * ca - bc) * d_c) / rest
                l_c = ((ab * bc - ca) * d_a + (ab * ca - bc) * d_b + (1.0 - ab * ab) * d_c) / rest
                if min(l_a, l_b, l_c) > 0.0 and l_a * d_a + l_b * d_b + l_c * d_c > square:
                    square = l_a * d_a + l_b * d_b + l_c * d_c
                    x = sign * (l_a * rows[row, p] + l_b * rows[row, q] + l_c * rows[row, r])
                    y = sign * (l_a * rows[row, p + 1] + l_b * rows[row, q + 1] + l_c * rows[row, r + 1])
                    z = sign * (l_a * rows[row, p + 2] + l_b * rows[row, q + 2] + l_c * rows[row, r + 2])
    d = math.sqrt(square)
    size = math.sqrt(x * x + y * y + z * z)
    return sign * d, sign * x / size, sign * y / size, sign * z / size


@njit(inline="always")
def _to_plane(rows: np.ndarray, row: int, edge: int, a: int, u: float, v: float, w: float) -> float:
    """Return how far a point lies before plane `a`, or behind it if what lies behind any plane is solid."""
    at = edge + EDGE_PLANES + 4 * a
    d = rows[row, at] * u + rows[row, at + 1] * v + rows[row, at + 2] * w - rows[row, at + 3]
    return rows[row, edge + EDGE_SIGN] * d


@njit(inline="always")
def _dot(rows: np.ndarray, row: int, p: int, q: int) -> float:
    """Compute the product of the normals at two columns."""
    return rows[row, p] * rows[row, q] + rows[row, p + 1] * rows[row, q + 1] + rows[row, p + 2] * rows[row, q + 2]


@njit(nogil=True, cache=True, error_model="numpy")
def spline(rows: np.ndarray, row: int, u: float, v: float, w: float) -> Gradient3:
    """Compute value and gradient (both per grid spacing) of the spline at (u, v, w) spacings from the first point."""
    ny, nz = int(rows[row, VALUES + 1]), int(rows[row, VALUES + 2])
    i, j, k = int(u + 0.5), int(v + 0.5), int(w + 0.5)
    p, q, r = u - i, v - j, w - k
    x_0, x_1, x_2 = 0.5 * (0.5 - p) ** 2, 0.75 - p * p, 0.5 * (0.5 + p) ** 2
    y_0, y_1, y_2 = 0.5 * (0.5 - q) ** 2, 0.75 - q * q, 0.5 * (0.5 + q) ** 2
    z_0, z_1, z_2 = 0.5 * (0.5 - r) ** 2, 0.75 - r * r, 0.5 * (0.5 + r) ** 2
    first = GRID_VALUES + 3 * int(rows[row, N_VERTICES]) + ((i - 1) * ny + j - 1) * nz + k - 1
    d = g_x = g_y = g_z = 0.0
    for a in range(3):
        x_a = x_0 if a == 0 else (x_1 if a == 1 else x_2)
        dx_a = p - 0.5 if a == 0 else (-2.0 * p if a == 1 else p + 0.5)
        plane = plane_y = plane_z = 0.0
        for b in range(3):
            at = first + (a * ny + b) * nz
            y_b = y_0 if b == 0 else (y_1 if b == 1 else y_2)
            dy_b = q - 0.5 if b == 0 else (-2.0 * q if b == 1 else q + 0.5)
            line = z_0 * rows[row, at] + z_1 * rows[row, at + 1] + z_2 * rows[row, at + 2]
            slope = (r - 0.5) * rows[row, at] - 2.0 * r * rows[row, at + 1] + (r + 0.5) * rows[row, at + 2]
            plane += y_b * line
            plane_y += dy_b * line
            plane_z += y_b * slope
        d += x_a * plane
        g_x += dx_a * plane
        g_y += x_a * plane_y
        g_z += x_a * plane_z
    return d, g_x, g_y, g_z
