"""Own objects from files, in configs, in a lake, and by name."""

import json
from contextlib import nullcontext
from pathlib import Path

import numpy as np
import pytest
import trimesh

from fast.lake.provenance import current_provenance
from fast.lake.store import Lake
from fast.lake.tables.campaign import ObjectRow
from fast.models.errors import ConfigError, UsageError
from fast.models.objects import catalogue
from fast.models.objects.catalogue import get_object, name_object
from fast.models.objects.distance import distance
from fast.models.objects.rigid import RigidObject
from fast.tasks.campaign.campaign import Campaign
from fast.tasks.campaign.config import load_config
from fast.tasks.campaign.settings import ObjectPlan
from fast.tasks.campaign.setup import register
from fast.tasks.objects import find_object, own_objects, read_object, read_objects

DUMBBELL = """
name = "dumbbell"
[[parts]]
shape = "sphere"
diameter_mm = 30
[[parts]]
shape = "cylinder"
diameter_mm = 14
length_mm = 40
"""
CONFIG = """
name = "own"
[objects]
ids = [30]
files = ["ball.stl", "dumbbell.toml"]
[bench]
world = "world.toml"
"""


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(catalogue, "_OWN", {})
    trimesh.creation.icosphere(2, 20.0).export(tmp_path / "ball.stl")
    (tmp_path / "dumbbell.toml").write_text(DUMBBELL)
    (tmp_path / "own.toml").write_text(CONFIG)
    (tmp_path / "world.toml").write_text((Path(__file__).parents[2] / "worlds" / "quick.toml").read_text())
    return tmp_path


def bow_tie() -> trimesh.Trimesh:
    """A closed tube along an eight: one body, which goes through itself."""
    at = np.linspace(0.0, 2.0 * np.pi, 48, endpoint=False)
    along = np.stack([20.0 * np.cos(at), 24.0 * np.cos(2.0 * at), 0.0 * at], axis=1)
    up = np.array([0.0, 0.0, 1.0])
    side = np.cross(along / np.linalg.norm(along, axis=1)[:, None], up)
    turn = np.linspace(0.0, 2.0 * np.pi, 12, endpoint=False)[:, None, None]
    centre = np.stack([20.0 * np.sin(at), 12.0 * np.sin(2.0 * at), 0.0 * at], axis=1)
    rings = centre + 5.0 * (np.cos(turn) * side + np.sin(turn) * up)  # 12 x 48 x 3
    number = np.arange(12 * 48).reshape(12, 48)
    right, behind = np.roll(number, -1, axis=0), np.roll(number, -1, axis=1)
    both = np.roll(right, -1, axis=1)
    faces = np.concatenate([np.stack([number, behind, right], -1), np.stack([right, behind, both], -1)])
    mesh = trimesh.Trimesh(rings.reshape(-1, 3), faces.reshape(-1, 3))
    mesh.fix_normals()
    return mesh


def test_a_body_whose_faces_cross_is_warned_of(folder: Path, caplog: pytest.LogCaptureFixture) -> None:
    read_object(folder / "ball.stl")
    assert caplog.text == ""
    bow_tie().export(folder / "eight.stl")
    read_object(folder / "eight.stl")
    assert "eight.stl`: faces of one body cross, and the simulator takes those inside of it for surface" in caplog.text


def test_a_config_names_objects_by_file_and_gives_them_free_places(folder: Path) -> None:
    plan = load_config(folder / "own.toml").objects
    ball, dumbbell = plan.own_ids
    assert plan.object_ids == (30, ball, dumbbell)
    assert plan.own_places == ((ball, 0), (dumbbell, 1))
    assert name_object(dumbbell) == f"dumbbell ({dumbbell})"


def test_names_of_files_decide_no_results_and_their_content_does(folder: Path) -> None:
    before = load_config(folder / "own.toml").science
    (folder / "ball.stl").rename(folder / "bowl.stl")
    (folder / "own.toml").write_text(CONFIG.replace("ball.stl", "bowl.stl"))
    assert load_config(folder / "own.toml").science == before
    trimesh.creation.icosphere(2, 21.0).export(folder / "bowl.stl")
    assert load_config(folder / "own.toml").science != before


def test_a_lake_knows_an_object_after_its_file_is_gone(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    ball = read_object(folder / "ball.stl")
    lake = Lake.open(folder / "lake", create=True)
    lake.append([ObjectRow.of(ball)], current_provenance())
    lake.close()
    (folder / "ball.stl").unlink()
    monkeypatch.setattr(catalogue, "_OWN", {})
    assert [obj.name for obj in own_objects(folder / "lake")] == ["ball"]
    assert find_object("ball", folder / "lake") == get_object(ball.object_id) == ball
    opened = Lake.open(folder / "lake")
    monkeypatch.setattr(catalogue, "_OWN", {})
    assert get_object(ball.object_id) == ball  # asked of the lake that is open
    opened.close()


def test_objects_are_found_by_name_number_and_file(folder: Path) -> None:
    lake = folder / "lake"
    assert find_object("cube", lake).object_id == find_object("30", lake).object_id == 30
    assert find_object("Large-Sphere", lake).object_id == 2
    assert find_object(str(folder / "dumbbell.toml"), lake).name == "dumbbell"
    for text, words in (
        ("cubee", "no object is called `cubee`; did you mean `cube`"),
        ("36", "object 36 does not exist"),
        ("-1", "object -1 does not exist"),
        ("123456", "own object that this lake does not have"),
        ("none.stl", "does not exist"),
    ):
        with pytest.raises((UsageError, ConfigError), match=words):
            find_object(text, lake)


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("x.blend", b"", "of no known kind; give one that ends in .stl"),
        ("x.stl", b"", "has no triangles that can be read as STL; export it again"),
        ("x.stl", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "has no triangles that can be read as STL"),
        ("x.stl", b"\x00" * 100, "x.stl"),
        ("x.obj", b"v 1 2\nf 1 2 3\n", "x.obj"),
        ("x.3mf", b"PK\x03\x04nonsense", "cannot be read as 3MF"),
        ("x.toml", b"\xff\xfe", "not a text file"),
        ("x.toml", b"name = ", "x.toml"),
        ("x.toml", b'name = "x"', "either `mesh` or `parts`"),
        ("x.toml", b'mesh = "x.png"', "must end in .stl"),
        ("x.toml", b'[[parts]]\nshape = "blob"\n', "`parts.0.shape` is 'blob', it must be one of 'sphere', 'capsule',"),
        ("x.toml", b"[[parts]]\ndiameter_mm = 3\n", "`parts.0.shape` is missing; add it."),
        ("x.toml", b"parts = [3]\n", "`parts.0` is 3, it must be a table of keys and values; change it."),
        (
            "x.toml",
            b'[[parts]]\nshape = "sphere"\ndiameter_mm = 3\ndiametre_mm = 3\n',
            "`parts.0.sphere.diametre_mm`; did you mean `diameter_mm`?",
        ),
        ("x.toml", b'[[parts]]\nshape = "sphere"\ndiameter_mm = -3\n', "diameter_mm"),
        ("x.toml", b'[[parts]]\nshape = "capsule"\ndiameter_mm = 30\nlength_mm = 20\n', "longer than its diameter"),
        (
            "x.toml",
            b'[[parts]]\nshape = "cylinder"\ndiameter_mm = 20\nlength_mm = 20\nbore_mm = 20\n',
            "a bore is smaller",
        ),
        (
            "x.toml",
            b'[[parts]]\nshape = "lathe"\noutline_mm = [[0, 0], [0, 20], [10, 20], [10, 0]]\n',
            "goes clockwise or has no area",
        ),
        ("x.toml", b'scale = 2\n[[parts]]\nshape = "sphere"\ndiameter_mm = 20\n', "are of a mesh"),
    ],
)
def test_a_wrong_file_is_one_sentence(folder: Path, name: str, content: bytes, words: str) -> None:
    (folder / name).write_bytes(content)
    with pytest.raises(ConfigError, match=words) as refused:
        read_object(folder / name)
    assert "\n" not in str(refused.value)


def test_a_mesh_called_like_one_of_the_36_or_in_inches_says_what_to_do(folder: Path) -> None:
    trimesh.creation.box((30.0, 30.0, 30.0)).export(folder / "cube.stl")
    with pytest.raises(ConfigError, match=r"none of the 36; rename the file, or set `name` in a .toml file"):
        read_object(folder / "cube.stl")
    trimesh.creation.box((1.2, 1.2, 1.2)).export(folder / "inches.stl")
    with pytest.raises(
        ConfigError, match=r"in a .toml file `scale = 1000` for a mesh in metres, 25.4 for one in inches"
    ):
        read_object(folder / "inches.stl")


THIN_TUBE = """
[[parts]]
shape = "cylinder"
diameter_mm = 30
length_mm = 30
bore_mm = 28.4
rounding_mm = 0.3
"""


def test_thin_walls_through_which_fingers_go_are_warned_of(folder: Path, caplog: pytest.LogCaptureFixture) -> None:
    for name, wall_mm in (("thin", 0.8), ("thick", 3.0)):
        trimesh.creation.annulus(15.0 - wall_mm, 15.0, 30.0, sections=48).export(folder / f"{name}.stl")
    (folder / "parts.toml").write_text(THIN_TUBE)
    for name in ("ball.stl", "dumbbell.toml", "thick.stl"):
        find_object(str(folder / name), folder / "lake")
    assert caplog.text == ""
    for name in ("thin.stl", "parts.toml"):
        find_object(str(folder / name), folder / "lake")
    for name in ("thin", "parts"):
        assert f"{name}: it has walls thinner than 1 mm; fingers may go through walls below 2 mm" in caplog.text


def test_a_mesh_of_an_older_lake_keeps_its_rounded_edges_and_is_told_of(
    folder: Path, caplog: pytest.LogCaptureFixture
) -> None:
    cube = trimesh.creation.box((40.0, 40.0, 40.0))
    cube.export(folder / "sharp.stl")
    corners = cube.vertices[:, None] - 0.5 * np.sign(cube.vertices)[:, None] * (1.0 - np.eye(3))
    trimesh.convex.convex_hull(corners.reshape(-1, 3)).export(folder / "chamfered.stl")
    now = [read_object(folder / name) for name in ("ball.stl", "chamfered.stl", "sharp.stl")]
    lake = Lake.open(folder / "lake", create=True)
    lake.append([ObjectRow.of(as_before(obj)) for obj in now], current_provenance())
    for obj in now:
        find_object(obj.name, folder / "lake")
    assert caplog.text.count("had their sharp edges rounded, so simulated forces may be up to 30 % off") == 1
    assert "sharp: it came to this lake" in caplog.text
    caplog.clear()
    path = folder / "own.toml"
    path.write_text(CONFIG.replace("ball.stl", "sharp.stl"))
    for _ in range(2):
        register(Campaign(lake, load_config(path)), path.read_text())  # the config reads the file anew
    assert caplog.text.count("sharp: it came to this lake") == 1  # where the campaign begins, not where it goes on
    edge = np.linspace([20.1, -9.9, 40.1], [20.1, 9.9, 40.1], 50)  # 0.14 mm before it
    rounded, sharp = (distance(obj.primitives, edge) for obj in (get_object(now[2].object_id), now[2]))
    assert rounded == pytest.approx(0.12, abs=0.005)
    assert sharp == pytest.approx(0.141, abs=0.001)


def as_before(obj: RigidObject) -> RigidObject:
    """The object as a lake of the first versions has it: its text says nothing of edges."""
    told = json.loads(obj.shape or "")
    del told["edges"]
    return obj.model_copy(update={"shape": json.dumps(told)})


def test_two_files_with_one_object_or_one_name_are_refused(folder: Path) -> None:
    (folder / "again.toml").write_text(DUMBBELL)
    with pytest.raises(ConfigError, match="hold the same object"):
        read_objects([folder / "dumbbell.toml", folder / "again.toml"])
    (folder / "again.toml").write_text(DUMBBELL.replace("40", "41"))
    with pytest.raises(ConfigError, match="another object is called `dumbbell`"):
        read_objects([folder / "dumbbell.toml", folder / "again.toml"])


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"files": ("a.stl",)}, "set `ids` to those that stay"),
        ({"ids": (), "files": ()}, "name one object at least"),
        ({"ids": (), "files": ("a.stl", "a.stl")}, "names one file twice"),
        ({"ids": (3,), "files": ("a.stl",), "places": (3,)}, "a place of its own"),
        ({"ids": (3,), "files": ("a.stl",), "places": (36,)}, "0 to 35"),
        ({"ids": tuple(range(36)), "files": ("a.stl",)}, "the bench has 36 places"),
    ],
)
def test_a_plan_without_room_is_refused(values: dict[str, object], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        ObjectPlan(**values)  # type: ignore[arg-type]


def write_bodies(path: Path, gap_mm: float) -> Path:
    lower, upper = trimesh.creation.box((20, 20, 20)), trimesh.creation.box((10, 10, 10))
    upper.apply_translation((0, 0, 15 + gap_mm))
    trimesh.util.concatenate([lower, upper]).export(path)
    return path


def test_a_body_that_floats_is_refused_and_bodies_that_touch_are_one_object(folder: Path) -> None:
    with pytest.raises(ConfigError, match="has 2 bodies that do not touch, 2 mm apart at the nearest"):
        read_object(write_bodies(folder / "two.stl", 2.0))
    assert read_object(write_bodies(folder / "touching.stl", 0.0)).name == "touching"
    assert read_object(write_bodies(folder / "overlapping.stl", -1.0)).name == "overlapping"


@pytest.mark.parametrize(("gap_mm", "floats"), [(0.1, False), (2.0, True)])
def test_gaps_of_bodies_are_those_of_the_scaled_object(folder: Path, gap_mm: float, floats: bool) -> None:
    mesh = trimesh.load_mesh(write_bodies(folder / "metres.stl", gap_mm))
    mesh.apply_scale(1e-3).export(folder / "metres.stl")
    (folder / "scaled.toml").write_text('mesh = "metres.stl"\nscale = 1000')
    with pytest.raises(ConfigError, match="do not touch") if floats else nullcontext():
        assert read_object(folder / "scaled.toml").size_mm[2] == pytest.approx(30 + gap_mm)


def test_a_ball_in_the_hole_of_a_ring_floats_and_the_wall_of_a_cavity_does_not(folder: Path) -> None:
    ring, ball = trimesh.creation.annulus(15, 20, 20), trimesh.creation.icosphere(2, 6)
    trimesh.util.concatenate([ring, ball]).export(folder / "ring.stl")
    with pytest.raises(ConfigError, match="has 2 bodies that do not touch"):
        read_object(folder / "ring.stl")
    hollow, wall = trimesh.creation.icosphere(3, 20), trimesh.creation.icosphere(3, 16)
    wall.invert()
    trimesh.util.concatenate([hollow, wall]).export(folder / "hollow.stl")
    assert read_object(folder / "hollow.stl").size_mm[2] == pytest.approx(40, abs=0.1)
    trimesh.util.concatenate([hollow, wall, ball]).export(folder / "rattle.stl")
    with pytest.raises(ConfigError, match="has 2 bodies that do not touch"):
        read_object(folder / "rattle.stl")


def test_parts_that_do_not_touch_are_refused(folder: Path) -> None:
    sphere = '[[parts]]\nshape = "sphere"\ndiameter_mm = 14\nat_mm = [0, 0, {}]\n'
    (folder / "pair.toml").write_text(sphere.format(7) + sphere.format(26))
    with pytest.raises(ConfigError, match="has 2 bodies that do not touch, 5 mm apart at the nearest"):
        read_object(folder / "pair.toml")
    (folder / "pair.toml").write_text(sphere.format(7) + sphere.format(20))
    assert read_object(folder / "pair.toml").size_mm[2] == pytest.approx(27)
    thin = '[[parts]]\nshape = "cylinder"\nrounding_mm = 0.1\n'
    rod = thin + "diameter_mm = 0.6\nlength_mm = 10\nat_mm = [0, 0, 17]\n"
    (folder / "pair.toml").write_text(sphere.format(7) + sphere.format(26) + rod)
    assert read_object(folder / "pair.toml").size_mm[2] == pytest.approx(33)
    ring = thin + "diameter_mm = 40\nbore_mm = 38\nlength_mm = 20\nat_mm = [0, 0, 10]\n"
    (folder / "pair.toml").write_text(ring + sphere.format(10))
    with pytest.raises(ConfigError, match="has 2 bodies that do not touch, 12 mm apart at the nearest"):
        read_object(folder / "pair.toml")


@pytest.mark.parametrize(
    ("stem", "name"),
    [
        ("7up", "object 7up"),
        ("mug.v2 (copy)", "mug-v2 -copy"),
        ("größe", "groe"),
        ("_mug", "object _mug"),
        ("杯", "object"),
        ("m" * 60, "m" * 40),
    ],
)
def test_any_file_name_gives_a_name_and_ply_is_read(folder: Path, stem: str, name: str) -> None:
    trimesh.creation.box((40, 40, 40)).export(folder / f"{stem}.ply")
    assert read_object(folder / f"{stem}.ply").name == name


def test_a_solid_of_a_cad_program_is_refused_with_what_to_do(folder: Path) -> None:
    (folder / "turned.toml").write_text('mesh = "cup.stp"')
    for give in (
        lambda: read_object(folder / "cup.STEP"),
        lambda: read_object(folder / "turned.toml"),
        lambda: find_object("cup.step", folder / "lake"),
    ):
        with pytest.raises(ConfigError, match="is a solid of a CAD program, .* export it there as 3MF, or as STL"):
            give()


def test_a_file_from_an_editor_of_windows_is_read(folder: Path) -> None:
    (folder / "bell.toml").write_text("\ufeff" + DUMBBELL.replace("\n", "\r\n"), encoding="utf-8", newline="")
    assert read_object(folder / "bell.toml").name == "dumbbell"
