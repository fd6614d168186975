"""A deposit is valid by the libraries of its two formats, complete, and comes back as the data that it was."""

import hashlib
import json
import zipfile
from pathlib import Path

import pytest

from fast.lake.handoff.eln import check_eln_path, write_eln
from fast.lake.handoff.import_folder import import_handoff
from fast.lake.handoff.publish import publish
from fast.lake.handoff.zenodo import read_access, upload_deposit
from fast.lake.store import Lake
from fast.lake.tables.campaign import GraspRow
from fast.models.errors import FastError, UsageError
from tests.flows.cli.cli_lakes import Fast
from tests.flows.server.local_server import Request, local_server
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
    report = frictionless.validate(str(deposit / "datapackage.json"))
    assert report.valid, report.flatten(["name", "rowNumber", "fieldName", "message"])
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
    assert "2 measured and 1 simulated grasp of 1 soft finger." in readme
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
    assert done.out.startswith("wrote 1 design, 2 measured grasps, 1 simulated grasp,")
    assert "publicdomain/zero" in (deposit.parent / "two" / "ro-crate-metadata.json").read_text()


def test_a_notebook_file_is_one_folder_with_a_data_set_of_every_file(deposit: Path, tmp_path: Path) -> None:
    """What the ELN Consortium's checks ask: one root folder named like the file, a data set in the root's parts."""
    from rocrate.rocrate import ROCrate

    write_eln(deposit, tmp_path / "fingers.eln")
    with zipfile.ZipFile(tmp_path / "fingers.eln") as archive:
        assert {name.split("/")[0] for name in archive.namelist()} == {"fingers"}
        archive.extractall(tmp_path / "unpacked")
    assert ROCrate(str(tmp_path / "unpacked" / "fingers")).name == ABOUT["title"]
    said = json.loads((tmp_path / "unpacked" / "fingers" / "ro-crate-metadata.json").read_text())
    graph = {node["@id"]: node for node in said["@graph"]}
    assert graph["./"]["hasPart"] == [{"@id": "./grasps/"}]
    data = graph["./grasps/"]
    assert {"name", "author", "text", "dateCreated", "dateModified", "keywords", "identifier"} <= set(data)
    for part in data["hasPart"]:
        node = graph[part["@id"]]
        content = (tmp_path / "unpacked" / "fingers" / part["@id"]).read_bytes()
        assert node["sha256"] == hashlib.sha256(content).hexdigest()
        assert node["contentSize"] == str(len(content))
        assert node["encodingFormat"]
    here = {path.name for path in deposit.rglob("*") if path.is_file()} - {"ro-crate-metadata.json"}
    assert {Path(part["@id"]).name for part in data["hasPart"]} == here


def test_a_notebook_file_has_its_ending_and_overwrites_nothing(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="ends with .eln"):
        check_eln_path(tmp_path / "fingers.zip")
    (tmp_path / "fingers.eln").touch()
    with pytest.raises(UsageError, match="is there already"):
        check_eln_path(tmp_path / "fingers.eln")
    with pytest.raises(UsageError, match="is no folder that can be written; nothing was written: give another --eln"):
        check_eln_path(tmp_path / "nowhere" / "fingers.eln")


class Archive:
    """Zenodo's deposit interface as far as it is used: drafts with files and metadata."""

    def __init__(self) -> None:
        self.address = ""
        self.files: dict[str, int] = {}
        self.metadata: dict[str, object] = {}
        self.is_deleted = False
        self.breaks_at = ""

    def __call__(self, request: Request) -> tuple[int, object]:
        if request.headers.get("Authorization") != "Bearer token":
            return 401, {}
        if self.breaks_at and self.breaks_at in request.path and request.method == "PUT":
            return 500, {}
        if request.method == "POST" and request.path == "/api/deposit/depositions":
            own = f"{self.address}/api/deposit/depositions/7"
            links = {"bucket": f"{self.address}/api/files/b", "self": own, "html": f"{self.address}/deposit/7"}
            return 201, {"id": 7, "links": links}
        if request.method == "PUT" and request.path.startswith("/api/files/b/"):
            self.files[request.path.rpartition("/")[2]] = int(request.headers["Content-Length"])
        elif request.method == "PUT":
            self.metadata = request.body["metadata"]
        elif request.method == "DELETE":
            self.is_deleted = True
        return 200, {}


def test_a_deposit_is_uploaded_as_a_draft_that_a_person_publishes(deposit: Path, monkeypatch) -> None:
    archive = Archive()
    with local_server(archive) as (archive.address, _):
        monkeypatch.setenv("FAST_ZENODO_URL", archive.address)
        monkeypatch.setenv("FAST_ZENODO_TOKEN", "token")
        assert upload_deposit(deposit, read_access()) == f"{archive.address}/deposit/7"
        assert set(archive.files) == {"README.md", "deposit.zip"}
        assert archive.metadata["title"] == ABOUT["title"]
        assert archive.metadata["creators"] == [{"name": "Ada Example"}, {"name": "Bo Example"}]
        assert archive.metadata["license"] == "cc-by-4.0"
        archive.breaks_at = "deposit.zip"
        with pytest.raises(FastError, match="did not take the deposit .500 .*nothing was published"):
            upload_deposit(deposit, read_access())
        assert archive.is_deleted
        with pytest.raises(UsageError, match="refused the token .401"):
            upload_deposit(deposit, (archive.address, "wrong"))
    with pytest.raises(FastError, match="cannot be reached"):
        upload_deposit(deposit, (archive.address, "token"))


@pytest.mark.parametrize(
    ("url", "token", "words"),
    [
        ("https://zenodo.org", "", "FAST_ZENODO_TOKEN is not set"),
        ("http://zenodo.org", "t", "a token is only sent to https"),
        ("http://127.0.0.1.evil.example", "t", "a token is only sent to https"),
    ],
)
def test_a_token_is_needed_and_goes_nowhere_else(monkeypatch, url: str, token: str, words: str) -> None:
    monkeypatch.setenv("FAST_ZENODO_URL", url)
    monkeypatch.setenv("FAST_ZENODO_TOKEN", token)
    with pytest.raises(UsageError, match=words):
        read_access()


def test_an_object_without_a_floor_is_published_alone(lake: Lake, tmp_path: Path, small_rows, make_grasp) -> None:
    lake.append([*small_rows, *make_grasp(object_id=14)], PROVENANCE)
    publish(lake, tmp_path / "deposit", **ABOUT)
    assert (tmp_path / "deposit" / "shapes" / "object_14_alone.stl").exists()
    assert "object 14 alone: it has no floor for a mount" in (tmp_path / "deposit" / "datapackage.json").read_text()
