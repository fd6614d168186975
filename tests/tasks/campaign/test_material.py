"""Lots of material: their files in the lake, and the lot that a calibration takes."""

from pathlib import Path

import pytest

from fast.lake.query.lineage import find_lineage
from fast.lake.store import Lake
from fast.lake.tables.campaign import CampaignRow, ToolRow
from fast.lake.tables.material import MaterialRow
from fast.models.errors import ConfigError, UsageError
from fast.tasks.bench.print import PrintConfirmation, confirm_print
from fast.tasks.campaign.campaign import Campaign
from fast.tasks.campaign.config import load_config, read_lot
from fast.tasks.campaign.material import find_lot, store_lot
from fast.tasks.campaign.setup import enter
from fast.tasks.scientist.propose import propose_initial
from tests.tasks.calibration.calibration_lake import CONFIG, PROVENANCE

ROOT = Path(__file__).parents[3]
PAPER = ROOT / "materials" / "paper.toml"


@pytest.fixture
def lake(tmp_path: Path) -> Lake:
    return Lake.open(tmp_path / "lake", create=True)


def n_rows(lake: Lake) -> int:
    """Rows in the files, superseded ones too."""
    return int(lake.query("SELECT count(*) AS n FROM raw_materials")["n"][0].as_py())


def test_the_papers_lot_is_what_the_paper_states(lake: Lake) -> None:
    assert store_lot(lake, PAPER) == "paper"
    rows = {row["quantity"]: row for row in lake.rows(MaterialRow, lot="paper")}
    assert {name: (row["value"], row["unit"], row["sd"], row["n"]) for name, row in rows.items()} == {
        "young_modulus": (11.5, "MPa", 1.75, 5),
        "static_friction": (0.41, "1", None, None),
        "dynamic_friction": (0.99, "1", None, None),
        "hardness": (85.0, "Shore A", None, None),
    }
    assert all("FAST paper, Methods, " in row["source"] for row in rows.values())


def test_a_lot_is_stored_once_and_a_correction_replaces(lake: Lake, tmp_path: Path) -> None:
    for _ in range(2):
        store_lot(lake, PAPER)
    assert n_rows(lake) == 4
    path = tmp_path / "paper.toml"
    path.write_text(PAPER.read_text().replace("0.99", "0.95"))
    store_lot(lake, path)
    assert n_rows(lake) == 5
    (row,) = lake.rows(MaterialRow, quantity="dynamic_friction")
    assert row["value"] == 0.95


def test_a_strange_lot_is_a_question_until_its_file_says_that_it_is_so(lake: Lake, tmp_path: Path) -> None:
    path = tmp_path / "L7.toml"
    path.write_text(PAPER.read_text().replace("value = 11.5\n", "value = 115\n").replace("sd = 1.75 ", "sd = 17.5 "))
    with pytest.raises(
        UsageError, match=r"115 MPa, 85 Shore A are about 13.2 MPa, a decimal point.*be 11.5 MPa.*`sure"
    ):
        store_lot(lake, path)
    assert n_rows(lake) == 0
    path.write_text(path.read_text().replace("value = 115\n", "value = 115\nsure = true\n"))
    for _ in range(2):
        store_lot(lake, path)
    assert n_rows(lake) == 4
    assert {row.quantity: row.sure for row in lake.records(MaterialRow) if row.sure} == {
        "young_modulus": "decimal point"
    }


@pytest.mark.parametrize(
    ("name", "text", "sentence"),
    [
        ("L7.toml", "", "L7.toml: nothing is measured; add a table such as"),
        ("L7.toml", "[young_modulus]\nvalue = x", "is not TOML"),
        ("none.toml", PAPER.read_text(), "here `none.toml`; it must be letters"),
        ("L7.txt", PAPER.read_text(), "here `L7.txt`; it must be letters"),
    ],
)
def test_a_wrong_file_is_refused(tmp_path: Path, name: str, text: str, sentence: str) -> None:
    path = tmp_path / name
    path.write_text(text)
    with pytest.raises(ConfigError, match=sentence):
        read_lot(path)


def campaign_row(name: str, lot: str) -> CampaignRow:
    line = f'material = "../materials/{lot}.toml"\n' if lot else ""
    return CampaignRow(campaign_id=name, name=name, config_toml=line + CONFIG.format(name=name, tier="production"))


def test_the_lot_is_the_one_asked_for_or_that_of_the_campaigns(lake: Lake, tmp_path: Path) -> None:
    store_lot(lake, PAPER)
    other = tmp_path / "TPU 26-117.toml"
    other.write_text(PAPER.read_text())
    rows = [campaign_row("one", "paper"), campaign_row("two", "TPU 26-117"), campaign_row("three", "")]
    lake.append(rows, PROVENANCE)
    assert find_lot(lake, None, ["three"]) is None
    assert find_lot(lake, "none", ["one"]) is None
    found = find_lot(lake, None, ["one", "three"])
    assert found is not None
    assert (found.name, set(found.material_ids)) == ("paper", lake.ids(MaterialRow))
    found = find_lot(lake, str(other), ["one"])  # its file comes into the lake
    assert found is not None
    assert found.name == "TPU 26-117"
    assert found.lot == read_lot(PAPER)
    with pytest.raises(UsageError, match="name different material lots .one names paper, two names TPU 26-117."):
        find_lot(lake, None, ["one", "two"])
    with pytest.raises(UsageError, match=r"lot `papr` is not in .*; did you mean `paper`\? A new one comes in by its"):
        find_lot(lake, "papr", [])


def write_config(folder: Path, lot: Path | None) -> Path:
    path = folder / "small.toml"
    line = f'material = "{lot}"\n' if lot else ""
    world = ROOT / "worlds" / "plain.toml"
    path.write_text(line + CONFIG.format(name="small", tier="production").replace("world.toml", str(world)))
    return path


def test_a_campaign_brings_its_lot_and_its_tools_are_printed_of_it(lake: Lake, tmp_path: Path) -> None:
    path = write_config(tmp_path, PAPER)
    campaign = Campaign(lake, load_config(path))
    for _ in range(2):
        enter(campaign, path)
    assert n_rows(lake) == 4
    propose_initial(campaign)
    confirm_print(lake, "small", 1, PrintConfirmation(operator="ada", again={1: "torn"}))
    confirm_print(lake, "small", 1, PrintConfirmation(operator="ada", material_lot="L7"))
    assert [row["material_lot"] for row in lake.rows(ToolRow)] == ["paper"] * 9 + ["L7"]
    tables = [node.table for node in find_lineage(lake, "small/B01T0", depth=1).rows]
    assert tables.count("materials") == 4


def test_a_config_names_a_lot_that_is_there_and_without_one_has_its_old_hash(tmp_path: Path) -> None:
    without = load_config(write_config(tmp_path, None))
    assert "material" not in without.science
    assert load_config(write_config(tmp_path, PAPER)).config_hash != without.config_hash
    with pytest.raises(ConfigError, match="material lot `.*L7.toml` does not exist; give the path of a TOML file"):
        load_config(write_config(tmp_path, tmp_path / "L7.toml"))
