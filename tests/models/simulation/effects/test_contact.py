"""Contact effects: laws in limit cases, and what the contact does with them."""

import numpy as np
import pytest

from fast.models.design.space import BEST_PUBLISHED
from fast.models.objects.catalogue import OBJECTS, get_object
from fast.models.objects.distance import distance
from fast.models.objects.primitives import bounds
from fast.models.records import GraspSetup, Placement, Theta
from fast.models.simulation.body.assembly import ElasticBody, Material
from fast.models.simulation.contact.law import NO_STOP, ContactLaw, ContactSurface, Obstacle, PointSpacing
from fast.models.simulation.effects.contact import (
    FingerFingerContact,
    ObjectEdgeRadius,
    PressureDependentFriction,
    ShearAdhesion,
    StaticKineticFriction,
)
from fast.models.simulation.grasp import simulate_grasp
from fast.models.simulation.mesh.build import build_mesh
from fast.models.simulation.version import MeshSettings, SimulatorVersion

CUBE, CONE = get_object(30), get_object(24)
TAU, MU, DEPTH_MM = 0.02, 0.5, 0.1
LAW = ContactLaw(adhesion_mpa=TAU)


def test_friction_falls_from_static_to_kinetic() -> None:
    effect = StaticKineticFriction(kinetic_ratio=0.7, slip_scale_mm=1.0)
    factor = effect.friction_factor(np.array([0.0, 1.0, 1e3]), np.zeros(3))
    assert np.allclose(factor, [1.0, 0.7 + 0.3 / np.e, 0.7])


def test_friction_falls_with_pressure_by_a_power_and_stays_finite() -> None:
    effect = PressureDependentFriction(exponent=1.0 / 3.0, reference_mpa=0.05)
    factor = effect.friction_factor(np.zeros(4), np.array([0.05, 0.4, 0.05 / 8, 0.0]))
    assert np.allclose(factor, [1.0, 0.5, 2.0, 20.0 ** (1.0 / 3.0)])


OBSTACLE = Obstacle.of(CUBE, Placement(), is_mirrored=False)


def pressed_finger(near_mm: float) -> tuple[ContactSurface, np.ndarray]:
    """The contact surface of a finger, and its nodes with the front at x = `near_mm`."""
    mesh = build_mesh(BEST_PUBLISHED, MeshSettings(), full_width=True)
    nodes = np.ascontiguousarray(mesh.nodes * [1.0, -1.0, -1.0] + [0.0, 0.0, BEST_PUBLISHED.height_mm - 5.0])
    body = ElasticBody(mesh, nodes, Material(11.5, 0.45))
    surface = ContactSurface(body, nodes, LAW, PointSpacing(along_mm=1.0, across_mm=2.0))
    return surface, nodes + [near_mm, 0.0, 0.0]


def test_a_sliding_contact_carries_adhesion_and_friction() -> None:
    surface, x = pressed_finger(20.0 - DEPTH_MM)
    friction = np.full(len(surface.areas), MU)
    response = surface.respond(x + [0.0, 0.0, 3.0], surface.start(x), OBSTACLE, friction, NO_STOP, None)
    assert_slides(response.traction, response.pressure)


def assert_slides(traction: np.ndarray, pressure: np.ndarray) -> None:
    firm = pressure > 0.01  # beyond the depth over which adhesion sets in
    assert firm.sum() > 20
    size = np.linalg.norm(traction, axis=1)
    assert np.allclose(size[firm], TAU + MU * pressure[firm])
    assert (size <= TAU + MU * pressure + 1e-12).all()


def test_adhesion_holds_without_friction() -> None:
    frictionless = SimulatorVersion(theta=Theta(friction=0.0))
    setup = GraspSetup(max_lift_mm=6)
    free, adhering = (
        simulate_grasp(BEST_PUBLISHED, CUBE, frictionless, setup, effects=[ShearAdhesion(tau)]) for tau in (0.0, 0.01)
    )
    half_area_mm2 = 2 * 38.0 * BEST_PUBLISHED.width_mm  # both sides of the cube
    assert free.peak_force_n < 0.3
    assert 0.2 < adhering.peak_force_n / (0.01 * half_area_mm2) < 1.1


def test_edges_are_rounded_and_faces_stay() -> None:
    rounder, sharper = (ObjectEdgeRadius(extra).modify_object(CUBE) for extra in (2.0, -0.5))
    assert np.allclose(bounds(rounder.primitives), bounds(CUBE.primitives))
    edge = np.array([[20.0, 0.0, 40.0]])  # of the sharp cube
    for obj, radius in ((sharper, 0.5), (CUBE, 1.0), (rounder, 3.0)):
        assert distance(obj.primitives, edge)[0] == pytest.approx((np.sqrt(2.0) - 1.0) * radius)
    assert distance(rounder.primitives, np.array([[20.0, 0.0, 20.0]]))[0] == pytest.approx(0.0, abs=1e-12)


def test_every_object_can_be_rounded() -> None:
    for obj in OBJECTS:
        rounder = ObjectEdgeRadius(2.0).modify_object(obj)
        assert (rounder is obj) == ("rounding_mm" not in obj.parameters)
        # Edges and tips go, nothing is added, and what is left is still the object.
        smaller, size = (np.ptp(bounds(o.primitives), axis=0) for o in (rounder, obj))
        assert (smaller <= size + 1e-9).all()
        assert (smaller > 0.7 * size).all()


@pytest.mark.parametrize("stop_mm", [-2.0, 0.0, 3.0])
def test_fingers_stop_each_other_before_their_plane(stop_mm: float) -> None:
    depth = 0.2
    surface, x = pressed_finger(stop_mm - depth)
    below = x - [0.0, 0.0, 400.0]  # no object there
    friction = np.full(len(surface.areas), MU)
    response = surface.respond(below, surface.start(below), OBSTACLE, friction, stop_mm, None)
    pressure = LAW.normal_n_per_mm3 * (depth - 0.5 * LAW.smoothing_mm)
    front_mm = BEST_PUBLISHED.height_mm - 3.0
    assert response.force[:, 0].sum() == pytest.approx(pressure * front_mm * BEST_PUBLISHED.width_mm, rel=0.03)
    clear = below + [depth + 1e-6, 0.0, 0.0]
    assert not surface.respond(clear, surface.start(clear), OBSTACLE, friction, stop_mm, None).force.any()


def test_fingers_that_stop_each_other_press_without_an_object() -> None:
    setup = GraspSetup(tip_below_mm=-40, max_lift_mm=2)  # far above the small cube
    small = get_object(31)
    free, stopped = (
        simulate_grasp(BEST_PUBLISHED, small, setup=setup, effects=[FingerFingerContact(gap)]) for gap in (0.0, 10.0)
    )
    assert free.contact_force_n == 0.0
    assert stopped.contact_force_n > 1.0
    assert abs(stopped.peak_force_n) < 0.05 * stopped.contact_force_n  # the stop is without friction
