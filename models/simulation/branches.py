"""Cells with two branches: a grasp that snaps may go on in two ways, and chance of placement decides which.

A cell is a design on an object. Its lift may pass a point where the finger snaps off an edge, or buckles. If a slightly
different placement avoids the snap, two force traces belong to the same cell, and the bench shows now one, now the
other. `find_branches` simulates again: at other placements, on another mesh, with shorter steps. Most cells need one
such run: with wider jaws, as a finger that holds less snaps first. The others are those whose grasp is flagged `snap`.

    two runs are on different branches  <=>  their forces differ by more than `LEAST_JUMP` of the peak over
                                             `LASTING_MM` of lift, whatever shift of up to `SHIFT_MM` in lift
    placement switches between them     <=>  they still do when their placements are a quarter of `placement_sd_mm`
                                             apart

The second line tells a snap from a force that is only sensitive: a smooth change shrinks with the interval.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from statistics import NormalDist

import numpy as np
from scipy.ndimage import maximum_filter1d, minimum_filter1d

from fast.models.errors import SimulationFailed
from fast.models.objects.rigid import RigidObject
from fast.models.records import Branch, BranchCause, Branches, Design, GraspSetup, GraspSimulation, Placement, Trace
from fast.models.simulation.grasp import SNAP, simulate_grasp
from fast.models.simulation.problem import find_numerics
from fast.models.simulation.solver.stepping import StepLimits
from fast.models.simulation.version import SimulatorVersion

PLACEMENT_SD_MM = 0.2  # of an object on its mount, in x and in z
REACH_SD = 2.0  # how far placements are tried on each axis: 95 % of them lie within
N_HALVINGS = 3  # of the interval in which the branch switches
LEAST_JUMP = 0.05  # of the peak
LASTING_MM = 4.0  # of lift, in all: letting go makes larger differences, but shorter ones
SHIFT_MM = 1.0  # of lift: events move with the placement, and steps of up to 2 mm blur them
SMOOTH_SHARE = 0.75  # a change that halving its interval reduces to less on both sides is no jump
SMOOTH_RATIO = 3.0  # times the largest smooth change by placement: what a change by another mesh must exceed
OTHER_EDGE = 0.75  # edges of the other mesh, in those of the nominal one
OTHER_STEP = 0.5  # the shorter steps, in the nominal ones
_GRID_MM = 0.25
_NORMAL = NormalDist()

Simulate = Callable[..., GraspSimulation]


def lasting_difference(one: Trace, other: Trace) -> float:
    """By what share of the larger peak two forces differ over `LASTING_MM` of lift in all.

    The difference at a lift is the distance of one force from the range of the other within `SHIFT_MM`.
    """
    end_mm = max(float(one.lift_mm[-1]), float(other.lift_mm[-1])) + LASTING_MM
    grid = np.arange(0.0, end_mm, _GRID_MM)
    a, b = (np.interp(grid, t.lift_mm[t.is_lift], t.force_n[t.is_lift], right=0.0) for t in (one, other))
    peak = max(float(a.max()), float(b.max()))
    if peak <= 0.0:
        return 0.0
    difference = np.maximum(_distance_to_range(a, b), _distance_to_range(b, a))
    return float(np.sort(difference)[-round(LASTING_MM / _GRID_MM)] / peak)


def _distance_to_range(force_n: np.ndarray, other_n: np.ndarray) -> np.ndarray:
    width = 2 * round(SHIFT_MM / _GRID_MM) + 1
    low, high = minimum_filter1d(other_n, width), maximum_filter1d(other_n, width)
    return np.maximum(np.maximum(force_n - high, low - force_n), 0.0)


def find_branches(
    design: Design,
    obj: RigidObject,
    version: SimulatorVersion,
    setup: GraspSetup,
    nominal: GraspSimulation,
    *,
    placement_sd_mm: float = PLACEMENT_SD_MM,
    deadline_s: float | None = None,
    simulate: Simulate = simulate_grasp,
) -> Branches:
    """The branches of a cell whose grasp at the nominal placement is known, and the share of placements on each.

    The first run has the fingers `REACH_SD` standard deviations further from the object. If it stays on the branch and
    the nominal grasp is not flagged `snap`, there is one branch. Else there are five more: fingers as much nearer,
    the object as much higher and lower; a mesh with `OTHER_EDGE` of the edges; steps of `OTHER_STEP` the length. A
    placement on another branch takes up to `N_HALVINGS` more, to find where it switches. In x, both fingers are moved:
    they are solved alone, so this is what each of them meets, for half the cost of an object that is moved.

    The share is that of placements (normal, `placement_sd_mm` in x and in z) on this side of the straight line through
    the switches found. A third branch counts to the second.

    `simulate` is `simulate_grasp`, or stands for it. A run that fails says nothing and is left out.

    Raises:
        SimulationFailed: the wall time `deadline_s` of the test has passed (reason `time_out`).
    """
    cell = _Cell(design, obj, version, setup, nominal, simulate, deadline_s)
    reach_mm = REACH_SD * placement_sd_mm
    sides = [cell.find_switch(-reach_mm, 0.0)]
    if sides[0].beyond is None and nominal.flag != SNAP:
        return cell.result((Branch(1.0, nominal),))
    sides += [cell.find_switch(x * reach_mm, z * reach_mm) for x, z in ((1, 0), (0, -1), (0, 1))]
    least = max(LEAST_JUMP, SMOOTH_RATIO * max(side.smooth for side in sides))
    for other in (cell.run(has_other_mesh=True), cell.run(has_other_steps=True)):
        if other is not None and lasting_difference(nominal.trace, other.trace) > least:
            return cell.result((Branch(0.5, nominal), Branch(0.5, other)), "numerics", 0.5)
    beyond = min(sides, key=lambda side: side.far_mm).beyond
    if beyond is None:
        return cell.result((Branch(1.0, nominal),))
    near_sd, far_sd = np.array([[side.near_mm, side.far_mm] for side in sides]).T / placement_sd_mm
    low, high = _share_within(near_sd.reshape(2, 2)), _share_within(far_sd.reshape(2, 2))
    share = 0.5 * (low + high)
    return cell.result((Branch(share, nominal), Branch(1.0 - share, beyond)), "placement", 0.5 * (high - low))


@dataclass(frozen=True)
class _Side:
    """What lies in one direction from the nominal placement.

    The branch switches between `near_mm` and `far_mm` from it, to that of the grasp `beyond`; both are infinite where
    it does not, and `smooth` is by how much the force changes up to there.
    """

    near_mm: float = np.inf
    far_mm: float = np.inf
    beyond: GraspSimulation | None = None
    smooth: float = 0.0


class _Cell:
    """Runs the grasps of one cell and counts them."""

    def __init__(
        self,
        design: Design,
        obj: RigidObject,
        version: SimulatorVersion,
        setup: GraspSetup,
        nominal: GraspSimulation,
        simulate: Simulate,
        deadline_s: float | None,
    ) -> None:
        self._design, self._obj, self._version, self._setup = design, obj, version, setup
        self._nominal, self._simulate = nominal, simulate
        self._deadline = None if deadline_s is None else time.monotonic() + deadline_s
        self._n_runs, self._started = 0, time.process_time()

    def result(self, branches: tuple[Branch, ...], cause: BranchCause = "", share_error: float = 0.0) -> Branches:
        """The branches with what it took to find them."""
        return Branches(branches, cause, share_error, self._n_runs, time.process_time() - self._started)

    def run(
        self, x_mm: float = 0.0, z_mm: float = 0.0, *, has_other_mesh: bool = False, has_other_steps: bool = False
    ) -> GraspSimulation | None:
        """A grasp at another placement, on the other mesh, with shorter steps; None if it fails."""
        version, limits = self._version, StepLimits()
        if has_other_mesh:
            mesh = version.mesh.model_copy(update={"edge_mm": OTHER_EDGE * version.mesh.edge_mm})
            version = version.model_copy(update={"mesh": mesh})
        if has_other_steps:
            longest = ("closing_mm", "fine_lift_mm", "lift_mm")
            limits = replace(limits, **{name: OTHER_STEP * getattr(limits, name) for name in longest})
        gaps = {name: getattr(self._setup, name) - 2.0 * x_mm for name in ("open_gap_mm", "closed_gap_mm")}
        left_s = None if self._deadline is None else self._deadline - time.monotonic()
        if left_s is not None and left_s <= 0.0:
            raise SimulationFailed("The search for a second branch ran out of time.", reason="time_out")
        self._n_runs += 1
        try:
            return self._simulate(
                self._design,
                self._obj,
                version,
                self._setup.model_copy(update=gaps),
                placement=Placement(offset_z_mm=z_mm),
                numerics=replace(find_numerics(version), limits=limits),
                deadline_s=left_s,
            )
        except SimulationFailed:
            return None

    def find_switch(self, x_mm: float, z_mm: float) -> _Side:
        """Where the branch switches on the way from the nominal placement to this one, if it does."""
        inner, outer = self._nominal, self.run(x_mm, z_mm)
        if outer is None:
            return _Side()
        low, high = 0.0, 1.0
        change = lasting_difference(inner.trace, outer.trace)
        for _ in range(N_HALVINGS):
            if change <= LEAST_JUMP:
                break
            middle = 0.5 * (low + high)
            found = self.run(middle * x_mm, middle * z_mm)
            if found is None:
                return _Side()
            to_inner, to_outer = (lasting_difference(found.trace, end.trace) for end in (inner, outer))
            if max(to_inner, to_outer) < SMOOTH_SHARE * change:
                break
            if to_inner > to_outer:
                high, outer, change = middle, found, to_inner
            else:
                low, inner, change = middle, found, to_outer
        else:
            if change > LEAST_JUMP:
                reach_mm = float(np.hypot(x_mm, z_mm))
                return _Side(low * reach_mm, high * reach_mm, outer)
        return _Side(smooth=change)


def _share_within(switches_sd: np.ndarray) -> float:
    """Share of standard normal placements on this side of the switches.

    The nearest switches of the axes lie on one straight line. One on the other side of an axis cuts off its own tail.

    switches_sd: 2 x 2, distances in standard deviations: axes, sides.
    """
    with np.errstate(divide="ignore"):
        distance = float(1.0 / np.hypot(*(1.0 / switches_sd.min(axis=1))))
    tails = sum(_NORMAL.cdf(-furthest) for furthest in switches_sd.max(axis=1).tolist())
    return max(_NORMAL.cdf(distance) - tails, 0.0)
