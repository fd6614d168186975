"""Bodies of one object: those that overlap become one solid, and none may float when the object is printed."""

from collections.abc import Callable, Sequence
from itertools import combinations, product

import numpy as np
import trimesh
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from fast.models.errors import ConfigError
from fast.models.objects.distance import distance
from fast.models.objects.primitives import bounds

_NO_VOLUME = 1e-6  # of the largest body: two sheets back to back
_STICKS_OUT = 1e-3  # of a cavity's volume, that may lie outside by rounding
TOUCH_MM = 0.5  # bodies whose surfaces are this near are one
_MOST_BODIES = 100
_N_POINTS = 20_000  # of all surfaces together
_FIRST_SPACING_MM, _ACCURACY_MM = 4.0, 0.05
_CORNERS = np.array(list(product((-1.0, 1.0), repeat=3)))


def check_one_piece(mesh: trimesh.Trimesh, source: str) -> None:
    """Refuse an object in mm that has bodies which neither touch each other nor lie within another.

    Raises:
        ConfigError: how many there are, and how far apart the nearest two are.
    """
    body_of = _find_bodies(mesh)
    n_bodies = int(body_of.max()) + 1
    if n_bodies == 1:
        return
    if n_bodies > _MOST_BODIES:
        raise ConfigError(
            f"{source}: it has {n_bodies} bodies, at most {_MOST_BODIES} are taken; join them where it was made."
        )
    gaps_mm = _find_gaps_mm(mesh, body_of, n_bodies)
    _, group_of = connected_components(gaps_mm <= TOUCH_MM, directed=False)
    _check_groups(group_of, gaps_mm, source, lambda group: _is_within(mesh, group_of[body_of] == group))


def join_bodies(mesh: trimesh.Trimesh, source: str) -> trimesh.Trimesh:
    """Join a closed mesh in mm to one solid: bodies that overlap are one, and lose the faces that lie inside of it.

    A body that is turned inside out is a cavity of the smallest body that it lies in.

    Raises:
        ConfigError: a body is no clean solid, or is turned inside out and lies in none.
    """
    with np.errstate(invalid="ignore", divide="ignore"):  # what has no volume has no centre
        single = _without_doubles(mesh)
        bodies = single.split(only_watertight=False)
        if len(bodies) == 1:
            return single
        least_mm3 = _NO_VOLUME * max(abs(body.volume) for body in bodies)
        solids = sorted((body for body in bodies if body.volume > least_mm3), key=lambda body: float(body.volume))
        cavities = [body for body in bodies if body.volume < -least_mm3]
        for cavity in cavities:
            cavity.invert()
        if not all(body.is_volume for body in (*solids, *cavities)):
            raise ConfigError(
                f"{source}: one of its bodies is no clean solid (its own faces meet or cross), so they cannot be made "
                "one; join them in the program that made it."
            )
    within: list[list[trimesh.Trimesh]] = [[] for _ in solids]
    for cavity in cavities:
        within[_find_around(cavity, solids, source)].append(cavity)
    hollow = [
        trimesh.boolean.difference([solid, *inner], engine="manifold") if inner else solid
        for solid, inner in zip(solids, within, strict=True)
    ]
    return trimesh.boolean.union(hollow, engine="manifold")


def _without_doubles(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """Return the mesh without the triangles that it has twice, if it stays closed: a body that was exported twice."""
    single = mesh.copy()
    single.update_faces(single.unique_faces())
    _, n_faces = np.unique(single.edges_sorted, axis=0, return_counts=True)
    return mesh if (n_faces % 2).any() else single


def _find_around(cavity: trimesh.Trimesh, solids: Sequence[trimesh.Trimesh], source: str) -> int:
    """Find the number of the first solid that a cavity lies in."""
    for number, solid in enumerate(solids):
        (low, high), (from_mm, to_mm) = cavity.bounds, solid.bounds
        if (low < from_mm - TOUCH_MM).any() or (high > to_mm + TOUCH_MM).any():
            continue
        outside = trimesh.boolean.difference([cavity, solid], engine="manifold")
        if len(outside.faces) == 0 or outside.volume <= _STICKS_OUT * cavity.volume:
            return number
    raise ConfigError(
        f"{source}: a body of it is turned inside out and sticks out of the others, so it may be meant as solid or as "
        "a hole; turn its faces, or cut the hole, in the program that made it."
    )


def check_parts_touch(parts: Sequence[np.ndarray], source: str) -> None:
    """Refuse an object of parts, rows of primitives (n_rows, n_columns) each, some of which touch no other one.

    Raises:
        ConfigError: how many bodies there are, and how far apart the nearest two are.
    """
    gaps_mm = np.zeros((len(parts), len(parts)))
    for one, other in combinations(range(len(parts)), 2):
        gaps_mm[one, other] = gaps_mm[other, one] = _find_gap_mm(parts[one], parts[other])
    _, group_of = connected_components(gaps_mm <= TOUCH_MM, directed=False)
    _check_groups(group_of, gaps_mm, source, lambda group: False)


def _check_groups(group_of: np.ndarray, gaps_mm: np.ndarray, source: str, is_within: Callable[[int], bool]) -> None:
    """Refuse bodies of several groups that do not touch, but for those that lie within others."""
    groups = range(int(group_of.max()) + 1)
    loose = [group for group in groups if len(groups) > 1 and not is_within(group)]
    if len(loose) > 1:
        is_of = [group_of == group for group in loose]
        apart_mm = min(float(gaps_mm[np.ix_(one, ~one)].min()) for one in is_of)
        raise ConfigError(
            f"{source}: it has {len(loose)} bodies that do not touch, {apart_mm:.2g} mm apart at the nearest, so one "
            "of them would float; join them, or give one object for each."
        )


def _find_gap_mm(one: np.ndarray, other: np.ndarray) -> float:
    """Find the distance of two solids, to `_ACCURACY_MM`; not exact below `TOUCH_MM`.

    Half of it is the least value of the larger of their two distances: cells in which no point can be better than the
    best one so far are left out, the others are divided.
    """
    lows, highs = zip(bounds(one), bounds(other), strict=True)
    low, high = np.min(lows, axis=0), np.max(highs, axis=0)
    step_mm, best_mm = _FIRST_SPACING_MM, np.inf
    axes = [np.arange(a, b + step_mm, step_mm) for a, b in zip(low, high, strict=True)]
    centres = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    while True:
        values = np.maximum(distance(one, centres), distance(other, centres))
        best_mm = min(best_mm, float(values.min()))
        if best_mm <= TOUCH_MM / 2 or step_mm < _ACCURACY_MM:
            return max(2.0 * best_mm, 0.0)
        centres = centres[values - np.sqrt(3) / 2 * step_mm <= best_mm]
        step_mm /= 2.0
        centres = (centres[:, None] + step_mm / 2.0 * _CORNERS).reshape(-1, 3)


def _find_bodies(mesh: trimesh.Trimesh) -> np.ndarray:
    """Find the number of the body of each triangle; those that share a corner are of one body."""
    n = len(mesh.vertices)
    graph = coo_array((np.ones(len(mesh.edges), dtype=bool), tuple(mesh.edges.T)), shape=(n, n))
    _, part_of = connected_components(graph, directed=False)
    _, body_of = np.unique(part_of[mesh.faces[:, 0]], return_inverse=True)  # corners of no triangle are left out
    return body_of


def _find_gaps_mm(mesh: trimesh.Trimesh, body_of: np.ndarray, n_bodies: int) -> np.ndarray:
    """Find the distances (n_bodies, n_bodies) of the surfaces of bodies, from their corners and points in between.

    The distance of their boxes where that is above `TOUCH_MM` already.
    """
    sampled, faces = trimesh.sample.sample_surface(mesh, _N_POINTS, seed=0)
    spacing_mm = float(np.sqrt(mesh.area / _N_POINTS))
    points = [
        np.concatenate([mesh.triangles[body_of == body].reshape(-1, 3), sampled[body_of[faces] == body]])
        for body in range(n_bodies)
    ]
    trees = [cKDTree(of_body) for of_body in points]
    low, high = (np.array([end(of_body, axis=0) for of_body in points]) for end in (np.min, np.max))
    gaps_mm = np.zeros((n_bodies, n_bodies))
    for one in range(n_bodies):
        for other in range(one):
            gap_mm = float(np.linalg.norm(np.maximum(np.maximum(low[one] - high[other], low[other] - high[one]), 0.0)))
            if gap_mm <= TOUCH_MM:
                gap_mm = max(gap_mm, float(trees[one].query(points[other])[0].min()) - spacing_mm)
            gaps_mm[one, other] = gaps_mm[other, one] = gap_mm
    return gaps_mm


def _is_within(mesh: trimesh.Trimesh, is_own: np.ndarray) -> bool:
    """Return whether triangles lie in material the others enclose: by their winding number about a corner of it."""
    a, b, c = np.moveaxis(mesh.triangles[~is_own] - mesh.triangles[is_own][0, 0], 1, 0)
    la, lb, lc = (np.linalg.norm(corner, axis=1) for corner in (a, b, c))
    volume = np.einsum("ij,ij->i", a, np.cross(b, c))
    below = la * lb * lc + sum(
        np.einsum("ij,ij->i", one, other) * length for one, other, length in ((a, b, lc), (b, c, la), (c, a, lb))
    )
    return abs(float(np.arctan2(volume, below).sum())) > np.pi  # half of 2 pi, which is once around
