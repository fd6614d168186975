"""Grasps off the nominal place: which part is solved, mirror images, the twist of the tips, and places that fail."""

import numpy as np
import pytest

from fast.models.design.space import BEST_PUBLISHED, numbered_design
from fast.models.errors import SimulationFailed, UsageError
from fast.models.objects.catalogue import get_object
from fast.models.objects.rigid import RigidObject
from fast.models.records import GraspSetup, GraspSimulation, Placement
from fast.models.simulation.grasp import simulate_grasp
from fast.models.simulation.mesh.build import build_mesh
from fast.models.simulation.model import roll
from fast.models.simulation.output.recording import GraspRecording, Snapshot
from fast.models.simulation.output.twist import TwistGauge, rotation_between, twist_about_z_deg
from fast.models.simulation.placement import check_reach, describe_placement, find_symmetry, needs_full_width
from fast.models.simulation.version import MeshSettings, SimulatorVersion

SPHERE, CYLINDER_X, SPIRAL, TRIANGLE, CONE, CUBE, TURNED_CUBE = (get_object(i) for i in (1, 7, 13, 21, 24, 30, 32))
COARSE = SimulatorVersion(mesh=MeshSettings(edge_mm=12))
SHORT = GraspSetup(max_lift_mm=5)  # to the peak and a little further
ASKEW = Placement(offset_x_mm=0.5, offset_y_mm=1.0, yaw_deg=4.0, roll_deg=2.0)


def grasp(obj: RigidObject, placement: Placement, setup: GraspSetup = SHORT) -> GraspSimulation:
    return simulate_grasp(BEST_PUBLISHED, obj, COARSE, setup, placement=placement)


def same_trace(one: GraspSimulation, other: GraspSimulation) -> bool:
    """Equal but for rounding: a mirrored mesh sums the same forces in another order."""
    return one.trace.force_n.shape == other.trace.force_n.shape and np.allclose(
        one.trace.force_n, other.trace.force_n, rtol=0, atol=1e-9
    )


@pytest.fixture(scope="module")
def askew() -> GraspSimulation:
    return grasp(TURNED_CUBE, ASKEW)


@pytest.fixture(scope="module")
def turned() -> GraspSimulation:
    return grasp(TURNED_CUBE, Placement(yaw_deg=5.0))


# Object, placement; half a finger is enough, one finger is enough.
@pytest.mark.parametrize(
    ("obj", "placement", "half", "one"),
    [
        (CUBE, Placement(), True, True),
        (CUBE, Placement(offset_z_mm=3.0), True, True),
        (CUBE, Placement(offset_x_mm=1.0), True, False),
        (CUBE, Placement(offset_y_mm=1.0), False, True),
        (CUBE, Placement(offset_x_mm=1.0, offset_y_mm=1.0), False, False),
        (CUBE, Placement(yaw_deg=1.0), False, True),
        (CUBE, Placement(roll_deg=1.0), False, True),
        (CUBE, Placement(yaw_deg=1.0, offset_y_mm=1.0), False, False),
        (SPHERE, Placement(yaw_deg=1.0), True, True),
        (SPHERE, Placement(roll_deg=1.0), False, True),
        (SPHERE, Placement(roll_deg=1.0, offset_y_mm=1.0), False, False),
        (CONE, Placement(yaw_deg=1.0, offset_y_mm=1.0), False, True),
        (CYLINDER_X, Placement(yaw_deg=1.0), False, True),
        (SPIRAL, Placement(), False, False),
        (TRIANGLE, Placement(), True, False),
        (TRIANGLE, Placement(yaw_deg=1.0), False, False),
    ],
)
def test_symmetry_decides_what_is_solved(obj: RigidObject, placement: Placement, half: bool, one: bool) -> None:
    assert needs_full_width(obj, placement) != half
    assert find_symmetry(obj, placement).sides == (("right",) if one else ("right", "left"))


def test_mirror_image_in_y_has_the_same_trace(askew: GraspSimulation) -> None:
    mirrored = grasp(TURNED_CUBE, ASKEW.model_copy(update={"offset_y_mm": -1.0, "yaw_deg": -4.0, "roll_deg": -2.0}))
    assert same_trace(mirrored, askew)
    assert mirrored.twist_deg == pytest.approx(askew.twist_deg, rel=1e-6)


def test_mirror_image_in_x_swaps_the_fingers(askew: GraspSimulation) -> None:
    mirrored = grasp(TURNED_CUBE, ASKEW.model_copy(update={"offset_x_mm": -0.5, "yaw_deg": -4.0, "roll_deg": -2.0}))
    assert same_trace(mirrored, askew)
    assert mirrored.contact_force_n == pytest.approx(askew.contact_force_n, rel=1e-9)


def test_twisted_grasp_repeats_bit_for_bit(askew: GraspSimulation) -> None:
    grasp(SPHERE, Placement(), GraspSetup(max_lift_mm=0.5))
    again = grasp(TURNED_CUBE, ASKEW)
    assert np.array_equal(again.trace.force_n, askew.trace.force_n)
    assert again.twist_deg == askew.twist_deg


def test_one_finger_after_a_half_turn_counts_for_both(turned: GraspSimulation) -> None:
    both = grasp(TURNED_CUBE.model_copy(update={"mirror_x": False}), Placement(yaw_deg=5.0))
    assert both.n_steps == 2 * turned.n_steps
    assert same_trace(both, turned)
    assert both.contact_force_n == pytest.approx(turned.contact_force_n, rel=1e-9)
    assert both.twist_deg == pytest.approx(turned.twist_deg, rel=1e-6)


def test_yaw_of_a_round_object_changes_nothing() -> None:
    nominal, turned = grasp(SPHERE, Placement()), grasp(SPHERE, Placement(yaw_deg=30.0))
    assert np.array_equal(turned.trace.force_n, nominal.trace.force_n)
    assert turned.n_dof == nominal.n_dof
    assert turned.twist_deg == 0.0


def test_tips_turn_with_the_flat_side_that_they_press_on() -> None:
    closing = GraspSetup(max_lift_mm=0.5)
    assert grasp(CUBE, Placement(yaw_deg=5.0), closing).twist_deg == pytest.approx(5.0, abs=0.3)
    # A tool that sits askew by the same angle meets the side squarely.
    assert grasp(CUBE, Placement(yaw_deg=5.0, roll_deg=5.0), closing).twist_deg < 1.0


def friction_moment_n_mm(snapshot: Snapshot) -> float:
    """Moment of friction about the normal of the contact, at the centre of pressure."""
    press = snapshot.contact_areas * snapshot.pressure
    normal = press @ snapshot.contact_normals
    arm = snapshot.contact_points - press @ snapshot.contact_points / press.sum()
    rub = snapshot.contact_areas[:, None] * snapshot.traction
    return float(np.cross(arm, rub).sum(axis=0) @ normal / np.linalg.norm(normal))


def tip_twist_deg(snapshot: Snapshot) -> float:
    gauge = TwistGauge(snapshot.mesh, snapshot.rest_nodes, numbered_design(0).tip_length_mm)
    gauge.add(snapshot.nodes)
    return gauge.largest_deg


def test_a_lifted_finger_slides_and_no_friction_is_left_against_its_twist() -> None:
    """Why no tip slips off in torsion: pressure alone turns it, and goes on doing so."""
    recording = GraspRecording()
    place = Placement(yaw_deg=10.0)
    simulate_grasp(numbered_design(0), TURNED_CUBE, COARSE, SHORT, placement=place, recorder=recording.add)
    snapshots = [snapshot for snapshot in recording.of("right") if len(snapshot.pressure)]
    closing = max(abs(friction_moment_n_mm(snapshot)) for snapshot in snapshots if snapshot.phase == "closing")
    assert closing > 3.0
    assert abs(friction_moment_n_mm(snapshots[-1])) < 0.1 * closing
    twist_deg = [tip_twist_deg(snapshot) for snapshot in snapshots]
    assert twist_deg[-1] > 0.9 * max(twist_deg) > 3.0


def test_roll_turns_the_finger_about_the_middle_of_its_base() -> None:
    mesh = build_mesh(BEST_PUBLISHED, MeshSettings(edge_mm=12), full_width=True)
    turned = roll(mesh.nodes, mesh.base_nodes, 30.0)
    middle = mesh.nodes[mesh.base_nodes].mean(axis=0)
    x_mm = 0.5 * (mesh.nodes[mesh.base_nodes, 0].min() + mesh.nodes[mesh.base_nodes, 0].max())
    assert middle[1] == pytest.approx(0.0, abs=1e-9)
    radius = np.hypot(mesh.nodes[:, 0] - x_mm, mesh.nodes[:, 1])
    assert np.hypot(turned[:, 0] - x_mm, turned[:, 1]) == pytest.approx(radius)
    front = np.argmax(mesh.nodes[:, 1] - 1e3 * mesh.nodes[:, 0])  # a corner on the front wall, at y > 0
    assert turned[front, 0] < mesh.nodes[front, 0]  # counter-clockwise, seen from above
    assert np.array_equal(turned[:, 2], mesh.nodes[:, 2])


@pytest.mark.parametrize("twist_deg", [-170.0, -7.0, 0.0, 25.0])
def test_twist_is_what_bending_leaves(twist_deg: float) -> None:
    bend, twist = np.radians(40.0), np.radians(twist_deg)
    about_y = np.array([[np.cos(bend), 0, np.sin(bend)], [0, 1, 0], [-np.sin(bend), 0, np.cos(bend)]])
    about_z = np.array([[np.cos(twist), -np.sin(twist), 0], [np.sin(twist), np.cos(twist), 0], [0, 0, 1]])
    points = np.random.default_rng(3).normal(size=(50, 3))
    found = rotation_between(points, points @ (about_y @ about_z).T + np.array([1.0, 2.0, 3.0]))
    assert found == pytest.approx(about_y @ about_z, abs=1e-12)
    assert twist_about_z_deg(found) == pytest.approx(twist_deg)


@pytest.mark.parametrize(
    ("placement", "said"),
    [
        (
            Placement(offset_y_mm=40.0),
            "with offset_y_mm 40 it reaches from 20.0 to 60.0 mm in y, they from -16.5 to 16.5",
        ),
        (Placement(offset_x_mm=-60.0), "with offset_x_mm -60 it reaches from -80.0 to -40.0 mm in x"),
        (Placement(offset_z_mm=-50.0), "close on nothing; take an offset between -45.0 and"),
    ],
)
def test_object_outside_the_fingers_is_refused(placement: Placement, said: str) -> None:
    with pytest.raises(SimulationFailed, match=said) as failure:
        grasp(CUBE, placement)
    assert failure.value.reason == "object_outside"


def test_object_that_the_fingers_miss_anyway_is_a_legal_grasp() -> None:
    above = GraspSetup(tip_below_mm=-35)
    check_reach(get_object(11), Placement(offset_z_mm=1.0), BEST_PUBLISHED, above)
    check_reach(CUBE, Placement(offset_y_mm=36.0), BEST_PUBLISHED, GraspSetup())


def test_finger_inside_the_object_is_refused_before_it_closes() -> None:
    with pytest.raises(SimulationFailed, match=r"cube at offset_x_mm 18\) overlap by 3\.00 mm") as failure:
        grasp(CUBE, Placement(offset_x_mm=18.0))
    assert failure.value.reason == "overlap_at_start"
    with pytest.raises(SimulationFailed, match=r"open the jaws to 40\.0 mm or more") as narrow:
        grasp(CUBE, Placement(), GraspSetup(open_gap_mm=30))
    assert narrow.value.reason == "overlap_at_start"


def test_half_a_finger_is_refused_where_it_is_not_enough() -> None:
    half = build_mesh(BEST_PUBLISHED, COARSE.mesh)
    with pytest.raises(UsageError, match="half a finger is not enough for object 30 at this placement"):
        simulate_grasp(BEST_PUBLISHED, CUBE, COARSE, placement=Placement(roll_deg=1.0), mesh=half)


def test_placement_in_words() -> None:
    assert describe_placement(Placement()) == ""
    assert describe_placement(Placement(yaw_deg=5, offset_y_mm=-1)) == " at offset_y_mm -1, yaw_deg 5"
