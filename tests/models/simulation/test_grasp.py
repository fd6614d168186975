"""Whole grasps: scale laws, symmetries, features of the paper's traces, failures that are honest."""

import numpy as np
import pytest

from fast.models.design.space import BEST_PUBLISHED, numbered_design, random_designs
from fast.models.errors import SimulationFailed, UsageError
from fast.models.objects.catalogue import get_object
from fast.models.objects.rigid import RigidObject
from fast.models.records import Design, GraspSetup, GraspSimulation, Placement, Theta
from fast.models.simulation.contact.law import ContactLaw
from fast.models.simulation.effects.contact import StaticKineticFriction
from fast.models.simulation.effects.geometry import WallThicknessOffset
from fast.models.simulation.grasp import RIM, Numerics, simulate_grasp
from fast.models.simulation.mesh.build import build_mesh
from fast.models.simulation.solver.stepping import LOCATED, StepLimits
from fast.models.simulation.version import MeshSettings, SimulatorVersion
from fast.models.traces.step_features import step_means

SPHERE, CUBE, CONE, SPIRAL, TRIANGLE = (get_object(i) for i in (1, 30, 24, 13, 21))
COARSE = SimulatorVersion(mesh=MeshSettings(edge_mm=12))  # for what holds on every mesh
ONE_RIB = numbered_design(1)  # for what holds for every finger
SHORT = GraspSetup(max_lift_mm=5)  # to the peak and a little further
PROTOTYPE_SETUP = GraspSetup(closed_gap_mm=26)  # overlap of 12 mm with objects of 50 mm


def solid_of(object_class: str, parameters: dict[str, float], orientation: str = "axis z") -> RigidObject:
    return RigidObject.model_validate(
        {
            "object_id": 99,
            "name": "reference",
            "object_class": object_class,
            "parameters": parameters,
            "orientation": orientation,
            "mirror_x": True,
            "mirror_y": True,
        }
    )


def peak_and_force(design: Design, obj: RigidObject, young_modulus_mpa: float) -> GraspSimulation:
    return simulate_grasp(design, obj, SimulatorVersion(theta=Theta(young_modulus_mpa=young_modulus_mpa)))


@pytest.fixture(scope="module")
def cube() -> GraspSimulation:
    return simulate_grasp(BEST_PUBLISHED, CUBE)


# Peak of one finger in N by the prototype's finest mesh, 12.9 k unknowns and sharp corners.
@pytest.mark.parametrize(
    ("obj", "peak_n"),
    [
        (solid_of("sphere", {"diameter_mm": 50}), 6.51),
        (solid_of("cylinder", {"diameter_mm": 50, "length_mm": 50, "rounding_mm": 1}, "axis y"), 6.97),
        (solid_of("cube", {"size_x_mm": 50, "size_y_mm": 50, "size_z_mm": 50, "rounding_mm": 1}), 10.59),
    ],
)
def test_peaks_agree_with_the_prototype(obj: RigidObject, peak_n: float) -> None:
    result = simulate_grasp(BEST_PUBLISHED, obj, setup=PROTOTYPE_SETUP)
    assert result.peak_force_n / 2 == pytest.approx(peak_n, rel=0.03)
    assert result.cpu_s < 10


def test_force_is_exactly_proportional_to_the_modulus(cube: GraspSimulation) -> None:
    double = peak_and_force(BEST_PUBLISHED, CUBE, 2 * 11.5)
    assert np.array_equal(double.trace.force_n, 2 * cube.trace.force_n)
    assert np.array_equal(double.trace.lift_mm, cube.trace.lift_mm)
    assert double.contact_force_n == 2 * cube.contact_force_n


def test_result_repeats_bit_for_bit(cube: GraspSimulation) -> None:
    again = simulate_grasp(BEST_PUBLISHED, CUBE, mesh=build_mesh(BEST_PUBLISHED, MeshSettings()))
    assert np.array_equal(again.trace.force_n, cube.trace.force_n)


def test_full_width_and_both_fingers_agree_with_the_symmetric_model() -> None:
    cube = simulate_grasp(ONE_RIB, CUBE, COARSE)
    wide = simulate_grasp(ONE_RIB, CUBE.model_copy(update={"mirror_y": False}), COARSE, SHORT)
    half = simulate_grasp(ONE_RIB, CUBE, COARSE, SHORT)
    assert wide.peak_force_n == pytest.approx(half.peak_force_n, rel=2e-4)
    assert wide.n_dof > 1.7 * cube.n_dof
    both = simulate_grasp(ONE_RIB, CUBE.model_copy(update={"mirror_x": False}), COARSE)
    assert np.allclose(both.trace.force_n, cube.trace.force_n, atol=1e-9)
    assert both.contact_force_n == pytest.approx(cube.contact_force_n)


def test_trace_follows_the_sequence(cube: GraspSimulation) -> None:
    trace, setup = cube.trace, GraspSetup()
    assert trace.time_s[0] == trace.lift_mm[0] == trace.force_n[0] == 0.0
    assert (np.diff(trace.time_s) > 0).all()
    closing_s = (setup.open_gap_mm - setup.closed_gap_mm) / 2 / setup.close_speed_mm_per_s
    lifting = trace.lift_mm > 0
    assert np.allclose((trace.time_s[lifting] - closing_s) * setup.lift_speed_mm_per_s, trace.lift_mm[lifting])
    assert (trace.lift_mm[trace.time_s <= closing_s] == 0.0).all()
    assert abs(trace.force_n[-1]) < 0.3
    first = trace.lift_mm[(trace.lift_mm > 0) & (trace.lift_mm <= 3.0)]
    assert np.diff(first).max() <= 0.5 + 1e-9


def test_traces_show_the_features_of_the_paper(cube: GraspSimulation) -> None:
    sphere, cone = simulate_grasp(BEST_PUBLISHED, SPHERE), simulate_grasp(BEST_PUBLISHED, CONE)
    for result in (cube, sphere, cone):
        assert result.trace.force_n[~result.trace.is_lift].min() < -5.0  # closing pushes the gripper up
    # The cone lets go within a few millimetres; the cube holds on a plateau while rib after rib leaves its edge.
    assert np.interp(12.0, cone.trace.lift_mm, cone.trace.force_n) < 0.4 * cone.peak_force_n
    assert np.interp(12.0, cube.trace.lift_mm, cube.trace.force_n) > 0.6 * cube.peak_force_n
    assert cone.peak_force_n < sphere.peak_force_n < cube.peak_force_n


def test_friction_and_modulus_enter_as_expected() -> None:
    low, high, none = (
        simulate_grasp(BEST_PUBLISHED, SPHERE, COARSE.model_copy(update={"theta": Theta(friction=friction)}), SHORT)
        for friction in (0.3, 0.8, 0.0)
    )
    assert none.peak_force_n < 0.3 * low.peak_force_n < 0.3 * high.peak_force_n


def test_shifted_object_breaks_the_symmetry_of_the_fingers() -> None:
    right = simulate_grasp(BEST_PUBLISHED, SPHERE, COARSE, SHORT, placement=Placement(offset_x_mm=1.5))
    left = simulate_grasp(BEST_PUBLISHED, SPHERE, COARSE, SHORT, placement=Placement(offset_x_mm=-1.5))
    nominal = simulate_grasp(BEST_PUBLISHED, SPHERE, COARSE, SHORT)
    assert right.peak_force_n == pytest.approx(left.peak_force_n, rel=1e-9)
    assert right.peak_force_n == pytest.approx(nominal.peak_force_n, rel=0.1)
    assert right.peak_force_n != nominal.peak_force_n


def test_only_a_pull_that_hangs_on_a_rim_is_flagged() -> None:
    """A refined section changes the trace by 0.8 N on the diabolo, by 0.3 N on the turned cube (at 9.2 MPa)."""
    strong, weak = numbered_design(50), numbered_design(51)
    diabolo, turned_cube = get_object(26), get_object(32)
    assert simulate_grasp(strong, diabolo).flag == RIM
    assert simulate_grasp(strong, turned_cube).flag == ""
    assert simulate_grasp(weak, diabolo).flag == ""


def test_raised_object_is_a_lowered_finger() -> None:
    raised = simulate_grasp(BEST_PUBLISHED, SPHERE, COARSE, SHORT, placement=Placement(offset_z_mm=2.0))
    lowered = simulate_grasp(BEST_PUBLISHED, SPHERE, COARSE, SHORT.model_copy(update={"tip_below_mm": 7}))
    assert raised.peak_force_n == pytest.approx(lowered.peak_force_n, rel=1e-6)


def test_jaws_that_stay_open_feel_nothing() -> None:
    result = simulate_grasp(BEST_PUBLISHED, get_object(31), setup=GraspSetup(closed_gap_mm=60))
    assert result.contact_force_n == 0.0
    # Two fingers set in motion within the first step, 0.02 s, and Newton's tolerance.
    assert np.abs(result.trace.force_n).max() < 0.03


def test_crossing_jaws_press_on_each_other() -> None:
    setup = GraspSetup(closed_gap_mm=-4, tip_below_mm=-35)
    result = simulate_grasp(BEST_PUBLISHED, get_object(11), setup=setup)
    assert result.contact_force_n > 1.0
    assert abs(result.trace.force_n).max() < 0.1  # far above the object only the mirror plane is touched


def test_objects_without_symmetry_use_the_full_finger() -> None:
    result = simulate_grasp(BEST_PUBLISHED, SPIRAL, setup=SHORT)
    assert result.n_dof > 2500
    assert result.peak_force_n > 5.0


def test_effects_at_zero_are_identical_and_act_in_the_right_direction(cube: GraspSimulation) -> None:
    neutral = simulate_grasp(BEST_PUBLISHED, CUBE, effects=[StaticKineticFriction(1.0, 1.0), WallThicknessOffset(0.0)])
    assert np.array_equal(neutral.trace.force_n, cube.trace.force_n)
    weaker = simulate_grasp(BEST_PUBLISHED, CUBE, effects=[StaticKineticFriction(0.6, 0.5)])
    assert weaker.work_j < 0.9 * cube.work_j
    thicker = simulate_grasp(BEST_PUBLISHED, CUBE, effects=[WallThicknessOffset(0.1)])
    assert 1.02 < thicker.peak_force_n / cube.peak_force_n < 1.3


TURNED_CUBE = get_object(32)  # lets go of its edge at 39 mm of lift with a short negative force
HALF_STEPS = Numerics(limits=StepLimits(closing_mm=1.0, fine_lift_mm=0.25, lift_mm=1.0, event_mm=0.02, missed_mm=0.02))


@pytest.fixture(scope="module")
def letting_go() -> GraspSimulation:
    return simulate_grasp(BEST_PUBLISHED, TURNED_CUBE)


def test_the_trace_is_converged_in_the_step_although_the_force_jumps(letting_go: GraspSimulation) -> None:
    fine = simulate_grasp(BEST_PUBLISHED, TURNED_CUBE, numerics=HALF_STEPS)
    errors_n = step_means(letting_go.trace) - step_means(fine.trace)
    # Without located events: 0.4 N or more, for the negative force is skipped or taken for a millimetre long.
    assert np.sqrt(np.mean(errors_n**2)) < 0.02 * fine.peak_force_n
    assert letting_go.work_j == pytest.approx(fine.work_j, rel=0.01)


def test_the_last_touch_is_located(letting_go: GraspSimulation) -> None:
    trace = letting_go.trace
    held = np.flatnonzero(np.abs(trace.force_n) > 0.02 * letting_go.peak_force_n)[-1]
    assert trace.force_n[held] < -0.05 * letting_go.peak_force_n  # on the edge, just before it lets go
    step_mm = trace.lift_mm[held + 1] - trace.lift_mm[held]
    assert step_mm <= LOCATED * StepLimits().event_mm + 1e-9


def test_steps_are_short_only_where_something_happens(letting_go: GraspSimulation) -> None:
    steps_mm = np.diff(letting_go.trace.lift_mm[letting_go.trace.is_lift])
    assert steps_mm.max() == pytest.approx(StepLimits().lift_mm)
    assert len(steps_mm) < 120  # as short as its shortest step everywhere it would take 1,300


def test_slip_weakening_converges_with_the_step() -> None:
    effect = StaticKineticFriction(0.6, 1.0)
    coarse = simulate_grasp(BEST_PUBLISHED, SPHERE, setup=SHORT, effects=[effect])
    steps = Numerics(limits=StepLimits(closing_mm=1.0, fine_lift_mm=0.25, lift_mm=1.0))
    fine = simulate_grasp(BEST_PUBLISHED, SPHERE, setup=SHORT, effects=[effect], numerics=steps)
    assert coarse.peak_force_n == pytest.approx(fine.peak_force_n, rel=0.05)


def test_a_removed_tier_is_refused_in_one_sentence() -> None:
    with pytest.raises(UsageError, match="The simulator tier `screening` was removed; simulate with `production`"):
        simulate_grasp(BEST_PUBLISHED, SPHERE, SimulatorVersion(tier="screening"))


def test_time_and_step_limits_fail_with_a_reason() -> None:
    with pytest.raises(SimulationFailed, match="wall-clock limit") as late:
        simulate_grasp(BEST_PUBLISHED, SPHERE, deadline_s=0.0)
    assert late.value.reason == "time_out"
    with pytest.raises(SimulationFailed, match="Stopped after 5 steps") as long:
        simulate_grasp(BEST_PUBLISHED, SPHERE, numerics=Numerics(limits=StepLimits(max_steps=5)))
    assert long.value.reason == "max_steps"


def test_point_contact_of_a_rim_is_converged_in_the_penalty() -> None:
    diabolo = get_object(26)
    stiffer = Numerics(contact=ContactLaw(normal_n_per_mm3=8.0, tangential_n_per_mm3=8.0))
    usual = simulate_grasp(BEST_PUBLISHED, diabolo)
    stiff = simulate_grasp(BEST_PUBLISHED, diabolo, numerics=stiffer)
    assert usual.peak_force_n == pytest.approx(stiff.peak_force_n, rel=0.04)
    assert usual.work_j == pytest.approx(stiff.work_j, rel=0.02)


@pytest.mark.parametrize(
    ("mesh", "n_designs"), [(MeshSettings(edge_mm=12), 1), pytest.param(MeshSettings(), 3, marks=pytest.mark.study)]
)
def test_random_designs_never_fail(mesh: MeshSettings, n_designs: int) -> None:
    rng = np.random.default_rng(20)
    version = SimulatorVersion(theta=Theta(poisson_ratio=0.49), mesh=mesh)
    peaks = []
    for design in random_designs(n_designs, rng):
        for obj in (CUBE, TRIANGLE, get_object(26), get_object(28)):
            result = simulate_grasp(design, obj, version, deadline_s=120)
            peaks.append(result.peak_force_n)
    assert min(peaks) > 0.0
    assert max(peaks) < 150.0
