"""Penalty contact of surface points against a rigid obstacle given by its signed distance.

Contact points are midpoints of a fine subdivision of the quadratic faces, each with its reference area. With
penetration d = -distance > 0 the pressure is p = kn d^2 / (2 d0) below d0 and kn (d - d0/2) above (continuous
slope), the nodal force w (p n + t) and the tangent w (p'(d) n n^T + friction); the curvature of the obstacle is
left out of the tangent, which stays positive semi-definite. The spacing along z must resolve the objects' edge
radius of 1 mm: with 1 mm spacing an edge hooks between two rows of points and the peak is 33 % too high.
"""

import copy
from dataclasses import dataclass
from typing import Self

import numpy as np

from fast.models.objects.distance import distance, distance_and_normal
from fast.models.objects.primitives import mirrored
from fast.models.objects.rigid import RigidObject
from fast.models.records import Placement
from fast.models.simulation.body.assembly import ElasticBody, block_map
from fast.models.simulation.contact import kernel as contact_kernel
from fast.models.simulation.contact.kernel import FrictionState, Law, NearPoints, Sightings, Surface, Touching
from fast.models.simulation.contact.points import ContactPoints, PointSpacing, contact_points
from fast.models.simulation.placement import place

__all__ = [
    "NO_STOP",
    "ContactLaw",
    "ContactResponse",
    "ContactState",
    "ContactSurface",
    "Obstacle",
    "PointSpacing",
]

NO_STOP = -np.inf
NO_BLOCKS = np.zeros((0, 3, 3))


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
        own = self.normal_n_per_mm3, self.tangential_n_per_mm3, self.smoothing_mm, self.adhesion_mpa
        return Law(*(float(value) for value in own))


@dataclass(frozen=True, eq=False)
class Obstacle:
    """A rigid body that a finger can touch: rows (n_rows, N_COLUMNS) of `models.objects.primitives`, in its frame."""

    primitives: np.ndarray

    @classmethod
    def of(cls, obj: RigidObject, placement: Placement, *, is_mirrored: bool) -> Self:
        """Make the test object at its placement, in the frame of one finger (which stands on the +x side).

        For the finger on the other side the object is mirrored in x: its distance at (x, y, z) is the object's at
        (-x, y, z).
        """
        rows = place(obj, placement)
        return cls(np.ascontiguousarray(mirrored(rows) if is_mirrored else rows))

    def distance(self, points: np.ndarray) -> np.ndarray:
        """Return the signed distance in mm (n) of points (n, 3), negative inside."""
        return distance(self.primitives, points)

    def normal(self, points: np.ndarray) -> np.ndarray:
        """Return unit outward normals (n, 3) at points (n, 3) near the surface."""
        return distance_and_normal(self.primitives, points)[1]


@dataclass
class ContactState:
    """What friction remembers of the last converged step, and what the contact law stands for in it.

    `nodes` (nodes, 3) mm, deformed. Of the points that touch the obstacle (m), in ascending order: their numbers
    `points`, `traction` (m, 3) MPa, `pressure` (m) MPa. Of every point (n): `slip` accumulated, mm.
    `unresolved_n_mm`: sum over the points of A p^2 / kn |n_z|, with area A and normal n: twice the energy of the
    springs that stand for the indentation that the mesh does not resolve, as far as they act along the lift.
    """

    nodes: np.ndarray
    points: np.ndarray
    traction: np.ndarray
    pressure: np.ndarray
    slip: np.ndarray
    unresolved_n_mm: float = 0.0

    @classmethod
    def before_contact(cls, nodes: np.ndarray, n: int) -> Self:
        """Return the state of n points that have not touched anything, at deformed nodes."""
        return cls(nodes, np.zeros(0, dtype=np.int32), np.zeros((0, 3)), np.zeros(0), np.zeros(n))

    def spread_pressure(self) -> np.ndarray:
        """Return the pressure of every point (n), 0 where it does not touch."""
        values = np.zeros(len(self.slip))
        values[self.points] = self.pressure
        return values


class _Recalled:
    """The traction (n, 3) of every point that the present step goes on from; `points` are those where it is not 0."""

    def __init__(self, n: int) -> None:
        self.traction, self.points = np.zeros((n, 3)), np.zeros(0, dtype=np.int32)


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
        """Take `nodes` (n, 3): undeformed mesh, in the frame of the calculation."""
        self.law = law
        points = contact_points(body.mesh.contact_faces, nodes, spacing)
        n, n_patches = len(points.areas), len(points.reach)
        patch, face = np.zeros(n_patches, dtype=np.int32), np.zeros(n_patches, dtype=np.int32)
        self.compiled = Surface(
            points,
            block_map(points.faces, body.row_of_node, body.pattern),
            law.compiled,
            _sightings(points),
            NearPoints(patch, face, np.zeros((n, 3)), np.zeros(n), np.zeros((n, 3))),
            Touching(np.zeros(n, dtype=np.int32), np.zeros((n, 3)), np.zeros(n), np.zeros(n), np.zeros(n)),
        )
        self._seen_of: tuple[Obstacle | None, float] = (None, NO_STOP)
        self._recalled = _Recalled(n)

    def on(self, body: ElasticBody) -> Self:
        """Return the same surface on a body that differs only in its tangent's pattern; both share their buffers."""
        other = copy.copy(self)
        places = block_map(self.compiled.points.faces, body.row_of_node, body.pattern)
        other.compiled = self.compiled._replace(places=places)
        return other

    def moved(self, before: np.ndarray, after: np.ndarray, law: ContactLaw) -> Self:
        """Return the same points with their own law, and areas as of undeformed nodes (n, 3) `after`, not `before`.

        Both share their buffers: what is remembered of distances holds for any nodes.
        """
        other = copy.copy(self)
        points = self.compiled.points
        ratio = _corner_areas(points.faces, after) / _corner_areas(points.faces, before)
        areas = self.areas * np.repeat(ratio, np.diff(points.first_point[points.first_patch]))
        other.law = law
        other.compiled = self.compiled._replace(points=points._replace(areas=areas), law=law.compiled)
        return other

    @property
    def areas(self) -> np.ndarray:
        """Undeformed area of every point (n) in mm2."""
        return self.compiled.points.areas

    def forget(self) -> None:
        """Drop what is remembered of distances: the next evaluation starts as if it were the first."""
        self._seen_of = (None, NO_STOP)

    def start(self, x: np.ndarray) -> ContactState:
        """Return the state before any contact, at deformed nodes x (n, 3)."""
        return ContactState.before_contact(x, len(self.areas))

    def advance(self, state: ContactState, x: np.ndarray, response: ContactResponse) -> ContactState:
        """Return the state after a converged step from `state` to nodes x (n, 3) with this response."""
        points, pressure, slip = response.points.copy(), response.pressure.copy(), state.slip.copy()
        slip[points] += response.slip_step
        energies = self.areas[points] * pressure**2 / self.law.normal_n_per_mm3
        unresolved_n_mm = float(energies @ np.abs(response.normal_z))
        return ContactState(x, points, response.traction.copy(), pressure, slip, unresolved_n_mm)

    def recall(self, state: ContactState, friction: np.ndarray) -> FrictionState:
        """Return what friction goes on from after `state`; good until the next call, also of a copy of this surface.

        `friction` (n): coefficient of every point.
        """
        own = self._recalled
        own.traction[own.points] = 0.0
        own.traction[state.points], own.points = state.traction, state.points
        return FrictionState(state.nodes, own.traction, friction)

    def positions(self, x: np.ndarray) -> np.ndarray:
        """Return the contact points (n, 3) at deformed nodes x."""
        positions = np.zeros((len(self.areas), 3))
        contact_kernel.interpolate(self.compiled.points, x, positions)
        return positions

    def gap_mm(self, x: np.ndarray, obstacle: Obstacle) -> float:
        """Return the least distance of any contact point at deformed nodes x from an obstacle, negative inside."""
        return float(contact_kernel.least_gap(obstacle.primitives, self.compiled.points, x))

    def positions_of(self, points: np.ndarray, x: np.ndarray) -> np.ndarray:
        """Return a few contact points (m, 3), given by their numbers (m), at deformed nodes x."""
        own = self.compiled.points
        face = np.searchsorted(own.first_point[own.first_patch[:-1]], points, side="right") - 1
        return np.einsum("mk,mki->mi", own.shape[points], x[own.faces[face]])

    def respond(
        self,
        x: np.ndarray,
        state: ContactState,
        obstacle: Obstacle,
        friction: np.ndarray,
        stop_mm: float,
        blocks: np.ndarray | None,
    ) -> ContactResponse:
        """Compute the contact force at deformed nodes x; adds the tangent to `blocks` (z, 3, 3) unless None.

        `friction` (n): coefficient per point. `stop_mm`: the frictionless plane x >= stop stands for the other
        finger (`NO_STOP`: there is none).
        """
        self.turn_to(obstacle, stop_mm)
        force, own = np.zeros(x.shape), self.recall(state, friction)
        of_blocks = NO_BLOCKS if blocks is None else blocks
        m = contact_kernel.respond(self.compiled, obstacle.primitives, stop_mm, own, x, force, of_blocks)
        return ContactResponse(force, *self.touching(m))

    def turn_to(self, obstacle: Obstacle, stop_mm: float) -> None:
        """Forget the distances from another obstacle, or plane x = stop, than this."""
        if self._seen_of[0] is not obstacle or self._seen_of[1] != stop_mm:
            self._seen_of, seen = (obstacle, stop_mm), self.compiled.seen
            seen.face_gap[:] = -np.inf
            seen.gap_in_face[:] = seen.patch_gap[:] = -np.inf

    def touching(self, m: int) -> Touching:
        """Return what the last evaluation wrote of the m points that touch."""
        return Touching(*(values[:m] for values in self.compiled.touching))


def _corner_areas(faces: np.ndarray, nodes: np.ndarray) -> np.ndarray:
    """Return areas (f) of plane faces (f, k) with straight sides, times a factor that their kind has."""
    corners = nodes[faces]
    is_square = faces.shape[1] == 8
    along = corners[:, 2 if is_square else 1] - corners[:, 0]
    across = corners[:, 3] - corners[:, 1] if is_square else corners[:, 2] - corners[:, 0]
    return np.asarray(np.linalg.norm(np.cross(along, across), axis=1))


def _sightings(points: ContactPoints) -> Sightings:
    """Make sightings with nothing seen yet."""
    k, n_faces, n_patches = points.faces.shape[1], len(points.faces), len(points.reach)
    return Sightings(
        np.zeros((n_faces, k, 3)),
        np.full(n_faces, -np.inf),
        np.full(n_patches, -np.inf),
        np.zeros((n_patches, k, 3)),
        np.full(n_patches, -np.inf),
    )
