"""Penalty contact of surface points against a rigid obstacle given by its signed distance.

Contact points are midpoints of a fine subdivision of the quadratic faces, each with its reference area. With
penetration d = -distance > 0 the pressure is p = kn d^2 / (2 d0) below d0 and kn (d - d0/2) above (continuous
slope), the nodal force w (p n + t) and the tangent w (p'(d) n n^T + friction); the curvature of the obstacle is
left out of the tangent, which stays positive semi-definite. The spacing along z must resolve the objects' edge
radius of 1 mm: with 1 mm spacing an edge hooks between two rows of points and the peak is 33 % too high
(notes/fem.md section 1).
"""

from dataclasses import dataclass
from typing import Protocol

import numba as nb
import numpy as np

from models.fem.assembly import ElasticBody, block_map
from models.fem.friction import return_mapping
from models.fem.shape import face_shape


@dataclass(frozen=True)
class ContactLaw:
    """Penalty stiffness in N/mm3 and smoothing depth d0, at REFERENCE_MODULUS_MPA.

    Both stiffnesses are in proportion to E for any other modulus (see models.fem.elasticity). Rims and corners that
    touch in a point decide: at 2 N/mm3 they sink in by a millimetre and hook (diabolo: peak 46 N), from 4 on the
    peak stays within 2 % (26 N). Stiffer needs finer points and more steps.
    """

    normal_n_per_mm3: float = 4.0
    tangential_n_per_mm3: float = 4.0
    smoothing_mm: float = 0.05


MAX_SHAPE_SUM = 3.0  # largest sum of |N_a| on an eight-node face, at its centre


class Obstacle(Protocol):
    """A rigid body (or the space outside one) that a finger can touch."""

    def distance(self, points: np.ndarray) -> np.ndarray:
        """Signed distance in mm (n) of points (n, 3), negative inside; must not change faster than the points move."""
        ...

    def normal(self, points: np.ndarray) -> np.ndarray:
        """Unit outward normals (n, 3) at points (n, 3) inside, near the surface."""
        ...


@dataclass(frozen=True)
class PointSpacing:
    """Largest distance of contact points along the finger (z) and across it (y), mm.

    A quarter of the objects' edge radius both ways: across matters for upright edges and rims (3 mm gives a 15 %
    higher peak on the cube turned by 45 deg). Points in air cost next to nothing.
    """

    along_mm: float = 0.25
    across_mm: float = 0.25


@dataclass
class ContactState:
    """What friction remembers of the last converged step, per contact point (n).

    `position` (n, 3) mm; `traction` (n, 3) MPa; `pressure` (n) MPa; `slip` (n) accumulated, mm.
    """

    position: np.ndarray
    traction: np.ndarray
    pressure: np.ndarray
    slip: np.ndarray


@dataclass
class ContactResponse:
    """Outcome of one evaluation: nodal force (nodes, 3) in N and, per point, what the next state would hold."""

    force: np.ndarray
    position: np.ndarray
    traction: np.ndarray
    pressure: np.ndarray
    slip_step: np.ndarray
    distance: np.ndarray


class ContactSurface:
    """Contact points of a body: interpolation, areas, and the response to an obstacle."""

    def __init__(self, body: ElasticBody, nodes: np.ndarray, law: ContactLaw, spacing: PointSpacing) -> None:
        """`nodes` (n, 3): undeformed mesh, in the frame of the calculation."""
        self.law = law
        faces = np.ascontiguousarray(body.mesh.contact_faces)
        self._faces = faces
        self._places = block_map(faces, body.row_of_node, body.pattern)
        parts = [_subdivide(nodes[face], spacing) for face in faces]
        self._face_of_point = np.repeat(np.arange(len(faces), dtype=np.int32), [len(w) for _, w in parts])
        self._shape = np.ascontiguousarray(np.vstack([shape for shape, _ in parts]))
        self.areas = np.concatenate([weights for _, weights in parts])
        self._known_obstacle: Obstacle | None = None
        self._face_nodes = np.zeros((len(faces), faces.shape[1], 3))
        self._face_bound = np.full(len(faces), -np.inf)
        self._known_distance = np.full(len(self.areas), -np.inf)
        self._known_position = np.zeros((len(self.areas), 3))

    def forget(self) -> None:
        """Drop what is remembered of distances: the next evaluation starts as if it were the first."""
        self._known_obstacle = None

    def start(self, x: np.ndarray) -> ContactState:
        """State before any contact, at deformed nodes x (n, 3)."""
        n = len(self.areas)
        return ContactState(self.positions(x), np.zeros((n, 3)), np.zeros(n), np.zeros(n))

    def positions(self, x: np.ndarray) -> np.ndarray:
        """Contact points (n, 3) at deformed nodes x."""
        positions = np.zeros((len(self.areas), 3))
        every_face = np.ones(len(self._faces), dtype=bool)
        _interpolate(x, self._faces, self._face_of_point, self._shape, every_face, positions)
        return positions

    def respond(
        self,
        x: np.ndarray,
        state: ContactState,
        obstacle: Obstacle,
        friction: np.ndarray,
        has_mirror: bool,
        blocks: np.ndarray | None,
    ) -> ContactResponse:
        """Contact force at deformed nodes x; adds the tangent to `blocks` (z, 3, 3) unless None.

        `friction` (n): coefficient per point. `has_mirror`: the frictionless plane x >= 0 stands for the other
        finger.
        """
        positions, distance, normal = self._gaps(x, obstacle, has_mirror)
        n = len(distance)
        response = ContactResponse(np.zeros_like(x), positions, np.zeros((n, 3)), np.zeros(n), np.zeros(n), distance)
        _add_contact(
            self._faces,
            self._face_of_point,
            self._shape,
            self._places,
            self.areas,
            positions,
            distance,
            normal,
            friction,
            state.position,
            state.traction,
            self.law.normal_n_per_mm3,
            self.law.tangential_n_per_mm3,
            self.law.smoothing_mm,
            has_mirror,
            response.force,
            response.traction,
            response.pressure,
            response.slip_step,
            blocks is not None,
            blocks if blocks is not None else np.zeros((0, 3, 3)),
        )
        return response

    def _gaps(self, x: np.ndarray, obstacle: Obstacle, has_mirror: bool) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Positions (n, 3), distances (n), and normals (n, 3) where the distance is negative.

        A distance changes at most as far as its point moves, so faces and then points that cannot have arrived are
        left out: their distance reads as infinite, and the position of a left-out face's points as far away.
        """
        if obstacle is not self._known_obstacle:
            self._known_obstacle = obstacle
            self._known_distance[:] = -np.inf
            self._face_bound[:] = -np.inf
        faces = _near_faces(x, self._faces, self._face_nodes, self._face_bound, has_mirror)
        positions, distance = np.full((len(self.areas), 3), np.inf), np.full(len(self.areas), np.inf)
        _interpolate(x, self._faces, self._face_of_point, self._shape, faces, positions)
        bound = _lower_bounds(positions, self._known_position, self._known_distance, self._face_of_point, faces)
        near = np.flatnonzero(bound <= 0.0)
        if near.size:
            self._known_distance[near] = bound[near] = distance[near] = obstacle.distance(positions[near])
            self._known_position[near] = positions[near]
        _remember_faces(x, self._faces, self._face_of_point, faces, bound, self._face_nodes, self._face_bound)
        normal = np.zeros_like(positions)
        inside = near[distance[near] < 0.0]
        if inside.size:
            normal[inside] = obstacle.normal(positions[inside])
        return positions, distance, normal


def _subdivide(corners: np.ndarray, spacing: PointSpacing) -> tuple[np.ndarray, np.ndarray]:
    """Shape values (p, k) and areas (p) in mm2 of the points of one face with nodes (k, 3)."""
    if len(corners) == 8:
        along = np.linalg.norm(corners[1] - corners[0])
        across = np.linalg.norm(corners[3] - corners[0])
        n_r, n_s = max(int(np.ceil(along / spacing.along_mm)), 1), max(int(np.ceil(across / spacing.across_mm)), 1)
        r, s = (2.0 * (np.arange(n) + 0.5) / n - 1.0 for n in (n_r, n_s))
        points = np.column_stack([np.repeat(r, n_s), np.tile(s, n_r)])
        cell = 4.0 / (n_r * n_s)
    else:
        longest = max(np.linalg.norm(corners[i] - corners[j]) for i, j in ((0, 1), (1, 2), (2, 0)))
        n = max(int(np.ceil(longest / spacing.along_mm)), 1)
        points = _triangle_cells(n)
        cell = 0.5 / len(points)
    values, gradients = face_shape(len(corners), points)
    tangent = np.einsum("pkc,ki->pci", gradients, corners)
    area = np.linalg.norm(np.cross(tangent[:, 0], tangent[:, 1]), axis=1) * cell
    return values, area


def _triangle_cells(n: int) -> np.ndarray:
    """Centroids (n^2, 2) of the uniform subdivision of the unit triangle."""
    upright = [((i + 1 / 3) / n, (j + 1 / 3) / n) for i in range(n) for j in range(n - i)]
    inverted = [((i + 2 / 3) / n, (j + 2 / 3) / n) for i in range(n) for j in range(n - i - 1)]
    return np.array(upright + inverted)


@nb.njit(cache=True, nogil=True, error_model="numpy")
def _interpolate(
    x: np.ndarray,
    faces: np.ndarray,
    face_of_point: np.ndarray,
    shape: np.ndarray,
    wanted: np.ndarray,
    positions: np.ndarray,
) -> None:
    """Positions of the points on the faces that are wanted (f)."""
    for c in range(len(face_of_point)):
        f = face_of_point[c]
        if not wanted[f]:
            continue
        p0 = p1 = p2 = 0.0
        for a in range(faces.shape[1]):
            node, weight = faces[f, a], shape[c, a]
            p0 += weight * x[node, 0]
            p1 += weight * x[node, 1]
            p2 += weight * x[node, 2]
        positions[c, 0], positions[c, 1], positions[c, 2] = p0, p1, p2


@nb.njit(cache=True, nogil=True, error_model="numpy")
def _near_faces(
    x: np.ndarray, faces: np.ndarray, face_nodes: np.ndarray, face_bound: np.ndarray, has_mirror: bool
) -> np.ndarray:
    """Faces (f) with a point that may touch the obstacle or the mirror plane."""
    near = np.zeros(len(faces), dtype=np.bool_)
    for f in range(len(faces)):
        moved, lowest, highest = 0.0, np.inf, -np.inf
        for a in range(faces.shape[1]):
            square = 0.0
            for i in range(3):
                square += (x[faces[f, a], i] - face_nodes[f, a, i]) ** 2
            moved = max(moved, square)
            lowest, highest = min(lowest, x[faces[f, a], 0]), max(highest, x[faces[f, a], 0])
        # No point moves further than sum |N_a| <= 3 times its nodes, nor reaches beyond their range by more than it.
        near[f] = face_bound[f] <= MAX_SHAPE_SUM * np.sqrt(moved)
        near[f] |= has_mirror and lowest < highest - lowest
    return near


@nb.njit(cache=True, nogil=True, error_model="numpy")
def _lower_bounds(
    positions: np.ndarray,
    known_position: np.ndarray,
    known_distance: np.ndarray,
    face_of_point: np.ndarray,
    wanted: np.ndarray,
) -> np.ndarray:
    """What the distance of each point is at least; infinity on faces that are not wanted."""
    bound = np.full(len(positions), np.inf)
    for c in range(len(positions)):
        if not wanted[face_of_point[c]]:
            continue
        moved = 0.0
        for i in range(3):
            moved += (positions[c, i] - known_position[c, i]) ** 2
        bound[c] = known_distance[c] - np.sqrt(moved)
    return bound


@nb.njit(cache=True, nogil=True, error_model="numpy")
def _remember_faces(
    x: np.ndarray,
    faces: np.ndarray,
    face_of_point: np.ndarray,
    wanted: np.ndarray,
    bound: np.ndarray,
    face_nodes: np.ndarray,
    face_bound: np.ndarray,
) -> None:
    """Keep the least distance bound of the wanted faces, and where their nodes were."""
    for f in range(len(faces)):
        if wanted[f]:
            face_bound[f] = np.inf
            for a in range(faces.shape[1]):
                face_nodes[f, a] = x[faces[f, a]]
    for c in range(len(face_of_point)):
        f = face_of_point[c]
        if wanted[f]:
            face_bound[f] = min(face_bound[f], bound[c])


@nb.njit(inline="always")
def _pressure(depth: float, kn: float, d0: float) -> tuple[float, float]:
    """Pressure in MPa and its slope in N/mm3 at a penetration in mm."""
    if depth < d0:
        slope = kn * depth / d0
        return 0.5 * slope * depth, slope
    return kn * (depth - 0.5 * d0), kn


@nb.njit(inline="always")
def _scatter_force(face: np.ndarray, shape: np.ndarray, point_force: np.ndarray, force: np.ndarray) -> None:
    for a in range(len(face)):
        for i in range(3):
            force[face[a], i] += shape[a] * point_force[i]


@nb.njit(inline="always")
def _scatter_tangent(places: np.ndarray, shape: np.ndarray, tangent: np.ndarray, blocks: np.ndarray) -> None:
    """Add a symmetric point tangent (3, 3) to the blocks between the nodes of its face."""
    for a in range(len(shape)):
        for b in range(a + 1):
            place = places[a, b]
            if place == -1:
                continue
            if place < 0:
                place = -2 - place
            factor = shape[a] * shape[b]
            for i in range(3):
                for j in range(3):
                    blocks[place, i, j] += factor * tangent[i, j]


@nb.njit(cache=True, nogil=True, error_model="numpy")
def _add_contact(
    faces: np.ndarray,
    face_of_point: np.ndarray,
    shape: np.ndarray,
    places: np.ndarray,
    areas: np.ndarray,
    positions: np.ndarray,
    distance: np.ndarray,
    normals: np.ndarray,
    friction: np.ndarray,
    old_position: np.ndarray,
    old_traction: np.ndarray,
    kn: float,
    kt: float,
    d0: float,
    has_mirror: bool,
    force: np.ndarray,
    traction: np.ndarray,
    pressure: np.ndarray,
    slip_step: np.ndarray,
    has_tangent: bool,
    blocks: np.ndarray,
) -> None:
    point_force, tangent = np.zeros(3), np.zeros((3, 3))
    for c in range(len(areas)):
        f, w = face_of_point[c], areas[c]
        if has_mirror and positions[c, 0] < 0.0:
            p, slope = _pressure(-positions[c, 0], kn, d0)
            point_force[:] = 0.0
            point_force[0] = w * p
            _scatter_force(faces[f], shape[c], point_force, force)
            if has_tangent:
                tangent[:] = 0.0
                tangent[0, 0] = w * slope
                _scatter_tangent(places[f], shape[c], tangent, blocks)
        if not distance[c] < 0.0:
            continue
        p, slope = _pressure(-distance[c], kn, d0)
        normal = normals[c]
        slip_step[c] = return_mapping(
            old_traction[c],
            positions[c] - old_position[c],
            normal,
            friction[c] * p,
            kt,
            traction[c],
            tangent,
        )
        pressure[c] = p
        for i in range(3):
            point_force[i] = w * (p * normal[i] + traction[c, i])
        _scatter_force(faces[f], shape[c], point_force, force)
        if has_tangent:
            for i in range(3):
                for j in range(3):
                    tangent[i, j] = w * (tangent[i, j] + slope * normal[i] * normal[j])
            _scatter_tangent(places[f], shape[c], tangent, blocks)
