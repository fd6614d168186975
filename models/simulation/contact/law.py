"""Penalty contact of surface points against a rigid obstacle given by its signed distance.

Contact points are midpoints of a fine subdivision of the quadratic faces, each with its reference area. With
penetration d = -distance > 0 the pressure is p = kn d^2 / (2 d0) below d0 and kn (d - d0/2) above (continuous
slope), the nodal force w (p n + t) and the tangent w (p'(d) n n^T + friction); the curvature of the obstacle is
left out of the tangent, which stays positive semi-definite. The spacing along z must resolve the objects' edge
radius of 1 mm: with 1 mm spacing an edge hooks between two rows of points and the peak is 33 % too high.
"""

import copy
from dataclasses import dataclass
from typing import Protocol, Self, runtime_checkable

import numpy as np

from fast.models.objects.distance import distance, distance_and_normal
from fast.models.objects.primitives import mirrored
from fast.models.objects.rigid import RigidObject
from fast.models.records import Placement
from fast.models.simulation.body.assembly import ElasticBody, block_map
from fast.models.simulation.contact import kernel as contact_kernel
from fast.models.simulation.contact.kernel import FrictionState, Law, NearPoints, Sightings, Touching
from fast.models.simulation.contact.points import ContactPoints, PointSpacing, contact_points
from fast.models.simulation.placement import place

__all__ = [
    "NO_STOP",
    "ContactLaw",
    "ContactResponse",
    "ContactState",
    "ContactSurface",
    "ObjectObstacle",
    "Obstacle",
    "PointSpacing",
    "Solid",
]

NO_STOP = -np.inf
SURE_MM = 1e-9  # far above rounding
_NO_BLOCKS = np.zeros((0, 3, 3))


@dataclass(frozen=True)
class ContactLaw:
    """Penalty stiffness in N/mm3, smoothing depth d0 and adhesion in MPa, at REFERENCE_MODULUS_MPA.

    The friction limit is mu p + adhesion. Stiffnesses and adhesion are in proportion to E for any other modulus (see
    models.simulation.body.elasticity). Rims and corners that touch in a point decide: at 2 N/mm3 they sink in by a
    millimetre and hook (diabolo: peak 46 N). On faces and rims twice the stiffness moves the peak by about 3 % at most.
    Bare edges and corners stay mesh-bound: the stiffness stands for the indentation that the elements do not resolve
    (Hertz on a radius of 1 mm: 6 to 16 N/mm3), and on one layer across the half width more of it makes a corner hook
    (turned diamond: 33 N at 4, 40 N at 8; 28 N on a fine mesh).
    """

    normal_n_per_mm3: float = 4.0
    tangential_n_per_mm3: float = 4.0
    smoothing_mm: float = 0.05
    adhesion_mpa: float = 0.0

    @property
    def compiled(self) -> Law:
        """The law as compiled code takes it."""
        return Law(self.normal_n_per_mm3, self.tangential_n_per_mm3, self.smoothing_mm, self.adhesion_mpa)


class Obstacle(Protocol):
    """A rigid body (or the space outside one) that a finger can touch."""

    def distance(self, points: np.ndarray) -> np.ndarray:
        """Signed distance in mm (n) of points (n, 3), negative inside; must not change faster than the points move."""
        ...

    def normal(self, points: np.ndarray) -> np.ndarray:
        """Unit outward normals (n, 3) at points (n, 3) inside, near the surface."""
        ...


@runtime_checkable
class Solid(Protocol):
    """An obstacle made of primitives, (n_rows, N_COLUMNS) of `models.objects.primitives`, measured in compiled code."""

    primitives: np.ndarray


class ObjectObstacle:
    """The test object at its placement, in the frame of one finger (which stands on the +x side); a `Solid`.

    For the finger on the other side the object is mirrored in x: its distance at (x, y, z) is the object's at
    (-x, y, z).
    """

    def __init__(self, obj: RigidObject, placement: Placement, *, is_mirrored: bool) -> None:
        rows = place(obj, placement)
        self.primitives = mirrored(rows) if is_mirrored else rows

    def distance(self, points: np.ndarray) -> np.ndarray:
        """See `Obstacle`."""
        return distance(self.primitives, points)

    def normal(self, points: np.ndarray) -> np.ndarray:
        """See `Obstacle`."""
        return distance_and_normal(self.primitives, points)[1]


@dataclass
class ContactState:
    """What friction remembers of the last converged step, and what the contact law stands for in it.

    `nodes` (nodes, 3) mm, deformed; per contact point (n): `traction` (n, 3) MPa, `pressure` (n) MPa, `slip` (n)
    accumulated, mm. `unresolved_n_mm`: sum over the points of A p^2 / kn |n_z|, with area A and normal n: twice the
    energy of the springs that stand for the indentation that the mesh does not resolve, as far as they act along the
    lift.
    """

    nodes: np.ndarray
    traction: np.ndarray
    pressure: np.ndarray
    slip: np.ndarray
    unresolved_n_mm: float = 0.0


@dataclass(frozen=True)
class ContactResponse:
    """Outcome of one evaluation.

    Nodal force (nodes, 3) in N; of the points that touch the obstacle (m) their numbers, tractions (m, 3) and
    pressures (m) in MPa, slips of the step (m) in mm, and vertical parts of the outward normals (m). The arrays of
    points are views of the surface's buffers: its next evaluation overwrites them.
    """

    force: np.ndarray
    points: np.ndarray
    traction: np.ndarray
    pressure: np.ndarray
    slip_step: np.ndarray
    normal_z: np.ndarray


class ContactSurface:
    """Contact points of a body: interpolation, areas, and the response to an obstacle."""

    def __init__(self, body: ElasticBody, nodes: np.ndarray, law: ContactLaw, spacing: PointSpacing) -> None:
        """`nodes` (n, 3): undeformed mesh, in the frame of the calculation."""
        self.law = law
        self._points = contact_points(body.mesh.contact_faces, nodes, spacing)
        self._places = block_map(self._points.faces, body.row_of_node, body.pattern)
        self._seen = _sightings(self._points)
        self._seen_of: tuple[Obstacle | None, float] = (None, NO_STOP)
        self._primitives: np.ndarray | None = None
        n, n_patches = len(self.areas), len(self._points.reach)
        patch, face = np.zeros(n_patches, dtype=np.int32), np.zeros(n_patches, dtype=np.int32)
        self._near = NearPoints(patch, face, np.zeros((n, 3)), np.zeros(n), np.zeros((n, 3)))
        self._touching = Touching(np.zeros(n, dtype=np.int32), np.zeros((n, 3)), np.zeros(n), np.zeros(n), np.zeros(n))

    def on(self, body: ElasticBody) -> Self:
        """The same surface on a body that differs in the pattern of its tangent only; both share their buffers."""
        other = copy.copy(self)
        places = block_map(self._points.faces, body.row_of_node, body.pattern)
        other._places = places  # noqa: SLF001 - a copy of this object
        return other

    def moved(self, before: np.ndarray, after: np.ndarray, law: ContactLaw) -> Self:
        """The same points with a law of their own, and areas as of undeformed nodes (n, 3) `after` instead of `before`.

        Both share their buffers: what is remembered of distances holds for any nodes.
        """
        other = copy.copy(self)
        ratio = _corner_areas(self._points.faces, after) / _corner_areas(self._points.faces, before)
        per_face = np.diff(self._points.first_point[self._points.first_patch])
        other.law = law
        other._points = self._points._replace(areas=self.areas * np.repeat(ratio, per_face))  # noqa: SLF001 - a copy
        return other

    @property
    def areas(self) -> np.ndarray:
        """Undeformed area of every point (n) in mm2."""
        return self._points.areas

    def forget(self) -> None:
        """Drop what is remembered of distances: the next evaluation starts as if it were the first."""
        self._seen_of = (None, NO_STOP)

    def start(self, x: np.ndarray) -> ContactState:
        """State before any contact, at deformed nodes x (n, 3)."""
        n = len(self.areas)
        return ContactState(x, np.zeros((n, 3)), np.zeros(n), np.zeros(n))

    def advance(self, state: ContactState, x: np.ndarray, response: ContactResponse) -> ContactState:
        """State after a converged step from `state` to nodes x (n, 3) with this response."""
        new = self.start(x)
        new.traction[response.points], new.pressure[response.points] = response.traction, response.pressure
        new.slip[:] = state.slip
        new.slip[response.points] += response.slip_step
        energies = self.areas[response.points] * response.pressure**2 / self.law.normal_n_per_mm3
        new.unresolved_n_mm = float(energies @ np.abs(response.normal_z))
        return new

    def positions(self, x: np.ndarray) -> np.ndarray:
        """Contact points (n, 3) at deformed nodes x."""
        positions = np.zeros((len(self.areas), 3))
        contact_kernel.interpolate(self._points, x, positions)
        return positions

    def gap_mm(self, x: np.ndarray, obstacle: Obstacle) -> float:
        """Least distance of any contact point at deformed nodes x from an obstacle, negative inside.

        A distance changes at most as far as its point moves: only patches are measured whose middle point is less than
        their size further away than the nearest middle point.
        """
        points, first = self.positions(x), self._points.first_point
        count = np.diff(first)
        distance = obstacle.distance(points[first[:-1]])
        from_middle = np.linalg.norm(points - np.repeat(points[first[:-1]], count, axis=0), axis=1)
        may_be_nearest = distance - np.maximum.reduceat(from_middle, first[:-1]) < distance.min() + SURE_MM
        return float(obstacle.distance(points[np.repeat(may_be_nearest, count)]).min())

    def positions_of(self, points: np.ndarray, x: np.ndarray) -> np.ndarray:
        """A few contact points (m, 3), given by their numbers (m), at deformed nodes x."""
        first_of_face = self._points.first_point[self._points.first_patch[:-1]]
        face = np.searchsorted(first_of_face, points, side="right") - 1
        return np.einsum("mk,mki->mi", self._points.shape[points], x[self._points.faces[face]])

    def respond(
        self,
        x: np.ndarray,
        state: ContactState,
        obstacle: Obstacle,
        friction: np.ndarray,
        stop_mm: float,
        blocks: np.ndarray | None,
    ) -> ContactResponse:
        """Contact force at deformed nodes x; adds the tangent to `blocks` (z, 3, 3) unless None.

        `friction` (n): coefficient per point. `stop_mm`: the frictionless plane x >= stop stands for the other
        finger (`NO_STOP`: there is none).
        """
        n_patches = self._measure(x, obstacle, stop_mm)
        force = np.zeros(x.shape)
        m = contact_kernel.add_contact(
            self._points,
            self._places,
            x,
            self._near,
            n_patches,
            stop_mm,
            self.law.compiled,
            FrictionState(state.nodes, state.traction, friction),
            force,
            _NO_BLOCKS if blocks is None else blocks,
            self._touching,
        )
        return ContactResponse(force, *(values[:m] for values in self._touching))

    def _measure(self, x: np.ndarray, obstacle: Obstacle, stop_mm: float) -> int:
        """Distances, and normals inside, of all points that may touch; returns the number of their patches.

        A distance changes at most as far as its point moves, so faces and then patches that cannot have arrived
        since they were last measured are left out.
        """
        points, near, seen = self._points, self._near, self._seen
        if self._seen_of[0] is not obstacle or self._seen_of[1] != stop_mm:
            self._seen_of = (obstacle, stop_mm)
            self._primitives = obstacle.primitives if isinstance(obstacle, Solid) else None
            seen.face_gap[:] = -np.inf
            seen.gap_in_face[:] = seen.patch_gap[:] = -np.inf
        if self._primitives is not None:
            return int(contact_kernel.measure(self._primitives, points, x, stop_mm, seen, near))
        n_patches, n_points = contact_kernel.find_near(points, x, seen, near)
        if n_points:
            near.distance[:n_points] = obstacle.distance(near.position[:n_points])
            inside = np.flatnonzero(near.distance[:n_points] < 0.0)
            if inside.size:
                near.normal[inside] = obstacle.normal(near.position[inside])
        contact_kernel.remember(points, near, n_patches, stop_mm, seen)
        return int(n_patches)


def _corner_areas(faces: np.ndarray, nodes: np.ndarray) -> np.ndarray:
    """Areas (f) of plane faces (f, k) with straight sides, times a factor that their kind has."""
    corners = nodes[faces]
    is_square = faces.shape[1] == 8
    along = corners[:, 2 if is_square else 1] - corners[:, 0]
    across = corners[:, 3] - corners[:, 1] if is_square else corners[:, 2] - corners[:, 0]
    return np.asarray(np.linalg.norm(np.cross(along, across), axis=1))


def _sightings(points: ContactPoints) -> Sightings:
    """Nothing seen yet."""
    k, n_faces, n_patches = points.faces.shape[1], len(points.faces), len(points.reach)
    return Sightings(
        np.zeros((n_faces, k, 3)),
        np.full(n_faces, -np.inf),
        np.full(n_patches, -np.inf),
        np.zeros((n_patches, k, 3)),
        np.full(n_patches, -np.inf),
    )
