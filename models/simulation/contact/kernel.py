"""Compiled loops of contact: find the points near an obstacle, measure them, add their forces and tangents.

Nothing here depends on what happened before but the time it takes: a patch is left out only if none of its points
can have reached anything since it was last measured, and everything else is computed afresh in a fixed order.
"""

import math
from typing import NamedTuple

import numba as nb
import numpy as np

from fast.models.objects.distance import choose_rows, chosen_distance, solid_distance
from fast.models.simulation.contact.friction import return_mapping
from fast.models.simulation.contact.points import ContactPoints

ADHESION_RAMP = 0.1  # share of the smoothing depth, where the pressure is a hundredth of that at the full depth
_MARGIN_MM = 1e-9  # far above rounding: a point left out is outside for certain


class Sightings(NamedTuple):
    """What is known of faces (f) and patches (q).

    The nodes of patches when last measured (q, k, 3), and a lower bound then, in mm, of the gap between their points
    and the nearest thing to touch (q). The nodes of faces when last looked at (f, k, 3), and bounds then of the gaps of
    their patches, the least one (f) and each (q).
    """

    face_nodes: np.ndarray
    face_gap: np.ndarray
    gap_in_face: np.ndarray
    patch_nodes: np.ndarray
    patch_gap: np.ndarray


class NearPoints(NamedTuple):
    """Buffers for one evaluation.

    Of patches that may touch: their numbers `patch` (q) and faces `face` (q); of their points, in a row: positions
    (n, 3), distances (n) and, where these are negative, normals (n, 3). A positive distance may be a lower bound.
    """

    patch: np.ndarray
    face: np.ndarray
    position: np.ndarray
    distance: np.ndarray
    normal: np.ndarray


class Touching(NamedTuple):
    """Buffers for the points that touch the obstacle.

    Numbers (n), traction (n, 3), pressure (n), slip (n), and the vertical part of the outward normal (n).
    """

    point: np.ndarray
    traction: np.ndarray
    pressure: np.ndarray
    slip: np.ndarray
    normal_z: np.ndarray


class Law(NamedTuple):
    """Penalty stiffnesses along and across the normal in N/mm3, the smoothing depth in mm, and adhesion in MPa."""

    kn: float
    kt: float
    d0: float
    adhesion: float


class Surface(NamedTuple):
    """Points, places (f, k, k) of the blocks between the nodes of a face, the law, and buffers."""

    points: ContactPoints
    places: np.ndarray
    law: Law
    seen: Sightings
    near: NearPoints
    touching: Touching


class FrictionState(NamedTuple):
    """Last converged nodes (nodes, 3) and tractions (n, 3), and the coefficient of every point (n)."""

    nodes: np.ndarray
    traction: np.ndarray
    coefficient: np.ndarray


@nb.njit(cache=True, nogil=True, error_model="numpy")
def respond(
    surface: Surface,
    rows: np.ndarray,
    stop_mm: float,
    state: FrictionState,
    x: np.ndarray,
    force: np.ndarray,
    blocks: np.ndarray,
) -> int:
    """Add forces (nodes, 3) at deformed nodes x, and tangents to `blocks` unless that is empty.

    `rows` are the primitives of the obstacle. Returns how many points touch it: they are in `surface.touching`.
    """
    n_patches = _find_near(surface.points, x, surface.seen, surface.near)
    _measure(rows, surface.points, surface.near, n_patches)
    _remember(surface.points, surface.near, n_patches, stop_mm, surface.seen)
    return _add_contact(surface, x, n_patches, stop_mm, state, force, blocks)


@nb.njit(cache=True, nogil=True, error_model="numpy")
def least_gap(rows: np.ndarray, points: ContactPoints, x: np.ndarray) -> float:
    """Return the least distance in mm of any point at deformed nodes x from a solid of primitives, negative inside.

    A distance changes at most as far as its point moves: only faces, and of these patches, are looked at whose middle
    point is less than their size further away than the nearest point.
    """
    gap, local, position = np.inf, np.zeros((points.faces.shape[1], 3)), np.zeros((1, 3))
    least = np.zeros(len(points.faces))
    for f in range(len(points.faces)):
        _take_nodes(points.faces, f, x, local)
        middle = _distance_of_point(rows, points.shape, points.face_middle[f], local, position)
        least[f] = middle - _size(points.face_reach[f], local, position)
        gap = min(gap, middle)
    for f in range(len(points.faces)):
        if least[f] > gap:
            continue
        _take_nodes(points.faces, f, x, local)
        for p in range(points.first_patch[f], points.first_patch[f + 1]):
            middle = _distance_of_point(rows, points.shape, points.first_point[p], local, position)
            if middle - _size(points.reach[p], local, position) > gap:
                continue
            for c in range(points.first_point[p], points.first_point[p + 1]):
                gap = min(gap, _distance_of_point(rows, points.shape, c, local, position))
    return gap


@nb.njit(cache=True, nogil=True, error_model="numpy")
def _distance_of_point(rows: np.ndarray, shape: np.ndarray, c: int, local: np.ndarray, position: np.ndarray) -> float:
    """Find how far, mm, point c of the face with nodes `local` (k, 3) is; put the point into `position` (1, 3)."""
    _interpolate_point(shape, c, local, position, 0)
    return solid_distance(rows, position[0, 0], position[0, 1], position[0, 2])[0]


@nb.njit(inline="always")
def _size(reach: float, local: np.ndarray, middle: np.ndarray) -> float:
    """Bound on how far points within `reach` of a middle point (1, 3) are from it, a little more than rounding above.

    `local` (k, 3): the nodes of their face.
    """
    most = 0.0
    for a in range(len(local)):
        square = 0.0
        for i in range(3):
            square += (local[a, i] - middle[0, i]) ** 2
        most = max(most, square)
    return reach * math.sqrt(most) + _MARGIN_MM


@nb.njit(cache=True, nogil=True, error_model="numpy")
def interpolate(points: ContactPoints, x: np.ndarray, positions: np.ndarray) -> None:
    """Interpolate the positions (n, 3) of all points at deformed nodes x."""
    local = np.zeros((points.faces.shape[1], 3))
    for f in range(len(points.faces)):
        _take_nodes(points.faces, f, x, local)
        for c in range(points.first_point[points.first_patch[f]], points.first_point[points.first_patch[f + 1]]):
            _interpolate_point(points.shape, c, local, positions, c)


@nb.njit(inline="always")
def _take_nodes(faces: np.ndarray, f: int, x: np.ndarray, local: np.ndarray) -> None:
    """Copy the nodal vectors x of face f to `local` (k, 3)."""
    for a in range(faces.shape[1]):
        for i in range(3):
            local[a, i] = x[faces[f, a], i]


@nb.njit(inline="always")
def _interpolate_point(shape: np.ndarray, c: int, local: np.ndarray, result: np.ndarray, row: int) -> None:
    """Put the nodal vectors `local` (k, 3), interpolated to point c, into a row of `result`."""
    u = v = w = 0.0
    for a in range(len(local)):
        weight = shape[c, a]
        u += weight * local[a, 0]
        v += weight * local[a, 1]
        w += weight * local[a, 2]
    result[row, 0], result[row, 1], result[row, 2] = u, v, w


@nb.njit(inline="always")
def _travel(shape: np.ndarray, c: int, reach: float, local: np.ndarray, before: np.ndarray, row: int) -> float:
    """Bound on how far any point within `reach` of point c is from where it was.

    `local` (k, 3): the nodes of its face; a row of `before` (., k, 3): where they were. Point c itself moves by
    v = sum N_a du_a, a point with other shape values N_a + dN_a by sum dN_a (du_a - v) more.
    """
    u = v = w = 0.0
    for a in range(len(local)):
        weight = shape[c, a]
        u += weight * (local[a, 0] - before[row, a, 0])
        v += weight * (local[a, 1] - before[row, a, 1])
        w += weight * (local[a, 2] - before[row, a, 2])
    most = 0.0
    for a in range(len(local)):
        du = local[a, 0] - before[row, a, 0] - u
        dv = local[a, 1] - before[row, a, 1] - v
        dw = local[a, 2] - before[row, a, 2] - w
        most = max(most, du * du + dv * dv + dw * dw)
    return math.sqrt(u * u + v * v + w * w) + reach * math.sqrt(most)


@nb.njit(cache=True, nogil=True, error_model="numpy")
def _find_near(points: ContactPoints, x: np.ndarray, seen: Sightings, near: NearPoints) -> int:
    """Collect the patches that may touch something, and their points; returns how many patches."""
    n_patches = n_points = 0
    local = np.zeros((points.faces.shape[1], 3))
    for f in range(len(points.faces)):
        _take_nodes(points.faces, f, x, local)
        travel = _travel(points.shape, points.face_middle[f], points.face_reach[f], local, seen.face_nodes, f)
        if seen.face_gap[f] > travel + _MARGIN_MM:
            continue
        seen.face_gap[f] = np.inf
        seen.face_nodes[f] = local
        for p in range(points.first_patch[f], points.first_patch[f + 1]):
            gap = seen.gap_in_face[p] - travel
            if not gap > _MARGIN_MM:
                first = points.first_point[p]
                gap = seen.patch_gap[p] - _travel(points.shape, first, points.reach[p], local, seen.patch_nodes, p)
            if gap > _MARGIN_MM:
                seen.gap_in_face[p] = gap
                seen.face_gap[f] = min(seen.face_gap[f], gap)
                continue
            seen.patch_nodes[p] = local
            near.patch[n_patches], near.face[n_patches] = p, f
            n_patches += 1
            for c in range(points.first_point[p], points.first_point[p + 1]):
                _interpolate_point(points.shape, c, local, near.position, n_points)
                n_points += 1
    return n_patches


@nb.njit(cache=True, nogil=True, error_model="numpy")
def _measure(rows: np.ndarray, points: ContactPoints, near: NearPoints, n_patches: int) -> None:
    """Measure distances and normals of the near points from a solid of primitives.

    A patch whose middle point is further away than its size is not looked at closer.
    """
    position, distance, normal, first = near.position, near.distance, near.normal, 0
    chosen = np.zeros(len(rows), dtype=np.int64)
    for q in range(n_patches):
        p = near.patch[q]
        last = first + points.first_point[p + 1] - points.first_point[p]
        x, y, z = position[first, 0], position[first, 1], position[first, 2]
        size = 0.0
        for i in range(first, last):
            size = max(size, (position[i, 0] - x) ** 2 + (position[i, 1] - y) ** 2 + (position[i, 2] - z) ** 2)
        size = math.sqrt(size)
        gap, n_chosen = choose_rows(rows, x, y, z, size, chosen)
        if gap > size + _MARGIN_MM:
            distance[first:last] = gap - size
        else:
            for i in range(first, last):
                distance[i], normal[i, 0], normal[i, 1], normal[i, 2] = chosen_distance(
                    rows, chosen, n_chosen, position[i, 0], position[i, 1], position[i, 2]
                )
        first = last


@nb.njit(cache=True, nogil=True, error_model="numpy")
def _remember(points: ContactPoints, near: NearPoints, n_patches: int, stop_mm: float, seen: Sightings) -> None:
    """Keep how far the patches just measured are from the nearest thing to touch."""
    i = 0
    for q in range(n_patches):
        p, f, gap = near.patch[q], near.face[q], np.inf
        for _ in range(points.first_point[p], points.first_point[p + 1]):
            gap = min(gap, near.distance[i], near.position[i, 0] - stop_mm)
            i += 1
        seen.patch_gap[p] = seen.gap_in_face[p] = gap
        seen.face_gap[f] = min(seen.face_gap[f], gap)


@nb.njit(cache=True, nogil=True, error_model="numpy")
def _add_contact(
    surface: Surface,
    x: np.ndarray,
    n_patches: int,
    stop_mm: float,
    state: FrictionState,
    force: np.ndarray,
    blocks: np.ndarray,
) -> int:
    """Add the forces (nodes, 3) of the near points, and their tangents to `blocks` unless that is empty.

    Forces and tangents are summed per face before they go to the nodes. Returns how many points touch the obstacle.
    """
    points, places, near, law, touching = surface.points, surface.places, surface.near, surface.law, surface.touching
    k, has_tangent = points.faces.shape[1], len(blocks) > 0
    moved, point_force, tangent = np.zeros((k, 3)), np.zeros(3), np.zeros((3, 3))
    face_force, face_tangent, pairs = np.zeros((k, 3)), np.zeros((6, k * (k + 1) // 2)), np.zeros(k * (k + 1) // 2)
    own = (np.zeros((1, 3)), np.zeros(3), np.zeros(3), np.zeros(3))
    n_touching, i, current = 0, 0, -1
    for q in range(n_patches):
        f, p = near.face[q], near.patch[q]
        for c in range(points.first_point[p], points.first_point[p + 1]):
            is_touching, is_behind = near.distance[i] < 0.0, near.position[i, 0] < stop_mm
            if is_touching or is_behind:
                if f != current:
                    _scatter(points.faces, places, current, has_tangent, face_force, face_tangent, force, blocks)
                    current = f
                    for a in range(k):
                        for j in range(3):
                            moved[a, j] = x[points.faces[f, a], j] - state.nodes[points.faces[f, a], j]
                point_force[:] = 0.0
                tangent[:] = 0.0
                if is_touching:
                    _interpolate_point(points.shape, c, moved, own[0], 0)
                    _press(c, i, near, law, state, own, point_force, tangent, touching, n_touching)
                    n_touching += 1
                if is_behind:
                    pressure, slope = penalty(stop_mm - near.position[i, 0], law)
                    point_force[0] += pressure
                    tangent[0, 0] += slope
                _add_force(points, c, point_force, face_force)
                if has_tangent:
                    _add_tangent(points, c, tangent, pairs, face_tangent)
            i += 1
    _scatter(points.faces, places, current, has_tangent, face_force, face_tangent, force, blocks)
    return n_touching


@nb.njit(inline="always")
def penalty(depth: float, law: Law) -> tuple[float, float]:
    """Return the pressure in MPa and its slope in N/mm3 at a penetration in mm."""
    if depth < law.d0:
        slope = law.kn * depth / law.d0
        return 0.5 * slope * depth, slope
    return law.kn * (depth - 0.5 * law.d0), law.kn


@nb.njit(inline="always")
def friction_limit(coefficient: float, pressure: float, depth: float, law: Law) -> float:
    """Return the largest tangential stress, MPa, at a pressure and penetration; adhesion sets in over a short depth."""
    return coefficient * pressure + law.adhesion * min(depth / (ADHESION_RAMP * law.d0), 1.0)


@nb.njit(inline="always")
def _press(
    c: int,
    i: int,
    near: NearPoints,
    law: Law,
    state: FrictionState,
    own: tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray],
    point_force: np.ndarray,
    tangent: np.ndarray,
    touching: Touching,
    place: int,
) -> None:
    """Compute force and tangent per area of point c, the i-th near one, on the obstacle; its traction goes to `place`.

    `own`: motion (1, 3), and storage for the old traction, the normal and the new traction.
    """
    motion, old, normal, traction = own
    for j in range(3):
        old[j], normal[j] = state.traction[c, j], near.normal[i, j]
    p, slope = penalty(-near.distance[i], law)
    limit = friction_limit(state.coefficient[c], p, -near.distance[i], law)
    slip = return_mapping(old, motion[0], normal, limit, law.kt, traction, tangent)
    touching.point[place], touching.pressure[place], touching.slip[place] = c, p, slip
    touching.normal_z[place] = normal[2]
    for a in range(3):
        touching.traction[place, a] = traction[a]
        point_force[a] = p * normal[a] + traction[a]
        for b in range(3):
            tangent[a, b] += slope * normal[a] * normal[b]


@nb.njit(inline="always")
def _add_force(points: ContactPoints, c: int, point_force: np.ndarray, face_force: np.ndarray) -> None:
    for a in range(len(face_force)):
        factor = points.areas[c] * points.shape[c, a]
        for i in range(3):
            face_force[a, i] += factor * point_force[i]


@nb.njit(inline="always")
def _add_tangent(
    points: ContactPoints, c: int, tangent: np.ndarray, pairs: np.ndarray, face_tangent: np.ndarray
) -> None:
    """Add the six entries of a symmetric tangent (3, 3) times N_a N_b for the pairs a >= b."""
    n = 0
    for a in range(points.shape.shape[1]):
        factor = points.areas[c] * points.shape[c, a]
        for b in range(a + 1):
            pairs[n] = factor * points.shape[c, b]
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
    faces: np.ndarray,
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
    for a in range(faces.shape[1]):
        for i in range(3):
            force[faces[f, a], i] += face_force[a, i]
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
