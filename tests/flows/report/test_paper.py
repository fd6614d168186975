"""The parts of a report that show Figs. 2a, 2c and 5 of the paper, throughput, and where each figure stands."""

import csv
import dataclasses
import re
from datetime import timedelta

import numpy as np
import pytest

from fast.flows.report.campaign import queries
from fast.flows.report.campaign import shapes as shapes_module
from fast.flows.report.campaign.content import Content
from fast.flows.report.campaign.page import SECTIONS, add_features
from fast.flows.report.campaign.quality import draw_quality, prepare_headline
from fast.flows.report.campaign.shapes import GROUPS, choose_objects, choose_tools
from fast.flows.report.campaign.traces import (
    BatchPlots,
    Curve,
    Window,
    describe_specialists,
    gather_curves,
)
from fast.flows.report.campaign.work import compare_work
from fast.flows.report.folder import Folder
from fast.flows.report.style import figure_style
from fast.lake.provenance import Provenance
from fast.lake.store import Lake
from fast.lake.tables.campaign import GraspRow, SimulationRow
from fast.tasks.templates import render
from tests.flows.synthetic_lake import Campaign, build

PROVENANCE = Provenance(code_version="0.1.0", code_dirty=False, config_hash="c0ffee123456", seed=3, parents=())


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


def show(name: str, content: Content, folder: Folder) -> str:
    """A section of the page on one line; nothing where it is left out."""
    told = SECTIONS[name](content, folder)
    if told is None:
        return ""
    return " ".join(render(f"flows/report/campaign/{name}.html.j2", content=content, told=told).split())


def show_headline(content: Content) -> str:
    told = {"content": content, "headline": prepare_headline(content), "sections": {}, "now": None}
    return " ".join(render("flows/report/campaign/page.html.j2", **told).split())


def test_batches_show_every_tool_of_the_first_and_the_last(content, folder):
    html = show("traces", content, folder)
    assert html.count('<div class="panel">') == 4
    drawn = gather_curves(
        content.result("x", (folder.root / "data" / "traces.sql").read_text()).rows, "object_id", "batch", "slot"
    )
    lines = {key[1:]: curve for key, curve in drawn.items() if key[0] == 0}
    assert lines.keys() == {(batch, slot) for batch in (1, 2) for slot in range(3)}
    panels = BatchPlots((1, 2), content.best, content.tools, Window((0.0, 50.0), (-5.0, 30.0)))
    counts = [[len(axes.lines) for axes in panels.draw(lines, own).axes] for own in (None, lines[1, 0])]
    assert counts == [[4, 5], [4, 6]]  # three tools and the zero; the best over them; its simulation


def test_the_best_tool_is_drawn_even_if_it_is_of_neither_batch(tmp_path, folder):
    content = Content.load(
        build(Lake.open(tmp_path / "lake", create=True), Campaign(n_batches=3, n_measured_batches=3)), "demo"
    )
    middle = next(tool for tool in content.tools if tool.batch == 2)
    content.__dict__["best"] = middle
    show("traces", content, folder)
    assert {(row["batch"], row["slot"]) for row in numbers(folder, "traces") if row["batch"] == "2"} == {
        ("2", str(middle.slot))
    }


def test_binned_traces_are_means_over_the_repeats(lake, content, folder):
    show("traces", content, folder)
    row = next(r for r in numbers(folder, "traces") if (r["batch"], r["slot"], r["object_id"]) == ("2", "1", "2"))
    grasps = [g for g in lake.records(GraspRow, batch=2, slot=1, object_id=2) if g.status == "ok"]
    low = float(row["lift_mm"]) - 0.5
    traces = [lake.trace(g.grasp_id) for g in grasps]
    values = [t.force_n[(t.lift_mm > max(low, 0.0)) & (t.lift_mm >= low) & (t.lift_mm < low + 1.0)] for t in traces]
    assert float(row["force_n"]) == pytest.approx(np.mean(np.concatenate(values)))


def test_closure_and_pull_up_are_drawn_at_five_instants(content, folder):
    html = show("moments", content, folder)
    assert [f"figures/moments/{k}.svg" in html for k in range(1, 7)] == [True] * 5 + [False]
    won = [row for row in content.work.rows if (row["batch"], row["slot"]) == (content.best.batch, content.best.slot)]
    held = max(won, key=lambda row: row["peak_force_n"])
    assert f"({held['object_id']}), in the simulator" in html
    assert f"{held['peak_force_n']:.1f} N on the bench" in html
    assert re.search(r"is\s[\d.]+ N here \(sd [\d.]+ N between\s+prints and mountings\), and", html)
    assert not re.search("±|&plusmn;", html)  # which is an interval of 95 % elsewhere on this page


def test_a_grasp_that_the_simulator_does_not_get_through_is_said(content, folder, monkeypatch):
    monkeypatch.setattr("fast.flows.report.campaign.simulation.simulate_again", lambda *_: None)
    assert "The simulator has no such grasp to draw" in show("moments", content, folder)


def test_specialists_are_the_strongest_on_something():
    rows = [
        {"batch": 1, "slot": slot, "object_id": o, "peak_force_n": force}
        for slot, forces in enumerate(((3.0, 1.0), (2.0, 4.0), (1.0, 2.0)))
        for o, force in enumerate(forces)
    ]
    assert describe_specialists(rows, (1, 1)) == "In B01, 2 of 3 tools are the strongest on at least one object."


def test_window_cuts_pushes_but_keeps_the_whole_pull():
    window = Window.of([Curve(np.linspace(0, 80, 81), np.r_[-60.0, np.linspace(20, 0, 50), np.zeros(30)])])
    assert window.force_n == pytest.approx((-7.4, 21.0))
    assert 45.0 < window.lift_mm[1] < 55.0


def test_simulated_forces_do_not_press_the_measured_ones_flat():
    measured, simulated = (Curve(np.linspace(0, 10, 11), np.full(11, force)) for force in (20.0, 100.0))
    assert Window.of([measured], [simulated]).force_n[1] == pytest.approx(1.05 * 1.5 * 20.0)
    assert Window.of([measured], [measured]).force_n[1] == pytest.approx(1.05 * 20.0)


def test_objects_of_a_group_are_of_many_classes():
    flat = GROUPS[0]
    classes = {30: "cube", 31: "cube", 32: "cube", 33: "prism", 34: "prism", 21: "triangle", 24: "cone"}
    assert choose_objects(flat, classes) == [21, 30, 31, 33]


def test_softest_and_stiffest_are_told_by_the_simulation_where_it_knows_all_tools(content):
    tools, source = choose_tools(content, content.best)
    assert source is not None
    assert {row["slot"] for row in source.rows} == {0, 1, 2}
    assert tools["best"] is content.best


def test_without_simulations_softest_and_stiffest_are_told_by_quality(tmp_path):
    lake = build(Lake.open(tmp_path / "lake", create=True), Campaign(n_batches=1, with_simulations=False))
    content = Content.load(lake, "demo")
    tools, source = choose_tools(content, content.best)
    by_quality = sorted(content.first, key=lambda tool: tool.quality_n)
    assert source is None
    assert tuple(tools.values()) == tuple(by_quality)  # the strongest is the best, so it is not the stiffest


def test_shapes_without_known_classes_still_list_their_features(content, folder):
    html = show("shapes", content, folder)
    assert "Nothing yet." in html  # the made-up class belongs to no group
    assert len(numbers(folder, "shape_features")) == 1


def test_a_tool_that_lets_go_early_is_drawn_between_the_others(content, folder, monkeypatch):
    monkeypatch.setattr(shapes_module, "SHORT", 1.0)
    monkeypatch.setattr(shapes_module, "STABLE_CLASSES", {"made up"})
    html = show("shapes", content, folder)
    strong = [r for r in numbers(folder, "early_losses") if float(r["peak_force_n"]) > 1.0]
    least = min(strong, key=lambda r: float(r["part"]))
    assert f"B{int(least['batch']):02d}T{least['slot']} on the {least['object_name']}" in html
    assert (folder.root / "figures" / "early_loss.svg").exists()


def test_no_tool_lets_go_early_is_one_line(content, folder, monkeypatch):
    monkeypatch.setattr(shapes_module, "SHORT", 0.0)
    monkeypatch.setattr(shapes_module, "STABLE_CLASSES", {"made up"})
    html = show("shapes", content, folder)
    assert re.search(
        r"<p>No tool holds a stably grasped object for less than 0 %[^<]*\(the shortest: \d+ %\)\.</p>", html
    )


def test_change_of_work_is_the_difference_of_the_means(content):
    changes = compare_work(content, 1, 2)
    assert len(changes) == 4
    for row in changes:
        rows = [r for r in content.work.rows if r["object_id"] == row.object_id]
        works = {b: [r["work_j"] for r in rows if r["batch"] == b] for b in (1, 2)}
        assert row.change.mean == pytest.approx(np.mean(works[2]) - np.mean(works[1]))
        assert row.change.lower <= row.change.mean <= row.change.upper


def test_other_lakes_are_drawn_as_other_approaches(lake, folder, tmp_path):
    other = build(Lake.open(tmp_path / "measured-only-7", create=True), Campaign(seed=5, with_simulations=False))
    html = show("baselines", Content.load(lake, "demo", [other]), folder)
    rows = numbers(folder, "approaches")
    assert {(row["approach"], row["seed"]) for row in rows} == {("data", "0"), ("measured only", "7")}
    assert len(rows) == 12
    assert "measured only" in html
    assert "figures/approaches.svg" in html


def test_no_other_approach_is_one_line(content, folder):
    html = show("baselines", content, folder)
    assert "this lake has none" in html
    assert "<img" not in html


def test_throughput_counts_every_attempt(lake, content, folder):
    html = show("cost", content, folder)
    (row,) = content.result("throughput", queries.THROUGHPUT).rows
    assert row["n_grasps"] == len(lake.ids(GraspRow, campaign_id="demo"))
    assert 0 <= row["n_simulated_meanwhile"] <= row["n_simulated"]
    assert "8,532" in html


def test_what_is_missing_is_said_in_the_table_of_figures(content, folder):
    show("progress", content, folder)
    html = show("paper", content, folder)
    assert html.count("here</a>") == 1
    assert "needs a calibration: fast calibrate" in html


def test_only_simulations_beside_a_measured_grasp_count_as_meanwhile(tmp_path):
    size = Campaign(n_batches=2, n_tools=1, n_objects=1, n_repeats=1, failed_grasps=0, with_simulations=False)
    lake = build(Lake.open(tmp_path / "lake", create=True), size)  # two grasps, a day apart
    first = min(lake.records(GraspRow), key=lambda g: g.started_at)
    lasts_s = float(lake.trace(first.grasp_id).time_s[-1])
    for ends_s in (-4.0, 0.5 * lasts_s, lasts_s + 3.0 + 4.0):  # just before, during and just after the grasp
        _add_simulation(lake, first, 3.0, ends_s)
    for ends_s in (-3600.0, 43200.0):  # an hour before, and between the two days
        _add_simulation(lake, first, 3.0, ends_s)
    (row,) = Content.load(lake, "demo").result("throughput", queries.THROUGHPUT).rows
    assert (row["n_simulated"], row["n_simulated_meanwhile"]) == (5, 3)


def _add_simulation(lake: Lake, grasp: GraspRow, lasting_s: float, ends_s: float) -> None:
    """A simulation of a grasp's design that took `lasting_s` and ended `ends_s` after the grasp began."""
    row = SimulationRow(
        simulation_id=f"S{ends_s}", design_id=grasp.design_id, object_id=grasp.object_id, version_id="V",
        status="ok", peak_force_n=1.0, cpu_s=lasting_s, setup_id=grasp.setup_id, setup_json=grasp.setup_json,
    )  # fmt: skip
    ended_at = grasp.started_at + timedelta(seconds=ends_s)
    lake.append([row], Provenance(code_version="0", code_dirty=False, created_at=ended_at))


def test_imported_tools_are_squares_that_no_scientist_chose(content, folder):
    content.__dict__["tools"] = [dataclasses.replace(tool, kind="imported") for tool in content.tools]
    html = show("progress", content, folder)
    assert "Squares were imported." in html
    assert "scientist" not in html
    figure = draw_quality(content.tools, content.best)
    assert {line.lines[0].get_marker() for line in figure.axes[0].containers if line.lines} == {"s"}


def test_one_tool_on_one_object_is_told_in_the_singular_and_gains_nothing(tmp_path):
    size = Campaign(n_batches=1, n_measured_batches=1, n_tools=1, n_objects=1, failed_grasps=0, with_simulations=False)
    html = show_headline(Content.load(build(Lake.open(tmp_path / "lake", create=True), size), "demo"))
    assert "mean over 1 object<" in html
    assert "first batch, 1 tool<" in html
    assert "best tool against that mean" not in html
    assert "simulated grasps" not in html  # the lake has none, whatever the page draws


def test_the_headline_counts_simulations_and_their_versions(content):
    assert re.search(r"<b>\d+</b><span>simulated grasps with 2 simulator versions<", show_headline(content))
