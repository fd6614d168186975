"""Compiled loops of self-contact: the faces of a cavity as lines in slices across the width, and what they press on.

A strip is one face in one slice: straight segments between vertices on the face. A segment presses with its middle on
the nearest segment, of another strip of the same cavity and slice, that faces it.
"""

import math
from typing import NamedTuple

import numba as nb
import numpy as np

from fast.models.simulation.contact.kernel import Law, penalty

REACH_MM = 0.5  # segments further apart are not looked at: what is deeper is a failure, and faces at a corner are near
FACING = -0.5  # cosine between the normals of two segments, below which they can touch: 60 deg about opposite
SQUARE_ON = 0.9  # cosine: a middle further off the normal of its nearest segment is beside that, not in it
_FAR_MM = 3.0  # distance of a middle from a vertex, above which its segment, about 1 mm long, is out of reach


class Strips(NamedTuple):
    """Strips (s) of faces with 8 nodes; strips of one slice of a cavity are in a row, and so are their vertices (v).

    `faces` (f, 8) nodes; `face` (s) of each strip; `first_vertex` (s + 1); `first_strip` (g + 1) of every slice of a
    cavity; `strip` (v) of each vertex; `shape` (v, 8) values at the vertices; `areas` (v): undeformed, mm2, of the
    segment that starts at a vertex; 0 for the last vertex of a strip, where none starts.
    """

    faces: np.ndarray
    face: np.ndarray
    first_vertex: np.ndarray
    first_strip: np.ndarray
    strip: np.ndarray
    shape: np.ndarray
    areas: np.ndarray


class Lines(NamedTuple):
    """Buffers: the strips in one deformed state; of vertices (v), the segments that start there, and strips (s)."""

    vertex: np.ndarray
    """(v, 2) positions, x and z, mm."""
    force: np.ndarray
    """(v, 2) on the vertices, x and z."""
    normal: np.ndarray
    """(v, 2) of the segments, unit length, out of the material."""
    square: np.ndarray
    """(v) squared distance of a segment's middle from the nearest one that faces it, mm2."""
    nearest: np.ndarray
    """(v) number of that segment."""
    share: np.ndarray
    """(v) where on it, 0 to 1."""
    box: np.ndarray
    """(s, 4) least and greatest x, least and greatest z, mm."""
    outward: np.ndarray
    """(s, 2) directions of the strips' normals."""


class Cavities(NamedTuple):
    """The faces of all cavities of a body, the law between them, and buffers.

    `pair` (f, f): number of the pair of two faces, the lower one first, -1 for none; `places` (p, 16, 16): of the
    blocks between the nodes of a pair, negative for those that others are the transpose of.
    """

    strips: Strips
    law: Law
    lines: Lines
    pair: np.ndarray
    places: np.ndarray


@nb.njit(cache=True, nogil=True, error_model="numpy")
def measure(strips: Strips, x: np.ndarray, lines: Lines) -> float:
    """Place all strips at deformed nodes x and find the nearest segments; returns the greatest depth in mm."""
    _place(strips, x, lines)
    lines.square[:] = REACH_MM**2
    for g in range(len(strips.first_strip) - 1):
        for s in range(strips.first_strip[g], strips.first_strip[g + 1]):
            for t in range(s + 1, strips.first_strip[g + 1]):
                if _are_near(lines.box, lines.outward, s, t, REACH_MM) and not _are_one_corner(strips, s, t):
                    _pair(strips.first_vertex, lines, s, t)
    deepest = 0.0
    for v in range(len(lines.square)):
        if lines.square[v] < REACH_MM**2:
            deepest = max(deepest, _depth(lines, v)[0])
    return deepest


@nb.njit(cache=True, nogil=True, error_model="numpy")
def _place(strips: Strips, x: np.ndarray, lines: Lines) -> None:
    """Place the vertices, normals and boxes of all strips at deformed nodes x."""
    vertex, normal, box = lines.vertex, lines.normal, lines.box
    for s in range(len(strips.face)):
        f, first, last = strips.face[s], strips.first_vertex[s], strips.first_vertex[s + 1]
        box[s, 0] = box[s, 2] = np.inf
        box[s, 1] = box[s, 3] = -np.inf
        for v in range(first, last):
            u = w = 0.0
            for a in range(8):
                u += strips.shape[v, a] * x[strips.faces[f, a], 0]
                w += strips.shape[v, a] * x[strips.faces[f, a], 2]
            vertex[v, 0], vertex[v, 1] = u, w
            box[s, 0], box[s, 1] = min(box[s, 0], u), max(box[s, 1], u)
            box[s, 2], box[s, 3] = min(box[s, 2], w), max(box[s, 3], w)
        for v in range(first, last - 1):
            du, dw = vertex[v + 1, 0] - vertex[v, 0], vertex[v + 1, 1] - vertex[v, 1]
            size = math.sqrt(du * du + dw * dw)
            normal[v, 0], normal[v, 1] = -dw / size, du / size
        lines.outward[s, 0] = vertex[first, 1] - vertex[last - 1, 1]
        lines.outward[s, 1] = vertex[last - 1, 0] - vertex[first, 0]


@nb.njit(inline="always")
def _are_near(box: np.ndarray, outward: np.ndarray, s: int, t: int, reach_mm: float) -> bool:
    """Return whether two strips turn to each other, roughly, and their boxes are within reach."""
    return (
        outward[s, 0] * outward[t, 0] + outward[s, 1] * outward[t, 1] < 0.0
        and box[s, 0] - box[t, 1] < reach_mm
        and box[t, 0] - box[s, 1] < reach_mm
        and box[s, 2] - box[t, 3] < reach_mm
        and box[t, 2] - box[s, 3] < reach_mm
    )


@nb.njit(inline="always")
def _are_one_corner(strips: Strips, s: int, t: int) -> bool:
    """Return whether it is a fillet's short face and the one beside it: no crossing while no element is inverted."""
    n_s, n_t = strips.first_vertex[s + 1] - strips.first_vertex[s], strips.first_vertex[t + 1] - strips.first_vertex[t]
    if n_s > 2 and n_t > 2:
        return False
    f, g = strips.face[s], strips.face[t]
    return strips.faces[f, 5] == strips.faces[g, 7] or strips.faces[f, 7] == strips.faces[g, 5]


@nb.njit(cache=True, nogil=True, error_model="numpy")
def _pair(first_vertex: np.ndarray, lines: Lines, s: int, t: int) -> None:
    """Keep the nearest segments between two strips, both ways."""
    vertex, normal, square, nearest, share = lines.vertex, lines.normal, lines.square, lines.nearest, lines.share
    for v in range(first_vertex[s], first_vertex[s + 1] - 1):
        for w in range(first_vertex[t], first_vertex[t + 1] - 1):
            if abs(vertex[v, 0] - vertex[w, 0]) > _FAR_MM or abs(vertex[v, 1] - vertex[w, 1]) > _FAR_MM:
                continue
            if normal[v, 0] * normal[w, 0] + normal[v, 1] * normal[w, 1] < FACING:
                _keep_nearer(vertex, square, nearest, share, v, w)
                _keep_nearer(vertex, square, nearest, share, w, v)


@nb.njit(inline="always")
def _keep_nearer(
    vertex: np.ndarray, square: np.ndarray, nearest: np.ndarray, share: np.ndarray, v: int, w: int
) -> None:
    """Let segment w be the nearest of segment v if it is nearer to its middle than the one before."""
    u = 0.5 * (vertex[v, 0] + vertex[v + 1, 0]) - vertex[w, 0]
    z = 0.5 * (vertex[v, 1] + vertex[v + 1, 1]) - vertex[w, 1]
    du, dz = vertex[w + 1, 0] - vertex[w, 0], vertex[w + 1, 1] - vertex[w, 1]
    part = min(max((u * du + z * dz) / (du * du + dz * dz), 0.0), 1.0)
    u, z = u - part * du, z - part * dz
    if u * u + z * z < square[v]:
        square[v], nearest[v], share[v] = u * u + z * z, w, part


@nb.njit(inline="always")
def _depth(lines: Lines, v: int) -> tuple[float, float, float]:
    """Return how deep the middle of segment v is in its nearest segment, mm (0 outside), and the way out (x, z)."""
    w, part, vertex, normal = lines.nearest[v], lines.share[v], lines.vertex, lines.normal
    u = vertex[w, 0] + part * (vertex[w + 1, 0] - vertex[w, 0]) - 0.5 * (vertex[v, 0] + vertex[v + 1, 0])
    z = vertex[w, 1] + part * (vertex[w + 1, 1] - vertex[w, 1]) - 0.5 * (vertex[v, 1] + vertex[v + 1, 1])
    size = math.sqrt(u * u + z * z)
    if not u * normal[w, 0] + z * normal[w, 1] > SQUARE_ON * size:
        return 0.0, normal[w, 0], normal[w, 1]
    return size, u / size, z / size


@nb.njit(cache=True, nogil=True, error_model="numpy")
def add_forces(cavities: Cavities, x: np.ndarray, force: np.ndarray) -> None:
    """Add to `force` (nodes, 3) what the segments do to each other at deformed nodes x.

    Both sides press with half of their area, so the force is that of one penalty between them.
    """
    strips, law, lines = cavities.strips, cavities.law, cavities.lines
    if not measure(strips, x, lines) > 0.0:
        return
    lines.force[:] = 0.0
    for v in range(len(strips.areas)):
        if lines.square[v] >= REACH_MM**2:
            continue
        d, nx, nz = _depth(lines, v)
        if d > 0.0:
            pressure, _ = penalty(d, law)
            w, part, size = lines.nearest[v], lines.share[v], 0.5 * strips.areas[v] * pressure
            for i, component in enumerate((size * nx, size * nz)):
                lines.force[v, i] += 0.5 * component
                lines.force[v + 1, i] += 0.5 * component
                lines.force[w, i] -= (1.0 - part) * component
                lines.force[w + 1, i] -= part * component
    for v in range(len(strips.areas)):
        if lines.force[v, 0] != 0.0 or lines.force[v, 1] != 0.0:
            f = strips.face[strips.strip[v]]
            for a in range(8):
                force[strips.faces[f, a], 0] += strips.shape[v, a] * lines.force[v, 0]
                force[strips.faces[f, a], 2] += strips.shape[v, a] * lines.force[v, 1]


@nb.njit(cache=True, nogil=True, error_model="numpy")
def add_tangent(cavities: Cavities, x: np.ndarray, blocks: np.ndarray) -> None:
    """Add minus the derivative of the forces between pairs at x to `blocks` (z, 3, 3); the lines do not turn."""
    strips, law, lines, pair, places = cavities
    if not measure(strips, x, lines) > 0.0:
        return
    values = np.zeros(16)
    for v in range(len(strips.areas)):
        if lines.square[v] >= REACH_MM**2:
            continue
        d, nx, nz = _depth(lines, v)
        w, part = lines.nearest[v], lines.share[v]
        own, other = strips.face[strips.strip[v]], strips.face[strips.strip[w]]
        p = pair[min(own, other), max(own, other)]
        if not d > 0.0 or p < 0:
            continue
        first, second = (0, 8) if own < other else (8, 0)
        for a in range(8):
            values[first + a] = 0.5 * (strips.shape[v, a] + strips.shape[v + 1, a])
            values[second + a] = -(1.0 - part) * strips.shape[w, a] - part * strips.shape[w + 1, a]
        size = 0.5 * strips.areas[v] * penalty(d, law)[1]
        for a in range(16):
            for b in range(16):
                # A node of both faces has two numbers here, and its own block gets all four products.
                place, factor = places[p, a, b], size * values[a] * values[b]
                if place >= 0:
                    blocks[place, 0, 0] += factor * nx * nx
                    blocks[place, 0, 2] += factor * nx * nz
                    blocks[place, 2, 0] += factor * nz * nx
                    blocks[place, 2, 2] += factor * nz * nz


@nb.njit(cache=True, nogil=True, error_model="numpy")
def mark_pairs(strips: Strips, lines: Lines, reach_mm: float, pair: np.ndarray) -> None:
    """Set `pair` (f, f), the lower face first, to 0 for faces that turn to each other with boxes within reach."""
    for g in range(len(strips.first_strip) - 1):
        for s in range(strips.first_strip[g], strips.first_strip[g + 1]):
            for t in range(s + 1, strips.first_strip[g + 1]):
                if _are_near(lines.box, lines.outward, s, t, reach_mm):
                    a, b = strips.face[s], strips.face[t]
                    pair[min(a, b), max(a, b)] = 0


@nb.njit(cache=True, nogil=True, error_model="numpy")
def presses_uncoupled(strips: Strips, lines: Lines, pair: np.ndarray) -> bool:
    """Return whether faces, as last measured, are in each other that are no pair."""
    for v in range(len(strips.areas)):
        if lines.square[v] < REACH_MM**2 and _depth(lines, v)[0] > 0.0:
            a, b = strips.face[strips.strip[v]], strips.face[strips.strip[lines.nearest[v]]]
            if pair[min(a, b), max(a, b)] < 0:
                return True
    return False
