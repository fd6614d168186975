"""The best division of a polygon into quadrilaterals and triangles between its own vertices.

Dynamic programming over sub-polygons (Klincsek's minimal triangulation, 1980, with quadrilaterals added). Pieces
between vertices i < j < ... of a simple polygon that are all positively oriented tile it without overlap, so no
test of visibility is needed.
"""

import numba as nb
import numpy as np

TRIANGLE_FACTOR = 1.5  # a triangle counts as this many equally good quadrilaterals: wedges are the stiffer elements
WORST_SINE = 1e-4  # corners flatter than this make a piece unusable


def partition(points: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    """Divide a counter-clockwise polygon (n, 2) into triangles (t, 3) and quadrilaterals (q, 4) of its vertices.

    Minimises the sum over pieces of 1/sin^2 of their worst corner. None if no division has usable corners.
    """
    n = len(points)
    cost, choice = _best(np.ascontiguousarray(points))
    if not np.isfinite(cost[0, n - 1]):
        return None
    triangles, quads = [], []
    open_parts = [(0, n - 1)]
    while open_parts:
        i, j = open_parts.pop()
        if j - i < 2:
            continue
        k, m = choice[i, j]
        if m < 0:
            triangles.append((i, k, j))
            open_parts += [(i, k), (k, j)]
        else:
            quads.append((i, k, m, j))
            open_parts += [(i, k), (k, m), (m, j)]
    return np.array(triangles, dtype=int).reshape(-1, 3), np.array(quads, dtype=int).reshape(-1, 4)


@nb.njit(inline="always")
def _corner(points: np.ndarray, a: int, b: int, c: int) -> float:
    """Return the sine of the angle at b between the sides to a and to c; negative when the corner is reflex."""
    ux, uz = points[c, 0] - points[b, 0], points[c, 1] - points[b, 1]
    vx, vz = points[a, 0] - points[b, 0], points[a, 1] - points[b, 1]
    return (ux * vz - uz * vx) / np.sqrt((ux * ux + uz * uz) * (vx * vx + vz * vz))


@nb.njit(cache=True)
def _best(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Find the least cost (n, n) of each sub-polygon i..j, its piece at side i-j: (k, m), or (k, -1) for a triangle."""
    n = len(points)
    cost = np.full((n, n), np.inf)
    choice = np.full((n, n, 2), -1)
    for i in range(n - 1):
        cost[i, i + 1] = 0.0
    for width in range(2, n):
        for i in range(n - width):
            j = i + width
            for k in range(i + 1, j):
                worst = min(_corner(points, j, i, k), _corner(points, i, k, j), _corner(points, k, j, i))
                if worst > WORST_SINE:
                    # The best corner a triangle can have is sin 60 deg.
                    total = TRIANGLE_FACTOR * 0.75 / worst**2 + cost[i, k] + cost[k, j]
                    if total < cost[i, j]:
                        cost[i, j] = total
                        choice[i, j, 0], choice[i, j, 1] = k, -1
                for m in range(k + 1, j):
                    below = cost[i, k] + cost[k, m] + cost[m, j]
                    if below >= cost[i, j]:
                        continue
                    worst = min(
                        min(_corner(points, j, i, k), _corner(points, i, k, m)),
                        min(_corner(points, k, m, j), _corner(points, m, j, i)),
                    )
                    if worst > WORST_SINE and 1.0 / worst**2 + below < cost[i, j]:
                        cost[i, j] = 1.0 / worst**2 + below
                        choice[i, j, 0], choice[i, j, 1] = k, m
    return cost, choice
