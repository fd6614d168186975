import numpy as np
import pytest

from fast.models.errors import UsageError
from fast.models.objects.catalogue import OBJECTS, get_object
from fast.models.objects.distance import distance
from fast.models.objects.primitives import bounds, rotated, turn_about_z
from fast.models.objects.rigid import RigidObject
from fast.models.objects.surface import object_mesh

IDS = [obj.name for obj in OBJECTS]
CLASSES_OF_THE_PAPER = {
    "cube", "cone", "diamond", "pyramid", "diabolo", "hourglass", "tube", "cylinder", "torus", "sphere",
    "spiral", "triangle", "jack", "ellipsoid",
}  # fmt: skip


def test_numbers_and_classes_are_those_of_the_paper() -> None:
    assert [obj.object_id for obj in OBJECTS] == list(range(36))
    assert len(set(IDS)) == 36
    assert {obj.object_class for obj in OBJECTS} >= CLASSES_OF_THE_PAPER
    assert OBJECTS[14].object_class == "tube"
    assert [OBJECTS[i].object_class for i in (24, 25)] == ["cone", "cone"]
    assert {OBJECTS[i].object_class for i in range(30, 36)} == {"cube", "prism"}
    assert {obj.object_id for obj in OBJECTS if obj.object_class in ("cube", "prism")} == set(range(30, 36))


@pytest.mark.parametrize("object_id", [-1, 36])
def test_unknown_number_is_refused_in_a_sentence(object_id: int) -> None:
    with pytest.raises(UsageError, match=f"object {object_id} does not exist; the numbers go from 0 to 35"):
        get_object(object_id)


def test_known_number_gives_the_object() -> None:
    assert get_object(35) is OBJECTS[35]


@pytest.mark.parametrize("obj", OBJECTS, ids=IDS)
def test_object_rests_on_the_mount_inside_its_box(obj: RigidObject) -> None:
    low, high = bounds(obj.primitives)
    assert low[2] == pytest.approx(0, abs=1e-9)
    assert high[2] <= 50 + 1e-9
    assert low[:2] + high[:2] == pytest.approx(np.zeros(2), abs=1e-9)
    assert high[0] <= 25
    assert high[1] <= 25
    # The jaws close to a gap of 16 mm: anything thinner would not be gripped.
    assert high[0] - low[0] >= 25


@pytest.mark.parametrize("obj", OBJECTS, ids=IDS)
def test_edges_are_rounded_by_a_millimetre(obj: RigidObject) -> None:
    assert obj.parameters.get("rounding_mm", 1) >= 1


@pytest.mark.parametrize("obj", OBJECTS, ids=IDS)
def test_mirror_flags_tell_the_truth(obj: RigidObject) -> None:
    rows = obj.primitives
    points = np.random.default_rng(5).uniform([-27, -27, -3], [27, 27, 53], (2000, 3))
    here = distance(rows, points)
    for is_mirrored, signs in ((obj.mirror_x, [-1, 1, 1]), (obj.mirror_y, [1, -1, 1])):
        difference = np.abs(distance(rows, points * signs) - here).max()
        assert difference < 1e-9 if is_mirrored else difference > 0.5


@pytest.mark.parametrize("obj", OBJECTS, ids=IDS)
def test_round_objects_are_those_that_a_turn_does_not_change(obj: RigidObject) -> None:
    rows = obj.primitives
    points = np.random.default_rng(7).uniform([-27, -27, -3], [27, 27, 53], (2000, 3))
    difference = np.abs(distance(rotated(rows, turn_about_z(17.0)), points) - distance(rows, points)).max()
    assert difference < 1e-9 if obj.is_round else difference > 0.5


@pytest.mark.parametrize("obj", OBJECTS, ids=IDS)
def test_mesh_agrees_with_the_distance(obj: RigidObject) -> None:
    rows = obj.primitives
    mesh = object_mesh(obj)
    assert mesh.is_watertight
    assert np.abs(distance(rows, mesh.vertices)).max() < 0.02
    # Flat triangles of 1 mm cut the edges, which are rounded by 1 mm.
    sag = np.abs(distance(rows, mesh.triangles_center))
    assert sag.max() < 0.45
    assert sag.mean() < 0.04
    assert mesh.bounds == pytest.approx(bounds(rows), abs=0.25)
    points = np.random.default_rng(6).uniform([-25, -25, 0], [25, 25, 50], (100_000, 3))
    inside_mm3 = np.mean(distance(rows, points) < 0) * 50**3
    assert mesh.volume == pytest.approx(inside_mm3, rel=0.06)


def test_mesh_of_a_sphere_has_its_volume() -> None:
    assert object_mesh(OBJECTS[1]).volume == pytest.approx(4 / 3 * np.pi * 20**3, rel=0.005)
    assert object_mesh(OBJECTS[1], spacing_mm=2.0).volume == pytest.approx(4 / 3 * np.pi * 20**3, rel=0.02)
