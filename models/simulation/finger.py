"""One finger in one grasp: its mechanics at a time step, for Newton's method.

Implicit Euler with the real density: f_int - f_contact + M/dt^2 (x - x_n - dt v_n) = 0. Inertia is a thousandth of
the stiffness while the grasp is quasi-static; where the finger snaps (a rib buckles, the tip slips off) steps
become short and inertia carries it through. Ten times less density changes the peak by less than 0.01 %.
"""

from dataclasses import dataclass
from typing import NamedTuple, Self

import numba as nb
import numpy as np

from fast.models.errors import SimulationFailed
from fast.models.simulation.body.assembly import (
    Elastic,
    ElasticBody,
    SymmetryBlocks,
    add_elastic_forces,
    add_stiffness,
    decouple_y,
)
from fast.models.simulation.contact import kernel as contact_kernel
from fast.models.simulation.contact.kernel import FrictionState, Surface
from fast.models.simulation.contact.law import NO_BLOCKS, ContactResponse, ContactState, ContactSurface, Obstacle
from fast.models.simulation.contact.self_contact import SelfContact
from fast.models.simulation.contact.self_kernel import Cavities, add_forces, add_tangent

DENSITY_T_PER_MM3 = 1.1e-9  # silicone-like print material, 1.1 g/cm3; at REFERENCE_MODULUS_MPA
_UNKNOWN = -1  # in place of the number of points that touch


@dataclass
class FingerState:
    """A converged instant: positions x (n, 3) mm, velocities v (n, 3) mm/s, contact memory, base offset (3) mm."""

    x: np.ndarray
    v: np.ndarray
    contact: ContactState
    base: np.ndarray


class Mechanics(NamedTuple):
    """What compiled code reads of a finger before its obstacle, and buffers for one evaluation."""

    body: Elastic
    """Elements and material."""
    surface: Surface
    """Contact points, with buffers of their own."""
    cavities: Cavities
    """Faces that can touch each other, with buffers of their own."""
    row_of_node: np.ndarray
    """Block row of each node (n), `CLAMPED` for those that the base holds."""
    symmetric: np.ndarray
    """Rows (s) without y."""
    symmetry: SymmetryBlocks
    """The blocks of the tangent that these rows concern."""
    diagonal: np.ndarray
    """Numbers of the diagonal blocks (rows + 1), and of one more."""
    primitives: np.ndarray
    """Of the obstacle."""
    stop_mm: float
    """The plane x >= stop stands for the other finger."""
    ribs_touch: bool
    """Whether ribs and walls are kept apart."""
    u: np.ndarray
    """Buffer: the unknowns (rows, 3)."""
    x: np.ndarray
    """Buffer: the nodes (n, 3)."""
    elastic_n: np.ndarray
    """Buffer: their forces (n, 3) by the elements."""
    contact_n: np.ndarray
    """Buffer: their forces (n, 3) by contact."""
    n_touching: np.ndarray
    """Buffer (1): how many points touch, `_UNKNOWN` where an element is inverted."""
    no_blocks: np.ndarray
    """Empty (0, 3, 3), in place of a tangent."""


class Motion(NamedTuple):
    """A time step: the nodes `clamped` (n, 3) where the base holds them, M/dt^2 `inertia` (rows), `target` (rows, 3).

    The target is where the unknowns would be without forces. `friction` is what friction goes on from.
    """

    clamped: np.ndarray
    inertia: np.ndarray
    target: np.ndarray
    friction: FrictionState


class FingerStep:
    """The equations of one time step: residual(u) = 0 for the unknown positions u (rows, 3)."""

    def __init__(
        self,
        body: ElasticBody,
        surface: ContactSurface,
        nodes: np.ndarray,
        obstacle: Obstacle,
        *,
        stop_mm: float,
        inside: SelfContact | None = None,
        ribs_touch: bool = False,
    ) -> None:
        """Take `nodes` (n, 3): undeformed, in the object frame with the front wall at x = 0 and no lift.

        `stop_mm`: the frictionless plane x >= stop stands for the other finger. `inside`: the faces that can touch each
        other; they are kept apart if `ribs_touch`.
        """
        self._inside = SelfContact.of_nothing(nodes, surface.law) if inside is None else inside
        self.body, self.surface, self.nodes = body, surface, nodes
        self._obstacle = obstacle
        self._free = body.row_of_node >= 0
        self._rows = body.row_of_node[self._free]
        n_rows = body.pattern.n
        self._mass = np.zeros(n_rows)
        self._mass[self._rows] = DENSITY_T_PER_MM3 * body.lumped_volume()[self._free]
        plane = body.row_of_node[body.mesh.symmetry_nodes]
        self.mechanics = Mechanics(
            body=body.compiled,
            surface=surface.compiled,
            cavities=self._inside.compiled,
            row_of_node=body.row_of_node,
            symmetric=plane[plane >= 0],
            symmetry=body.symmetry,
            diagonal=body.pattern.indptr,
            primitives=obstacle.primitives,
            stop_mm=float(stop_mm),
            ribs_touch=ribs_touch,
            u=np.zeros((n_rows, 3)),
            x=np.zeros(nodes.shape),
            elastic_n=np.zeros(nodes.shape),
            contact_n=np.zeros(nodes.shape),
            n_touching=np.full(1, _UNKNOWN),
            no_blocks=NO_BLOCKS,
        )
        at_rest = FrictionState(nodes, np.zeros((0, 3)), np.zeros(0))
        self.motion = Motion(nodes, np.zeros(n_rows), np.zeros((n_rows, 3)), at_rest)

    @property
    def ribs_touch(self) -> bool:
        """True if ribs and walls are kept apart."""
        return self.mechanics.ribs_touch

    def undeformed(self, base: np.ndarray, velocity: np.ndarray) -> FingerState:
        """Return the undeformed finger with its base moved by `base` (3), all of it at `velocity` (3) in mm/s."""
        x = self.nodes + base
        return FingerState(x, np.tile(velocity, (len(x), 1)), self.surface.start(x), base.copy())

    def begin(self, state: FingerState, base: np.ndarray, dt_s: float, friction: np.ndarray) -> np.ndarray:
        """Set up the step from `state` to the base position `base`; returns the first guess of the unknowns."""
        target = np.zeros((len(self._mass), 3))
        _aim(state.x, state.v, dt_s, self.body.row_of_node, target)
        own = self.surface.recall(state.contact, friction)
        self.motion = Motion(self.nodes + base, self._mass / dt_s**2, target, own)
        self.mechanics.n_touching[0] = _UNKNOWN
        self.surface.turn_to(self._obstacle, self.mechanics.stop_mm)
        return target.copy()

    def start_from(self, state: FingerState) -> np.ndarray:
        """Return another first guess of the unknowns: the positions of `state`, moved along with the base."""
        u = np.zeros_like(self.motion.target)
        u[self._rows] = (state.x + (self.motion.clamped - self.nodes - state.base))[self._free]
        return u

    def unknowns_of(self, state: FingerState) -> np.ndarray:
        """Return the unknowns (rows, 3) of this finger in `state`, to the last bit."""
        u = np.zeros((len(self._mass), 3))
        u[self._rows] = state.x[self._free]
        return u

    def distance_to_object(self, base: np.ndarray) -> float:
        """Return the least distance in mm of the undeformed finger, base at `base` (3), from the obstacle."""
        return self.surface.gap_mm(self.nodes + base, self._obstacle)

    def distance_to_anything(self, base: np.ndarray) -> float:
        """Do as `distance_to_object` does, but the other finger (the plane x = stop) counts too."""
        gap = self.distance_to_object(base)
        front = float((self.nodes + base)[:, 0].min())
        return min(gap, front - self.mechanics.stop_mm)

    def is_touching(self, state: FingerState) -> bool:
        """Return whether any contact point carries pressure from the obstacle."""
        return bool((state.contact.pressure > 0.0).any())

    def depth_mm(self, state: FingerState) -> float:
        """Return how deep the finger is in the obstacle at most, from the pressure."""
        return float(state.contact.pressure.max(initial=0.0)) / self.surface.law.normal_n_per_mm3

    def sinking_mm(self, state: FingerState, new: FingerState) -> float:
        """Return how much deeper a point is at most than it was in `state`."""
        more_mpa = new.contact.pressure - state.contact.spread_pressure()[new.contact.points]
        return float(more_mpa.max(initial=0.0)) / self.surface.law.normal_n_per_mm3

    def rib_depth_mm(self, state: FingerState) -> float:
        """Return how deep ribs and walls are in each other at most."""
        return self._inside.depth_mm(state.x)

    def must_couple_ribs(self, state: FingerState) -> bool:
        """Return whether ribs and walls are in each other that equations do not keep apart, or that share no blocks."""
        return self._inside.presses_uncoupled(state.x)

    def with_ribs_coupled(self, state: FingerState) -> Self:
        """Return the same finger, its ribs and walls pressing on each other; those near in `state` share blocks."""
        pairs = self._inside.pairs_near(state.x)
        body = self.body.coupled(self._inside.nodes_of(pairs))
        inside = self._inside.coupled(pairs, body)
        return self._like(body, self.surface.on(body), self.nodes, inside, ribs_touch=True)

    def copied(self, body: ElasticBody, surface: ContactSurface, nodes: np.ndarray) -> Self:
        """Copy the finger, with another body and surface on nodes (n, 3); it touches itself where this one does.

        How its ribs press on each other is shared: it depends on where nodes are, and a little on areas, which stay.
        """
        return self._like(body, surface, nodes, self._inside, ribs_touch=self.ribs_touch)

    def numbered_as(self, finger: Self) -> Self:
        """Return this copy of a finger, its unknowns in the order that the finger's have now that its ribs touch."""
        body = self.body.numbered_as(finger.body)
        return self._like(body, self.surface, self.nodes, finger._inside, ribs_touch=finger.ribs_touch)

    def _like(
        self, body: ElasticBody, surface: ContactSurface, nodes: np.ndarray, inside: SelfContact, *, ribs_touch: bool
    ) -> Self:
        """Make another finger before the same obstacle."""
        stop_mm = self.mechanics.stop_mm
        return type(self)(body, surface, nodes, self._obstacle, stop_mm=stop_mm, inside=inside, ribs_touch=ribs_touch)

    def finish(
        self, state: FingerState, u: np.ndarray, base: np.ndarray, dt_s: float
    ) -> tuple[FingerState, np.ndarray]:
        """Return the state after the step, and the force (3) in N that the clamp exerts on the meshed body."""
        # Newton ends on the positions that it evaluated last.
        now = self.mechanics
        if (now.n_touching[0] < 0 or not np.array_equal(now.u, u)) and self.residual(u) is None:
            raise SimulationFailed("An element is inverted in a state of equilibrium.", reason="inverted_element")
        clamp = (now.elastic_n - now.contact_n)[~self._free].sum(axis=0)
        x, response = now.x.copy(), ContactResponse(now.contact_n, *self.surface.touching(now.n_touching[0]))
        contact = self.surface.advance(state.contact, x, response)
        return FingerState(x, (x - state.x) / dt_s, contact, base.copy()), clamp

    def residual(self, u: np.ndarray) -> np.ndarray | None:
        """Compute the out-of-balance force (rows, 3) in N at unknowns u (rows, 3); None if an element is inverted."""
        rows = np.zeros(u.shape)
        return rows if evaluate(self.mechanics, self.motion, u, rows) else None


@nb.njit(cache=True, nogil=True, error_model="numpy")
def evaluate(mechanics: Mechanics, motion: Motion, u: np.ndarray, rows: np.ndarray) -> bool:
    """Overwrite `rows` (rows, 3) with the out-of-balance force at unknowns u; False if an element is inverted.

    The buffers of `mechanics` keep what was evaluated.
    """
    x, elastic, contact = mechanics.x, mechanics.elastic_n, mechanics.contact_n
    mechanics.n_touching[0] = _UNKNOWN
    _gather(u, mechanics.row_of_node, motion.clamped, x)
    elastic[:] = 0.0
    if not add_elastic_forces(mechanics.body, x, elastic):
        return False
    contact[:] = 0.0
    n_touching = contact_kernel.respond(
        mechanics.surface, mechanics.primitives, mechanics.stop_mm, motion.friction, x, contact, mechanics.no_blocks
    )
    if mechanics.ribs_touch:
        add_forces(mechanics.cavities, x, contact)
    _balance(mechanics.row_of_node, mechanics.symmetric, contact, elastic, motion, u, rows)
    mechanics.u[:] = u
    mechanics.n_touching[0] = n_touching
    return True


@nb.njit(cache=True, nogil=True, error_model="numpy")
def linearise(mechanics: Mechanics, motion: Motion, u: np.ndarray, blocks: np.ndarray) -> bool:
    """Overwrite `blocks` (z, 3, 3) with minus the derivative of the out-of-balance force; False if one is inverted."""
    x, contact = np.zeros(mechanics.x.shape), np.zeros(mechanics.x.shape)
    _gather(u, mechanics.row_of_node, motion.clamped, x)
    blocks[:] = 0.0
    if not add_stiffness(mechanics.body, x, blocks):
        return False
    contact_kernel.respond(
        mechanics.surface, mechanics.primitives, mechanics.stop_mm, motion.friction, x, contact, blocks
    )
    if mechanics.ribs_touch:
        add_tangent(mechanics.cavities, x, blocks)
    shift(mechanics, motion, 1.0, blocks)
    decouple_y(mechanics.symmetry, blocks)
    return True


@nb.njit(cache=True, nogil=True, error_model="numpy")
def shift(mechanics: Mechanics, motion: Motion, amount: float, blocks: np.ndarray) -> None:
    """Add `amount` times the inertia M/dt^2 to the diagonal of a tangent."""
    for row in range(len(mechanics.diagonal) - 1):
        for i in range(3):
            blocks[mechanics.diagonal[row], i, i] += amount * motion.inertia[row]


@nb.njit(cache=True, nogil=True, error_model="numpy")
def _aim(x: np.ndarray, v: np.ndarray, dt_s: float, row_of_node: np.ndarray, target: np.ndarray) -> None:
    """Find where the unknown rows come to from x (n, 3) at velocities v (n, 3)."""
    for node in range(len(x)):
        row = row_of_node[node]
        if row >= 0:
            for i in range(3):
                target[row, i] = x[node, i] + dt_s * v[node, i]


@nb.njit(cache=True, nogil=True, error_model="numpy")
def _gather(u: np.ndarray, row_of_node: np.ndarray, clamped: np.ndarray, x: np.ndarray) -> None:
    """Gather the node positions: from the unknown rows, or where the clamp holds them."""
    for node in range(len(x)):
        row = row_of_node[node]
        for i in range(x.shape[1]):
            x[node, i] = clamped[node, i] if row < 0 else u[row, i]


@nb.njit(cache=True, nogil=True, error_model="numpy")
def _balance(
    row_of_node: np.ndarray,
    symmetric: np.ndarray,
    contact: np.ndarray,
    elastic: np.ndarray,
    motion: Motion,
    u: np.ndarray,
    rows: np.ndarray,
) -> None:
    """Compute rows' out-of-balance force: contact - elastic + M/dt^2 (target - u); no y in `symmetric` ones."""
    inertia, target = motion.inertia, motion.target
    for node in range(len(row_of_node)):
        row = row_of_node[node]
        if row < 0:
            continue
        for i in range(u.shape[1]):
            rows[row, i] = contact[node, i] - elastic[node, i] + inertia[row] * (target[row, i] - u[row, i])
    for row in symmetric:
        rows[row, 1] = 0.0
