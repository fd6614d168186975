"""A deposit is valid by the libraries of its two formats, complete, and comes back as the data that it was."""

import hashlib
import json
from pathlib import Path

import pytest

from fast.lake.handoff.import_folder import import_handoff
from fast.lake.handoff.publish import publish
from fast.lake.store import Lake
from fast.lake.tables.campaign import GraspRow
from fast.models.errors import UsageError
from tests.flows.cli.cli_lakes import Fast
from tests.lake.handoff.handoff_folder import PROVENANCE

frictionless = pytest.importorskip("frictionless")
ABOUT = {"title": "Grasps of forty fingers", "authors": ["Ada Example", "Bo Example"]}


@pytest.fixture
def deposit(lake: Lake, tmp_path: Path, small_rows, make_grasp, make_simulation) -> Path:
    failed, _ = make_grasp(object_id=5, status="failed", reason="no air", peak_force_n=None, work_j=None)
    lake.append([*small_rows, *make_grasp(), failed, *make_simulation()], PROVENANCE)
    publish(lake, tmp_path / "deposit", **ABOUT)
    return tmp_path / "deposit"


@pytest.mark.filterwarnings("ignore")
def test_the_data_package_is_valid_and_its_tables_have_the_stated_types(deposit: Path) -> None:
    package = frictionless.Package(str(deposit / "datapackage.json"))
    for resource in package.resources:
        if resource.format == "csv":
            report = frictionless.validate(resource)
            assert report.valid, report.flatten(["rowNumber", "fieldName", "message"])
    columns = {field.name: field.type for field in package.get_resource("grasps-csv").schema.fields}
    assert (columns["object_id"], columns["tool_id"], columns["grasp_id"]) == ("integer", "string", "string")
    designs = {field.name: field for field in package.get_resource("designs-csv").schema.fields}
    assert (designs["height_mm"].type, designs["height_mm"].title) == ("number", "height (mm)")


def test_every_file_has_its_checksum(deposit: Path) -> None:
    package = json.loads((deposit / "datapackage.json").read_text())
    for resource in package["resources"]:
        data = (deposit / resource["path"]).read_bytes()
        assert resource["bytes"] == len(data)
        assert resource["hash"] == f"sha256:{hashlib.sha256(data).hexdigest()}"
    listed = {resource["path"] for resource in package["resources"]}
    there = {path.relative_to(deposit).as_posix() for path in deposit.rglob("*") if path.is_file()}
    assert listed | {"README.md", "datapackage.json", "ro-crate-metadata.json"} == there


def test_measured_fingers_and_objects_are_there_to_print(deposit: Path) -> None:
    import trimesh

    shapes = {path.name: trimesh.load_mesh(path) for path in (deposit / "shapes").iterdir()}
    fingers = [name for name in shapes if not name.startswith("object_")]
    assert len(fingers) == 2  # of one design: the compliant part and the rigid one
    assert {"object_4.stl", "object_5.stl"} & set(shapes)
    assert all(mesh.is_watertight for mesh in shapes.values())


def test_the_crate_says_who_what_and_under_which_licence(deposit: Path) -> None:
    from rocrate.rocrate import ROCrate

    crate = ROCrate(str(deposit))
    assert crate.name == ABOUT["title"]
    assert crate.license == "https://creativecommons.org/licenses/by/4.0/"
    assert [author["name"] for author in crate.creator] == ABOUT["authors"]
    files = {entity.id for entity in crate.data_entities}
    assert files >= {"designs.csv", "grasps.csv", "traces.parquet", "README.md", "datapackage.json"}
    readme = (deposit / "README.md").read_text()
    assert "2 measured and 1 simulated grasps of 1 soft fingers" in readme
    assert "Ada Example, Bo Example. Licence: Creative Commons Attribution 4.0" in readme


def test_it_is_read_back(deposit: Path, lake: Lake, tmp_path: Path) -> None:
    other = Lake.open(tmp_path / "other", create=True)
    import_handoff(other, deposit, PROVENANCE)
    assert other.ids(GraspRow) == lake.ids(GraspRow)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"title": " "}, "needs a title and at least one author"),
        ({"authors": []}, "needs a title and at least one author"),
        ({"licence": "MIT"}, "the licence `MIT` is unknown; give one of CC-BY-4.0"),
    ],
)
def test_a_deposit_without_author_or_licence_is_refused(lake: Lake, tmp_path: Path, change: dict, words: str) -> None:
    with pytest.raises(UsageError, match=words):
        publish(lake, tmp_path / "deposit", **ABOUT | change)
    assert not (tmp_path / "deposit").exists()


def test_from_the_command_line_and_never_over_another(deposit: Path, lake: Lake, capsys) -> None:
    words = ("lake", "publish", deposit, "--title", "T", "--author", "A", "--lake", lake.address)
    assert "already holds README.md" in Fast(capsys).refused(*words)
    done = Fast(capsys)(*words[:2], deposit.parent / "two", *words[3:], "--licence", "CC0-1.0")
    assert done.out.startswith("wrote 1 designs, 2 measured grasps, 1 simulated grasps")
    assert "publicdomain/zero" in (deposit.parent / "two" / "ro-crate-metadata.json").read_text()
