"""Snapshots of a grasp agree with its trace; the drawn surface is that of the finger."""

import numpy as np
import pytest
import trimesh

from fast.models.design.space import BEST_PUBLISHED
from fast.models.objects.catalogue import get_object
from fast.models.records import GraspSimulation, Placement, Theta
from fast.models.simulation.grasp import simulate_grasp
from fast.models.simulation.mesh.build import build_mesh
from fast.models.simulation.output.pressure import patch_pressure
from fast.models.simulation.output.recording import GraspRecording
from fast.models.simulation.output.surface import section_of, section_outline, skin_of
from fast.models.simulation.version import MeshSettings, SimulatorVersion

SPHERE = get_object(1)
COARSE = SimulatorVersion(mesh=MeshSettings(edge_mm=10), theta=Theta(young_modulus_mpa=23.0))


@pytest.fixture(scope="module")
def filmed() -> tuple[GraspSimulation, GraspRecording]:
    recording = GraspRecording()
    return simulate_grasp(BEST_PUBLISHED, SPHERE, COARSE, recorder=recording.add), recording


def test_recording_changes_nothing(filmed: tuple[GraspSimulation, GraspRecording]) -> None:
    plain = simulate_grasp(BEST_PUBLISHED, SPHERE, COARSE)
    assert np.array_equal(plain.trace.force_n, filmed[0].trace.force_n)


def test_snapshots_are_the_samples_of_the_trace(filmed: tuple[GraspSimulation, GraspRecording]) -> None:
    result, recording = filmed
    snapshots = recording.of("right")
    assert recording.of("left") is snapshots  # the sphere is symmetric in x
    at = np.searchsorted(result.trace.time_s, [s.time_s for s in snapshots])
    assert np.array_equal(result.trace.time_s[at], [s.time_s for s in snapshots])
    assert np.allclose(result.trace.lift_mm[at], [s.lift_mm for s in snapshots])
    assert np.allclose(result.trace.force_n[at], [2.0 * s.scale * s.clamp_force[2] for s in snapshots])
    assert [s.phase for s in snapshots] == sorted(s.phase for s in snapshots)
    assert snapshots[0].displacement_mm.max() == 0.0


def test_contact_balances_the_clamp(filmed: tuple[GraspSimulation, GraspRecording]) -> None:
    closed = [s for s in filmed[1].of("right") if s.phase == "closing"][-1]
    on_finger = 2.0 * closed.contact_force.sum(axis=0)  # of both halves
    # Apart from inertia and the nodes under the clamp the finger is in equilibrium.
    assert on_finger[[0, 2]] == pytest.approx(-closed.clamp_force[[0, 2]], rel=0.02)
    assert (SPHERE.mirror_y, closed.mesh.is_half) == (True, True)
    middle = closed.contact_points - np.array([0.0, 0.0, 20.0])
    assert np.einsum("ci,ci->c", middle, closed.contact_normals) == pytest.approx(20.0, abs=0.5)


def test_the_largest_pressure_is_that_of_ten_square_millimetres(
    filmed: tuple[GraspSimulation, GraspRecording],
) -> None:
    result, recording = filmed
    largest_kpa = 0.0
    for snapshot in recording.of("right"):
        order = np.argsort(-snapshot.pressure)
        area_mm2 = np.concatenate([[0.0], np.cumsum(2.0 * snapshot.contact_areas[order])])  # of both halves
        force_n = np.concatenate([[0.0], np.cumsum((2.0 * snapshot.contact_areas * snapshot.pressure)[order])])
        largest_kpa = max(largest_kpa, 1e3 * snapshot.scale * np.interp(10.0, area_mm2, force_n) / 10.0)
    assert result.pressure_kpa == pytest.approx(largest_kpa)
    assert 50.0 < largest_kpa < 2000.0


def test_half_a_finger_presses_as_a_whole_one_and_in_proportion_to_its_modulus(
    filmed: tuple[GraspSimulation, GraspRecording],
) -> None:
    mesh = build_mesh(BEST_PUBLISHED, COARSE.mesh, full_width=True)
    theta = Theta(young_modulus_mpa=2.0 * COARSE.theta.young_modulus_mpa)
    stiffer = simulate_grasp(BEST_PUBLISHED, SPHERE, COARSE.model_copy(update={"theta": theta}), mesh=mesh)
    assert stiffer.pressure_kpa == pytest.approx(2.0 * filmed[0].pressure_kpa, rel=0.03)


@pytest.mark.parametrize(
    ("pressure", "patch_mm2", "mean"),
    [([0.0, 0.0], 10.0, 0.0), ([2.0, 4.0], 5.0, 3.6), ([2.0, 4.0], 10.0, 2.4), ([2.0, 4.0], 1.0, 4.0)],
)
def test_pressure_is_a_mean_over_what_is_pressed_most(pressure: list[float], patch_mm2: float, mean: float) -> None:
    areas_mm2 = np.array([4.0, 4.0])
    assert patch_pressure(np.array(pressure), areas_mm2, patch_mm2) == pytest.approx(mean)


def test_a_shifted_object_has_a_finger_on_either_side() -> None:
    recording = GraspRecording()
    placement = Placement(offset_x_mm=1.0)
    simulate_grasp(BEST_PUBLISHED, SPHERE, COARSE, placement=placement, recorder=recording.add)
    right, left = recording.of("right"), recording.of("left")
    assert {s.side for s in left} == {"left"}
    # The object came nearer to the right finger, so that one touches earlier.
    assert right[0].time_s < left[0].time_s


@pytest.mark.parametrize("full_width", [False, True])
@pytest.mark.parametrize("settings", [MeshSettings(), MeshSettings(edge_mm=10)])
def test_skin_is_the_closed_surface_of_the_whole_finger(settings: MeshSettings, full_width: bool) -> None:
    mesh = build_mesh(BEST_PUBLISHED, settings, full_width=full_width)
    skin = skin_of(mesh)
    surface = trimesh.Trimesh(skin.vertices(mesh.nodes), skin.triangles)
    assert surface.is_watertight
    section = section_of(mesh)
    area = sum(_area(mesh.nodes[rim][:, [0, 2]]) for rim in section)
    assert surface.volume == pytest.approx(BEST_PUBLISHED.width_mm * area, rel=1e-6)
    # One closed outline around every cavity and around the finger.
    _, degree = np.unique(section_outline(section), return_counts=True)
    assert (degree == 2).all()


def _area(corners: np.ndarray) -> float:
    x, z = corners.T
    return 0.5 * abs(float(np.dot(x, np.roll(z, -1)) - np.dot(z, np.roll(x, -1))))
