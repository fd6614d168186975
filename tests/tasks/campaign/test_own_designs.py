"""Designs of one's own: read, placed in batches, printed beside proposed ones, and measured again as references."""

from pathlib import Path
from typing import Any

import pytest

from fast.flows.campaign.batch_folder import plan_batch
from fast.lake.store import Lake
from fast.lake.tables.campaign import ProposalRow
from fast.models.design.families import find_family
from fast.models.design.space import BEST_PUBLISHED
from fast.models.errors import ConfigError, UsageError
from fast.tasks.bench.reference_tools import ask_references, list_owed, note_gone
from fast.tasks.bench.told import Telling, ToldGrasp, take_told
from fast.tasks.campaign.campaign import Campaign, read_own_designs
from fast.tasks.campaign.config import load_config
from fast.tasks.campaign.own_designs import OwnDesign, place_designs, read_designs
from fast.tasks.campaign.settings import Schedule
from fast.tasks.campaign.setup import enter
from fast.tasks.scientist.propose import propose_guided, propose_initial

HEADER = "name,batch,length_mm,width_mm,height_mm,tip_length_mm,front_thickness_mm,back_thickness_mm,rib_thickness_mm,"
HEADER += "rib_count,rib_angle_deg\n"
PUBLISHED = "published,1,32.3,32,99.5,22.3,2.4,2.9,2,7,-10\n"
LATER = "later,2,27.1,30.2,104.6,23.7,2.2,2.3,2.1,5.0,12.5\n"
FREE = "free,,30,30,100,25,2.5,2.5,2.5,3,0\n"
CONFIG = """
name = "mine"
seed = 1
designs = "mine.csv"
[schedule]
initial_tools = 3
tools_per_batch = 3
guided_batches = 1
initial_simulations = 0
simulations_per_batch = 0
reference_tools = 1
[objects]
ids = [2]
repeats = 1
[simulator]
simulate_tools = false
[bench]
kind = "folder"
"""


def begin(folder: Path, rows: str = PUBLISHED + LATER + FREE, config: str = CONFIG) -> Campaign:
    (folder / "mine.csv").write_text(HEADER + rows)
    path = folder / "mine.toml"
    path.write_text(config)
    loaded = load_config(path)
    own = read_own_designs(path, loaded)
    campaign = Campaign(Lake.open(folder / "lake", create=True), loaded, config_path=path, own_designs=own)
    enter(campaign, path)
    return campaign


@pytest.mark.parametrize(("separator", "encoding"), [("\t", "utf-16"), (";", "utf-8-sig"), ("\t", "utf-8")])
def test_a_table_is_read_as_spreadsheets_save_it(tmp_path: Path, separator: str, encoding: str) -> None:
    """Text that is separated by tabs, in UTF-16, is what some spreadsheets call Unicode text; commas are decimal."""
    plain, saved = tmp_path / "plain.csv", tmp_path / "saved.csv"
    plain.write_text(HEADER + PUBLISHED + LATER)
    saved.write_text((HEADER + PUBLISHED + LATER).replace(",", separator).replace(".", ","), encoding=encoding)
    assert [one.design for one in read_designs(saved)] == [one.design for one in read_designs(plain)]


def tell_all(campaign: Campaign, batch: int) -> None:
    asked = plan_batch(campaign, campaign.state(), batch)
    forces = {tool.tool_id: 10.0 + tool.slot for tool in campaign.state().tools}
    grasps = [ToldGrasp(f"row {i}", g.tool_id, g.object_id, g.repeat, forces[g.tool_id]) for i, g in enumerate(asked)]
    take_told(campaign, grasps, Telling("ada"))


def test_own_designs_hang_beside_proposed_ones_and_the_best_tool_comes_back(tmp_path: Path) -> None:
    campaign = begin(tmp_path)
    propose_initial(campaign)
    first = {row["slot"]: row for row in campaign.lake.rows(ProposalRow, batch=1)}
    own = [(first[slot]["name"], first[slot]["acquisition"]) for slot in (0, 1)]
    assert own == [("published", "own"), ("free", "own")]
    assert first[2]["acquisition"] != "own"
    assert {tool.slot: tool.design.rib_count for tool in campaign.state().tools}[0] == 7
    tell_all(campaign, 1)
    propose_guided(campaign, 2)
    second = {row["slot"]: row for row in campaign.lake.rows(ProposalRow, batch=2)}
    assert [second[slot]["name"] for slot in (0, 1, 2)] == ["later", None, None]
    ask_references(campaign, campaign.state(), 2)
    ask_references(campaign, campaign.state(), 2)  # asking twice asks once
    (owed,) = list_owed(campaign, 2)
    assert owed.tool_id == "mine/B01T2"  # the best of batch 1
    assert plan_batch(campaign, campaign.state(), 2)[0].tool_id == "mine/B01T2"
    tell_all(campaign, 2)
    assert list_owed(campaign, 2) == []
    quality = campaign.lake.query("SELECT tool_id, n_grasps FROM tool_quality ORDER BY tool_id").to_pylist()
    assert {row["n_grasps"] for row in quality} == {1}  # a reference grasp says nothing of quality


@pytest.mark.parametrize("name", ["B01T3", "B03T0", "B1T0", "other/B01T0", "fin-ray"])
def test_a_reference_tool_that_no_batch_has_is_refused_at_the_start(tmp_path: Path, name: str) -> None:
    config = CONFIG.replace("reference_tools = 1", f'reference_tools = ["B02T2", "mine/B01T2", "{name}"]')
    with pytest.raises(ConfigError, match=f"names `{name}`, which this campaign never prints; .*1 to 2.*0 to 2 in"):
        begin(tmp_path, config=config)
    with pytest.raises(ConfigError, match="names a tool twice"):
        begin(tmp_path, config=config.replace(name, "B02T2"))
    begin(tmp_path, config=config.replace(f', "{name}"', ""))


def test_a_reference_tool_that_is_gone_owes_nothing(tmp_path: Path) -> None:
    campaign = begin(tmp_path)
    propose_initial(campaign)
    tell_all(campaign, 1)
    propose_guided(campaign, 2)
    ask_references(campaign, campaign.state(), 2)
    with pytest.raises(UsageError, match="--gone mine/B01T0 is no reference tool of batch 2"):
        note_gone(campaign.lake, "mine", 2, ["B01T0"], "ada")
    note_gone(campaign.lake, "mine", 2, ["B01T2"], "ada")
    assert list_owed(campaign, 2) == []


def test_rows_of_proposed_batches_may_not_change(tmp_path: Path) -> None:
    campaign = begin(tmp_path)
    propose_initial(campaign)
    with pytest.raises(ConfigError, match="batch 1, which is proposed already"):
        begin(tmp_path, PUBLISHED.replace("32.3", "32.4") + LATER + FREE)
    begin(tmp_path, PUBLISHED + LATER + FREE + LATER.replace("later", "more").replace("27.1", "27.2"))


@pytest.mark.parametrize(
    ("row", "words"),
    [
        (PUBLISHED.replace("32.3", "50"), "mine.csv row 2.*length_mm.* is 50.* at most 35"),
        (PUBLISHED.replace(",7,", ",7.5,"), "rib_count is `7.5`, it must be a whole number"),
        (PUBLISHED.replace(",1,32.3", ",0,32.3"), "batch is `0`, it must be at least 1"),
        (PUBLISHED.replace(",1,32.3", ",9,32.3"), "batch is 9, the schedule ends with batch 2"),
        (PUBLISHED * 4, "batch 1 has 3 tools, and this design is one too many"),
        (FREE * 4, "the initial batches have 3 tools"),
        (PUBLISHED.replace("2.4", ""), "front_thickness_mm is ``, it must be a finite number"),
        (PUBLISHED.replace("published", "x" * 61), "at most 60 characters"),
        ("", "has no usable rows"),
        (PUBLISHED.replace("published", "b01t1"), "tools are called so by batch and slot"),
    ],
)
def test_a_wrong_file_is_one_sentence(tmp_path: Path, row: str, words: str) -> None:
    with pytest.raises(UsageError, match=words) as refused:
        begin(tmp_path, row)
    assert "\n" not in str(refused.value)


def test_designs_of_another_family(tmp_path: Path) -> None:
    values: dict[str, Any] = BEST_PUBLISHED.model_dump() | {"rib_modulus_factor": 2.0, "tip_modulus_factor": 0.5}
    path = tmp_path / "graded.csv"
    path.write_text(",".join(values) + "\n" + ",".join(map(str, values.values())) + "\n")
    (own,) = read_designs(path, family=find_family("graded-fin-ray"))
    assert own.design.model_dump() == values
    with pytest.raises(UsageError, match="rib_modulus_factor"):
        read_designs(path)


def test_designs_without_a_batch_fill_the_initial_ones() -> None:
    schedule = Schedule(initial_tools=4, tools_per_batch=2, guided_batches=1)
    designs = [OwnDesign(f"row {i}", f"own {i}", BEST_PUBLISHED, 1 if i == 2 else None) for i in range(3)]
    placed = place_designs(designs, schedule)
    assert {batch: [own.name for own in found] for batch, found in placed.items()} == {
        1: ["own 2", "own 0"],
        2: ["own 1"],
    }


def test_a_reference_finger_is_the_first_tool_of_the_first_batch_whatever_the_file_says(tmp_path: Path) -> None:
    config = CONFIG.replace("[schedule]", '[schedule]\nreference = "fin-ray"')
    campaign = begin(tmp_path, config=config)
    propose_initial(campaign)
    rows = {row["slot"]: row for row in campaign.lake.rows(ProposalRow, batch=1)}
    told = [(row["name"], row["acquisition"]) for _, row in sorted(rows.items())]
    assert told == [("fin-ray", "reference"), ("published", "own"), ("free", "own")]
    assert rows[0]["design_id"] == BEST_PUBLISHED.design_id
    assert begin(tmp_path, config=config).state().tools == campaign.state().tools  # a continued campaign adds nothing
    with pytest.raises(ConfigError, match="was started with another config .schedule.reference"):
        begin(tmp_path)


def test_a_full_first_batch_has_no_room_for_the_reference_finger(tmp_path: Path) -> None:
    config = CONFIG.replace("[schedule]", '[schedule]\nreference = "fin-ray"')
    with pytest.raises(UsageError, match="row 4: batch 1 has 3 tools, and this design is one too many"):
        begin(tmp_path, PUBLISHED + PUBLISHED.replace("published", "b") + PUBLISHED.replace("published", "c"), config)


def test_a_campaign_without_a_file_prints_the_reference_finger_too(tmp_path: Path) -> None:
    config = CONFIG.replace("[schedule]", '[schedule]\nreference = "fin-ray"').replace('designs = "mine.csv"\n', "")
    campaign = begin(tmp_path, config=config)
    propose_initial(campaign)
    assert campaign.state().tools_of(1)[0].design == BEST_PUBLISHED


def test_designs_and_simpler_fingers_may_be_asked_for_while_a_campaign_is_under_way(tmp_path: Path) -> None:
    """A report names a simpler finger after the first batch, when the config has neither key."""
    plain = CONFIG.replace('designs = "mine.csv"\n', "")
    propose_initial(begin(tmp_path, config=plain))
    begin(tmp_path, rows=LATER, config=CONFIG)
    begin(tmp_path, config=plain.replace("[schedule]", '[schedule]\nsimpler = ["nearest"]'))
    with pytest.raises(ConfigError, match="`mine.csv` has 1 designs for batch 1, which is proposed already with 0"):
        begin(tmp_path, rows=PUBLISHED, config=CONFIG)


def test_a_file_of_designs_that_are_printed_stays(tmp_path: Path) -> None:
    propose_initial(begin(tmp_path))
    with pytest.raises(ConfigError, match="names no file of designs, which has 0 designs for batch 1"):
        begin(tmp_path, config=CONFIG.replace('designs = "mine.csv"\n', ""))


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"simpler": ["less material"]}, "did you mean `least material`"),
        ({"simpler": ["nearest", "nearest"]}, "a name stands twice"),
        ({"simpler": ["nearest"], "tools_per_batch": 1}, "take 1 of the 1 tools"),
        ({"simpler": ["nearest"], "alike": ["rib_count"]}, "leave one out"),
    ],
)
def test_wrong_words_about_simpler_fingers_are_refused(changes: dict[str, Any], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        Schedule.model_validate(changes)


def test_a_family_without_ribs_has_none_with_fewest(tmp_path: Path) -> None:
    config = CONFIG.replace('designs = "mine.csv"\n', "").replace("[schedule]", '[schedule]\nsimpler = ["fewest ribs"]')
    begin(tmp_path, config=config)
    with pytest.raises(ConfigError, match="simpler by `fewest ribs`; schedule.simpler may name `least material` or"):
        begin(tmp_path, config=config + '[design]\nfamily = "free-form"\n')
