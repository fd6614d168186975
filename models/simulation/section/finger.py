"""The section of one finger in one grasp: its mechanics at a time step, as `models.simulation.finger` for the solid."""

from dataclasses import dataclass

import numpy as np

from models.errors import SimulationFailed
from models.simulation.finger import DENSITY_T_PER_MM3, FingerState, add_diagonal, balance, gather
from models.simulation.section.body import PlaneBody
from models.simulation.section.contact import PlaneResponse, PlaneSurface

IN_PLANE = [0, 2]  # x and z of a base position


@dataclass(frozen=True)
class _Evaluation:
    """Mechanics at unknowns u (rows, 2): nodes x (n, 2), contact response, elastic nodal force (n, 2)."""

    u: np.ndarray
    x: np.ndarray
    contact: PlaneResponse
    elastic: np.ndarray


class PlaneFinger:
    """The equations of one time step in the (x, z) plane; a `models.simulation.solver.newton.Problem` of 2 x 2 blocks.

    States hold positions x (n, 2); base positions and clamp forces stay (3), with y = 0.
    """

    def __init__(self, body: PlaneBody, surface: PlaneSurface, nodes: np.ndarray, *, stop_mm: float) -> None:
        """`nodes` (n, 2): undeformed, in the object frame with the front wall at x = 0 and no lift.

        `stop_mm` as in `FingerStep`.
        """
        self.body, self.surface, self.nodes, self._stop_mm = body, surface, nodes, stop_mm
        self._free = np.flatnonzero(body.row_of_node >= 0)
        self._rows = body.row_of_node[self._free]
        self._mass = np.zeros(body.pattern.n)
        self._mass[self._rows] = DENSITY_T_PER_MM3 * body.lumped_volume()[self._free]
        self._clamped = self.nodes
        self._rate = 0.0
        self._target = np.zeros((body.pattern.n, 2))
        self._friction = np.zeros(surface.n_points)
        self._state = surface.start(nodes)
        self._last: _Evaluation | None = None

    @property
    def n_points(self) -> int:
        """Number of contact points."""
        return self.surface.n_points

    def undeformed(self, base: np.ndarray, velocity: np.ndarray) -> FingerState:
        """The undeformed finger with its base moved by `base` (3), all of it at `velocity` (3) in mm/s."""
        x = self.nodes + base[IN_PLANE]
        return FingerState(x, np.tile(velocity[IN_PLANE], (len(x), 1)), self.surface.start(x), base.copy())

    def begin(self, state: FingerState, base: np.ndarray, dt_s: float, friction: np.ndarray) -> np.ndarray:
        """Set up the step from `state` to the base position `base`; returns the first guess of the unknowns."""
        self._clamped = self.nodes + base[IN_PLANE]
        self._rate = 1.0 / dt_s**2
        self._target[self._rows] = (state.x + dt_s * state.v)[self._free]
        self._friction, self._state, self._last = friction, state.contact, None
        return self._target.copy()

    def start_from(self, state: FingerState) -> np.ndarray:
        """Another first guess of the unknowns: the positions of `state`, moved along with the base."""
        u = np.zeros_like(self._target)
        u[self._rows] = (state.x + (self._clamped - self.nodes - state.base[IN_PLANE]))[self._free]
        return u

    def distance_to_object(self, base: np.ndarray) -> float:
        """Least distance in mm of the undeformed finger, base at `base` (3), from the obstacle."""
        return self.surface.distance(self.nodes + base[IN_PLANE])

    def distance_to_anything(self, base: np.ndarray) -> float:
        """As `distance_to_object`, but the other finger (the plane x = stop) counts too."""
        gap = self.distance_to_object(base)
        return min(gap, float(self.nodes[:, 0].min() + base[0]) - self._stop_mm)

    def is_touching(self, state: FingerState) -> bool:
        """True if any contact point carries pressure from the obstacle."""
        return bool((state.contact.pressure > 0.0).any())

    def depth_mm(self, state: FingerState) -> np.ndarray:
        """Penetration of every contact point (n), from its pressure."""
        return state.contact.pressure / self.surface.law.normal_n_per_mm3

    def finish(
        self, state: FingerState, u: np.ndarray, base: np.ndarray, dt_s: float
    ) -> tuple[FingerState, np.ndarray]:
        """The state after the step, and the force (3) in N that the clamp exerts on the meshed body."""
        end = self._evaluate(u)
        if end is None:
            raise SimulationFailed("An element is inverted in a state of equilibrium.", reason="inverted_element")
        clamp = np.zeros(3)
        clamp[IN_PLANE] = (end.elastic - end.contact.force)[self.body.mesh.base_nodes].sum(axis=0)
        contact = self.surface.advance(state.contact, end.x, end.contact)
        return FingerState(end.x, (end.x - state.x) / dt_s, contact, base.copy()), clamp

    def positions(self, u: np.ndarray) -> np.ndarray:
        """All nodes (n, 2) from the unknown rows."""
        x = np.zeros_like(self.nodes)
        gather(u, self.body.row_of_node, self._clamped, x)
        return x

    def residual(self, u: np.ndarray) -> np.ndarray | None:
        """See `Problem`."""
        now = self._evaluate(u)
        if now is None:
            return None
        rows, inertia = np.zeros_like(u), self._rate * self._mass
        balance(self.body.row_of_node, now.contact.force, now.elastic, inertia, self._target, u, rows)
        return rows

    def tangent(self, u: np.ndarray, blocks: np.ndarray) -> bool:
        """See `Problem`."""
        now = self._evaluate(u)
        if now is None:
            return False
        self.body.stiffness(now.x, blocks)
        self.surface.add_stiffness(now.contact, blocks)
        self.shift(blocks, 1.0)
        return True

    def shift(self, blocks: np.ndarray, amount: float) -> None:
        """See `Problem`; in units of the inertia M/dt^2."""
        add_diagonal(self.body.pattern.indptr, amount * self._rate * self._mass, blocks)

    def _evaluate(self, u: np.ndarray) -> _Evaluation | None:
        """Contact and elastic forces; None if an element is inverted. The last one is kept: Newton asks again."""
        if self._last is None or not np.array_equal(self._last.u, u):
            x = self.positions(u)
            elastic = self.body.force(x)
            if elastic is None:
                return None
            contact = self.surface.respond(x, self._state, self._friction, self._stop_mm)
            self._last = _Evaluation(u.copy(), x, contact, elastic)
        return self._last
