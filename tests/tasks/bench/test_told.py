"""Grasps of a bench of one's own: what is taken, what is refused with which words, and what a second telling does."""

import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from fast.flows.campaign.batch_folder import plan_batch
from fast.lake.store import Lake
from fast.lake.tables.campaign import GraspRow, SimTraceRow, SimulationRow, ToolRow, TraceRow
from fast.models.errors import UsageError
from fast.models.objects.rigid import RigidObject
from fast.models.question import Question
from fast.models.records import Design, Trace
from fast.models.simulation import grasp
from fast.tasks.bench import told_questions
from fast.tasks.bench.told import Telling, ToldGrasp, take_back, take_told
from fast.tasks.bench.told_files import read_peaks, read_rows_of
from fast.tasks.bench.told_questions import ask_about
from fast.tasks.campaign.campaign import Campaign
from fast.tasks.campaign.state import rank_tools
from fast.tasks.scientist.propose import propose_initial
from tests.flows.cli.cli_lakes import ROOT
from tests.tasks.campaign.small_campaign import small_campaign

N_ASKED = 8  # two tools, two objects, two repeats
ADA = Telling("ada")


@pytest.fixture
def campaign(tmp_path: Path) -> Campaign:
    made = small_campaign(tmp_path, bench={"kind": "folder", "name": "pull-tester", "max_force_n": 100.0})
    propose_initial(made)
    return made


def trace(peak_n: float = 9.0, speed: float = 5.0, **channels: Any) -> Trace:
    lift_mm = np.linspace(0.0, 40.0, 200)
    usual = {"time_s": lift_mm / speed, "lift_mm": lift_mm, "force_n": peak_n * np.sin(np.pi * lift_mm / 40.0)}
    return Trace(**{**usual, **channels})


def told(campaign: Campaign, **values: Any) -> list[ToldGrasp]:
    """Every asked grasp, told with 10 N or what `values` say of the first one."""
    asked = plan_batch(campaign, campaign.state(), 1)
    every = [ToldGrasp(f"row {i}", g.tool_id, g.object_id, g.repeat, 10.0 + i) for i, g in enumerate(asked)]
    return [ToldGrasp(**{**vars(every[0]), **values}), *every[1:]]


def test_what_is_told_closes_the_batch(campaign: Campaign) -> None:
    taken = take_told(campaign, told(campaign), ADA)
    assert (taken.n_written, taken.n_traces, taken.n_failed, taken.n_known) == (N_ASKED, 0, 0, 0)
    rows = campaign.lake.records(GraspRow)
    assert sorted(row.peak_force_n or 0.0 for row in rows) == [10.0 + i for i in range(N_ASKED)]
    assert {(row.bench, row.status, row.setup_json != "") for row in rows} == {("pull-tester", "ok", True)}
    assert {row.status for row in campaign.lake.records(ToolRow)} == {"printed"}
    assert plan_batch(campaign, campaign.state(), 1) == ()
    assert campaign.state().is_confirmed(1)


def test_a_trace_is_kept_with_its_peak(campaign: Campaign) -> None:
    taken = take_told(campaign, told(campaign, peak_force_n=None, trace=trace()), ADA)
    assert taken.n_traces == 1
    (row,) = [r for r in campaign.lake.records(GraspRow) if r.work_j is not None]
    assert row.peak_force_n == pytest.approx(9.0, rel=0.01)
    assert row.work_j == pytest.approx(9.0 * 0.04 * 2 / np.pi, rel=0.02)
    assert campaign.lake.ids(TraceRow) == {row.grasp_id}


def test_a_pull_that_ends_in_a_kick_is_kept(campaign: Campaign) -> None:
    force_n = trace().force_n.copy()
    force_n[-3] = -20.0
    assert take_told(campaign, told(campaign, peak_force_n=None, trace=trace(force_n=force_n)), ADA).n_traces == 1


def test_telling_again_writes_nothing_and_a_part_may_be_told_later(campaign: Campaign) -> None:
    every = told(campaign)
    take_told(campaign, every[:3], ADA)
    assert len(plan_batch(campaign, campaign.state(), 1)) == N_ASKED - 3
    again = take_told(campaign, every, ADA)
    assert (again.n_written, again.n_known) == (N_ASKED - 3, 3)
    assert len(campaign.lake.records(GraspRow)) == N_ASKED


def test_other_numbers_need_replace_and_keep_one_row(campaign: Campaign) -> None:
    take_told(campaign, told(campaign), ADA)
    changed = told_again(campaign, 33.0)
    sentence = (
        "the lake has this grasp with 10 N, now it is 33 N; `fast tell --replace` (in Python `may_replace=True`) "
        "corrects it"
    )
    with pytest.raises(UsageError, match=re.escape(sentence)):
        take_told(campaign, changed, ADA)
    take_told(campaign, changed, Telling("ada", may_replace=True))
    assert len(campaign.lake.records(GraspRow)) == N_ASKED
    assert max(row.peak_force_n or 0.0 for row in campaign.lake.records(GraspRow)) == 33.0


def told_again(campaign: Campaign, force_n: float) -> list[ToldGrasp]:
    first = min(campaign.lake.records(GraspRow), key=lambda row: row.peak_force_n or 0.0)
    return [ToldGrasp("row 0", first.tool_id, first.object_id, first.repeat, force_n)]


def test_a_failure_is_final_until_it_succeeds(campaign: Campaign) -> None:
    take_told(campaign, told(campaign, peak_force_n=None, reason="object broke"), ADA)
    assert plan_batch(campaign, campaign.state(), 1) == ()
    (row,) = campaign.lake.records(GraspRow, status="failed")
    assert row.reason == "object broke"
    take_told(campaign, [ToldGrasp("row 0", row.tool_id, row.object_id, row.repeat, 12.0)], ADA)
    later = campaign.lake.records(GraspRow, tool_id=row.tool_id, object_id=row.object_id, repeat=row.repeat)
    assert sorted((one.attempt, one.status) for one in later) == [(0, "failed"), (1, "ok")]


def test_a_corrected_trace_with_the_same_peak_is_no_repetition(campaign: Campaign) -> None:
    told_as = {"peak_force_n": None, "reason": ""}
    take_told(campaign, told(campaign, **told_as, trace=trace()), ADA)
    (row,) = [one for one in campaign.lake.records(GraspRow) if one.work_j is not None]
    place = {"tool_id": row.tool_id, "object_id": row.object_id, "repeat": row.repeat}
    short = trace()
    corrected = [ToldGrasp("row 0", **place, trace=replace(short, lift_mm=0.5 * short.lift_mm))]
    with pytest.raises(UsageError, match="with 8.99972 N with its trace, now it is 8.99972 N with another trace"):
        take_told(campaign, corrected, ADA)
    assert take_told(campaign, corrected, Telling("ada", may_replace=True)).n_written == 1
    assert take_told(campaign, corrected, ADA).n_known == 1
    (after,) = campaign.lake.records(GraspRow, grasp_id=row.grasp_id)
    assert after.work_j == pytest.approx(0.5 * (row.work_j or 0.0))
    assert campaign.lake.records(TraceRow)[-1].lift_mm[-1] == 20.0


def test_a_peak_in_place_of_a_trace_leaves_no_trace_beside_it(campaign: Campaign) -> None:
    take_told(campaign, told(campaign, peak_force_n=None, trace=trace()), ADA)
    (row,) = [one for one in campaign.lake.records(GraspRow) if one.work_j is not None]
    peak = [ToldGrasp("row 0", row.tool_id, row.object_id, row.repeat, 5.0)]
    take_told(campaign, peak, Telling("ada", may_replace=True))
    assert campaign.lake.query("FROM grasp_traces WHERE is_valid").num_rows == 0
    assert campaign.lake.query("FROM grasp_summary WHERE is_valid").num_rows == N_ASKED
    assert campaign.lake.query("SELECT min(peak_force_n) AS n FROM grasp_summary WHERE is_valid")["n"][0].as_py() == 5.0
    assert take_told(campaign, peak, ADA).n_known == 1
    assert take_back(campaign, "ada") == 1
    assert len(plan_batch(campaign, campaign.state(), 1)) == 1


def test_a_failure_that_was_taken_back_or_has_another_reason_is_told_again(campaign: Campaign) -> None:
    every = told(campaign, peak_force_n=None, reason="slipped")
    take_told(campaign, every, ADA)
    assert take_told(campaign, every, ADA).n_known == N_ASKED
    assert take_back(campaign, "ada") == N_ASKED
    assert take_told(campaign, every, ADA).n_written == N_ASKED
    assert plan_batch(campaign, campaign.state(), 1) == ()
    assert take_told(campaign, [replace(every[0], reason="torn")], ADA).n_written == 1
    reasons = [row.reason for row in campaign.lake.records(GraspRow, status="failed")]
    assert sorted(reasons) == ["taken back by ada"] * (N_ASKED - 1) + ["torn"]
    assert plan_batch(campaign, campaign.state(), 1) == ()


def test_a_dry_run_writes_nothing(campaign: Campaign) -> None:
    before = campaign.lake.rows(GraspRow), campaign.lake.rows(ToolRow)
    assert take_told(campaign, told(campaign), Telling("ada", is_dry=True)).n_written == N_ASKED
    assert (campaign.lake.rows(GraspRow), campaign.lake.rows(ToolRow)) == before


def falling() -> np.ndarray:
    lift_mm = np.linspace(0.0, 40.0, 200)
    lift_mm[100:] -= 10.0
    return lift_mm


WRONG = {
    "another tool": ({"tool_id": "small/B07T1"}, "tool small/B07T1 was not asked for; tools are named like small/B01"),
    "another object": ({"object_id": 9}, "object 9, repeat 0 .* was not asked for; objects are 4, 7, repeats 0 to 1"),
    "too strong": ({"peak_force_n": 101.0}, "the peak is 101 N, it must be from 0 to 100 N; look at unit"),
    "pushed": ({"peak_force_n": -3.0}, "the peak is -3 N"),
    "no number": ({"peak_force_n": float("nan")}, "the peak is nan N"),
    "nothing": ({"peak_force_n": None}, "neither a force nor a reason"),
    "both": ({"reason": "slipped"}, "a force and a reason"),
    "kN": ({"peak_force_n": None, "trace": trace(peak_n=9000.0)}, "the peak is 8999.72 N, it must be from 0 to 100 N"),
    "ms": ({"peak_force_n": None, "trace": trace(speed=0.005)}, "the lift has 0.005 mm/s, 5 mm/s were asked for"),
    "few": (
        {"peak_force_n": None, "trace": Trace(time_s=np.arange(3.0), lift_mm=np.arange(3.0), force_n=np.ones(3))},
        "3 samples, it must have at least 10",
    ),
    "no lift": ({"peak_force_n": None, "trace": trace(lift_mm=np.linspace(0, -40, 200))}, "must begin at 0 and rise"),
    "downwards": (
        {"peak_force_n": None, "trace": trace(peak_n=-9.0)},
        "the pull is counted downwards, to -8.99972 N at sample 100; .*change the sign",
    ),
    "falls": ({"peak_force_n": None, "trace": trace(lift_mm=falling())}, "the lift goes back by 9.8 mm"),
    "infinite": ({"peak_force_n": None, "trace": trace(force_n=np.full(200, np.inf))}, "not finite numbers"),
    "time back": (
        {"peak_force_n": None, "trace": trace(time_s=np.linspace(8.0, 0.0, 200))},
        "time goes back at sample",
    ),
}


def test_a_mirrored_file_is_one_sentence(campaign: Campaign) -> None:
    down = trace(peak_n=-9.0)
    fading = trace(force_n=-4.0 * (1.0 - down.lift_mm / down.lift_mm.max()))
    every = [
        replace(one, peak_force_n=None, trace=down if number == 0 else fading)
        for number, one in enumerate(told(campaign))
    ]
    with pytest.raises(UsageError, match="counted downwards in the whole file: 8 of 8 measured grasps") as refused:
        take_told(campaign, every, ADA)
    assert str(refused.value).endswith("change its sign everywhere; nothing was written.")


@pytest.mark.parametrize("name", WRONG)
def test_a_wrong_grasp_is_one_sentence_and_nothing_is_written(campaign: Campaign, name: str) -> None:
    values, words = WRONG[name]
    with pytest.raises(UsageError, match=words) as refused:
        take_told(campaign, told(campaign, **values), ADA)
    assert str(refused.value).startswith("row 0: ")
    assert str(refused.value).endswith("nothing was written.")
    assert "\n" not in str(refused.value)
    assert campaign.lake.rows(GraspRow) == campaign.lake.rows(ToolRow) == []


def test_all_faults_are_named_at_once(campaign: Campaign) -> None:
    every = told(campaign, peak_force_n=500.0)
    every[1] = every[2]
    with pytest.raises(UsageError) as refused:
        take_told(campaign, every, ADA)
    assert str(refused.value).startswith("2 things are wrong, nothing was written:\n")
    assert "is told twice, first in row 2; leave one of the two out" in str(refused.value)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("tool_id,object_id,repeat\nB01T0,4,0\n", "peak_force_n"),
        ("tool_id,object_id,repeat,peak_force_n\nB01T0,4,0,\n", "no peak_force_n and no reason"),
        ("tool_id,object_id,repeat,peak_force_n\nB01T0,4,0,ten\n", "peak_force_n is `ten`, it must be a finite number"),
        ("tool_id,object_id,repeat,peak_force_n\nB01T0,4,0,OL\n", "in N, or empty with a reason beside it; nothing"),
        ("tool_id,object_id,repeat,peak_force_n\nB01T0,4,0,1_0\n", "peak_force_n is `1_0`, it must be a finite number"),
        ("tool_id,object_id,repeat,peak_force_n\nB01T0,4.5,0,1\n", "object_id is `4.5`, it must be a whole number"),
        ("tool_id,object_id,repeat,peak_force_n,reasn\nB01T0,4,0,1,1\n", "reasn"),
        ("", "results.csv: row 1 names no column"),
        ("tool_id|object_id|repeat|peak_force_n\nB01T0|4|0|1\n", "separate names by commas, semicolons or tabs"),
        (
            "# rig 1\ntool_id,object_id,repeat,peak_force_n\nB01T0,4,0,1\n",
            "without lines above: tool_id, object_id, repeat",
        ),
    ],
)
def test_a_table_that_cannot_be_read_says_where(tmp_path: Path, text: str, words: str) -> None:
    path = tmp_path / "results.csv"
    path.write_text(text)
    with pytest.raises(UsageError, match=words):
        read_peaks(path)


def test_a_german_spreadsheet_is_read(tmp_path: Path) -> None:
    path = tmp_path / "results.csv"
    path.write_text("\ufefftool_id;object_id;repeat;peak_force_n\r\nB01T0;4;1;12,5\r\n", encoding="utf-8")
    (one,) = read_peaks(path)
    assert (one.tool_id, one.object_id, one.repeat, one.peak_force_n) == ("B01T0", 4, 1, 12.5)
    path.write_text(path.read_text(encoding="utf-8-sig").replace(";", "\t"), encoding="utf-16")
    assert read_peaks(path) == [one]


def test_mappings_are_checked_by_name() -> None:
    with pytest.raises(UsageError, match="grasp 1: `repeat` is missing"):
        read_rows_of([{"tool_id": "B01T0", "object_id": 4}])
    with pytest.raises(UsageError, match="unknown key `force`"):
        read_rows_of([{"tool_id": "B01T0", "object_id": 4, "repeat": 0, "force": 1.0}])


def test_other_campaigns_of_the_lake_are_left_alone(campaign: Campaign) -> None:
    take_told(campaign, told(campaign), ADA)
    assert Lake.open(Path(campaign.lake.address)).query("SELECT DISTINCT campaign_id FROM grasps").to_pylist() == [
        {"campaign_id": "small"}
    ]


def test_a_strange_number_is_asked_about_and_marked_where_a_person_is_sure(tmp_path: Path) -> None:
    campaign = small_campaign(tmp_path, bench={"kind": "folder", "name": "pull-tester", "max_force_n": 200.0})
    propose_initial(campaign)
    every = told(campaign)
    tenfold = [ToldGrasp(**{**vars(one), "peak_force_n": 10.0 if n else 100.0}) for n, one in enumerate(every)]

    def ask(_campaign: Campaign, _tools: Any, new: Any) -> list[Question]:
        return [Question("decimal point", "row 0: a decimal point?", (0,))] if new[0].peak_force_n == 100.0 else []

    with pytest.raises(
        UsageError, match=r"1 number is strange, nothing was written: row 0: a decimal point\? Correct the file"
    ):
        take_told(campaign, tenfold, ADA, ask=ask)
    assert campaign.lake.records(GraspRow) == []
    assert take_told(campaign, tenfold, Telling("ada", is_sure=True), ask=ask).n_written == N_ASKED
    assert [row.details_json for row in campaign.lake.records(GraspRow) if "sure" in row.details_json] == [
        '{"sure":["decimal point"],"telling":0,"told_by":"ada"}'
    ]


def test_objects_by_name_units_in_cells_and_unknown_columns_are_read(tmp_path: Path) -> None:
    (tmp_path / "results.csv").write_text(
        "tool_id,object_id,repeat,peak_force_n,remark\nb01t0,Tube,0,12.3 N,x\nB01T0,14,1,1.5 kgf,\nB01T0,2,0,0.5 kN,\n"
    )
    notes: list[str] = []
    one, two, three = read_peaks(tmp_path / "results.csv", notes)
    assert (one.object_id, one.peak_force_n, two.peak_force_n, three.peak_force_n) == (14, 12.3, 14.709975, 500.0)
    assert notes == ["results.csv: columns that nobody knows were left out: remark"]


def test_an_object_that_the_name_beside_it_denies_is_asked_about(tmp_path: Path) -> None:
    header, path = "tool_id,object_id,repeat,peak_force_n,object\n", tmp_path / "results.csv"
    path.write_text(header + "B01T0,2,0,5,Large Sphere\nB01T0,2,1,5,the red one\nB01T0,tube,0,5,tube\n")
    assert [one.object_id for one in read_peaks(path)] == [2, 2, 14]
    path.write_text(header + "B01T0,2,0,5,cube\n")
    with pytest.raises(UsageError, match="row 2: object is `cube`, but object_id is `2`, another object; which was it"):
        read_peaks(path)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("B01T0,tubbe,0,5", "object_id is `tubbe`, it must be a number or a name"),
        ("B01T0,14,0,5 mm", "peak_force_n is `5 mm`, it must be a finite number"),
    ],
)
def test_a_name_or_unit_that_is_none_is_named(tmp_path: Path, text: str, words: str) -> None:
    (tmp_path / "results.csv").write_text(f"tool_id,object_id,repeat,peak_force_n\n{text}\n")
    with pytest.raises(UsageError, match=words):
        read_peaks(tmp_path / "results.csv")


@pytest.mark.parametrize("name", ["good", "object-names", "short-ids", "unit-in-cell", "extra-column"])
def test_files_of_people_are_read(name: str) -> None:
    grasps = read_peaks(ROOT / "tests" / "data" / "cases" / "people" / f"{name}.csv")
    assert len(grasps) == 48
    assert {one.object_id for one in grasps} == {2, 5, 14, 20}


def test_the_last_telling_is_taken_back_and_can_be_told_again(campaign: Campaign) -> None:
    every = told(campaign)
    take_told(campaign, every[:3], ADA)
    ranking = rank_tools(campaign.lake, campaign.campaign_id)
    missing = plan_batch(campaign, campaign.state(), 1)
    take_told(campaign, every[3:], ADA)
    assert plan_batch(campaign, campaign.state(), 1) == ()
    assert take_back(campaign, "bo") == N_ASKED - 3
    assert plan_batch(campaign, campaign.state(), 1) == missing
    assert rank_tools(campaign.lake, campaign.campaign_id) == ranking
    reasons = {row.reason for row in campaign.lake.records(GraspRow) if row.status == "failed"}
    assert reasons == {"taken back by bo"}
    assert take_told(campaign, every, ADA).n_written == N_ASKED - 3
    assert take_back(campaign, "bo") == N_ASKED - 3
    assert take_back(campaign, "bo") == 3
    with pytest.raises(UsageError, match="has no telling that could be taken back"):
        take_back(campaign, "bo")
    assert take_told(campaign, every, ADA).n_written == N_ASKED


def test_told_traces_are_held_against_the_simulated_ones_of_the_lake(campaign: Campaign) -> None:
    asked = plan_batch(campaign, campaign.state(), 1)
    rows: list[Any] = []
    for tool in campaign.state().tools:
        for object_id in campaign.config.objects.object_ids:
            row, made = simulated(tool.design.design_id, object_id, trace(9.0))
            rows += [SimTraceRow.of(row.simulation_id, made), row]
    campaign.lake.append(rows, campaign.provenance())
    sound = [ToldGrasp(f"row {i}", g.tool_id, g.object_id, g.repeat, trace=trace(8.0 + i)) for i, g in enumerate(asked)]
    empty = [replace(one, trace=trace(0.05 + 0.01 * i)) for i, one in enumerate(sound)]
    with pytest.raises(UsageError, match=r"8 traces hold no force where 9 N are expected, a valve that stuck"):
        take_told(campaign, empty, ADA, ask=ask_about)
    assert campaign.lake.rows(GraspRow) == []
    assert take_told(campaign, sound, ADA, ask=ask_about).n_traces == N_ASKED


def test_a_file_that_is_asked_about_twice_is_simulated_once(
    campaign: Campaign, monkeypatch: pytest.MonkeyPatch
) -> None:
    simulated_cells: list[str] = []

    def simulate(design: Design, obj: RigidObject, *_: object, **__: object) -> SimpleNamespace:
        simulated_cells.append(f"{design.design_id} {obj.object_id}")
        return SimpleNamespace(peak_force_n=9.0, trace=trace(9.0))

    monkeypatch.setattr(grasp, "simulate_grasp", simulate)
    monkeypatch.setattr(told_questions, "_SIMULATED", {})
    tools = {tool.tool_id: tool for tool in campaign.state().tools}
    sound = [replace(one, peak_force_n=9.0 + 0.01 * i) for i, one in enumerate(told(campaign))]
    first, again = (ask_about(campaign, tools, sound) for _ in range(2))
    assert first == again
    assert len(simulated_cells) == len(set(simulated_cells)) > 2
    tenfold = [replace(sound[0], peak_force_n=90.0), *sound[1:]]
    assert ask_about(campaign, tools, tenfold) != first


def simulated(design_id: str, object_id: int, made: Trace) -> tuple[SimulationRow, Trace]:
    """A simulation of the lake with this trace."""
    row = SimulationRow(
        simulation_id=f"S-{design_id}-{object_id}",
        design_id=design_id,
        object_id=object_id,
        version_id="V1",
        status="ok",
        peak_force_n=float(made.force_n.max()),
        setup_id="any",
        setup_json="{}",
    )
    return row, made


def test_a_lift_and_a_force_that_were_exchanged_are_named(campaign: Campaign) -> None:
    usual = trace()
    turned = trace(lift_mm=usual.force_n, force_n=usual.lift_mm)
    with pytest.raises(UsageError, match="the lift comes back and the force never does; look whether the two are exch"):
        take_told(campaign, told(campaign, peak_force_n=None, trace=turned), ADA)
