"""A planar mesh of a fin-ray profile: quadrilaterals through walls and ribs, triangles only where nothing else fits.

Stations are set where the joints end: each inner corner is projected through its walls, so a wall becomes a row of
quadrilaterals as thick as itself, in which 20-node elements carry bending exactly, and a joint becomes a cell of a
few corners, divided by `models.simulation.mesh.partition`. Between the joints the walls are divided with growing
lengths.
"""

import numpy as np
from shapely.geometry import Polygon

from fast.models.errors import MeshingFailed
from fast.models.simulation.mesh.outline import Outline
from fast.models.simulation.mesh.partition import partition
from fast.models.simulation.mesh.planar import PlanarMesh, add_middles, split

FACE_MM = 0.75  # shorter sides are parts of fillets and are not projected
REACH_MM = 12.0  # longest chord through the material: ribs and walls are 2-3 mm thick, the tip up to 11 mm
NEAR_JOINT = 0.5  # length of the first element at a joint, in units of the wall's thickness
GROWTH = 1.0  # growth of the element length per length away from the joint


def planar_mesh(profile: Polygon, edge_mm: float, refine: int = 0) -> PlanarMesh:
    """Mesh a profile (x, z in mm) with sides of at most `edge_mm`; `refine` divides every element into four.

    Raises:
        MeshingFailed: `empty` when the elements do not cover the profile.
    """
    outline = Outline(profile)
    _project_corners(outline)
    for cell in outline.parts():
        if _strip_side(outline, cell) is None:
            _divide_sides(outline, cell, edge_mm)
    triangles, quads = _elements(outline, edge_mm)
    vertices = np.array(outline.points)
    _check_area(vertices, triangles, quads, profile)
    mesh = add_middles(vertices, triangles, quads)
    for _ in range(refine):
        mesh = split(mesh)
    return mesh


def _project_corners(outline: Outline) -> None:
    """Draw chords from both faces at every inner corner, straight through the material."""
    start, end = outline.sides()
    before = np.argsort(outline.following)
    along = end - start
    length = np.hypot(*along.T)
    normal = np.column_stack([-along[:, 1], along[:, 0]]) / length[:, None]
    turn = along[before, 0] * along[:, 1] - along[before, 1] * along[:, 0]
    for corner in np.flatnonzero(turn < 0.0):
        for side in (before[corner], corner):
            if length[side] > FACE_MM:
                outline.project(int(corner), normal[side], REACH_MM)


def _strip_side(outline: Outline, part: list[int]) -> int | None:
    """Return the number (0 or 1) of the first of the two opposite boundary sides of a piece of wall; else None.

    A piece of wall has four corners; where all its sides are on the boundary, the longer two count.
    """
    if len(part) != 4:
        return None
    free = [outline.is_side(a, b) for a, b in zip(part, np.roll(part, -1), strict=True)]
    points = np.array(outline.points)[part]
    length = np.hypot(*(np.roll(points, -1, axis=0) - points).T)
    pairs = [(length[i] + length[i + 2], i) for i in (0, 1) if free[i] and free[i + 2]]
    return max(pairs)[1] if pairs else None


def _divide_sides(outline: Outline, part: list[int], edge_mm: float) -> None:
    """Divide the long boundary sides of a cell and set stations through it from there.

    The outer face of a joint, from station to station, is halved: that lets the joint turn (see `NEAR_JOINT`).
    """
    sides = [(a, b) for a, b in zip(part, np.roll(part, -1).tolist(), strict=True) if outline.is_side(a, b)]
    for start, end in sides:
        if min(start, end) >= outline.n_corners and outline.is_side(start, end):
            outline.divide(start, np.array([0.5]))
        # Stations of the sides before may lie on this one by now.
        while start != end:
            stop = outline.following[start]
            along = np.subtract(outline.points[stop], outline.points[start])
            length = float(np.hypot(*along))
            n = int(np.ceil(length / edge_mm - 1e-6))
            for point in outline.divide(start, np.arange(1, n) / n):
                outline.project(point, np.array([-along[1], along[0]]) / length, REACH_MM)
            start = stop


def _elements(outline: Outline, edge_mm: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the triangles (t, 3) and quadrilaterals (q, 4) of all cells."""
    triangles, quads = [np.zeros((0, 3), dtype=int)], [np.zeros((0, 4), dtype=int)]
    for part in outline.parts():
        first = _strip_side(outline, part)
        if first is not None:
            quads.append(_divided_strip(outline, np.roll(part, -first).tolist(), edge_mm))
            continue
        numbers = np.array(part)
        parts = partition(np.array(outline.points)[numbers])
        if parts is None:
            raise MeshingFailed(f"A cell of {len(part)} corners has no usable division.", reason="empty")
        triangles.append(numbers[parts[0]])
        quads.append(numbers[parts[1]])
    return np.vstack(triangles), np.vstack(quads)


def _divided_strip(outline: Outline, part: list[int], edge_mm: float) -> np.ndarray:
    """Divide a piece of wall, its first and third side on the boundary, into a row of quadrilaterals (n, 4)."""
    a, b, c, d = part
    corners = np.array(outline.points)[[a, b, c, d]]
    side = np.hypot(*(np.roll(corners, -1, axis=0) - corners).T)
    fractions = graded(float(max(side[0], side[2])), NEAR_JOINT * float(side[1] + side[3]) / 2, edge_mm)
    lower = [a, *outline.divide(a, fractions), b]
    upper = [d, *outline.divide(c, (1.0 - fractions)[::-1])[::-1], c]
    return np.array([lower[:-1], lower[1:], upper[1:], upper[:-1]]).T


def graded(length: float, near: float, far: float) -> np.ndarray:
    """Return fractions (n) that divide a length into pieces of about `near` at both ends, growing to at most `far`."""
    place = np.linspace(0.0, 1.0, 257)
    to_end = length * np.minimum(place, 1.0 - place)
    density = length / np.minimum(far, near + GROWTH * to_end)
    count = np.concatenate([[0.0], np.cumsum(0.5 * (density[1:] + density[:-1]) * np.diff(place))])
    n = max(int(np.ceil(count[-1] - 0.25)), 1)
    while True:
        ends: np.ndarray = np.interp(np.linspace(0.0, count[-1], n + 1), count, place)
        if length * np.diff(ends).max() <= far * (1.0 + 1e-9):
            return ends[1:-1]
        n += 1


def _check_area(vertices: np.ndarray, triangles: np.ndarray, quads: np.ndarray, profile: Polygon) -> None:
    area = sum(float(_areas(vertices[part]).sum()) for part in (triangles, quads))
    if abs(area - profile.area) > 1e-6 * profile.area:
        raise MeshingFailed(
            f"The elements cover {area:.3f} of {profile.area:.3f} mm2 of the profile; change the edge length or the "
            "fillet.",
            reason="empty",
        )


def _areas(corners: np.ndarray) -> np.ndarray:
    """Return the areas (m) of polygons with corners (m, k, 2)."""
    following = np.roll(corners, -1, axis=1)
    return 0.5 * (corners[..., 0] * following[..., 1] - corners[..., 1] * following[..., 0]).sum(axis=1)
