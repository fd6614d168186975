from pathlib import Path

import pytest

from fast.flows.campaign.batch_folder import plan_batch
from fast.flows.report.campaign.queries import FAILURES
from fast.lake.handoff.export_folder import export_handoff
from fast.lake.handoff.import_folder import Origin, import_handoff
from fast.lake.handoff.tables import HandoffError
from fast.lake.provenance import current_provenance
from fast.lake.store import Lake
from fast.lake.tables.campaign import EventRow, ToolRow
from fast.models.design.recipe import Recipe
from fast.models.design.space import FIN_RAYS, PARAMETERS, to_unit
from fast.models.errors import UsageError
from fast.tasks.bench.measured_tools import MEASURED, MeasuredTool, measure_printed, take_back_measured
from fast.tasks.bench.print import (
    PrintConfirmation,
    Printed,
    confirm_print,
    open_slots,
    print_folder,
    write_tray,
)
from fast.tasks.bench.told import Telling, ToldGrasp, take_told
from fast.tasks.campaign.campaign import Campaign
from fast.tasks.campaign.config import load_config
from fast.tasks.campaign.setup import enter
from fast.tasks.scientist.propose import propose_initial
from tests.flows.cli.cli_lakes import Fast

RECIPES = Path(__file__).parents[3] / "recipes"


@pytest.fixture
def proposed(campaign):
    propose_initial(campaign)
    return campaign


def test_tray_is_written_with_sheet_and_files(proposed):
    folder = print_folder(proposed.lake, "small", 1)
    sheet = write_tray(proposed.lake, "small", 1, folder)
    names = {path.name for path in folder.iterdir()}
    assert {"tray.3mf", "B01T0_compliant.stl", "B01T1_rigid.stl", "sheet.html"} <= names
    assert "fast print confirm small/B01 --operator NAME" in sheet.read_text()


def test_confirmation_records_rejects_and_measures(proposed):
    word = PrintConfirmation(
        operator="ada", rejected={1: "tip torn"}, measured={0: MeasuredTool(measured_front_thickness_mm=2.4)}
    )
    assert confirm_print(proposed.lake, "small", 1, word) == Printed(n_mounted=1, n_rejected=1)
    tools = {row["slot"]: row for row in proposed.lake.rows(ToolRow)}
    assert tools[0]["measured_front_thickness_mm"] == 2.4
    assert (tools[1]["status"], tools[1]["reason"]) == ("rejected", "tip torn")
    assert proposed.state().is_confirmed(1)


def test_second_confirmation_changes_nothing(proposed):
    confirm_print(proposed.lake, "small", 1, PrintConfirmation(operator="ada"))
    with pytest.raises(UsageError, match="already confirmed; nothing was changed"):
        confirm_print(proposed.lake, "small", 1, PrintConfirmation(operator="bob"))
    assert {row["operator"] for row in proposed.lake.rows(ToolRow)} == {"ada"}


def test_unknown_slot_and_batch_are_refused(proposed):
    with pytest.raises(UsageError, match="slot 7 is not in batch small/B01, its slots are 0 to 1"):
        confirm_print(proposed.lake, "small", 1, PrintConfirmation(operator="ada", rejected={7: "lost"}))
    with pytest.raises(UsageError, match="batch small/B09 does not exist"):
        confirm_print(proposed.lake, "small", 9, PrintConfirmation(operator="ada"))
    assert proposed.lake.rows(ToolRow) == []


def test_tools_hang_where_a_person_says(proposed):
    word = PrintConfirmation(operator="ada", mounted={0: 1, 1: 0})
    confirm_print(proposed.lake, "small", 1, word)
    first, second = proposed.state().tools_of(1)
    assert (first.label, first.slot, first.rack_slot) == ("B01T0", 0, 1)
    assert (second.label, second.slot, second.rack_slot) == ("B01T1", 1, 0)


@pytest.mark.parametrize(
    ("mounted", "sentence"),
    [
        ({0: 1}, "tools 0 and 1 cannot both hang in rack slot 1"),
        ({0: 12}, "tool 0 cannot hang in rack slot 12; the rack has 0 to 9"),
        ({5: 1}, "slot 5 is not in batch small/B01"),
    ],
)
def test_an_impossible_rack_is_refused(proposed, mounted, sentence):
    with pytest.raises(UsageError, match=sentence):
        confirm_print(proposed.lake, "small", 1, PrintConfirmation(operator="ada", mounted=mounted))
    assert proposed.lake.rows(ToolRow) == []


def test_a_rejected_tool_leaves_its_slot_to_another(proposed):
    word = PrintConfirmation(operator="ada", rejected={1: "torn"}, mounted={0: 1})
    assert confirm_print(proposed.lake, "small", 1, word) == Printed(n_mounted=1, n_rejected=1)


def test_a_tool_counts_as_the_finger_that_was_printed(proposed):
    thin = MeasuredTool(measured_front_thickness_mm=1.9, measured_rib_thickness_mm=2.5)
    confirm_print(proposed.lake, "small", 1, PrintConfirmation(operator="ada", measured={0: thin}))
    measured, as_asked = proposed.state().tools_of(1)
    front, back, rib = (PARAMETERS.index(f"{name}_thickness_mm") for name in ("front", "back", "rib"))
    asked, mounted = to_unit([measured.design])[0], measured.mounted_point(FIN_RAYS)
    assert mounted[front] == pytest.approx(-0.1)  # a tenth of the range below it
    assert mounted[rib] == pytest.approx(0.5)
    assert mounted[back] == asked[back]
    assert (as_asked.mounted_point(FIN_RAYS) == to_unit([as_asked.design])[0]).all()


def test_a_tool_printed_again_keeps_the_batch_waiting(proposed):
    first = confirm_print(proposed.lake, "small", 1, PrintConfirmation(operator="ada", again={1: "warped"}))
    assert (first.n_mounted, first.again, open_slots(proposed.lake, "small", 1)) == (1, (1,), [1])
    assert {path.name for path in first.sheet.parent.iterdir()} >= {"tray.3mf", "B01T1_rigid.stl"}
    assert not (first.sheet.parent / "B01T0_rigid.stl").exists()
    assert not proposed.state().is_confirmed(1)
    with pytest.raises(UsageError, match="slot 0 of batch small/B01 is already confirmed; leave it out"):
        confirm_print(proposed.lake, "small", 1, PrintConfirmation(operator="bob", rejected={0: "torn"}))
    with pytest.raises(UsageError, match="tools 0 and 1 cannot both hang in rack slot 0"):
        confirm_print(proposed.lake, "small", 1, PrintConfirmation(operator="bob", mounted={1: 0}))
    confirm_print(proposed.lake, "small", 1, PrintConfirmation(operator="bob"))
    assert proposed.state().is_confirmed(1)
    assert {row["slot"]: row["operator"] for row in proposed.lake.rows(ToolRow)} == {0: "ada", 1: "bob"}


def test_a_tool_has_one_fate(proposed):
    word = PrintConfirmation(operator="ada", rejected={1: "torn"}, again={1: "torn"})
    with pytest.raises(UsageError, match="slot 1 is to be printed again, so nothing else can be said of it"):
        confirm_print(proposed.lake, "small", 1, word)
    assert open_slots(proposed.lake, "small", 1) == [0, 1]


def test_walls_measured_later_are_kept_beside_what_was_said_before(proposed):
    said = PrintConfirmation(operator="ada", material_lot="L7", measured={0: MeasuredTool(hardness_shore_a=31)})
    confirm_print(proposed.lake, "small", 1, said)
    tool_id = "small/B01T0"
    with pytest.raises(UsageError, match="nothing was measured; give front=MM"):
        measure_printed(proposed.lake, tool_id, MeasuredTool(), "bo")
    with pytest.raises(UsageError, match="small/B09T0 is not among the printed tools of this lake"):
        measure_printed(proposed.lake, "small/B09T0", MeasuredTool(hardness_shore_a=30), "bo")
    measure_printed(proposed.lake, tool_id, MeasuredTool(measured_front_thickness_mm=2.75), "bo")
    (row,) = proposed.lake.records(ToolRow, tool_id=tool_id)
    assert (row.operator, row.material_lot, row.hardness_shore_a) == ("ada", "L7", 31)
    (tool,) = [tool for tool in proposed.state().tools if tool.tool_id == tool_id]
    front = PARAMETERS.index("front_thickness_mm")
    assert tool.mounted_point(FIN_RAYS)[front] == pytest.approx(0.75)
    assert "bo measured small/B01T0" in proposed.lake.rows(EventRow, kind=MEASURED)[-1]["message"]


def test_walls_are_told_from_the_command_line(proposed, capsys):
    confirm_print(proposed.lake, "small", 1, PrintConfirmation(operator="ada"))
    words = ("print", "measured", "small/B01T0")
    lake = ("--operator", "bo", "--lake", proposed.lake.address)
    assert (
        Fast(capsys)(*words, "front=2.61,rib=2.4", *lake, "--json", "--sure").json["measured_rib_thickness_mm"] == 2.4
    )
    assert "unknown measure `side`" in Fast(capsys).refused(*words, "side=2", *lake)
    assert "`thick` is not a number" in Fast(capsys).refused(*words, "front=thick", *lake)
    assert "26 mm, drawn" in (said := Fast(capsys).refused(*words, "front=26", *lake))
    assert "(a wall has 1 to 5 mm)" in said
    assert "give what was measured, or --undo" in Fast(capsys).refused(*words, *lake)


def drawn_walls(proposed):
    """Walls of both tools as a calliper gives them: a little more than drawn."""
    names = ("front", "back", "rib")
    return {
        tool.tool_id: {
            f"measured_{name}_thickness_mm": round(getattr(tool.design, f"{name}_thickness_mm") + more_mm, 2)
            for name, more_mm in zip(names, (0.03, 0.08, 0.06), strict=True)
        }
        for tool in proposed.state().tools_of(1)
    }


def test_strange_walls_are_a_question_a_mark_and_can_be_taken_back(proposed):
    first, second = drawn_walls(proposed).items()
    told = {0: MeasuredTool(**second[1]), 1: MeasuredTool(**first[1])}  # exchanged
    with pytest.raises(UsageError, match="B01T0 has the walls that are drawn of B01T1, and B01T1 those of B01T0; exch"):
        confirm_print(proposed.lake, "small", 1, PrintConfirmation(operator="ada", measured=told))
    assert proposed.lake.rows(ToolRow) == []
    confirm_print(proposed.lake, "small", 1, PrintConfirmation(operator="ada", measured=told, is_sure=True))
    assert [row["sure"] for row in proposed.lake.rows(ToolRow)] == ["exchanged tools"] * 2
    rows = proposed.lake.query(FAILURES.format(campaign="'small'")).to_pylist()
    assert {"what": "tool, measured with --sure", "reason": "exchanged tools", "n": 2} in rows
    for tool_id, _ in (first, second):
        take_back_measured(proposed.lake, tool_id, "ada")
        with pytest.raises(UsageError, match=f"nothing was measured of {tool_id} that could be taken back"):
            take_back_measured(proposed.lake, tool_id, "ada")
    for tool_id, walls in (first, second):
        measure_printed(proposed.lake, tool_id, MeasuredTool(**walls), "ada")
    rows = proposed.lake.records(ToolRow)
    assert {(row.sure, row.measured_rib_thickness_mm) for row in rows} == {
        (None, walls["measured_rib_thickness_mm"]) for _, walls in (first, second)
    }


def test_taking_back_gives_what_stood_before(proposed):
    confirm_print(proposed.lake, "small", 1, PrintConfirmation(operator="ada"))
    for hardness in (30, 31):
        measure_printed(proposed.lake, "small/B01T0", MeasuredTool(hardness_shore_a=hardness), "ada")
    assert [take_back_measured(proposed.lake, "small/B01T0", "bo").hardness_shore_a for _ in range(2)] == [30, None]


def test_what_cannot_be_is_refused_however_sure(proposed):
    confirm_print(proposed.lake, "small", 1, PrintConfirmation(operator="ada"))
    (tool_id, walls), _ = drawn_walls(proposed).items()
    in_cm = MeasuredTool(**{name: round(mm / 10, 3) for name, mm in walls.items()})
    with pytest.raises(UsageError, match=r"3 things cannot be, .*\n  B01T0 front wall: 0.\d+ mm, drawn .* or cm"):
        measure_printed(proposed.lake, tool_id, in_cm, "ada", is_sure=True)
    measure_printed(proposed.lake, "small/B01T1", MeasuredTool(hardness_shore_a=30), "ada")
    with pytest.raises(UsageError, match=r"78 Shore A, other tools of the lot have 30, Shore 00\? It would be 30"):
        measure_printed(proposed.lake, tool_id, MeasuredTool(hardness_shore_a=78), "ada")


@pytest.fixture
def with_recipe(tmp_path):
    """A campaign whose config names a recipe file and another colour; its file is gone once it has started."""
    recipe = tmp_path / "tpu.toml"
    recipe.write_text((RECIPES / "fdm-tpu.toml").read_text())
    config = """
name = "small"
[schedule]
initial_tools = 2
tools_per_batch = 2
guided_batches = 0
initial_simulations = 0
[print]   # how
recipe = "tpu.toml"
[print.compliant]
colour = "#00AA00"
[bench]
kind = "folder"
"""
    path = tmp_path / "small.toml"
    path.write_text(config)
    campaign = Campaign(Lake.open(tmp_path / "lake", create=True), load_config(path), config_path=path)
    enter(campaign, path)
    enter(campaign, path)  # the second time it is there
    recipe.unlink()
    propose_initial(campaign)
    return campaign


def test_the_recipe_is_kept_with_each_tool_and_printed_on_its_sheet(with_recipe):
    lake = with_recipe.lake
    sheet = write_tray(lake, "small", 1, print_folder(lake, "small", 1))
    assert "Recipe tpu" in sheet.read_text()
    assert "#00AA00" in sheet.read_text()
    confirm_print(lake, "small", 1, PrintConfirmation(operator="ada"))
    rows = lake.rows(ToolRow)
    assert [row["recipe"] for row in rows] == ["tpu", "tpu"]
    kept = Recipe.model_validate_json(rows[0]["recipe_json"])
    assert kept == with_recipe.config.print.model_copy(update={"recipe": None})
    assert kept.compliant.colour == "#00AA00"
    assert kept.compliant.material == "TPU, Shore A 85"


def test_without_a_recipe_nothing_is_made_up(proposed):
    sheet = write_tray(proposed.lake, "small", 1, print_folder(proposed.lake, "small", 1))
    assert "No recipe" in sheet.read_text()
    confirm_print(proposed.lake, "small", 1, PrintConfirmation(operator="ada"))
    assert {(row["recipe"], row["recipe_json"]) for row in proposed.lake.rows(ToolRow)} == {(None, None)}


def test_a_recipe_travels_with_its_tools(with_recipe, tmp_path):
    lake = with_recipe.lake
    confirm_print(lake, "small", 1, PrintConfirmation(operator="ada"))
    asked = plan_batch(with_recipe, with_recipe.state(), 1)[:1]
    take_told(with_recipe, [ToldGrasp("row 1", g.tool_id, g.object_id, g.repeat, 9.0) for g in asked], Telling("ada"))
    export_handoff(lake, tmp_path / "out", campaign_id="small")
    other = Lake.open(tmp_path / "other", create=True)
    import_handoff(other, tmp_path / "out", current_provenance(), Origin(campaign_id="theirs"))
    (row,) = other.rows(ToolRow)
    assert (row["recipe"], row["recipe_json"]) == ("tpu", lake.rows(ToolRow)[0]["recipe_json"])
    text = (tmp_path / "out" / "tools.csv").read_text()
    (tmp_path / "out" / "tools.csv").write_text(text.replace('""fdm""', '""laser""'))
    third = Lake.open(tmp_path / "third", create=True)
    with pytest.raises(HandoffError, match="must be a recipe as JSON"):
        import_handoff(third, tmp_path / "out", current_provenance(), Origin(campaign_id="theirs"))
