"""Own objects: meshes against exact shapes, parts, numbers from content, and what cannot be an object."""

import time
from functools import cache

import numpy as np
import pytest
import trimesh

from fast.models.design.space import BEST_PUBLISHED
from fast.models.errors import ConfigError, UsageError
from fast.models.objects.catalogue import FIRST_OWN_ID, OBJECTS, get_object
from fast.models.objects.distance import distance, distance_and_normal
from fast.models.objects.grid import MeshGrid
from fast.models.objects.mount import printable_mesh, unmounted_mesh
from fast.models.objects.own import object_of_mesh, object_of_parts, object_of_shape
from fast.models.objects.parts import Box, Capsule, Cylinder, Sphere, turn_matrix
from fast.models.objects.rigid import RigidObject
from fast.models.objects.surface import object_mesh
from fast.models.records import GraspSetup
from fast.models.simulation.grasp import simulate_grasp
from fast.models.simulation.version import SimulatorVersion

SPHERE = trimesh.creation.icosphere(4, 24.0)


@cache
def ball(**values: object) -> RigidObject:
    return object_of_mesh("ball", SPHERE, "ball.stl", **values)  # type: ignore[arg-type]


def points(n: int = 20_000) -> np.ndarray:
    return np.random.default_rng(0).uniform([-28.0, -28.0, 0.0], [28.0, 28.0, 52.0], (n, 3))


def test_a_meshed_sphere_is_the_sphere() -> None:
    exact = distance(get_object(2).primitives, points())
    near = np.abs(exact) < 1.0
    error = np.abs(distance(ball().primitives, points()) - exact)[near]
    assert np.median(error) < 0.03  # the triangles themselves are up to 0.05 mm inside
    assert error.max() < 0.08
    assert ball().size_mm == pytest.approx((48.0, 48.0, 48.0), abs=0.01)
    assert (ball().mirror_x, ball().mirror_y, ball().is_round) == (True, True, True)


def test_its_grasp_is_that_of_the_primitive_and_costs_little_more() -> None:
    def simulate(obj: RigidObject) -> tuple[float, float]:
        start = time.process_time()
        result = simulate_grasp(BEST_PUBLISHED, obj, SimulatorVersion(), GraspSetup())
        return result.peak_force_n, time.process_time() - start

    fine = object_of_mesh("ball", trimesh.creation.icosphere(5, 24.0), "ball.stl")
    for obj in (get_object(2), fine):
        simulate(obj)  # compiles
    exact_n, exact_s = min(simulate(get_object(2)) for _ in range(3))
    meshed_n, meshed_s = min(simulate(fine) for _ in range(3))
    assert meshed_n == pytest.approx(exact_n, rel=0.02)
    assert meshed_s < 2.0 * exact_s  # 1.1 times on a quiet machine (docs/how-to/bring-own-objects.md)


def test_sharp_edges_of_a_mesh_are_exact() -> None:
    """Along edges and corners that stick out (a tilted box), and along those between a plate and what stands on it."""
    turn = (20.0, 35.0, 10.0)
    block = Box(shape="box", size_x_mm=26, size_y_mm=24, size_z_mm=28, rounding_mm=0, turn_deg=turn)
    plate = Box(shape="box", size_x_mm=40, size_y_mm=36, size_z_mm=12, rounding_mm=0, at_mm=(0, 0, 6))
    post = Box(shape="box", size_x_mm=16, size_y_mm=20, size_z_mm=30, rounding_mm=0, at_mm=(3, 0, 15))
    step = trimesh.boolean.union([placed((40, 36, 12), (0, 0, 6)), placed((16, 20, 30), (3, 0, 15))])
    for exact, meshed in (
        (object_of_parts("tilted", [block], "x"), object_of_mesh("b", placed((26, 24, 28)), "b.stl", turn_deg=turn)),
        (object_of_parts("step", [plate, post], "x"), object_of_mesh("s", step, "s.stl")),
    ):
        at = points(400_000)
        near = at[np.abs(distance(exact.primitives, at)) < 0.1]
        depth, normal = distance_and_normal(exact.primitives, near)
        found, found_normal = distance_and_normal(meshed.primitives, near)
        assert np.quantile(np.abs(found - depth), 0.995) < 0.001
        assert np.abs(found - depth).max() < 0.03  # where the post's edges meet the plate; elsewhere 0.1 as a spline
        assert np.quantile(np.einsum("ij,ij->i", normal, found_normal), 0.01) > np.cos(np.radians(1.0))


def test_the_peak_of_a_mesh_with_sharp_edges_is_that_of_the_exact_shape() -> None:
    sizes = {"size_x_mm": 30, "size_y_mm": 30, "size_z_mm": 40, "turn_deg": (0, 0, 45)}
    exact = object_of_parts("bar", [Box(shape="box", rounding_mm=0, **sizes)], "x")  # type: ignore[arg-type]
    meshed = object_of_mesh("bar", placed((30, 30, 40)), "bar.stl", turn_deg=(0, 0, 45))
    peaks_n = [
        simulate_grasp(BEST_PUBLISHED, obj, SimulatorVersion(), GraspSetup()).peak_force_n for obj in (exact, meshed)
    ]
    assert peaks_n[1] == pytest.approx(peaks_n[0], rel=0.02)  # a radius of 1 mm takes 15 %


def placed(size_mm: tuple[float, float, float], at_mm: tuple[float, float, float] = (0, 0, 0)) -> trimesh.Trimesh:
    mesh = trimesh.creation.box(size_mm)
    mesh.apply_translation(at_mm)
    return mesh


def test_the_inside_of_a_mug_is_outside() -> None:
    cup = trimesh.creation.cylinder(18, 44, sections=96)
    hollow = trimesh.creation.cylinder(15, 44, sections=96).apply_translation([0, 0, 4])
    mug = object_of_mesh("mug", trimesh.boolean.difference([cup, hollow]), "mug.stl")
    found = distance(mug.primitives, np.array([[0, 0, 30.0], [0, 0, 2.0], [16.5, 0, 30.0], [19.0, 0, 30.0]]))
    assert found == pytest.approx([15.0, -2.0, -1.5, 1.0], abs=0.05)


def test_a_mesh_is_measured_once(monkeypatch: pytest.MonkeyPatch) -> None:
    measure, measured = MeshGrid.of, []
    monkeypatch.setattr(MeshGrid, "of", lambda mesh: measured.append(mesh) or measure(mesh))
    assert object_of_mesh("b", placed((9.0, 8.0, 7.0)), "b.stl").primitives.size
    assert len(measured) == 1


def test_the_number_follows_from_the_content() -> None:
    coarse = trimesh.creation.icosphere(1, 15.0)
    made = object_of_mesh("ball", coarse, "x")
    assert made.object_id >= FIRST_OWN_ID
    assert object_of_mesh("other name", coarse, "y").object_id == made.object_id
    assert object_of_mesh("ball", coarse, "x", scale=0.9).object_id != made.object_id
    parts = [Sphere(shape="sphere", diameter_mm=30)]
    assert object_of_parts("ball", parts, "x").object_id == object_of_parts("ball", parts, "y").object_id


def test_parts_are_exact_and_stand_on_the_mount() -> None:
    rod = Cylinder(shape="cylinder", diameter_mm=14, length_mm=40, at_mm=(50.0, 0.0, 90.0), rounding_mm=0.5)
    knob = Sphere(shape="sphere", diameter_mm=30, at_mm=(50.0, 0.0, 100.0))
    made = object_of_parts("dumbbell", [rod, knob], "x")
    assert made.size_mm == pytest.approx((30.0, 30.0, 45.0))
    found = distance(made.primitives, np.array([[0.0, 0.0, 30.0], [0.0, 0.0, 46.0], [10.0, 0.0, 5.0]]))
    assert found == pytest.approx([-15.0, 1.0, 3.0], abs=1e-9)
    assert made.is_round


def test_turns_are_about_x_then_y_then_z() -> None:
    assert turn_matrix((0.0, 0.0, 90.0)) @ [1.0, 0.0, 0.0] == pytest.approx([0.0, 1.0, 0.0])
    assert turn_matrix((90.0, 0.0, 0.0)) @ [0.0, 1.0, 0.0] == pytest.approx([0.0, 0.0, 1.0])
    assert turn_matrix((0.0, 90.0, 0.0)) @ [0.0, 0.0, 1.0] == pytest.approx([1.0, 0.0, 0.0])
    assert turn_matrix((90.0, 0.0, 90.0)) @ [0.0, 1.0, 0.0] == pytest.approx([0.0, 0.0, 1.0])
    lying = Capsule(shape="capsule", diameter_mm=10, length_mm=40, turn_deg=(90.0, 0.0, 0.0))
    assert object_of_parts("rod", [lying], "x").size_mm == pytest.approx((10.0, 40.0, 10.0))


def test_an_object_without_symmetry_says_so() -> None:
    block = Box(shape="box", size_x_mm=20, size_y_mm=20, size_z_mm=30)
    nose = Sphere(shape="sphere", diameter_mm=12, at_mm=(0.0, 10.0, 5.0))
    made = object_of_parts("nosed", [block, nose], "x")
    assert (made.mirror_x, made.mirror_y, made.is_round) == (True, False, False)


def test_an_object_is_printed_on_its_mount() -> None:
    mesh = printable_mesh(ball())
    assert mesh.is_volume
    assert mesh.body_count == 1
    assert mesh.bounds[:, 2] == pytest.approx([0.0, 33.0 + 48.0], abs=0.05)


def cube(size_mm: float, x_mm: float = 0.0) -> trimesh.Trimesh:
    mesh = trimesh.creation.box((size_mm, size_mm, size_mm))
    mesh.apply_translation((x_mm, 0.0, 0.0))
    return mesh


def test_cavities_and_bodies_that_overlap_are_printed_as_one_piece() -> None:
    cavity = cube(10.0)
    cavity.invert()
    hollow = object_of_mesh("hollow", trimesh.util.concatenate([cube(30.0), cavity]), "x")
    assert unmounted_mesh(hollow).volume == pytest.approx(30.0**3 - 10.0**3)
    assert printable_mesh(hollow).is_volume
    double = object_of_mesh("double", trimesh.util.concatenate([cube(20.0), cube(20.0, 10.0)]), "x")
    assert unmounted_mesh(double).volume == pytest.approx(1.5 * 20.0**3)
    assert printable_mesh(double).body_count == 1
    apart = object_of_mesh("apart", trimesh.util.concatenate([cube(20.0), cube(20.0, 20.05)]), "x")
    with pytest.raises(UsageError, match="apart would be printed in 2 pieces, which do not quite touch; let them over"):
        printable_mesh(apart)


def inside_out(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    mesh.invert()
    return mesh


def depth_mm(meshes: list[trimesh.Trimesh], at_mm: list[tuple[float, float, float]]) -> np.ndarray:
    obj = object_of_mesh("several", trimesh.util.concatenate(meshes), "several.stl")
    return -distance(obj.primitives, np.array(at_mm))


def test_faces_of_bodies_that_lie_inside_another_are_no_surface() -> None:
    """Two cubes that overlap are a block of 30 x 20 x 20 mm: a face of each lies 5 mm off its middle."""
    assert depth_mm([cube(20.0), cube(20.0, 10.0)], [(5.0, 0.0, 10.0), (-5.0, 4.0, 10.0)]) == pytest.approx(
        [10.0, 6.0], abs=0.01
    )
    assert depth_mm([cube(20.0), cube(20.0)], [(0.0, 0.0, 10.0)]) == pytest.approx([10.0], abs=0.01)
    assert depth_mm([cube(30.0), cube(10.0)], [(5.0, 0.0, 15.0)]) == pytest.approx([10.0], abs=0.01)
    above = placed((20, 20, 20), (0, 0, 20))
    assert depth_mm([cube(20.0), above], [(0.0, 0.0, 20.0)]) == pytest.approx([10.0], abs=0.01)


def test_a_cavity_stays_hollow_and_a_rib_across_it_solid() -> None:
    shell = [cube(30.0), inside_out(cube(20.0))]
    rib = placed((4.0, 4.0, 26.0))
    at = [(0.0, 0.0, 15.0), (6.0, 0.0, 15.0), (12.5, 0.0, 15.0)]
    assert depth_mm(shell, at) == pytest.approx([-10.0, -4.0, 2.5], abs=0.01)
    assert depth_mm([*shell, rib], at) == pytest.approx([2.0, -4.0, 2.5], abs=0.01)


def test_an_object_of_an_older_lake_stays_as_it_was() -> None:
    new = object_of_mesh("double", trimesh.util.concatenate([cube(20.0), cube(20.0, 10.0)]), "x")
    assert new.shape is not None
    old = object_of_shape("double", new.shape.replace('"bodies":"joined",', ""), "lake")
    assert old.object_id == new.object_id
    inner = np.array([[5.0, 0.0, 10.0]])
    assert distance(old.primitives, inner) == pytest.approx([0.0], abs=0.1)
    assert distance(object_of_shape("double", new.shape, "lake").primitives, inner) == pytest.approx([-10.0], abs=0.01)


def test_a_mesh_is_drawn_with_its_own_triangles() -> None:
    tilted = object_of_mesh("tilted", placed((20, 22, 24)), "x", turn_deg=(20, 35, 10))
    drawn = object_mesh(tilted)
    assert len(drawn.faces) == 12
    assert drawn.volume == pytest.approx(20 * 22 * 24, rel=1e-5)
    joined = object_of_mesh("joined", trimesh.util.concatenate([cube(20.0), cube(20.0, 10.0)]), "x")
    assert object_mesh(joined).volume == pytest.approx(1.5 * 20.0**3, rel=1e-5)


def open_mesh() -> trimesh.Trimesh:
    mesh = SPHERE.copy()
    mesh.update_faces(np.arange(len(mesh.faces)) > 4)
    return mesh


WRONG = {
    "open": (open_mesh(), {}, "not watertight, .* edges do not join two triangles"),
    "large": (SPHERE, {"scale": 2.0}, "96.0 mm wide in x, a place of the bench takes at most 64 mm; scale it down"),
    "small": (SPHERE, {"scale": 0.001}, "the fingers need 3 mm at least; scale it up"),
    "flat": (trimesh.creation.box((30.0, 30.0, 0.0)), {}, "no volume"),
    "empty": (trimesh.Trimesh(), {}, "no triangles"),
    "reversed": (
        trimesh.util.concatenate([cube(20.0), inside_out(placed((20, 20, 10), (10, 0, 0)))]),
        {},
        "a body of it is turned inside out and sticks out of the others, .*; turn its faces, or cut the hole",
    ),
    "nan": (trimesh.Trimesh(SPHERE.vertices * np.nan, SPHERE.faces, process=False), {}, "not a finite number"),
}


@pytest.mark.parametrize("name", WRONG)
def test_what_is_no_object_is_one_sentence(name: str) -> None:
    mesh, values, words = WRONG[name]
    with pytest.raises(ConfigError, match=words) as refused:
        object_of_mesh("own", mesh, "own.stl", **values)  # type: ignore[arg-type]
    assert str(refused.value).startswith("own.stl: ")
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("name", ["", "7 dwarfs", "cube", "x" * 41, "../up"])
def test_names_of_others_and_of_files_are_refused(name: str) -> None:
    with pytest.raises(ConfigError, match="cannot be the name of an own object"):
        object_of_mesh(name, SPHERE, "own.stl")


def test_an_inside_out_mesh_is_turned() -> None:
    inverted = trimesh.creation.icosphere(2, 24.0)
    inverted.invert()
    assert distance(object_of_mesh("b", inverted, "x").primitives, np.array([[0.0, 0.0, 24.0]]))[0] < -20.0


def test_the_36_are_untouched() -> None:
    assert [obj.shape for obj in OBJECTS] == [None] * 36
