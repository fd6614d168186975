"""What a person measured for a search is a fact of the lake, a tensile bar one of the material."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from fast.flows.report.campaign.queries import FAILURES
from fast.lake.provenance import current_provenance
from fast.lake.query.lineage import find_lineage
from fast.lake.store import Lake
from fast.lake.tables.campaign import ToolRow
from fast.lake.tables.material import MaterialRow
from fast.models.errors import UsageError
from fast.models.gap.ask.answers import Answers, Reading
from fast.tasks.bench.measured_tools import MeasuredTool, measure_printed
from fast.tasks.bench.print import PrintConfirmation, confirm_print
from fast.tasks.campaign.state import THICKNESSES, load_designs
from fast.tasks.gap import rounds
from fast.tasks.gap.readings import is_answered, read_readings, take_back_reading, write_reading
from tests.flows.cli.cli_lakes import proposed_lake

BAR = Reading(kind="tensile_bar", value=0.21)


@pytest.fixture
def lake(tmp_path: Path) -> Lake:
    found = Lake.open(proposed_lake(tmp_path))
    confirm_print(found, "quick", 1, PrintConfirmation(operator="ada", material_lot="L7"))
    return found


def test_a_tensile_bar_goes_into_the_lot_of_the_tools(lake: Lake) -> None:
    write_reading(lake, "quick", "A1", BAR, "ada")
    (row,) = lake.records(MaterialRow, lot="L7")
    assert (row.quantity, row.value, row.unit) == ("layer_modulus_excess", 0.21, "1")
    assert row.source == "ada, asked by search A1"
    assert "tensile bars" in row.method
    (tool, *_) = lake.ids(ToolRow)
    assert row.material_id in str(find_lineage(lake, tool))
    assert is_answered(lake, "A1", "tensile_bar")
    assert read_readings(lake, "quick") == (BAR,)  # once, though event and lot have it


def test_a_corrected_lot_counts_for_every_search_of_its_tools(lake: Lake) -> None:
    write_reading(lake, "quick", "A1", BAR, "ada")
    (row,) = lake.records(MaterialRow, lot="L7")
    write_reading(lake, "quick", "A1", Reading(kind="walls", value=0.1), "ada")
    write_reading(lake, None, "A2", Reading(kind="tensile_bar", value=0.4), "bob")
    assert {row.value for row in lake.records(MaterialRow, lot="L7")} == {0.4}
    assert read_readings(lake, "quick") == (Reading(kind="walls", value=0.1), BAR.model_copy(update={"value": 0.4}))


def test_a_reading_in_which_no_hypothesis_has_a_say_changes_no_name(monkeypatch: pytest.MonkeyPatch) -> None:
    naming: Any = object()
    hypotheses = [SimpleNamespace(name=name, probability=0.5, estimate_parameters=dict) for name in ("a", "unknown")]
    monkeypatch.setattr(rounds, "list_hypotheses", lambda naming: hypotheses)
    monkeypatch.setattr(rounds, "simulate_moved", lambda *_: {})
    grasps: Any = SimpleNamespace(steps_n=np.zeros((0, 120)), grasp_ids=())
    answers = Answers(grasps, np.zeros((0, 2), dtype=int), (BAR,))
    search: Any = SimpleNamespace(answers=answers, lake=None, campaign_id="quick")
    assert rounds.settle_answers(search, naming) == (naming, None)


def test_without_one_lot_a_bar_is_an_answer_to_its_search_alone(lake: Lake) -> None:
    (tool, *_) = lake.records(ToolRow, campaign_id="quick")
    other = tool.model_copy(update={"material_lot": "L8"})
    lake.append([other], current_provenance())
    write_reading(lake, "quick", "A1", BAR, "ada")
    assert not lake.ids(MaterialRow)
    assert read_readings(lake, "quick") == (BAR,)


def test_a_strange_reading_is_a_question_a_mark_and_can_be_taken_back(lake: Lake) -> None:
    itself = Reading(kind="tensile_bar", value=1.21)
    with pytest.raises(UsageError, match=r"1.21, usual is 0.1 or so, the ratio itself\? It would be 0.21"):
        write_reading(lake, "quick", "A1", itself, "ada")
    assert not lake.ids(MaterialRow)
    write_reading(lake, "quick", "A1", itself, "ada", is_sure=True)
    (row,) = lake.records(MaterialRow, lot="L7")
    assert row.sure == "another quantity"
    rows = lake.query(FAILURES.format(campaign="'quick'")).to_pylist()
    sure = {(row["what"], row["reason"]) for row in rows}
    assert ("answer to a search, with --sure", "tensile_bar: another quantity") in sure
    assert ("material, told as sure", "L7, layer_modulus_excess: another quantity") in sure
    take_back_reading(lake, "quick", "A1", "tensile_bar", "bo")
    assert read_readings(lake, "quick") == ()
    assert not is_answered(lake, "A1", "tensile_bar")
    with pytest.raises(UsageError, match="nobody has answered `tensile_bar` of search A1"):
        take_back_reading(lake, "quick", "A1", "tensile_bar", "bo")
    write_reading(lake, "quick", "A1", BAR, "ada")
    assert read_readings(lake, "quick") == (BAR,)


def measure_all(lake: Lake, but: int = 0) -> None:
    designs = load_designs(lake)
    for row in lake.records(ToolRow)[but:]:
        walls = {
            f"measured_{name}": round(getattr(designs[row.design_id], name) + 0.07 + 0.02 * place, 2)
            for place, name in enumerate(THICKNESSES)
        }
        measure_printed(lake, row.tool_id, MeasuredTool(**walls), "ada")


def test_walls_of_every_tool_leave_nothing_for_walls_to_explain(lake: Lake) -> None:
    write_reading(lake, "quick", "A1", Reading(kind="walls", value=0.1), "ada")
    measure_all(lake, but=1)
    assert read_readings(lake, "quick") == (Reading(kind="walls", value=0.1),)  # one tool is not measured yet
    measure_all(lake)
    assert read_readings(lake, "quick") == (Reading(kind="walls", value=0.0),)
