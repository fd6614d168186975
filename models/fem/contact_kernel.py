"""Compiled loops of contact: find the points near an obstacle, measure them, add their forces and tangents.

Nothing here depends on what happened before but the time it takes: a patch is left out only if none of its points
can have reached anything since it was last measured, and everything else is computed afresh in a fixed order.
"""

from typing import NamedTuple

import numba as nb
import numpy as np

from models.fem.contact_points import ContactPoints
from models.fem.friction import return_mapping
from models.objects.distance import solid_distance

_MARGIN_MM = 1e-9  # far above rounding: a point left out is outside for certain


class Sightings(NamedTuple):
    """What is known of faces (f) and patches (q): their nodes when last measured (., k, 3), and a lower bound then, in
    mm, of the gap between their points and the nearest thing to touch."""

    face_nodes: np.ndarray
    face_gap: np.ndarray
    patch_nodes: np.ndarray
    patch_gap: np.ndarray


class NearPoints(NamedTuple):
    """Buffers for one evaluation. Of patches that may touch: their numbers `patch` (q) and faces `face` (q); of their
    points in a row: positions (n, 3), distances (n) and normals (n, 3). A positive distance may be a lower bound."""

    patch: np.ndarray
    face: np.ndarray
    position: np.ndarray
    distance: np.ndarray
    normal: np.ndarray


class Touching(NamedTuple):
    """Buffers for the points that touch the obstacle: numbers (n), traction (n, 3), pressure (n), slip (n)."""

    point: np.ndarray
    traction: np.ndarray
    pressure: np.ndarray
    slip: np.ndarray


class Law(NamedTuple):
    """Penalty stiffnesses along and across the normal in N/mm3, and the smoothing depth in mm."""

    kn: float
    kt: float
    d0: float


class FrictionState(NamedTuple):
    """Last converged nodes (nodes, 3) and tractions (n, 3), and the coefficient of every point (n)."""

    nodes: np.ndarray
    traction: np.ndarray
    coefficient: np.ndarray


@nb.njit(cache=True, nogil=True, error_model="numpy")
def interpolate(points: ContactPoints, x: np.ndarray, positions: np.ndarray) -> None:
    """Positions (n, 3) of all points at deformed nodes x."""
    for f in range(len(points.faces)):
        for c in range(points.first_point[points.first_patch[f]], points.first_point[points.first_patch[f + 1]]):
            positions[c, 0], positions[c, 1], positions[c, 2] = _at_point(points, f, c, x)


@nb.njit(cache=True, nogil=True, error_model="numpy")
def find_near(points: ContactPoints, x: np.ndarray, seen: Sightings, near: NearPoints) -> tuple[int, int]:
    """Collect the patches that may touch something, and their points; returns how many of each."""
    n_patches = n_points = 0
    for f in range(len(points.faces)):
        most = 0.0
        for p in range(points.first_patch[f], points.first_patch[f + 1]):
            most = max(most, points.reach[p])
        if seen.face_gap[f] > most * _motion(points, f, x, seen.face_nodes[f]) + _MARGIN_MM:
            continue
        seen.face_gap[f] = np.inf
        for a in range(points.faces.shape[1]):
            seen.face_nodes[f, a] = x[points.faces[f, a]]
        for p in range(points.first_patch[f], points.first_patch[f + 1]):
            gap = seen.patch_gap[p] - points.reach[p] * _motion(points, f, x, seen.patch_nodes[p])
            if gap > _MARGIN_MM:
                seen.face_gap[f] = min(seen.face_gap[f], gap)
                continue
            near.patch[n_patches], near.face[n_patches] = p, f
            n_patches += 1
            for c in range(points.first_point[p], points.first_point[p + 1]):
                position = _at_point(points, f, c, x)
                near.position[n_points, 0], near.position[n_points, 1], near.position[n_points, 2] = position
                n_points += 1
    return n_patches, n_points


@nb.njit(inline="always")
def _motion(points: ContactPoints, f: int, x: np.ndarray, before: np.ndarray) -> float:
    """How far the node of a face that moved most is from where it was."""
    most = 0.0
    for a in range(points.faces.shape[1]):
        node, square = points.faces[f, a], 0.0
        for i in range(3):
            square += (x[node, i] - before[a, i]) ** 2
        most = max(most, square)
    return np.sqrt(most)


@nb.njit(inline="always")
def _at_point(points: ContactPoints, f: int, c: int, x: np.ndarray) -> tuple[float, float, float]:
    """Interpolate nodal vectors x to point c of face f."""
    u = v = w = 0.0
    for a in range(points.faces.shape[1]):
        node, weight = points.faces[f, a], points.shape[c, a]
        u += weight * x[node, 0]
        v += weight * x[node, 1]
        w += weight * x[node, 2]
    return u, v, w


@nb.njit(cache=True, nogil=True, error_model="numpy")
def measure_solid(rows: np.ndarray, points: ContactPoints, near: NearPoints, n_patches: int) -> None:
    """Distances and normals of the near points from a solid of primitives.

    A patch whose middle point is further away than twice its size is not looked at closer.
    """
    first = 0
    for q in range(n_patches):
        p = near.patch[q]
        last = first + points.first_point[p + 1] - points.first_point[p]
        middle = (first + last) // 2
        centre = near.position[middle]
        gap, size = solid_distance(rows, centre[0], centre[1], centre[2])[0], 0.0
        for i in range(first, last):
            near.distance[i] = gap - _distance_between(near.position[i], centre)
            size = max(size, gap - near.distance[i])
        if gap <= 2.0 * size:
            for i in range(first, last):
                near.distance[i], near.normal[i, 0], near.normal[i, 1], near.normal[i, 2] = solid_distance(
                    rows, near.position[i, 0], near.position[i, 1], near.position[i, 2]
                )
        first = last


@nb.njit(inline="always")
def _distance_between(a: np.ndarray, b: np.ndarray) -> float:
    return np.sqrt((a[0] - b[0]) ** 2 + (a[1] - b[1]) ** 2 + (a[2] - b[2]) ** 2)


@nb.njit(cache=True, nogil=True, error_model="numpy")
def remember(
    points: ContactPoints, x: np.ndarray, near: NearPoints, n_patches: int, has_mirror: bool, seen: Sightings
) -> None:
    """Keep how far the patches just measured are from the nearest thing to touch."""
    i = 0
    for q in range(n_patches):
        p, f = near.patch[q], near.face[q]
        gap = np.inf
        for _ in range(points.first_point[p], points.first_point[p + 1]):
            gap = min(gap, near.distance[i])
            if has_mirror:
                gap = min(gap, near.position[i, 0])
            i += 1
        for a in range(points.faces.shape[1]):
            seen.patch_nodes[p, a] = x[points.faces[f, a]]
        seen.patch_gap[p] = gap
        seen.face_gap[f] = min(seen.face_gap[f], gap)


@nb.njit(cache=True, nogil=True, error_model="numpy")
def add_contact(
    points: ContactPoints,
    places: np.ndarray,
    x: np.ndarray,
    near: NearPoints,
    n_patches: int,
    has_mirror: bool,
    law: Law,
    state: FrictionState,
    force: np.ndarray,
    blocks: np.ndarray,
    touching: Touching,
) -> int:
    """Add the forces (nodes, 3) of the near points, and their tangents to `blocks` unless that is empty.

    Forces and tangents are summed per face before they go to the nodes. Returns how many points touch the obstacle.
    """
    k = points.faces.shape[1]
    has_tangent = len(blocks) > 0
    point_force, tangent = np.zeros(3), np.zeros((3, 3))
    face_force, face_tangent, pairs = np.zeros((k, 3)), np.zeros((6, k * (k + 1) // 2)), np.zeros(k * (k + 1) // 2)
    n_touching, i, current = 0, 0, -1
    for q in range(n_patches):
        f = near.face[q]
        for c in range(points.first_point[near.patch[q]], points.first_point[near.patch[q] + 1]):
            is_touching, is_behind = near.distance[i] < 0.0, has_mirror and near.position[i, 0] < 0.0
            if is_touching or is_behind:
                if f != current:
                    _scatter(points, places, current, has_tangent, face_force, face_tangent, force, blocks)
                    current = f
                point_force[:] = 0.0
                tangent[:] = 0.0
                if is_touching:
                    motion = _moved_since(points, f, c, x, state.nodes)
                    _press(c, i, near, law, state, motion, point_force, tangent, touching, n_touching)
                    n_touching += 1
                if is_behind:
                    p, slope = _pressure(-near.position[i, 0], law)
                    point_force[0] += p
                    tangent[0, 0] += slope
                _add_point(points.shape[c], points.areas[c], point_force, face_force)
                if has_tangent:
                    _add_point_tangent(points.shape[c], points.areas[c], tangent, pairs, face_tangent)
            i += 1
    _scatter(points, places, current, has_tangent, face_force, face_tangent, force, blocks)
    return n_touching


@nb.njit(inline="always")
def _moved_since(points: ContactPoints, f: int, c: int, x: np.ndarray, before: np.ndarray) -> tuple[float, float, float]:
    u = v = w = 0.0
    for a in range(points.faces.shape[1]):
        node, weight = points.faces[f, a], points.shape[c, a]
        u += weight * (x[node, 0] - before[node, 0])
        v += weight * (x[node, 1] - before[node, 1])
        w += weight * (x[node, 2] - before[node, 2])
    return u, v, w


@nb.njit(inline="always")
def _pressure(depth: float, law: Law) -> tuple[float, float]:
    """Pressure in MPa and its slope in N/mm3 at a penetration in mm."""
    if depth < law.d0:
        slope = law.kn * depth / law.d0
        return 0.5 * slope * depth, slope
    return law.kn * (depth - 0.5 * law.d0), law.kn


@nb.njit(inline="always")
def _press(
    c: int,
    i: int,
    near: NearPoints,
    law: Law,
    state: FrictionState,
    motion: tuple[float, float, float],
    point_force: np.ndarray,
    tangent: np.ndarray,
    touching: Touching,
    place: int,
) -> None:
    """Force and tangent per area of point c, the i-th near one, on the obstacle; its traction goes to `place`."""
    p, slope = _pressure(-near.distance[i], law)
    normal, traction = near.normal[i], touching.traction[place]
    touching.slip[place] = return_mapping(
        state.traction[c], motion, normal, state.coefficient[c] * p, law.kt, traction, tangent
    )
    touching.point[place], touching.pressure[place] = c, p
    for a in range(3):
        point_force[a] = p * normal[a] + traction[a]
        for b in range(3):
            tangent[a, b] += slope * normal[a] * normal[b]


@nb.njit(inline="always")
def _add_point(shape: np.ndarray, area: float, point_force: np.ndarray, face_force: np.ndarray) -> None:
    for a in range(len(shape)):
        for i in range(3):
            face_force[a, i] += area * shape[a] * point_force[i]


@nb.njit(inline="always")
def _add_point_tangent(
    shape: np.ndarray, area: float, tangent: np.ndarray, pairs: np.ndarray, face_tangent: np.ndarray
) -> None:
    """Add the six entries of a symmetric tangent (3, 3) times N_a N_b for the pairs a >= b."""
    n = 0
    for a in range(len(shape)):
        factor = area * shape[a]
        for b in range(a + 1):
            pairs[n] = factor * shape[b]
            n += 1
    entry = 0
    for i in range(3):
        for j in range(i + 1):
            value = tangent[i, j]
            for n in range(len(pairs)):
                face_tangent[entry, n] += value * pairs[n]
            entry += 1


@nb.njit(cache=True, nogil=True, error_model="numpy")
def _scatter(
    points: ContactPoints,
    places: np.ndarray,
    f: int,
    has_tangent: bool,
    face_force: np.ndarray,
    face_tangent: np.ndarray,
    force: np.ndarray,
    blocks: np.ndarray,
) -> None:
    """Add the sums of face f (none if -1) to the nodes and blocks, and clear them."""
    if f < 0:
        return
    n = 0
    for a in range(points.faces.shape[1]):
        for i in range(3):
            force[points.faces[f, a], i] += face_force[a, i]
        if not has_tangent:
            continue
        for b in range(a + 1):
            place = places[f, a, b]
            if place != -1:
                # A transposed block gets the same: every pair's tangent is symmetric.
                place = place if place >= 0 else -2 - place
                entry = 0
                for i in range(3):
                    for j in range(i + 1):
                        blocks[place, i, j] += face_tangent[entry, n]
                        if i != j:
                            blocks[place, j, i] += face_tangent[entry, n]
                        entry += 1
            n += 1
    face_force[:] = 0.0
    if has_tangent:
        face_tangent[:] = 0.0
