"""A closed triangle mesh as a row of `models.objects.primitives`: its signed distance on a grid, as a spline.

Distances at the grid points are exact: next to the surface from every triangle near, further away from the triangles
that the neighbours are nearest to, swept over the grid (Bridson's SDFGen does the same). The sign is that of the
winding number along x, so bodies of one file that overlap are one solid. Between the points a spline of degree 2 goes
through the values: it has continuous normals, which a finger that slides over the object needs. It rounds sharp edges;
`models.objects.edges` puts planes there.
"""

from dataclasses import dataclass
from typing import Self

import numpy as np
import trimesh
from numba import njit
from scipy.ndimage import spline_filter

from fast.models.objects.edges import with_edges
from fast.models.objects.primitives import grid, turn_about_z
from fast.models.objects.triangles import triangle_distance

SPACING_MM = 0.5
_MARGIN = 3  # grid points beyond the box of the mesh: the spline needs one, the border smooths one
_ROUNDS = 2  # of eight sweeps, one from every corner
SAME_MM = 0.1  # what a printer may be off; the triangles of a round body are as far from round
_ROUND_TURNS_DEG = (13.0, 37.0, 90.0, 171.0)
_SURFACE_POINTS = 4000


@dataclass(frozen=True)
class MeshGrid:
    """A watertight mesh measured on a grid round it.

    `values` (nx, ny, nz): signed distance in spacings, `closest` which triangle is nearest; `triangles` (n, 3, 3):
    corners in spacings from the first grid point, which is at `origin_mm` (3), `beside` (n, 3) which triangles share
    their edges, -1 for none; `corners_mm` (n, 3): vertices of the convex hull.
    """

    values: np.ndarray
    closest: np.ndarray
    triangles: np.ndarray
    beside: np.ndarray
    origin_mm: np.ndarray
    spacing_mm: float
    corners_mm: np.ndarray

    @classmethod
    def of(cls, mesh: trimesh.Trimesh, spacing_mm: float = SPACING_MM) -> Self:
        """Measure a mesh in mm; `docs/how-to/bring-own-objects.md` says how exact a spacing is."""
        low, high = mesh.bounds
        shape = np.ceil((high - low) / spacing_mm).astype(np.int64) + 2 * _MARGIN + 1
        # In the middle: of a mesh that is its own mirror image, the grid is so too.
        origin_mm = (low + high) / 2 - (shape - 1) / 2 * spacing_mm
        triangles = (np.asarray(mesh.triangles, dtype=np.float64) - origin_mm) / spacing_mm
        values, closest = np.full(shape, np.inf), np.full(shape, -1, dtype=np.int64)
        _measure_near(triangles, values, closest)
        for _ in range(_ROUNDS):
            for corner in range(8):
                _sweep(triangles, values, closest, corner & 1, corner >> 1 & 1, corner >> 2 & 1)
        winding = np.zeros(shape, dtype=np.int32)
        _count_crossings(triangles, winding)
        values *= np.where(np.cumsum(winding, axis=0) != 0, -1.0, 1.0)
        return cls(
            values, closest, triangles, _find_beside(mesh), origin_mm, spacing_mm, np.asarray(mesh.convex_hull.vertices)
        )

    def row(self, *, is_round: bool, has_edges: bool) -> np.ndarray:
        """Return the solid's row (1, columns) in its own frame; `is_round`: about its z axis; `has_edges`: sharp."""
        coefficients = self.spacing_mm * spline_filter(self.values, order=2, output=np.float64)
        rows = grid(coefficients, self.spacing_mm, self.origin_mm, self.corners_mm, is_round=is_round)
        if not has_edges:
            return rows
        return with_edges(rows, self.triangles, self.values, self.closest, self.beside)

    def has_on_surface(self, points: np.ndarray) -> bool:
        """Return True if all `points` (n, 3) in mm lie on the surface of the mesh, to `SAME_MM`."""
        local = (points - self.origin_mm) / self.spacing_mm
        is_within = ((local > 0.0) & (local < np.array(self.values.shape) - 1.0)).all()
        within = SAME_MM / self.spacing_mm
        begin, numbers = _by_cell(self.triangles, self.values, within)
        shape = np.array(self.values.shape)
        return bool(is_within and _are_near(self.triangles, begin, numbers, shape, local, within))


def looks_round(mesh_grid: MeshGrid, points: np.ndarray) -> bool:
    """Return True if points (n, 3) of the surface are on the surface after any turn about z."""
    return all(mesh_grid.has_on_surface(points @ turn_about_z(turn_deg).T) for turn_deg in _ROUND_TURNS_DEG)


def _find_beside(mesh: trimesh.Trimesh) -> np.ndarray:
    """Find the numbers (n, 3) of the triangles that share an edge with each; -1 where there are fewer."""
    pairs = np.concatenate([mesh.face_adjacency, mesh.face_adjacency[:, ::-1]])
    pairs = pairs[np.argsort(pairs[:, 0], kind="stable")]
    place = np.arange(len(pairs)) - np.searchsorted(pairs[:, 0], pairs[:, 0])
    beside = np.full((len(mesh.faces), 3), -1, dtype=np.int64)
    pairs, place = pairs[place < 3], place[place < 3]
    beside[pairs[:, 0], place] = pairs[:, 1]
    return beside


def surface_points(mesh: trimesh.Trimesh) -> np.ndarray:
    """Return points (n, 3) spread over a mesh's surface, its vertices among them; the same for the same mesh."""
    sampled, _ = trimesh.sample.sample_surface(mesh, _SURFACE_POINTS, seed=0)
    return np.concatenate([np.asarray(mesh.vertices, dtype=np.float64), sampled])


@njit(nogil=True, cache=True, error_model="numpy")
def _by_cell(triangles: np.ndarray, values: np.ndarray, margin: float) -> tuple[np.ndarray, np.ndarray]:
    """List the numbers of the triangles that reach into each grid cell or its margin, in the order of the cells.

    Returns where those of each cell begin (n_cells + 1), and the numbers.
    """
    begin = np.zeros(values.size + 1, np.int64)
    first, last, numbers = np.zeros(3, np.int64), np.zeros(3, np.int64), np.zeros(0, np.int64)
    for has_room in (False, True):
        if has_room:
            numbers = np.zeros(begin[-1], np.int64)
        for t in range(len(triangles) - 1, -1, -1):
            _reach_of(triangles, t, margin, first, last)
            for i in range(first[0], last[0] + 1):
                for j in range(first[1], last[1] + 1):
                    for k in range(first[2], last[2] + 1):
                        cell = (i * values.shape[1] + j) * values.shape[2] + k
                        if has_room:
                            begin[cell] -= 1
                            numbers[begin[cell]] = t
                        else:
                            begin[cell] += 1
        if not has_room:
            for cell in range(values.size):
                begin[cell + 1] += begin[cell]
    return begin, numbers


@njit(nogil=True, cache=True, error_model="numpy")
def _reach_of(triangles: np.ndarray, t: int, margin: float, first: np.ndarray, last: np.ndarray) -> None:
    """Put the first and the last cell of the box of a triangle with a margin into `first` and `last` (3)."""
    for axis in range(3):
        low = min(triangles[t, 0, axis], triangles[t, 1, axis], triangles[t, 2, axis])
        high = max(triangles[t, 0, axis], triangles[t, 1, axis], triangles[t, 2, axis])
        first[axis], last[axis] = int(np.floor(low - margin)), int(np.floor(high + margin))


@njit(nogil=True, cache=True, error_model="numpy")
def _are_near(
    triangles: np.ndarray, begin: np.ndarray, numbers: np.ndarray, shape: np.ndarray, points: np.ndarray, within: float
) -> bool:
    """Return True if each point is within a distance, at most the margin of `_by_cell`, of a triangle."""
    for n in range(len(points)):
        x, y, z = points[n]
        cell = (int(x) * shape[1] + int(y)) * shape[2] + int(z)
        is_near = False
        for place in range(begin[cell], begin[cell + 1]):
            if triangle_distance(triangles, numbers[place], x, y, z) <= within:
                is_near = True
                break
        if not is_near:
            return False
    return True


@njit(nogil=True, cache=True, error_model="numpy")
def _measure_near(triangles: np.ndarray, values: np.ndarray, closest: np.ndarray) -> None:
    """Measure distances, in spacings, of the grid points next to each triangle; `closest` says which it is."""
    first, last = np.zeros(3, np.int64), np.zeros(3, np.int64)
    for t in range(len(triangles)):
        _reach_of(triangles, t, 1.0, first, last)
        for i in range(first[0], last[0] + 2):
            for j in range(first[1], last[1] + 2):
                for k in range(first[2], last[2] + 2):
                    d = triangle_distance(triangles, t, i, j, k)
                    if d < values[i, j, k]:
                        values[i, j, k], closest[i, j, k] = d, t


@njit(nogil=True, cache=True, error_model="numpy")
def _sweep(triangles: np.ndarray, values: np.ndarray, closest: np.ndarray, dx: int, dy: int, dz: int) -> None:
    """Ask, from corner to corner of the grid, whether a neighbour's closest triangle is nearer than one's own."""
    nx, ny, nz = values.shape
    sx, sy, sz = 2 * dx - 1, 2 * dy - 1, 2 * dz - 1
    for a in range(1, nx):
        i = a if dx else nx - 1 - a
        for b in range(1, ny):
            j = b if dy else ny - 1 - b
            for c in range(1, nz):
                k = c if dz else nz - 1 - c
                for step in range(1, 8):
                    p, q, r = i - sx * (step & 1), j - sy * (step >> 1 & 1), k - sz * (step >> 2 & 1)
                    t = closest[p, q, r]
                    if t < 0 or t == closest[i, j, k] or values[p, q, r] > values[i, j, k] + 1.7320508075688774:
                        continue
                    d = triangle_distance(triangles, t, i, j, k)
                    if d < values[i, j, k]:
                        values[i, j, k], closest[i, j, k] = d, t


@njit(nogil=True, cache=True, error_model="numpy")
def _count_crossings(triangles: np.ndarray, winding: np.ndarray) -> None:
    """Add, at the first grid point behind each crossing of a grid line along x with a triangle, which way it goes."""
    nx, ny, nz = winding.shape
    for t in range(len(triangles)):
        low_y = min(triangles[t, 0, 1], triangles[t, 1, 1], triangles[t, 2, 1])
        high_y = max(triangles[t, 0, 1], triangles[t, 1, 1], triangles[t, 2, 1])
        low_z = min(triangles[t, 0, 2], triangles[t, 1, 2], triangles[t, 2, 2])
        high_z = max(triangles[t, 0, 2], triangles[t, 1, 2], triangles[t, 2, 2])
        for j in range(max(int(np.ceil(low_y)), 0), min(int(np.floor(high_y)) + 1, ny)):
            for k in range(max(int(np.ceil(low_z)), 0), min(int(np.floor(high_z)) + 1, nz)):
                sign, x = _cross(triangles, t, j, k)
                if sign != 0:
                    winding[min(max(int(np.ceil(x)), 0), nx - 1), j, k] += sign


@njit(nogil=True, cache=True, error_model="numpy")
def _cross(triangles: np.ndarray, t: int, y: float, z: float) -> tuple[int, float]:
    """Tell which way (1, -1, or 0 for not at all) the line along x at (y, z) crosses a triangle, and where.

    A line through an edge or a vertex counts for one of its triangles only: see `_side`.
    """
    area, sign = np.zeros(3), 0
    for e in range(3):
        f, g = (e + 1) % 3, (e + 2) % 3
        fy, fz = triangles[t, f, 1] - y, triangles[t, f, 2] - z
        gy, gz = triangles[t, g, 1] - y, triangles[t, g, 2] - z
        side = _side(fy, fz, gy, gz)
        if side == 0 or side == -sign:
            return 0, 0.0
        area[e], sign = gy * fz - fy * gz, side
    total = area[0] + area[1] + area[2]
    if total == 0.0:
        return 0, 0.0
    return sign, (area[0] * triangles[t, 0, 0] + area[1] * triangles[t, 1, 0] + area[2] * triangles[t, 2, 0]) / total


@njit(nogil=True, cache=True, error_model="numpy")
def _side(fy: float, fz: float, gy: float, gz: float) -> int:
    """Tell which side of the edge from f to g the origin lies on; on the edge, the order of the corners decides."""
    area = gy * fz - fy * gz
    if area != 0.0:
        return 1 if area > 0.0 else -1
    if gz != fz:
        return 1 if gz > fz else -1
    if gy != fy:
        return 1 if fy > gy else -1
    return 0
