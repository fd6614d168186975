import time

import numpy as np
import pytest

from fast.models.objects import primitives as p
from fast.models.objects.catalogue import OBJECTS
from fast.models.objects.distance import _distances, distance, distance_and_normal
from fast.models.objects.rigid import RigidObject

IDS = [obj.name for obj in OBJECTS]


def cloud(n: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).uniform([-27, -27, -3], [27, 27, 53], (n, 3))


def brute_force(profile: list[tuple[float, float]], point: np.ndarray, *, is_square: bool) -> float:
    """Distance to the surface that a profile sweeps, from many points on that surface."""
    corners = np.array([*profile, profile[0]], float)
    s = np.linspace(0, 1, 400)[:, None]
    line = np.vstack([a + s * (b - a) for a, b in zip(corners, corners[1:], strict=False) if a[0] + b[0] > 0])
    turn = np.linspace(-1, 1, 801)[:, None]
    if is_square:
        across = turn * line[:, 0]
        x, y = np.broadcast_to(line[:, 0], across.shape), across
        sides = [(x, y), (-x, y), (y, x), (y, -x)]
    else:
        sides = [(np.cos(np.pi * turn) * line[:, 0], np.sin(np.pi * turn) * line[:, 0])]
    return min(
        float(np.sqrt(np.min((x - point[0]) ** 2 + (y - point[1]) ** 2 + (line[:, 1] - point[2]) ** 2)))
        for x, y in sides
    )


@pytest.mark.parametrize("is_square", [False, True])
def test_turned_profile_agrees_with_brute_force(is_square: bool) -> None:
    profile = [(0.0, -20.0), (18.0, -20.0), (8.0, 2.0), (14.0, 20.0), (0.0, 20.0)]
    row = (p.square_lathe if is_square else p.lathe)(profile, 0.0)[None]
    points = np.random.default_rng(1).uniform([-16, -16, -24], [16, 16, 24], (60, 3))
    expected = [brute_force(profile, point, is_square=is_square) for point in points]
    assert np.abs(distance(row, points)) == pytest.approx(np.array(expected), abs=0.05)
    half_side = np.interp(points[:, 2], [-20, 2, 20], [18, 8, 14])
    across = np.abs(points[:, :2]).max(axis=1) if is_square else np.hypot(points[:, 0], points[:, 1])
    is_inside = (across < half_side) & (np.abs(points[:, 2]) < 20)
    assert is_inside.sum() > 10
    assert np.array_equal(distance(row, points) < 0, is_inside)


def test_ellipsoid_point_moved_along_the_normal_is_that_far() -> None:
    axes = np.array([18.0, 14.0, 24.0])
    row = p.ellipsoid(*(2 * axes))[None]
    direction = np.random.default_rng(2).normal(size=(200, 3))
    surface = axes * direction / np.linalg.norm(direction, axis=1, keepdims=True)
    normal = surface / axes**2
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    for offset in (-5.0, -2.0, -0.01, 0.0, 0.01, 2.0, 30.0):
        points = surface + offset * normal
        d, n = distance_and_normal(row, points)
        assert d == pytest.approx(np.full(200, offset), abs=1e-8)
        assert np.abs(n - normal).max() < 1e-5


def test_ellipsoid_depth_at_its_centre_and_on_its_axes() -> None:
    row = p.ellipsoid(36, 28, 48)[None]
    points = np.array([[0.0, 0, 0], [0, 0, 23], [0, 0, 30], [20, 0, 0]])
    assert distance(row, points) == pytest.approx([-14, -1, 6, 2], abs=1e-5)


def test_rounded_box_against_closed_form() -> None:
    row = p.box(40, 40, 40, 1.0)[None]
    corner = 19 + (3 + 1) / np.sqrt(3)
    points = np.array([[25.0, 0, 0], [19.0, 5, 5], [corner, corner, corner], [0, 0, 0]])
    assert distance(row, points) == pytest.approx([5, -1, 3, -20])


def test_prism_of_four_sides_is_the_box() -> None:
    square = [(-15.0, -15.0), (15.0, -15.0), (15.0, 15.0), (-15.0, 15.0)]
    points = cloud(500) - np.array([0, 0, 25])
    boxed = distance(p.box(30, 30, 50, 1.0)[None], points)
    assert distance(p.prism(square, 50, 1.0)[None], points) == pytest.approx(boxed)
    profile = [(0.0, -25.0), (15.0, -25.0), (15.0, 25.0), (0.0, 25.0)]
    assert distance(p.square_lathe(profile, 1.0)[None], points) == pytest.approx(boxed)


def test_rotated_rows_measure_the_rotated_solid() -> None:
    rotation = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))[0]
    rows, points, shift = OBJECTS[28].primitives, cloud(300), np.array([1.0, -2.0, 3.0])
    turned = p.moved(p.rotated(rows, rotation), shift)
    assert distance(turned, points @ rotation.T + shift) == pytest.approx(distance(rows, points))


def test_what_is_read_only_is_measured_by_the_same_code() -> None:
    rows, points = p.sphere(2.0)[None], np.array([[0.0, 0.0, 5.0]])
    for array in (rows, points):
        assert distance(rows, points) == [3.0]
        array.flags.writeable = False
    assert distance(rows, points) == [3.0]
    assert len(_distances.signatures) == 1


def test_profile_with_too_many_vertices_is_refused() -> None:
    angles = np.arange(9) * 2 * np.pi / 9
    with pytest.raises(ValueError, match="9 vertices, at most 8"):
        p.prism([(float(10 * np.cos(a)), float(10 * np.sin(a))) for a in angles], 10, 0.5)


@pytest.mark.parametrize("obj", OBJECTS, ids=IDS)
def test_gradient_has_length_one_near_the_surface(obj: RigidObject) -> None:
    rows, h = obj.primitives, 1e-4
    points = cloud(20_000)
    points = points[np.abs(distance(rows, points)) < 2]
    assert len(points) > 100
    steps = [distance(rows, points + h * e) - distance(rows, points - h * e) for e in np.eye(3)]
    length = np.linalg.norm(steps, axis=0) / (2 * h)
    # Concave creases (waists, crossed rods) and the middle of thin parts have no gradient: a point hits them rarely.
    assert np.mean(np.abs(length - 1) > 0.02) < 0.002
    normals = distance_and_normal(rows, points)[1]
    assert np.linalg.norm(normals, axis=1) == pytest.approx(np.ones(len(points)))


@pytest.mark.parametrize("obj", OBJECTS, ids=IDS)
def test_stepping_back_along_the_normal_lands_on_the_surface(obj: RigidObject) -> None:
    rows = obj.primitives
    points = cloud(5_000, seed=4)
    d, normal = distance_and_normal(rows, points)
    near = (d > -1) & (d < 20)
    foot = points[near] - d[near, None] * normal[near]
    assert np.quantile(np.abs(distance(rows, foot)), 0.995) < 1e-3


@pytest.mark.parametrize("obj", OBJECTS, ids=IDS)
def test_normals_agree_with_central_differences(obj: RigidObject) -> None:
    rows, h = obj.primitives, 1e-4
    points = cloud(20_000, seed=7)
    d, normals = distance_and_normal(rows, points)
    points, normals = points[np.abs(d) < 0.9], normals[np.abs(d) < 0.9]
    steps = [distance(rows, points + h * e) - distance(rows, points - h * e) for e in np.eye(3)]
    slope = np.transpose(steps) / (2 * h)
    # Differences across a crease (between rods, in a waist) are shorter than 1; those across the border of a rounded
    # edge are off by the step times the jump of the curvature, at most 1 / (1 mm - 0.9 mm).
    is_smooth = np.abs(np.linalg.norm(slope, axis=1) - 1) < 1e-5
    assert is_smooth.mean() > 0.995
    error = np.abs(slope - normals)[is_smooth].max(axis=1)
    assert np.quantile(error, 0.99) < 1e-6
    assert error.max() < h / 0.1


@pytest.mark.parametrize("obj", OBJECTS, ids=IDS)
def test_distance_never_changes_faster_than_the_point_moves(obj: RigidObject) -> None:
    rng = np.random.default_rng(8)
    points = cloud(5_000, seed=8)
    step = rng.normal(size=points.shape) * 10 ** rng.uniform(-4, 1, (len(points), 1))
    change = np.abs(distance(obj.primitives, points + step) - distance(obj.primitives, points))
    assert np.all(change <= np.linalg.norm(step, axis=1) + 1e-9)


@pytest.mark.parametrize("name", ["spiral", "jack"])
def test_union_is_the_least_of_its_rows(name: str) -> None:
    rows, points = OBJECTS[IDS.index(name)].primitives, cloud(4_000, seed=9)
    least = np.min([distance(row[None], points) for row in rows], axis=0)
    assert np.array_equal(distance(rows, points), least)


def test_mirrored_rows_measure_the_mirror_image() -> None:
    rows, points, signs = OBJECTS[13].primitives, cloud(1_000), np.array([-1.0, 1.0, 1.0])
    d, normal = distance_and_normal(rows, points)
    mirror_d, mirror_normal = distance_and_normal(p.mirrored(rows), points * signs)
    assert mirror_d == pytest.approx(d, abs=1e-12)
    assert np.abs(mirror_normal * signs - normal).max() < 1e-9


def test_normals_at_corners_and_centres_have_length_one() -> None:
    square = [(-15.0, -15.0), (15.0, -15.0), (15.0, 15.0), (-15.0, 15.0)]
    cone = [(0.0, -20.0), (18.0, -20.0), (0.0, 20.0)]
    rows = [p.box(30, 30, 30, 0.0), p.prism(square, 30, 0.0), p.lathe(cone, 0.0), p.square_lathe(cone, 0.0)]
    rows += [p.sphere(15.0), p.torus(15.0, 5.0), p.ellipsoid(30, 30, 40), p.capsule(np.zeros(3), np.ones(3), 5.0)]
    points = np.array([[15.0, 15, 15], [15, 15, 0], [18, 18, -20], [18, 0, -20], [0, 0, 20], [15, 0, 0], [0, 0, 0]])
    for row in rows:
        normals = distance_and_normal(row[None], points)[1]
        assert np.linalg.norm(normals, axis=1) == pytest.approx(np.ones(len(points)))


@pytest.mark.parametrize("obj", OBJECTS, ids=IDS)
def test_distance_is_fast(obj: RigidObject) -> None:
    rows, points = obj.primitives, cloud(1200)
    distance(rows, points)
    seconds = []
    for _ in range(10):
        start = time.perf_counter()
        distance(rows, points)
        seconds.append(time.perf_counter() - start)
    assert min(seconds) < 1e-3
