"""Cells with two branches: found where a snap is, with the right share, and not where the force is only sensitive."""

from collections.abc import Callable
from statistics import NormalDist

import numpy as np
import pytest

from fast.models.design.space import BEST_PUBLISHED, numbered_design
from fast.models.errors import SimulationFailed
from fast.models.objects.catalogue import get_object
from fast.models.records import Branches, Design, GraspSetup, GraspSimulation, Placement, Theta, Trace
from fast.models.simulation import branches
from fast.models.simulation.branches import LEAST_JUMP, PLACEMENT_SD_MM, find_branches, lasting_difference
from fast.models.simulation.grasp import SNAP, Numerics, simulate_grasp
from fast.models.simulation.version import SimulatorVersion
from fast.models.traces import peak_force_n, work_j

TUBE, CONE = get_object(14), get_object(24)
VERSION, SETUP = SimulatorVersion(), GraspSetup()
HALF_LIFT = GraspSetup(max_lift_mm=22)  # 8 mm further than the tube's snap


def grasp_of(lift_mm: np.ndarray, force_n: np.ndarray, flag: str) -> GraspSimulation:
    trace = Trace(3.0 + lift_mm / 5.0, lift_mm, force_n)
    return GraspSimulation(trace, peak_force_n(trace), 2.0, work_j(trace), 1, 1, 1, 0.0, flag=flag)


def held(force_n: float = 6.0, snaps: bool = False, release_mm: float = 50.0) -> GraspSimulation:
    """A force that falls slowly until it is let go with a push; a snap at 15 mm takes a third of it for 20 mm."""
    lift = np.linspace(0.0, 60.0, 241)
    force = force_n * (1.0 - 0.008 * lift)
    if snaps:
        force -= 0.33 * force_n * ((lift > 15.0) & (lift < 35.0))
    force[lift > release_mm] = 0.0
    force[(lift > release_mm) & (lift < release_mm + 1.0)] = -1.5 * force_n
    return grasp_of(lift, force, SNAP if snaps else "")


class MadeUp:
    """Stands for `simulate_grasp`: a grasp by how far the fingers are moved (x > 0: nearer), height, mesh and steps."""

    def __init__(self, grasp: Callable[[float, float, float, float], GraspSimulation]) -> None:
        self.grasp = grasp
        self.n_calls = 0

    def __call__(
        self,
        design: Design,
        obj: object,
        version: SimulatorVersion,
        setup: GraspSetup,
        *,
        placement: Placement,
        numerics: Numerics,
        deadline_s: float | None,
    ) -> GraspSimulation:
        self.n_calls += 1
        x_mm = 0.5 * (SETUP.closed_gap_mm - setup.closed_gap_mm)
        assert setup.open_gap_mm - setup.closed_gap_mm == pytest.approx(SETUP.open_gap_mm - SETUP.closed_gap_mm)
        return self.grasp(x_mm, placement.offset_z_mm, version.mesh.edge_mm, numerics.limits.lift_mm)

    def search(self, deadline_s: float | None = None) -> Branches:
        nominal = self.grasp(0.0, 0.0, VERSION.mesh.edge_mm, 2.0)
        return find_branches(BEST_PUBLISHED, TUBE, VERSION, SETUP, nominal, deadline_s=deadline_s, simulate=self)


def test_a_snap_that_placement_decides_is_found_with_its_share() -> None:
    found = MadeUp(lambda x, z, edge, step: held(snaps=x < -0.13)).search()
    assert found.cause == "placement"
    nominal, other = found.branches
    expected = NormalDist().cdf(0.13 / PLACEMENT_SD_MM)
    assert nominal.share == pytest.approx(expected, abs=found.share_error + 1e-3)
    assert 0.0 < found.share_error < 0.07
    assert nominal.share + other.share == pytest.approx(1.0)
    assert other.result.work_j < 0.95 * nominal.result.work_j


def test_a_switch_in_two_directions_leaves_less_than_in_one() -> None:
    one = MadeUp(lambda x, z, edge, step: held(snaps=x < -0.13)).search()
    both = MadeUp(lambda x, z, edge, step: held(snaps=x + z < -0.13)).search()
    assert both.branches[0].share < one.branches[0].share
    assert both.branches[0].share == pytest.approx(NormalDist().cdf(0.13 / PLACEMENT_SD_MM / np.sqrt(2)), abs=0.1)


def test_a_nominal_grasp_that_snaps_is_tried_on_all_sides() -> None:
    found = MadeUp(lambda x, z, edge, step: held(snaps=z > -0.23)).search()
    assert found.cause == "placement"
    assert found.branches[1].result.flag == ""
    assert found.branches[0].share == pytest.approx(NormalDist().cdf(0.23 / PLACEMENT_SD_MM), abs=0.05)


def test_a_cell_without_a_snap_costs_one_run() -> None:
    simulate = MadeUp(lambda x, z, edge, step: held(6.0 + 0.3 * x))
    found = simulate.search()
    assert (simulate.n_calls, found.n_runs, found.cause, len(found.branches)) == (1, 1, "", 1)
    assert found.branches[0].share == 1.0


@pytest.mark.parametrize("per_mm", [0.5, 2.0])
def test_a_force_that_is_only_sensitive_has_one_branch(per_mm: float) -> None:
    simulate = MadeUp(lambda x, z, edge, step: held(6.0 * (1.0 + per_mm * (x + z)), snaps=True))
    assert lasting_difference(held().trace, held(6.0 * (1.0 + 0.4 * per_mm)).trace) > LEAST_JUMP
    assert simulate.search().cause == ""


def test_a_switch_beyond_the_reach_of_placement_does_not_count() -> None:
    assert MadeUp(lambda x, z, edge, step: held(snaps=x < -0.5)).search().cause == ""


@pytest.mark.parametrize("what", ["mesh", "steps"])
def test_what_only_numerics_decides_is_half_of_each(what: str) -> None:
    found = MadeUp(
        lambda x, z, edge, step: held(snaps=(edge == VERSION.mesh.edge_mm) if what == "mesh" else step == 2.0)
    ).search()
    assert found.cause == "numerics"
    assert [branch.share for branch in found.branches] == [0.5, 0.5]
    assert found.share_error == 0.5


def test_runs_that_fail_are_left_out() -> None:
    def fails_far_away(x: float, z: float, edge: float, step: float) -> GraspSimulation:
        if abs(x) > 0.3 or edge != VERSION.mesh.edge_mm:
            raise SimulationFailed("No equilibrium.", reason="no_convergence")
        return held(snaps=z < 0.1)

    found = MadeUp(fails_far_away).search()
    assert found.cause == "placement"
    assert found.branches[0].share == pytest.approx(NormalDist().cdf(0.1 / PLACEMENT_SD_MM), abs=0.1)


def test_a_search_ends_at_its_deadline() -> None:
    with pytest.raises(SimulationFailed, match="ran out of time") as caught:
        MadeUp(lambda x, z, edge, step: held()).search(deadline_s=0.0)
    assert caught.value.reason == "time_out"


def test_letting_go_a_little_later_is_no_other_branch() -> None:
    assert lasting_difference(held().trace, held(release_mm=50.75).trace) < 0.01
    assert lasting_difference(held().trace, held(snaps=True).trace) == pytest.approx(0.3, abs=0.05)


def test_the_share_is_that_of_normal_placements_on_this_side_of_the_line() -> None:
    far, normal = float("inf"), NormalDist()

    def share(*switches_sd: list[float]) -> float:
        return branches._share_within(np.array(switches_sd))

    assert share([far, far], [far, far]) == 1.0
    assert share([1.0, far], [far, far]) == pytest.approx(normal.cdf(1.0))
    assert share([1.0, 1.5], [far, far]) == pytest.approx(normal.cdf(1.0) - normal.cdf(-1.5))
    assert share([far, 0.6], [0.8, far]) == pytest.approx(normal.cdf(0.48))
    assert share([0.0, far], [far, far]) == 0.5
    rng = np.random.default_rng(1)
    x, z = rng.standard_normal((2, 200_000))
    assert share([far, 0.6], [0.8, far]) == pytest.approx(np.mean(x / 0.6 - z / 0.8 < 1.0), abs=0.005)


def test_the_tube_has_two_branches_at_this_friction() -> None:
    """A rib of random design 3 snaps off the tube or holds on, at one and the same friction."""
    version = SimulatorVersion(theta=Theta(friction=0.62, poisson_ratio=0.43))
    design = numbered_design(3)
    nominal = simulate_grasp(design, TUBE, version, HALF_LIFT)
    found = find_branches(design, TUBE, version, HALF_LIFT, nominal)
    assert found.cause != ""
    assert [branch.result.flag for branch in found.branches] == ["", SNAP]
    assert 0.3 < found.branches[0].share < 0.9
    assert lasting_difference(nominal.trace, found.branches[1].result.trace) > 0.15


def test_the_cone_has_one_branch() -> None:
    nominal = simulate_grasp(BEST_PUBLISHED, CONE, setup=HALF_LIFT)
    found = find_branches(BEST_PUBLISHED, CONE, VERSION, HALF_LIFT, nominal)
    assert (nominal.flag, found.cause, found.n_runs) == ("", "", 1)
