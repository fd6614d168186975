"""Grasps in the screening tier: exact laws, symmetries, and agreement with the production tier."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import spearmanr

from models.design.space import BEST_PUBLISHED, random_designs
from models.errors import SimulationFailed, UsageError
from models.objects.catalogue import RigidObject, get_object
from models.records import Design, GraspSimulation, MeshSettings, Placement, SimulatorVersion, Theta
from models.simulation.body.assembly import Material
from models.simulation.contact.law import ContactLaw, PointSpacing
from models.simulation.effects.force_limited_closing import ForceLimitedClosing
from models.simulation.effects.static_kinetic_friction import StaticKineticFriction
from models.simulation.effects.wall_thickness_offset import WallThicknessOffset
from models.simulation.grasp import SCREENING_NUMERICS, simulate_grasp
from models.simulation.mesh.build import build_mesh
from models.simulation.mesh.plane import plane_mesh
from models.simulation.obstacle import ObjectObstacle
from models.simulation.output.recording import GraspRecording
from models.simulation.section.body import PlaneBody
from models.simulation.section.contact import PlaneSurface, width_rows

SPHERE, SPIRAL, TRIANGLE, CONE, CUBE, SMALL_CUBE = (get_object(i) for i in (1, 13, 21, 24, 30, 31))
SCREENING = SimulatorVersion(tier="screening")


def screen(design: Design, obj: RigidObject, **keywords: object) -> GraspSimulation:
    return simulate_grasp(design, obj, SCREENING, **keywords)  # type: ignore[arg-type]  # keywords of simulate_grasp


@pytest.fixture(scope="module")
def cube() -> GraspSimulation:
    return screen(BEST_PUBLISHED, CUBE)


def test_force_is_exactly_proportional_to_the_modulus(cube: GraspSimulation) -> None:
    version = SCREENING.model_copy(update={"theta": Theta(young_modulus_mpa=2 * 11.5)})
    double = simulate_grasp(BEST_PUBLISHED, CUBE, version)
    assert np.array_equal(double.trace.force_n, 2 * cube.trace.force_n)
    assert np.array_equal(double.trace.lift_mm, cube.trace.lift_mm)


def test_result_repeats_bit_for_bit_after_other_grasps(cube: GraspSimulation) -> None:
    screen(BEST_PUBLISHED, SPHERE)
    screen(random_designs(1, np.random.default_rng(0))[0], CUBE)
    assert np.array_equal(screen(BEST_PUBLISHED, CUBE).trace.force_n, cube.trace.force_n)


def test_full_width_and_both_fingers_agree_with_the_symmetric_model(cube: GraspSimulation) -> None:
    both = screen(BEST_PUBLISHED, CUBE.model_copy(update={"mirror_x": False}))
    assert np.allclose(both.trace.force_n, cube.trace.force_n, atol=1e-9)
    half, wide = (screen(BEST_PUBLISHED, SPHERE.model_copy(update={"mirror_y": m})) for m in (True, False))
    assert wide.peak_force_n == pytest.approx(half.peak_force_n, rel=1e-2)
    assert wide.n_dof == half.n_dof


def test_shifted_object_mirrors() -> None:
    right = screen(BEST_PUBLISHED, TRIANGLE, placement=Placement(offset_x_mm=1.5))
    mirrored = screen(BEST_PUBLISHED, SPHERE, placement=Placement(offset_x_mm=1.5))
    left = screen(BEST_PUBLISHED, SPHERE, placement=Placement(offset_x_mm=-1.5))
    assert mirrored.peak_force_n == pytest.approx(left.peak_force_n, rel=1e-9)
    assert right.peak_force_n > 0.0


def test_one_row_of_points_is_enough_where_the_object_is_the_same_over_the_width() -> None:
    mesh = plane_mesh(BEST_PUBLISHED, MeshSettings())

    def rows(obj: RigidObject) -> int:
        y, width = width_rows(ObjectObstacle(obj, Placement(), is_mirrored=False), mesh, 0.5)
        assert width.sum() == pytest.approx(mesh.width_mm)
        assert (np.abs(y) < mesh.width_mm).all()
        return len(y)

    assert rows(CUBE) == rows(get_object(6)) == rows(get_object(35)) == 1
    assert rows(SPHERE) == rows(SMALL_CUBE) == rows(get_object(18)) == int(np.ceil(mesh.width_mm / 0.5))


def test_contact_force_balances_the_pressure_on_a_pressed_cube() -> None:
    mesh = plane_mesh(BEST_PUBLISHED, MeshSettings(), full_width=True)
    nodes = np.ascontiguousarray(mesh.nodes * [1.0, -1.0] + [0.0, BEST_PUBLISHED.height_mm - 5.0])
    body = PlaneBody(mesh, nodes, Material(11.5, 0.45))
    law = ContactLaw()
    surface = PlaneSurface(body, nodes, law, PointSpacing(), ObjectObstacle(CUBE, Placement(), is_mirrored=False))
    x = nodes + [19.9, 0.0]
    response = surface.respond(x, surface.start(x), np.full(surface.n_points, 0.5), stop_mm=0.0)
    pressure = law.normal_n_per_mm3 * (0.1 - 0.5 * law.smoothing_mm)  # of the flat side of 40 mm less two roundings
    assert response.force[:, 0].sum() == pytest.approx(pressure * 38.0 * mesh.width_mm, rel=0.02)
    blocks = np.zeros((len(body.pattern.indices), 2, 2))
    surface.add_stiffness(response, blocks)
    assert blocks[:, 0, 0].sum() > 0.0


def test_effects_act_as_in_the_solid(cube: GraspSimulation) -> None:
    neutral = screen(BEST_PUBLISHED, CUBE, effects=[StaticKineticFriction(1.0, 1.0), WallThicknessOffset(0.0)])
    assert np.array_equal(neutral.trace.force_n, cube.trace.force_n)
    assert screen(BEST_PUBLISHED, CUBE, effects=[StaticKineticFriction(0.6, 0.5)]).work_j < 0.9 * cube.work_j
    thicker = screen(BEST_PUBLISHED, CUBE, effects=[WallThicknessOffset(0.1)])
    assert 1.02 < thicker.peak_force_n / cube.peak_force_n < 1.3
    stalled = screen(BEST_PUBLISHED, CUBE, effects=[ForceLimitedClosing(max_force_n=0.5 * cube.contact_force_n)])
    assert stalled.contact_force_n == pytest.approx(0.5 * cube.contact_force_n, rel=0.05)


def test_recording_shows_the_section_as_a_solid(cube: GraspSimulation) -> None:
    recording = GraspRecording()
    result = screen(BEST_PUBLISHED, CUBE, recorder=recording.add)
    assert np.array_equal(result.trace.force_n, cube.trace.force_n)
    last_of_closing = [s for s in recording.of("right") if s.phase == "closing"][-1]
    assert last_of_closing.nodes.shape == last_of_closing.mesh.nodes.shape
    assert last_of_closing.displacement_mm.max() > 5.0
    push = 2.0 * last_of_closing.pressure @ last_of_closing.contact_areas  # the half stands for both
    assert push == pytest.approx(-last_of_closing.clamp_force[0], rel=0.1)


def test_failures_have_a_reason() -> None:
    with pytest.raises(SimulationFailed, match="wall-clock limit") as late:
        screen(BEST_PUBLISHED, SPHERE, deadline_s=0.0)
    assert late.value.reason == "time_out"
    few = replace(SCREENING_NUMERICS, limits=replace(SCREENING_NUMERICS.limits, max_steps=5))
    with pytest.raises(SimulationFailed, match="Stopped after 5 steps") as long:
        screen(BEST_PUBLISHED, SPHERE, numerics=few)
    assert long.value.reason == "max_steps"
    with pytest.raises(UsageError, match="tier `screening` cannot use a SolidMesh"):
        screen(BEST_PUBLISHED, SPHERE, mesh=build_mesh(BEST_PUBLISHED, MeshSettings()))


def test_screening_agrees_with_production_and_ranks_alike() -> None:
    designs = [BEST_PUBLISHED, *random_designs(3, np.random.default_rng(7))]
    forces = np.array(
        [
            [[simulate_grasp(d, o, v).peak_force_n for v in (SimulatorVersion(), SCREENING)] for o in (CUBE, SPHERE)]
            for d in designs
        ]
    )
    error = forces[..., 1] / forces[..., 0] - 1.0
    assert np.median(np.abs(error)) < 0.1
    assert spearmanr(*forces.mean(axis=1).T).statistic > 0.98


@pytest.mark.slow
def test_every_object_can_be_screened() -> None:
    design = random_designs(1, np.random.default_rng(11))[0]
    results = [screen(design, get_object(i)) for i in range(36)]
    assert min(r.peak_force_n for r in results) > 0.0
    assert float(np.median([r.cpu_s for r in results])) < 1.0
