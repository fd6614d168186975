"""Contact pressure, friction return mapping and the mechanics of a time step."""

import numpy as np
import pytest

from fast.models.design.space import BEST_PUBLISHED
from fast.models.simulation.body.assembly import ElasticBody, Material
from fast.models.simulation.contact.friction import return_mapping
from fast.models.simulation.contact.law import NO_STOP, ContactLaw, ContactSurface, Obstacle, PointSpacing
from fast.models.simulation.finger import FingerStep, linearise
from fast.models.simulation.mesh.build import build_mesh
from fast.models.simulation.mesh.solid import SolidMesh
from fast.models.simulation.model import to_object_frame
from fast.models.simulation.solver.stepping import TOUCH_MM, travel_to_touch
from fast.models.simulation.version import MeshSettings
from tests.models.simulation.obstacles import make_half_space

NORMAL = np.array([0.0, 0.6, 0.8])


def wall(level_mm: float) -> Obstacle:
    """Half space x < level: its surface faces the finger's front."""
    return make_half_space(np.array([level_mm, 0.0, 0.0]), np.array([1.0, 0.0, 0.0]))


def friction_of(traction: np.ndarray, motion: np.ndarray, limit: float) -> tuple[np.ndarray, np.ndarray, float]:
    result, tangent = np.zeros(3), np.zeros((3, 3))
    slip = return_mapping(traction, motion, NORMAL, limit, 2.0, result, tangent)
    return result, tangent, slip


def test_friction_sticks_elastically() -> None:
    motion = np.array([0.01, 0.0, 0.0])
    traction, tangent, slip = friction_of(np.zeros(3), motion, 1.0)
    assert np.allclose(traction, -2.0 * motion)
    assert slip == 0.0
    assert np.allclose(tangent, 2.0 * (np.eye(3) - np.outer(NORMAL, NORMAL)))


def test_friction_slides_at_its_limit_against_the_motion() -> None:
    motion = np.array([0.3, 0.08, -0.06])
    traction, _, slip = friction_of(np.array([0.05, 0.0, 0.0]), motion, 0.1)
    assert np.linalg.norm(traction) == pytest.approx(0.1)
    assert traction @ motion < 0.0
    assert traction @ NORMAL == pytest.approx(0.0, abs=1e-15)
    assert slip == pytest.approx((np.hypot(0.55, 0.2) - 0.1) / 2.0)


def test_friction_tangent_is_the_derivative_when_sliding() -> None:
    motion, old = np.array([0.3, 0.1, -0.2]), np.array([0.02, 0.0, 0.0])
    _, tangent, _ = friction_of(old, motion, 0.1)
    for axis in range(3):
        step = np.zeros(3)
        step[axis] = 1e-6
        difference = (friction_of(old, motion + step, 0.1)[0] - friction_of(old, motion - step, 0.1)[0]) / 2e-6
        assert np.allclose(-tangent[:, axis], difference, atol=1e-8)


@pytest.fixture(scope="module")
def solid() -> SolidMesh:
    return build_mesh(BEST_PUBLISHED, MeshSettings())


def finger_parts(mesh: SolidMesh, spacing: PointSpacing) -> tuple[ElasticBody, ContactSurface, np.ndarray]:
    nodes = to_object_frame(mesh.nodes, BEST_PUBLISHED.height_mm, 5.0)
    body = ElasticBody(mesh, nodes, Material(11.5, 0.45))
    return body, ContactSurface(body, nodes, ContactLaw(), spacing), nodes


def test_object_frame_hangs_the_finger_tip_down(solid: SolidMesh) -> None:
    nodes = to_object_frame(solid.nodes, BEST_PUBLISHED.height_mm, 5.0)
    assert nodes[:, 2].min() == pytest.approx(-5.0)
    assert nodes[:, 2].max() == pytest.approx(BEST_PUBLISHED.height_mm - 5.0 - 3.0)
    assert nodes[:, 0].min() == pytest.approx(0.0)


def test_contact_points_cover_front_and_tip(solid: SolidMesh) -> None:
    _, surface, _ = finger_parts(solid, PointSpacing(0.5, 3.0))
    front = (BEST_PUBLISHED.height_mm - 3.0) * BEST_PUBLISHED.width_mm / 2
    tip = (BEST_PUBLISHED.front_thickness_mm + 1.0) * BEST_PUBLISHED.width_mm / 2
    assert surface.areas.sum() == pytest.approx(front + tip)


def test_pressed_wall_gives_pressure_times_area(solid: SolidMesh) -> None:
    _, surface, nodes = finger_parts(solid, PointSpacing(0.5, 3.0))
    depth, law = 0.2, ContactLaw()
    n = len(surface.areas)
    response = surface.respond(nodes, surface.start(nodes), wall(depth), np.zeros(n), NO_STOP, None)
    x = surface.positions(nodes)[:, 0]
    assert np.array_equal(response.points, np.flatnonzero(x < depth))
    pressure = law.normal_n_per_mm3 * (depth - 0.5 * law.smoothing_mm)
    assert np.allclose(response.pressure[x[response.points] < 1e-9], pressure)
    assert response.force[:, 0].sum() == pytest.approx((surface.areas[response.points] * response.pressure).sum())
    assert np.abs(response.force[:, 1:]).max() == 0.0


def test_pressure_law_has_a_continuous_slope(solid: SolidMesh) -> None:
    _, surface, nodes = finger_parts(solid, PointSpacing(5.0, 20.0))
    friction = np.zeros(len(surface.areas))

    def force(depth: float) -> float:
        response = surface.respond(nodes, surface.start(nodes), wall(depth), friction, NO_STOP, None)
        return float(response.pressure.max(initial=0.0))

    d0, h = ContactLaw().smoothing_mm, 1e-6
    before, after = (force(d0) - force(d0 - h)) / h, (force(d0 + h) - force(d0)) / h
    assert before == pytest.approx(after, rel=1e-4)
    assert force(0.0) == 0.0


def test_mirror_plane_pushes_like_a_wall(solid: SolidMesh) -> None:
    _, surface, nodes = finger_parts(solid, PointSpacing(5.0, 20.0))
    state, friction = surface.start(nodes), np.full(len(surface.areas), 0.5)
    moved = nodes - np.array([0.1, 0.0, 0.0])
    by_mirror = surface.respond(moved, state, wall(-50.0), friction, 0.0, None).force
    by_wall = surface.respond(moved, state, wall(0.0), 0 * friction, NO_STOP, None).force
    assert np.allclose(by_mirror, by_wall)


def test_step_tangent_is_the_derivative_of_the_residual(solid: SolidMesh) -> None:
    body, surface, nodes = finger_parts(solid, PointSpacing(0.5, 3.0))
    finger = FingerStep(body, surface, nodes, wall(0.15), stop_mm=NO_STOP)
    u = finger.begin(
        finger.undeformed(np.zeros(3), np.zeros(3)), np.array([-0.05, 0, 0.0]), 0.05, np.full(len(surface.areas), 1e6)
    )
    blocks = np.zeros((len(body.pattern.indices), 3, 3))
    assert linearise(finger.mechanics, finger.motion, u, blocks)
    rng = np.random.default_rng(0)
    direction = rng.standard_normal(u.shape)
    direction[finger.residual(u + 1.0)[:, 1] == 0.0, 1] = 0.0  # rows of the symmetry plane
    columns = np.repeat(np.arange(body.pattern.n), np.diff(body.pattern.indptr))
    product = np.zeros_like(u)
    np.add.at(product, body.pattern.indices, np.einsum("zij,zj->zi", blocks, direction[columns]))
    strict = body.pattern.indices != columns
    upper = np.einsum("zji,zj->zi", blocks[strict], direction[body.pattern.indices[strict]])
    np.add.at(product, columns[strict], upper)
    difference = -(finger.residual(u + 1e-7 * direction) - finger.residual(u - 1e-7 * direction)) / 2e-7
    assert np.abs(product - difference).max() < 1e-5 * np.abs(difference).max()


def test_approach_stops_just_before_contact() -> None:
    travel = travel_to_touch(lambda base: 7.0 + 0.5 * base[0], np.zeros(3), np.array([-1.0, 0, 0]), 30.0)
    assert 14.0 - 2 * TOUCH_MM <= travel <= 14.0
    assert travel_to_touch(lambda _: 5.0, np.zeros(3), np.array([-1.0, 0, 0]), 30.0) == 30.0
