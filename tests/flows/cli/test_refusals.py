"""Wrong use: one sentence with value, limit and fix, exit status 2, nothing written."""

import importlib.util
import json
import re
import socket
import sys

import pytest

from fast.models.design.space import BEST_PUBLISHED
from tests.flows.cli.cli_lakes import QUICK, WORLD, Fast, everything_in, proposed_lake, write_config

NOWHERE = ("/proc/lake", "/proc/version/lake")  # nobody can make a folder there, not even root


@pytest.fixture
def fast(capsys, monkeypatch):
    monkeypatch.delenv("FAST_LAKE", raising=False)
    return Fast(capsys)


@pytest.fixture(scope="module")
def lake(tmp_path_factory):
    return proposed_lake(tmp_path_factory.mktemp("cli"))


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("seed = 1", "sede = 1", "unknown key `sede`; did you mean `seed`?"),
        ("friction = 0.56", "friction = 5.6", "`simulator.theta.friction` is 5.6, it must be at most 2"),
        ("ids = [2,", "ids = [36,", "object 36 does not exist, ids are 0 to 35"),
        ("ids = [2, 14, 28, 30]", 'ids = "some"', 'must be "all" or a list of object ids'),
        ("repeats = 2", 'repeats = "two"', "`objects.repeats` is 'two', it must be a whole number"),
        ("tools_per_batch = 4", "tools_per_batch = 11", "is 11, it must be at most 10"),
        ('name = "quick"', 'name = "Quick!"', "lower-case letters, digits, hyphens"),
        ("seed = 1", "seed = one", "is not TOML"),
        ("world.toml", "none.toml", "does not exist; set bench.world to an existing file"),
        ("[bench]", "[bnech]", "`bench` is missing; add it. unknown key `bnech`; did you mean `bench`?"),
        (
            "[bench]",
            '[[simulator.effects]]\neffect = "load_cell_lga"\n[bench]',
            "unknown effect `load_cell_lga`; did you mean `load_cell_lag`?",
        ),
        (
            "[bench]",
            '[[simulator.effects]]\neffect = "load_cell_gain"\nparameters = {gian = 1.1}\n[bench]',
            "has no parameter `gian`; did you mean `gain`?",
        ),
        (
            "[bench]",
            '[[simulator.effects]]\neffect = "load_cell_gain"\nparameters = {gain = 3}\n[bench]',
            "`gain` is 3.0, it must be within 0.8 to 1.25",
        ),
    ],
)
def test_a_bad_config_makes_no_lake(fast, tmp_path, old, new, said):
    assert old in QUICK
    config = write_config(tmp_path, QUICK.replace(old, new))
    before = everything_in(tmp_path)
    assert said in fast.refused("campaign", "run", config, "--lake", tmp_path / "lake")
    assert everything_in(tmp_path) == before
    assert not (tmp_path / "lake").exists()


@pytest.mark.parametrize(
    ("added", "said"),
    [
        ('[[hidden]]\neffect = "load_cell_gian"', "unknown hidden effect `load_cell_gian`; did you mean"),
        ('[[hidden]]\neffct = "load_cell_gain"', "has no effect; add effect ="),
        ('[[hidden]]\neffect = "load_cell_gain"\ngain = 9', "`gain` of hidden effect `load_cell_gain` is 9"),
        ("[sensors]\nrate_hz = 80", "unknown key `sensors`; did you mean `sensor`?"),
    ],
)
def test_a_bad_world_is_refused_by_all_who_read_it(fast, tmp_path, added, said):
    config = write_config(tmp_path)
    world = tmp_path / "world.toml"
    world.write_text(f"{WORLD.read_text()}\n{added}\n")
    assert said in fast.refused("campaign", "run", config, "--lake", tmp_path / "lake")
    assert said in fast.refused("gantry", "home", "--world", world)
    assert said in fast.refused("virtual", "start", world)
    assert not (tmp_path / "lake").exists()


@pytest.mark.parametrize("where", NOWHERE)
def test_a_lake_that_cannot_be_made_is_refused(fast, tmp_path, where):
    config = write_config(tmp_path)
    said = fast.refused("campaign", "run", config, "--lake", where)
    assert f"{where} cannot be written" in said
    assert "give another folder with --lake" in said


def test_a_folder_with_other_things_is_no_lake(fast, tmp_path):
    config = write_config(tmp_path)
    before = everything_in(tmp_path)
    said = fast.refused("campaign", "run", config, "--lake", tmp_path)
    assert "is not empty and not a lake" in said
    assert everything_in(tmp_path) == before


def test_a_lake_whose_state_cannot_be_written_is_refused(fast, tmp_path):
    root = proposed_lake(tmp_path)
    (root / ".state").write_text("in the way")
    answer = fast("campaign", "run", tmp_path / "quick.toml", "--lake", root)
    assert answer.status == 2
    assert ".state/prefect cannot be written (Not a directory)" in answer.err
    assert fast("campaign", "status", "--lake", root).status == 0


def test_a_changed_config_under_the_same_name_is_refused_with_what_changed(fast, tmp_path):
    root = proposed_lake(tmp_path)
    write_config(tmp_path, QUICK.replace("seed = 1", "seed = 2").replace("friction = 0.56", "friction = 0.6"))
    before = everything_in(root)
    said = fast.refused("campaign", "run", tmp_path / "quick.toml", "--lake", root)
    assert "seed 1 -> 2; simulator.theta.friction 0.56 -> 0.6" in said
    assert "undo the change or give the new config another name" in said
    after = everything_in(root)
    assert {name for name in after if name not in before} == {"leases/campaign-quick/00000001.json"}
    assert after.items() >= before.items()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["nonsense"], 'Unknown command "nonsense".'),
        (["campaign", "runn"], 'Did you mean "run"?'),
        (["campaign", "run"], "`fast campaign run` needs CONFIG: TOML file"),
        (["campaign", "status", "--lak", "x"], "Unknown option: --lak. Did you mean --lake? See `fast campaign"),
        (["simulate", "--object", "x"], "no object is called `x`; known: block, cone"),
        (["sql", "SELECT 1", "--format", "xml"], 'Choose from: "table", "csv", "json", "parquet".'),
        (["virtual", "start", str(WORLD), "--plc-port", "99999"], "Must be <= 65535"),
        (["virtual", "start", str(WORLD), "--speed-up", "0"], "Must be > 0"),
        (["gantry", "grasp", "--object", "2", "--repeats", "0"], "Must be >= 1"),
        (["gantry", "grasp", "--object", "36"], "object 36 does not exist; the numbers go from 0 to 35"),
        (["gantry", "grasp", "--object", "2", "--slot", "10"], "slot 10 has no tool; mounted are slots 0 to 9"),
        (["gantry", "home", "--world", "none.toml"], "world file `none.toml` cannot be read"),
        (["gantry", "home", "--real", "none.toml"], "bench file `none.toml` does not exist"),
        (["simulate", "--object", "36"], "object 36 does not exist; the numbers go from 0 to 35"),
        (["simulate", "--object", "2", "--set", "frction=1"], "did you mean `friction`?"),
        (["simulate", "--object", "2", "--set", "friction=9"], "`friction` is 9, it must be at most 2"),
        (["simulate", "--object", "2", "--set", "friction"], "has no value; write it like --set friction=0.5"),
        (["simulate", "--object", "2", "--out", "/proc/x"], "--out `/proc/x` cannot be written"),
        (["campaign", "status", "--lake", "/nowhere"], "/nowhere is not a lake: give another --lake"),
        (["serve", "--port", "70000"], "Must be <= 65535"),
        (["serve", "--port", "4200.5"], 'Invalid value for --port: unable to convert "4200.5" into a whole number.'),
        (["challenge", "make", "x", "--seed", "x", "--worlds", "3.5"], 'unable to convert "3.5" into a whole number.'),
        (["challenge", "make", "x", "--seed", "none", "--worlds", "4.0"], "the seed none cannot be read"),
    ],
)
def test_wrong_words_get_a_sentence(fast, words, said):
    assert said in fast.refused(*words)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["campaign", "status", "quack"], "campaign `quack` is not in this lake; did you mean `quick`?"),
        (["report", "quack"], "did you mean `quick`?"),
        (["view", "quack", "--save", "x.rrd"], "`quack` is no grasp, design, tool or campaign of this lake"),
        (["simulate", "--object", "2", "--version", "V1"], "simulator version `V1` is not in"),
        (["print", "sheet", "7"], "`7` is not a batch; write it like quick/B01 or B01"),
        (["print", "sheet", "B09"], "batch quick/B09 does not exist"),
        (["print", "sheet", "B01", "--out", "/proc/x"], "the print folder `/proc/x` cannot be written"),
        (["print", "confirm", "B01"], "needs --operator: Who printed and mounted it"),
        (["print", "confirm", "B01", "--operator", ""], "`operator` is '', it must be a text that is not empty"),
        (["print", "confirm", "B01", "--operator", "ada", "--reject", "3"], "write it like --reject 3='tip torn'"),
        (["print", "confirm", "B01", "--operator", "ada", "--reject", "8=torn"], "slot 8 is not in batch quick/B01"),
        (
            ["print", "confirm", "B01", "--operator", "ada", "--reject", "1=a", "--reject", "1=b"],
            "--reject names slot 1 twice",
        ),
        (
            ["print", "confirm", "B01", "--operator", "ada", "--measured", "0:front=9"],
            "B01T0 front wall: 9 mm, drawn 2.23 mm (a wall has 1 to 5 mm)",
        ),
        (
            ["print", "confirm", "B01", "--operator", "ada", "--measured", "0:front=0"],
            "--measured `0:front=0` front wall: 0 mm, it must be above 0 mm; measure it again.",
        ),
        (
            ["print", "confirm", "B01", "--operator", "ada", "--measured", "0:hardness=nan"],
            "hardness: nan Shore A, it must be above 0 Shore A",
        ),
        (["print", "confirm", "B01", "--operator", "ada", "--measured", "0:frnt=2"], "did you mean `front`?"),
        (["print", "confirm", "B01", "--operator", "ada", "--measured", "0:front=x"], "`x` is not a number"),
        (["sql", "FROM grasp"], "There is no table or view `grasp`; did you mean `grasps`?"),
        (["sql", "DROP TABLE grasps"], "the lake is read-only to SQL"),
        (["sql", "SELECT 1; SELECT 2"], "Give exactly one SELECT statement, not 2"),
        (["sql", "SELECT 1", "--format", "parquet"], "add --out FILE.parquet"),
        (["sql", "SELECT 1", "--format", "csv", "--json"], "contradict each other"),
        (["sql", "SELECT 1", "--out", "/proc/x"], "--out `/proc/x` cannot be written"),
        (["lake", "export", "exported", "--campaign", "quack"], "did you mean `quick`?"),
        (["lake", "export", "/proc/x"], "nothing was written: give another folder, or free disk space"),
    ],
)
def test_wrong_questions_to_a_lake_change_nothing(fast, lake, tmp_path, monkeypatch, words, said):
    monkeypatch.chdir(tmp_path)
    before = everything_in(lake)
    assert said in fast.refused(*words, "--lake", lake)
    assert everything_in(lake) == before
    assert list(tmp_path.iterdir()) == []


def test_a_request_to_a_campaign_that_does_not_run_has_failed(fast, lake):
    before = everything_in(lake)
    for verb in ("pause", "stop", "abort"):
        said = fast.refused("campaign", verb, "--lake", lake, status=1)
        assert f"campaign quick is not running, so there is nothing to {verb}" in said
    assert everything_in(lake) == before


def test_an_import_that_cannot_be_done_makes_no_lake(fast, tmp_path):
    assert "is not a folder" in fast.refused("lake", "import", tmp_path / "none", "--lake", tmp_path / "lake")
    assert not (tmp_path / "lake").exists()


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ("{", "is not JSON"),
        ('{"height_mm": 100, "height_mm": 90}', "the key `height_mm` is there twice; leave one out"),
        ("[1]", "the content is [1], it must be a table of keys and values"),
        ('{"height_mm": 300}', "`height_mm` is 300 mm, it must be at most 120.0 mm"),
        ('{"hieght_mm": 100}', "unknown key `hieght_mm`; did you mean `height_mm`?"),
        (json.dumps(BEST_PUBLISHED.model_dump() | {"rib_count": 2.5}), "`rib_count` is 2.5, it must be a whole number"),
    ],
)
def test_a_bad_design_file_is_refused(fast, tmp_path, content, said):
    path = tmp_path / "design.json"
    path.write_text(content)
    assert said in fast.refused("simulate", "--object", "2", "--design", path)
    assert said in fast.refused("virtual", "start", WORLD, "--design", path)


def test_a_missing_design_file_is_refused(fast, tmp_path):
    assert "cannot be read: No such file" in fast.refused("simulate", "--object", "2", "--design", tmp_path / "no")


def test_a_missing_package_is_named_before_anything_is_written(fast, tmp_path, monkeypatch):
    config = write_config(tmp_path)
    monkeypatch.setitem(sys.modules, "serial", None)
    monkeypatch.setitem(sys.modules, "prefect", None)
    assert importlib.util.find_spec("prefect") is None
    said = fast.refused("campaign", "run", config, "--lake", tmp_path / "lake")
    assert re.search(r"the packages `pyserial`, `prefect` are not installed; run `make setup`", said)
    assert "the package `prefect` is not installed" in fast.refused("serve", "--lake", tmp_path / "lake")
    assert not (tmp_path / "lake").exists()


def test_a_taken_port_is_refused(fast, tmp_path, monkeypatch):
    monkeypatch.delenv("FAST_PREFECT_API_URL", raising=False)
    with socket.create_server(("127.0.0.1", 0)) as taken:
        said = fast.refused("serve", "--port", taken.getsockname()[1], "--lake", tmp_path / "lake")
    assert "cannot be used on 127.0.0.1 (Address already in use); give another one" in said
    assert not (tmp_path / "lake").exists()


def test_a_named_server_that_does_not_answer_is_refused(fast, tmp_path, monkeypatch):
    monkeypatch.setenv("FAST_PREFECT_API_URL", "http://127.0.0.1:9/api")
    said = fast.refused("serve", "--lake", tmp_path / "lake")
    assert "FAST_PREFECT_API_URL is http://127.0.0.1:9/api, which does not answer or does not let us in" in said
    assert not (tmp_path / "lake").exists()
