"""The compiled contact of a finger with whole objects: energy, tangent, and that leaving points out changes nothing."""

import numpy as np
import pytest

from fast.models.design.space import BEST_PUBLISHED
from fast.models.objects.catalogue import get_object
from fast.models.records import Placement
from fast.models.simulation.body.assembly import ElasticBody, Material
from fast.models.simulation.contact.law import (
    NO_STOP,
    ContactLaw,
    ContactResponse,
    ContactSurface,
    Obstacle,
    PointSpacing,
)
from fast.models.simulation.contact.points import contact_points
from fast.models.simulation.mesh.build import build_mesh
from fast.models.simulation.model import to_object_frame
from fast.models.simulation.version import MeshSettings

LAW = ContactLaw()
SPHERE, SPIRAL, TURNED_DIAMOND, JACK, DIABOLO, CUBE = 1, 13, 18, 23, 26, 30


class Finger:
    """The best published finger and its contact points, in poses against an object."""

    def __init__(self) -> None:
        mesh = build_mesh(BEST_PUBLISHED, MeshSettings(edge_mm=10.0))
        self.nodes = to_object_frame(mesh.nodes, BEST_PUBLISHED.height_mm, 5.0)
        self.body = ElasticBody(mesh, self.nodes, Material(11.5, 0.45))
        self.surface = self.new_surface()

    def new_surface(self) -> ContactSurface:
        return ContactSurface(self.body, self.nodes, LAW, PointSpacing(0.5, 0.5))

    def pressed(self, obstacle: Obstacle, depth_mm: float, seed: int = 0) -> np.ndarray:
        """Nodes (n, 3), bent a little at random and moved until they reach `depth_mm` into the obstacle."""
        rng = np.random.default_rng(seed)
        phase, amplitude = rng.uniform(0, 6, 3), rng.uniform(0, 0.3, 3)
        x = self.nodes + np.sin(self.nodes[:, 2:] / 15.0 + phase) * amplitude
        x[:, 0] += 40.0
        for _ in range(60):
            x[:, 0] -= obstacle.distance(self.surface.positions(x)).min() + depth_mm
        return x

    def respond(self, surface: ContactSurface, x: np.ndarray, obstacle: Obstacle, friction: float) -> ContactResponse:
        state = surface.start(self.nodes)
        return surface.respond(x, state, obstacle, np.full(len(surface.areas), friction), 0.0, None)

    def times_blocks(self, blocks: np.ndarray, direction: np.ndarray) -> np.ndarray:
        """Product of the symmetric matrix in `blocks` with nodal vectors (n, 3); clamped nodes take no part."""
        free = self.body.row_of_node >= 0
        pattern = self.body.pattern
        rows, u = self.body.row_of_node[free], np.zeros((pattern.n, 3))
        u[rows] = direction[free]
        columns = np.repeat(np.arange(pattern.n), np.diff(pattern.indptr))
        product, strict = np.zeros_like(u), pattern.indices != columns
        np.add.at(product, pattern.indices, np.einsum("zij,zj->zi", blocks, u[columns]))
        upper = np.einsum("zji,zj->zi", blocks[strict], u[pattern.indices[strict]])
        np.add.at(product, columns[strict], upper)
        result = np.zeros_like(direction)
        result[free] = product[rows]
        return result


@pytest.fixture(scope="module")
def finger() -> Finger:
    return Finger()


def obstacle_of(object_id: int, offset_x_mm: float = 0.0, *, is_mirrored: bool = False) -> Obstacle:
    return Obstacle.of(get_object(object_id), Placement(offset_x_mm=offset_x_mm), is_mirrored=is_mirrored)


def energy_density(depth: np.ndarray) -> np.ndarray:
    """Integral of the pressure law over the depth, N/mm."""
    kn, d0, d = LAW.normal_n_per_mm3, LAW.smoothing_mm, np.maximum(depth, 0.0)
    return np.where(d < d0, kn * d**3 / (6 * d0), kn * (d**2 / 2 - d0 * d / 2 + d0**2 / 6))


def pressure(depth: np.ndarray) -> np.ndarray:
    kn, d0, d = LAW.normal_n_per_mm3, LAW.smoothing_mm, np.maximum(depth, 0.0)
    return np.where(d < d0, kn * d**2 / (2 * d0), kn * (d - d0 / 2))


@pytest.mark.parametrize("object_id", [SPHERE, SPIRAL, TURNED_DIAMOND, JACK, DIABOLO, CUBE])
def test_force_is_minus_the_gradient_of_the_energy(finger: Finger, object_id: int) -> None:
    surface, obstacle = finger.surface, obstacle_of(object_id)
    x = finger.pressed(obstacle, 0.3)
    x[:, 0] -= 0.1 * (x[:, 2] < 0)  # the tip may be behind the mirror plane
    direction = np.random.default_rng(1).standard_normal(x.shape)

    def energy(nodes: np.ndarray) -> float:
        points = surface.positions(nodes)
        return float(surface.areas @ (energy_density(-obstacle.distance(points)) + energy_density(-points[:, 0])))

    h = 1e-5
    slope = (energy(x + h * direction) - energy(x - h * direction)) / (2 * h)
    response = finger.respond(surface, x, obstacle, 0.0)
    assert len(response.points) > 2
    assert -np.vdot(response.force, direction) == pytest.approx(slope, rel=1e-6)


@pytest.mark.parametrize("object_id", [SPHERE, SPIRAL, TURNED_DIAMOND, JACK, DIABOLO, CUBE])
def test_tangent_is_the_derivative_of_the_force_but_for_the_curvature(finger: Finger, object_id: int) -> None:
    surface, obstacle, h = finger.surface, obstacle_of(object_id), 1e-6
    x = finger.pressed(obstacle, 0.3)
    direction = np.random.default_rng(2).standard_normal(x.shape)
    direction[finger.body.row_of_node < 0] = 0.0
    blocks = np.zeros((len(finger.body.pattern.indices), 3, 3))
    state, free_slip = surface.start(finger.nodes), np.zeros(len(surface.areas))
    surface.respond(x, state, obstacle, free_slip, NO_STOP, blocks)
    forces, turned = [], []
    middle = surface.positions(x)
    at_middle = surface.areas * pressure(-obstacle.distance(middle))
    for sign in (1.0, -1.0):
        moved = x + sign * h * direction
        forces.append(surface.respond(moved, state, obstacle, free_slip, NO_STOP, None).force)
        turned.append(at_middle[:, None] * obstacle.normal(surface.positions(moved)))
    change = (forces[0] - forces[1]) / (2 * h)
    curvature = (turned[0] - turned[1]) / (2 * h)
    # Work on a second direction stands for every entry of the matrix.
    other = np.random.default_rng(3).standard_normal(x.shape)
    other[finger.body.row_of_node < 0] = 0.0
    expected = -np.vdot(change, other) + np.vdot(curvature, surface.positions(other))
    assert np.vdot(finger.times_blocks(blocks, direction), other) == pytest.approx(expected, rel=1e-5)


@pytest.mark.parametrize("object_id", [SPHERE, SPIRAL, TURNED_DIAMOND, JACK])
def test_what_was_seen_before_changes_nothing(finger: Finger, object_id: int) -> None:
    rng, experienced = np.random.default_rng(4), finger.new_surface()
    obstacles = (obstacle_of(object_id), obstacle_of(object_id, 1.0), obstacle_of(SPIRAL, is_mirrored=True))
    friction, state = np.full(len(experienced.areas), 0.5), experienced.start(finger.nodes)
    blocks, fresh_blocks = (np.zeros((len(finger.body.pattern.indices), 3, 3)) for _ in range(2))
    x = finger.pressed(obstacles[0], 0.4)
    n_touching = 0
    for size in 10 ** rng.uniform(-4, 1, 25):
        moved = x + size * rng.standard_normal(3) + 0.1 * size * rng.standard_normal(x.shape)
        obstacle, stop_mm = obstacles[rng.choice(3, p=[0.8, 0.1, 0.1])], 0.0 if rng.random() < 0.8 else NO_STOP
        blocks[:], fresh_blocks[:] = 0.0, 0.0
        response = experienced.respond(moved, state, obstacle, friction, stop_mm, blocks)
        fresh = finger.new_surface().respond(moved, state, obstacle, friction, stop_mm, fresh_blocks)
        depth = -obstacle.distance(experienced.positions(moved))
        assert np.array_equal(response.points, np.flatnonzero(depth > 0.0))
        assert np.array_equal(response.pressure, fresh.pressure)
        assert np.array_equal(response.traction, fresh.traction)
        assert np.array_equal(response.slip_step, fresh.slip_step)
        assert np.array_equal(response.force, fresh.force)
        assert np.array_equal(blocks, fresh_blocks)
        n_touching += len(response.points)
    assert n_touching > 100


@pytest.mark.parametrize("object_id", [SPHERE, SPIRAL, DIABOLO])
@pytest.mark.parametrize("depth_mm", [-20.0, -0.5, 0.3])
def test_the_gap_is_that_of_the_nearest_point(finger: Finger, object_id: int, depth_mm: float) -> None:
    obstacle = obstacle_of(object_id)
    x = finger.pressed(obstacle, 0.0)
    x[:, 0] -= depth_mm
    gap_mm = finger.surface.gap_mm(x, obstacle)
    assert gap_mm == obstacle.distance(finger.surface.positions(x)).min()


@pytest.mark.parametrize("object_id", [SPHERE, DIABOLO, CUBE])
def test_unresolved_energy_is_that_of_the_springs_along_the_lift(finger: Finger, object_id: int) -> None:
    surface, obstacle = finger.new_surface(), obstacle_of(object_id)
    x = finger.pressed(obstacle, 0.4)
    state = surface.start(finger.nodes)
    after = surface.advance(state, x, finger.respond(surface, x, obstacle, 0.5))
    points = surface.positions(x)
    depth, normal = -obstacle.distance(points), obstacle.normal(points)
    springs = surface.areas * pressure(depth) ** 2 / LAW.normal_n_per_mm3
    assert after.unresolved_n_mm == pytest.approx(float(springs @ np.abs(normal[:, 2])))
    assert after.unresolved_n_mm > 0.0
    assert state.unresolved_n_mm == 0.0


def test_state_keeps_what_the_touching_points_did(finger: Finger) -> None:
    surface, obstacle = finger.surface, obstacle_of(SPHERE)
    x = finger.pressed(obstacle, 0.4)
    before = surface.start(x + np.array([0.0, 0.0, 0.2]))
    before.slip[:] = 1.0
    friction = np.full(len(surface.areas), 0.2)
    response = surface.respond(x, before, obstacle, friction, NO_STOP, None)
    after = surface.advance(before, x, response)
    assert np.array_equal(np.flatnonzero(after.spread_pressure()), response.points)
    assert np.array_equal(after.traction, response.traction)
    assert after.slip.sum() == pytest.approx(len(after.slip) + response.slip_step.sum())
    assert response.slip_step.max() > 0.1
    # The finger moved down by 0.2 mm, so friction pushes it up.
    assert response.traction[:, 2].max() > 0.0
    assert np.all(np.linalg.norm(response.traction, axis=1) <= 0.2 * response.pressure + 1e-12)
    again = surface.respond(x, after, obstacle, friction, NO_STOP, None)
    assert np.allclose(again.force, response.force, rtol=0, atol=1e-12)


def assert_reach_bounds_motion(motion: np.ndarray, moved: np.ndarray, middle: np.ndarray, reach: float) -> None:
    """Points (m, p, 3) stay within reach of the motion (m, k, 3) of their nodes, both against the middle (m, 3)."""
    most = np.linalg.norm(motion - middle[:, None], axis=2).max(axis=1)
    assert np.all(np.linalg.norm(moved - middle[:, None], axis=2).max(axis=1) <= reach * most + 1e-12)


SQUARE = np.array([[0, 0, 0], [6, 0, 0], [6, 4, 0], [0, 4, 0], [3, 0, 0], [6, 2, 0], [3, 4, 0], [0, 2, 0]], float)
TRIANGLE = np.array([[0, 0, 0], [6, 0, 0], [0, 4, 0], [3, 0, 0], [3, 2, 0], [0, 2, 0]], float)


@pytest.mark.parametrize(("nodes", "area"), [(SQUARE, 24.0), (TRIANGLE, 12.0)])
def test_patches_hold_every_point_once_and_bound_its_motion(nodes: np.ndarray, area: float) -> None:
    points = contact_points(np.arange(len(nodes))[None], nodes, PointSpacing(0.3, 0.4))
    assert points.areas.sum() == pytest.approx(area)
    assert points.first_point[0] == 0
    assert points.first_point[-1] == len(points.areas)
    assert np.all(np.diff(points.first_point) > 0)
    motion = np.random.default_rng(5).standard_normal((200, *nodes.shape))
    motion /= np.linalg.norm(motion, axis=2).max(axis=1)[:, None, None]
    moved = np.einsum("pk,mki->mpi", points.shape, motion)
    for patch, (start, end) in enumerate(zip(points.first_point[:-1], points.first_point[1:], strict=True)):
        assert_reach_bounds_motion(motion, moved[:, start:end], moved[:, start], float(points.reach[patch]))
        place = points.shape[start:end] @ nodes
        assert np.ptp(place, axis=0).max() < 4 * 0.4
    assert_reach_bounds_motion(motion, moved, moved[:, points.face_middle[0]], float(points.face_reach[0]))
