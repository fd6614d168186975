"""The parts of a report that show Figs. 2a, 2c and 5 of the paper, throughput, and where each figure stands."""

import csv
import re

import numpy as np
import pytest

from flows.report.campaign import early_loss as loss_module
from flows.report.campaign.content import Content
from flows.report.campaign.early_loss import early_loss
from flows.report.campaign.moments import moments_section
from flows.report.campaign.page import add_features
from flows.report.campaign.paper import paper_section
from flows.report.campaign.rivals import rivals_section
from flows.report.campaign.shapes import GROUPS, chosen_objects, shapes_section, three_tools
from flows.report.campaign.throughput import throughput
from flows.report.campaign.tool_traces import batches_figure, curves_of, specialists, tool_traces_section
from flows.report.campaign.traces import Curve
from flows.report.campaign.windows import Window
from flows.report.campaign.work import work_changes
from flows.report.folder import Folder
from flows.report.style import figure_style
from lake.store import Lake
from lake.tables.campaign import GraspRow
from tests.flows.synthetic_lake import Campaign, build


@pytest.fixture(scope="module")
def lake(tmp_path_factory):
    lake = build(Lake.open(tmp_path_factory.mktemp("lake") / "data", create=True), Campaign())
    add_features(lake, "demo")
    return lake


@pytest.fixture
def content(lake):
    return Content.load(lake, "demo")


@pytest.fixture
def folder(tmp_path):
    with figure_style():
        yield Folder(tmp_path / "out")


def numbers(folder: Folder, name: str) -> list[dict[str, str]]:
    with (folder.root / "data" / f"{name}.csv").open(encoding="utf-8") as file:
        return list(csv.DictReader(file))


def test_batches_show_every_tool_of_the_first_and_the_last(content, folder):
    html = tool_traces_section(content, folder)
    assert html.count('<div class="panel">') == 4
    drawn = curves_of(content.result("x", (folder.root / "data" / "batch_traces.sql").read_text()).rows)
    assert {batch: len(slots) for batch, slots in drawn[0].items()} == {1: 3, 2: 3}
    figure = batches_figure(drawn[0], (1, 2), {}, Window((0.0, 50.0), (-5.0, 30.0)))
    assert [len(axes.lines) for axes in figure.axes] == [4, 4]  # three tools and the zero


def test_binned_traces_are_means_over_the_repeats(lake, content, folder):
    tool_traces_section(content, folder)
    row = next(r for r in numbers(folder, "batch_traces") if (r["batch"], r["slot"], r["object_id"]) == ("2", "1", "2"))
    grasps = [g for g in lake.records(GraspRow, batch=2, slot=1, object_id=2) if g.status == "ok"]
    low = float(row["lift_mm"]) - 0.5
    traces = [lake.trace(g.grasp_id) for g in grasps]
    values = [t.force_n[(t.lift_mm > max(low, 0.0)) & (t.lift_mm >= low) & (t.lift_mm < low + 1.0)] for t in traces]
    assert float(row["force_n"]) == pytest.approx(np.mean(np.concatenate(values)))


def test_closure_and_pull_up_are_drawn_at_five_instants(content, folder):
    html = moments_section(content, folder)
    assert [f"figures/moments/{k}.svg" in html for k in range(1, 7)] == [True] * 5 + [False]
    won = [row for row in content.work.rows if (row["batch"], row["slot"]) == (content.best.batch, content.best.slot)]
    held = max(won, key=lambda row: row["peak_force_n"])
    assert f"({held['object_id']}), in the simulator" in html
    assert f"{held['peak_force_n']:.1f}\u00a0N on the bench" in html


def test_a_grasp_that_the_simulator_does_not_get_through_is_said(content, folder, monkeypatch):
    monkeypatch.setattr("flows.report.campaign.moments.simulate_again", lambda *_: None)
    assert "The simulator has no such grasp to draw" in moments_section(content, folder)


def test_specialists_are_the_strongest_on_something():
    rows = [
        {"batch": 1, "slot": slot, "object_id": o, "peak_force_n": force}
        for slot, forces in enumerate(((3.0, 1.0), (2.0, 4.0), (1.0, 2.0)))
        for o, force in enumerate(forces)
    ]
    assert specialists(rows, (1, 1)) == "In B01, 2 of 3 tools are the strongest on at least one object."


def test_window_cuts_pushes_but_keeps_the_whole_pull():
    window = Window.of([Curve(np.linspace(0, 80, 81), np.r_[-60.0, np.linspace(20, 0, 50), np.zeros(30)])])
    assert window.force_n == pytest.approx((-7.4, 21.0))
    assert 45.0 < window.lift_mm[1] < 55.0


def test_objects_of_a_group_are_of_many_classes():
    flat = GROUPS[0]
    classes = {30: "cube", 31: "cube", 32: "cube", 33: "prism", 34: "prism", 21: "triangle", 24: "cone"}
    assert chosen_objects(flat, classes) == [21, 30, 31, 33]


def test_softest_and_stiffest_are_told_by_the_simulation_where_it_knows_all_tools(content):
    tools, source = three_tools(content, content.best)
    assert source is not None
    assert {row["slot"] for row in source.rows} == {0, 1, 2}
    assert tools["best"] is content.best


def test_without_simulations_softest_and_stiffest_are_told_by_quality(tmp_path):
    lake = build(Lake.open(tmp_path / "lake", create=True), Campaign(n_batches=1, with_simulations=False))
    content = Content.load(lake, "demo")
    tools, source = three_tools(content, content.best)
    by_quality = sorted(content.first, key=lambda tool: tool.quality_n)
    assert source is None
    assert tuple(tools.values()) == tuple(by_quality)  # the strongest is the best, so it is not the stiffest


def test_shapes_without_known_classes_still_list_their_features(content, folder):
    html = shapes_section(content, folder)
    assert "Nothing yet." in html  # the made-up class belongs to no group
    assert len(numbers(folder, "shape_features")) == 1


def test_a_tool_that_lets_go_early_is_drawn_between_the_others(content, folder, monkeypatch):
    monkeypatch.setattr(loss_module, "SHORT", 1.0)
    html, sources = early_loss(content, folder, {"made up"})
    folder.sources(*sources)
    strong = [r for r in numbers(folder, "early_losses") if float(r["peak_force_n"]) > 1.0]
    least = min(strong, key=lambda r: float(r["part"]))
    assert f"B{int(least['batch']):02d}T{least['slot']} on the {least['object_name']}" in html
    assert (folder.root / "figures" / "early_loss.svg").exists()


def test_no_tool_lets_go_early_is_one_line(content, folder, monkeypatch):
    monkeypatch.setattr(loss_module, "SHORT", 0.0)
    html, _ = early_loss(content, folder, {"made up"})
    assert re.fullmatch(
        r"<p>No tool holds a stably grasped object for less than 0 %.*\(the shortest: \d+ %\)\.</p>", html
    )


def test_change_of_work_is_the_difference_of_the_means(content):
    changes = work_changes(content, 1, 2)
    assert len(changes) == 4
    for row in changes:
        rows = [r for r in content.work.rows if r["object_id"] == row.object_id]
        works = {b: [r["work_j"] for r in rows if r["batch"] == b] for b in (1, 2)}
        assert row.change.mean == pytest.approx(np.mean(works[2]) - np.mean(works[1]))
        assert row.change.lower <= row.change.mean <= row.change.upper


def test_other_lakes_are_drawn_as_other_approaches(lake, folder, tmp_path):
    other = build(Lake.open(tmp_path / "measured-only-7", create=True), Campaign(seed=5, with_simulations=False))
    html = rivals_section(Content.load(lake, "demo", [other]), folder)
    rows = numbers(folder, "approaches")
    assert {(row["approach"], row["seed"]) for row in rows} == {("data", "0"), ("measured only", "7")}
    assert len(rows) == 12
    assert "measured only" in html
    assert "figures/approaches.svg" in html


def test_no_other_approach_is_one_line(content, folder):
    html = rivals_section(content, folder)
    assert "this lake has none" in html
    assert "<img" not in html


def test_throughput_counts_every_attempt(lake, content):
    html, source = throughput(content)
    (row,) = source.rows
    assert row["n_grasps"] == len(lake.ids(GraspRow, campaign_id="demo"))
    assert 0 <= row["n_simulated_meanwhile"] <= row["n_simulated"]
    assert "8,532" in html


def test_what_is_missing_is_said_in_the_table_of_figures():
    html = paper_section('<img src="figures/quality_by_batch.svg">')
    assert html.count("here</a>") == 1
    assert "needs a calibration: fast calibrate" in html
