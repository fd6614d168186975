"""One finger in one grasp: its mechanics at a time step, for Newton's method.

Implicit Euler with the real density: f_int - f_contact + M/dt^2 (x - x_n - dt v_n) = 0. Inertia is a thousandth of
the stiffness while the grasp is quasi-static; where the finger snaps (a rib buckles, the tip slips off) steps
become short and inertia carries it through. Ten times less density changes the peak by less than 0.01 %.
"""

from dataclasses import dataclass
from typing import Self

import numba as nb
import numpy as np

from fast.models.errors import SimulationFailed
from fast.models.simulation.body.assembly import ElasticBody
from fast.models.simulation.contact.law import ContactResponse, ContactState, ContactSurface, Obstacle
from fast.models.simulation.contact.self_contact import SelfContact

DENSITY_T_PER_MM3 = 1.1e-9  # silicone-like print material, 1.1 g/cm3; at REFERENCE_MODULUS_MPA


@dataclass
class FingerState:
    """A converged instant: positions x (n, 3) mm, velocities v (n, 3) mm/s, contact memory, base offset (3) mm."""

    x: np.ndarray
    v: np.ndarray
    contact: ContactState
    base: np.ndarray


@dataclass(frozen=True)
class _Evaluation:
    """Mechanics at unknowns u (rows, 3): nodes x (n, 3), contact response, elastic nodal force (n, 3)."""

    u: np.ndarray
    x: np.ndarray
    contact: ContactResponse
    elastic: np.ndarray


class FingerStep:
    """The equations of one time step; a `models.simulation.solver.newton.Problem`."""

    def __init__(
        self,
        body: ElasticBody,
        surface: ContactSurface,
        nodes: np.ndarray,
        obstacle: Obstacle,
        *,
        stop_mm: float,
        inside: SelfContact | None = None,
    ) -> None:
        """`nodes` (n, 3): undeformed, in the object frame with the front wall at x = 0 and no lift.

        `stop_mm`: the frictionless plane x >= stop stands for the other finger. `inside`: the faces that can touch each
        other, which nothing keeps apart before `with_ribs_coupled`.
        """
        self.ribs_touch, self._inside = False, inside
        self.body, self.surface, self.nodes = body, surface, nodes
        self._obstacle, self._stop_mm = obstacle, stop_mm
        self._free = body.row_of_node >= 0
        self._rows = body.row_of_node[self._free]
        self._mass = np.zeros(body.pattern.n)
        self._mass[self._rows] = DENSITY_T_PER_MM3 * body.lumped_volume()[self._free]
        plane = body.row_of_node[body.mesh.symmetry_nodes]
        self._symmetric = plane[plane >= 0]
        self._last: _Evaluation | None = None
        self._clamped = self.nodes
        self._inertia = np.zeros_like(self._mass)
        self._target = np.zeros((body.pattern.n, 3))
        self._friction = np.zeros(len(surface.areas))
        self._state = ContactState(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0), np.zeros(0))

    @property
    def n_points(self) -> int:
        """Number of contact points."""
        return len(self.surface.areas)

    def undeformed(self, base: np.ndarray, velocity: np.ndarray) -> FingerState:
        """The undeformed finger with its base moved by `base` (3), all of it at `velocity` (3) in mm/s."""
        x = self.nodes + base
        return FingerState(x, np.tile(velocity, (len(x), 1)), self.surface.start(x), base.copy())

    def begin(self, state: FingerState, base: np.ndarray, dt_s: float, friction: np.ndarray) -> np.ndarray:
        """Set up the step from `state` to the base position `base`; returns the first guess of the unknowns."""
        self._clamped = self.nodes + base
        self._inertia = self._mass / dt_s**2
        self._target[self._rows] = (state.x + dt_s * state.v)[self._free]
        self._friction, self._state, self._last = friction, state.contact, None
        return self._target.copy()

    def start_from(self, state: FingerState) -> np.ndarray:
        """Another first guess of the unknowns: the positions of `state`, moved along with the base."""
        u = np.zeros_like(self._target)
        u[self._rows] = (state.x + (self._clamped - self.nodes - state.base))[self._free]
        return u

    def distance_to_object(self, base: np.ndarray) -> float:
        """Least distance in mm of the undeformed finger, base at `base` (3), from the obstacle."""
        return self.surface.gap_mm(self.nodes + base, self._obstacle)

    def distance_to_anything(self, base: np.ndarray) -> float:
        """As `distance_to_object`, but the other finger (the plane x = stop) counts too."""
        gap = self.distance_to_object(base)
        front = float((self.nodes + base)[:, 0].min())
        return min(gap, front - self._stop_mm)

    def is_touching(self, state: FingerState) -> bool:
        """True if any contact point carries pressure from the obstacle."""
        return bool((state.contact.pressure > 0.0).any())

    def depth_mm(self, state: FingerState) -> np.ndarray:
        """Penetration of every contact point (n), from its pressure."""
        return state.contact.pressure / self.surface.law.normal_n_per_mm3

    def rib_depth_mm(self, state: FingerState) -> float:
        """How deep ribs and walls are in each other at most."""
        return 0.0 if self._inside is None else self._inside.depth_mm(state.x)

    def must_couple_ribs(self, state: FingerState) -> bool:
        """True if ribs and walls are in each other that the equations do not keep apart, or that share no blocks."""
        return self._inside is not None and self._inside.presses_uncoupled(state.x)

    def with_ribs_coupled(self, state: FingerState) -> Self:
        """The same finger, its ribs and walls pressing on each other; those near each other in `state` share blocks."""
        if self._inside is None:
            raise ValueError("a finger without cavity faces has no ribs that could touch")
        pairs = self._inside.pairs_near(state.x)
        body = self.body.coupled(self._inside.nodes_of(pairs))
        finger = type(self)(
            body,
            self.surface.on(body),
            self.nodes,
            self._obstacle,
            stop_mm=self._stop_mm,
            inside=self._inside.coupled(pairs, body),
        )
        finger.ribs_touch = True
        return finger

    def copied(self, body: ElasticBody, surface: ContactSurface, nodes: np.ndarray) -> Self:
        """The same finger with another body and surface on nodes (n, 3), one that touches itself where this one does.

        How its ribs press on each other is shared: it depends on where nodes are, and a little on areas, which stay.
        """
        finger = type(self)(body, surface, nodes, self._obstacle, stop_mm=self._stop_mm, inside=self._inside)
        finger.ribs_touch = self.ribs_touch
        return finger

    def numbered_as(self, finger: Self) -> Self:
        """This copy of a finger, its unknowns in the order that the finger's have now that its ribs touch."""
        other = self.copied(self.body.numbered_as(finger.body), self.surface, self.nodes)
        other.ribs_touch, other._inside = finger.ribs_touch, finger._inside  # noqa: SLF001 - a finger of this kind
        return other

    def finish(
        self, state: FingerState, u: np.ndarray, base: np.ndarray, dt_s: float
    ) -> tuple[FingerState, np.ndarray]:
        """The state after the step, and the force (3) in N that the clamp exerts on the meshed body."""
        # Newton ends on the positions that it evaluated last.
        is_known = self._last is not None and np.array_equal(self._last.u, u)
        end = self._last if is_known else self._evaluate(u)
        if end is None:
            raise SimulationFailed("An element is inverted in a state of equilibrium.", reason="inverted_element")
        x, response = end.x, end.contact
        clamp = (end.elastic - response.force)[~self._free].sum(axis=0)
        contact = self.surface.advance(state.contact, x, response)
        return FingerState(x, (x - state.x) / dt_s, contact, base.copy()), clamp

    def positions(self, u: np.ndarray) -> np.ndarray:
        """All nodes (n, 3) from the unknown rows."""
        x = np.zeros(self.nodes.shape)
        gather(u, self.body.row_of_node, self._clamped, x)
        return x

    def residual(self, u: np.ndarray) -> np.ndarray | None:
        """See `Problem`."""
        now = self._evaluate(u)
        if now is None:
            return None
        self._last = now
        rows = np.zeros(u.shape)
        forces = now.contact.force, now.elastic
        balance(self.body.row_of_node, self._symmetric, *forces, self._inertia, self._target, u, rows)
        return rows

    def _evaluate(self, u: np.ndarray) -> _Evaluation | None:
        """Contact and elastic forces; None if an element is inverted."""
        x = self.positions(u)
        elastic = self.body.force(x)
        if elastic is None:
            return None
        contact = self._contact(x, None)
        if self.ribs_touch and self._inside is not None:
            self._inside.add_force(x, contact.force)
        return _Evaluation(u.copy(), x, contact, elastic)

    def tangent(self, u: np.ndarray, blocks: np.ndarray) -> bool:
        """See `Problem`."""
        x = self.positions(u)
        if self.body.stiffness(x, blocks) is None:
            return False
        self._contact(x, blocks)
        if self.ribs_touch and self._inside is not None:
            self._inside.add_tangent(x, blocks)
        self.shift(blocks, 1.0)
        self.body.apply_symmetry(blocks)
        return True

    def shift(self, blocks: np.ndarray, amount: float) -> None:
        """See `Problem`; in units of the inertia M/dt^2."""
        add_diagonal(self.body.pattern.indptr, amount * self._inertia, blocks)

    def _contact(self, x: np.ndarray, blocks: np.ndarray | None) -> ContactResponse:
        return self.surface.respond(x, self._state, self._obstacle, self._friction, self._stop_mm, blocks)


@nb.njit(cache=True, nogil=True, error_model="numpy")
def gather(u: np.ndarray, row_of_node: np.ndarray, clamped: np.ndarray, x: np.ndarray) -> None:
    """Node positions: from the unknown rows, or where the clamp holds them."""
    for node in range(len(x)):
        row = row_of_node[node]
        for i in range(x.shape[1]):
            x[node, i] = clamped[node, i] if row < 0 else u[row, i]


@nb.njit(cache=True, nogil=True, error_model="numpy")
def balance(
    row_of_node: np.ndarray,
    symmetric: np.ndarray,
    contact: np.ndarray,
    elastic: np.ndarray,
    inertia: np.ndarray,
    target: np.ndarray,
    u: np.ndarray,
    rows: np.ndarray,
) -> None:
    """Out-of-balance force of the unknown rows: contact - elastic + M/dt^2 (target - u); no y in `symmetric` ones."""
    for node in range(len(row_of_node)):
        row = row_of_node[node]
        if row < 0:
            continue
        for i in range(u.shape[1]):
            rows[row, i] = contact[node, i] - elastic[node, i] + inertia[row] * (target[row, i] - u[row, i])
    for row in symmetric:
        rows[row, 1] = 0.0


@nb.njit(cache=True, nogil=True, error_model="numpy")
def add_diagonal(indptr: np.ndarray, amounts: np.ndarray, blocks: np.ndarray) -> None:
    """Add amounts (n) times the identity to the diagonal blocks."""
    for row in range(len(amounts)):
        for i in range(blocks.shape[1]):
            blocks[indptr[row], i, i] += amounts[row]
