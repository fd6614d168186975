import json
import re
from html import unescape
from pathlib import Path

import numpy as np
import pytest

from fast.flows.report.campaign.content import Content
from fast.flows.report.campaign.page import write_report
from fast.flows.report.campaign.quality import draw_quality
from fast.flows.report.campaign.queries import BATCH_TRACES
from fast.flows.report.campaign.simulation import describe_version, draw_agreement
from fast.lake.provenance import Provenance
from fast.lake.query.sql import csv_bytes, run_sql
from fast.lake.store import Lake
from fast.lake.tables.campaign import CampaignRow, EventRow, GraspRow, TraceRow
from fast.models.errors import UsageError
from fast.tasks.campaign.night_story import Night
from tests.flows.synthetic_lake import Campaign, build
from tests.flows.undrawn import leave_unsimulated

SECTIONS = (
    "best",
    "taught",
    "moments",
    "progress",
    "baselines",
    "traces",
    "shapes",
    "work",
    "agreement",
    "calibration",
    "tools",
    "surrogate",
    "cost",
    "paper",
    "provenance",
)


def make_lake(folder: Path, **size) -> Lake:
    return build(Lake.open(folder, create=True), Campaign(**size))


@pytest.fixture(scope="module")
def lake(tmp_path_factory):
    return make_lake(tmp_path_factory.mktemp("lake") / "data")


@pytest.fixture(scope="module")
def report(lake, tmp_path_factory):
    return write_report(lake, "demo", tmp_path_factory.mktemp("report") / "out")


def text_of(index: Path, hidden: str = "style|details") -> str:
    """What a reader sees, without tags and folded parts."""
    html = re.sub(rf"<({hidden}).*?</\1>", " ", index.read_text(encoding="utf-8"), flags=re.S)
    return re.sub(r"\s+", " ", unescape(re.sub(r"<[^>]+>", " ", html)))


def test_every_section_and_every_file_it_names_is_there(report):
    html = report.read_text(encoding="utf-8")
    assert re.findall(r'<section id="(\w+)"', html) == list(SECTIONS)
    named = re.findall(r'(?:src|href)="([^"#]+)"', html)
    assert len(named) > 30
    assert [name for name in named if not (report.parent / name).is_file()] == []


def test_nothing_comes_from_the_network(report):
    html = report.read_text(encoding="utf-8")
    assert "http:" not in html
    assert "https:" not in html
    assert "//" not in "".join(re.findall(r'(?:src|href)="([^"]*)"', html))
    for drawing in report.parent.rglob("*.svg"):
        links = set(re.findall(r"https?://[^\s\"')]+", drawing.read_text(encoding="utf-8")))
        assert links <= {"http://www.w3.org/2000/svg", "http://www.w3.org/1999/xlink"}, drawing.name


def test_csv_files_are_the_answers_of_their_queries(report, lake, tmp_path):
    queries = sorted((report.parent / "data").glob("*.sql"))
    assert len(queries) >= 12
    for query in queries:
        answer = run_sql(lake, query.read_text(encoding="utf-8"))
        (tmp_path / "again.csv").write_bytes(csv_bytes(answer))
        assert (tmp_path / "again.csv").read_bytes() == query.with_suffix(".csv").read_bytes(), query.name


def test_shown_queries_are_the_executed_ones(report):
    html = unescape(report.read_text(encoding="utf-8"))
    for query in (report.parent / "data").glob("*.sql"):
        assert query.read_text(encoding="utf-8").strip() in html, query.name


def test_headline_numbers_follow_from_the_grasps(report, lake):
    grasps = [g for g in lake.records(GraspRow, campaign_id="demo") if g.status == "ok"]
    peaks: dict = {}
    for grasp in grasps:
        peaks.setdefault((grasp.batch, grasp.slot), {}).setdefault(grasp.object_id, []).append(grasp.peak_force_n)
    quality = {tool: np.mean([np.mean(p) for p in objects.values()]) for tool, objects in peaks.items()}
    best = max(quality, key=quality.get)
    first = np.mean([value for (batch, _), value in quality.items() if batch == 1])
    seen = text_of(report)
    assert f"B{best[0]:02d}T{best[1]} holds best" in seen
    assert f"{quality[best]:.2f} ±" in seen
    assert f"mean of the first batch ({first:.1f} N)".replace(" N", "\xa0N") in report.read_text(encoding="utf-8")
    assert f"{100 * (quality[best] / first - 1):+.0f} %" in seen
    assert f"{len(grasps)} measured grasps that count, 2 more failed" in seen


def test_failures_are_told_in_words_and_kept_as_codes(report):
    assert "the solver found no balance of forces" in text_of(report)
    assert "no_convergence" not in text_of(report)
    assert "no_convergence" in (report.parent / "data" / "failures.csv").read_text()


def test_a_minus_is_one_sign_in_pages_and_figures_and_ascii_in_data(report):
    """Tables had U+2212, and figures a hyphen, which is narrower than the plus."""
    drawings = "".join(path.read_text(encoding="utf-8") for path in sorted((report.parent / "figures").rglob("*.svg")))
    drawn = " ".join(re.findall(r"<text[^>]*>([^<]*)</text>", drawings))
    for text in (text_of(report, "style|details|pre"), drawn):
        assert re.findall(r"[^\n]{0,20}(?<![\w./-])-\d\S*", text) == []
    assert "\u22122.35 N" in drawn
    data = "".join(path.read_text(encoding="utf-8") for path in (report.parent / "data").glob("*.csv"))
    assert "\u2212" not in data


def test_interval_is_the_pooled_t_interval_of_the_repeats(lake):
    content = Content.load(lake, "demo")
    tool = next(t for t in content.tools if t.label == "B02T1")
    rows = lake.records(GraspRow, tool_id=tool.tool_id, status="ok")
    by_object = [[r.peak_force_n for r in rows if r.object_id == o] for o in range(4)]
    pooled = np.mean([np.var(values, ddof=1) for values in by_object])
    # Quantile 0.975 of Student's t with 8 degrees of freedom (4 objects x 2): 2.306.
    expected = 2.3060 * np.sqrt(pooled / 12)
    assert tool.half_width_n == pytest.approx(expected, rel=1e-4)


def test_tool_quality_is_that_of_the_lake(lake):
    rows = lake.query("SELECT tool_id, tool_quality_n, work_j FROM tool_quality").to_pylist()
    expected = {row["tool_id"]: (row["tool_quality_n"], row["work_j"]) for row in rows}
    found = {t.tool_id: (t.quality_n, t.work_j) for t in Content.load(lake, "demo").tools}
    assert found.keys() == expected.keys()
    for tool_id, values in found.items():
        assert values == pytest.approx(expected[tool_id], rel=1e-12)


def test_quality_figure_draws_the_table(lake):
    content = Content.load(lake, "demo")
    axes = draw_quality(content.tools, content.best).axes[0]
    drawn = sorted(float(container.lines[0].get_ydata()[0]) for container in axes.containers if container.lines)
    assert drawn == pytest.approx(sorted(t.quality_n for t in content.tools))
    assert [label.get_text() for label in axes.get_xticklabels()] == ["B01", "B02"]


def test_agreement_figure_draws_the_pairs(lake):
    content = Content.load(lake, "demo")
    pairs = [row for row in content.pairs.rows if row["version_id"] == content.compared[0]]
    axes = draw_agreement(pairs, "per object").axes[0]
    drawn = [(x, y) for line in axes.lines[:2] for x, y in zip(*line.get_data(), strict=True)]
    expected = sorted((p["simulated_n"], p["measured_n"]) for p in pairs)
    np.testing.assert_allclose(sorted(drawn), expected)
    assert axes.get_xlim() == axes.get_ylim()


def test_virtual_bench_and_repeat_interval_are_said(report):
    seen = text_of(report)
    assert "Measured on the virtual bench" in seen
    assert "does not cover another print" in seen


def test_provenance_names_code_config_world_and_person(report):
    seen = text_of(report)
    for word in ("0.1.0+abc1234", "c0ffee123456", "w0r1d0000007", "R. Lane", "AG-85A-017", "separation_not_found"):
        assert word in seen, word


def test_same_lake_gives_the_same_files(report, lake, tmp_path):
    again = write_report(lake, "demo", tmp_path / "again")
    for path in [*report.parent.rglob("*.svg"), *report.parent.rglob("*.png"), *report.parent.rglob("*.csv")]:
        assert (again.parent / path.relative_to(report.parent)).read_bytes() == path.read_bytes(), path.name


def test_campaign_without_measurements(tmp_path):
    lake = make_lake(tmp_path / "lake", n_batches=1, n_measured_batches=0)
    index = write_report(lake, "demo", tmp_path / "out")
    seen = text_of(index)
    assert seen.count("No tool of this campaign has been measured on any object yet") == 1
    assert "No tool has been printed and mounted yet." in seen
    assert re.search(r"5[0-9] simulated grasps", seen)


def test_empty_campaign(tmp_path):
    lake = make_lake(tmp_path / "lake", n_batches=0, n_measured_batches=0, n_extra_simulated=0)
    seen = text_of(write_report(lake, "demo", tmp_path / "out"))
    assert "Nothing has been simulated yet." in seen
    assert "Nothing failed." in seen


def test_campaign_without_simulations_and_with_one_batch(tmp_path, monkeypatch):
    leave_unsimulated(monkeypatch)
    lake = make_lake(tmp_path / "lake", n_batches=2, n_measured_batches=1, with_simulations=False, n_repeats=1)
    index = write_report(lake, "demo", tmp_path / "out")
    seen = text_of(index)
    assert "No measured design has been simulated with the same grasp setup yet." in seen
    assert "It is one of the first batch" in seen
    assert "the comparison begins with the next" in seen
    assert "simulated</span>" not in index.read_text(encoding="utf-8")


def test_half_measured_tool_is_shown_but_not_ranked(tmp_path, no_figures):
    lake = make_lake(tmp_path / "lake", n_batches=2, failed_grasps=9, n_repeats=3)  # B01T0 keeps one object of four
    seen = text_of(write_report(lake, "demo", tmp_path / "out"))
    assert "Not ranked, because not measured on every object: B01T0." in seen
    assert "not all objects" in seen


def test_a_first_batch_that_holds_nothing_has_a_report(tmp_path, no_figures):
    lake = make_lake(tmp_path / "lake")
    empty = [row.model_copy(update={"peak_force_n": 0.0}) for row in lake.records(GraspRow, batch=1, status="ok")]
    lake.append(empty, Provenance(code_version="0", code_dirty=False))
    seen = text_of(write_report(lake, "demo", tmp_path / "out"))
    assert "more than the mean of the first batch (0.0 N) and more than its best tool" in seen


def test_what_was_taken_back_did_not_fail(tmp_path, no_figures):
    lake = make_lake(tmp_path / "lake")
    gone = lake.records(GraspRow, batch=2)[0]
    changes = {"status": "failed", "reason": "taken back by ada", "details_json": '{"taken_back_by":"ada"}'}
    lake.append([gone.model_copy(update=changes)], Provenance(code_version="0", code_dirty=False))
    content = Content.load(lake, "demo")
    assert sum(tool.n_failed for tool in content.tools) == sum(row["n_failed"] for row in content.batches.rows) == 2
    seen = text_of(write_report(lake, "demo", tmp_path / "out"))
    assert "taken back" not in seen


def test_grasps_an_hour_count_the_time_between_them(lake):
    assert [row["grasps_per_h"] for row in Content.load(lake, "demo").batches.rows] == [pytest.approx(3600 / 24)] * 2


def test_traces_of_other_setups_are_no_repeats(tmp_path):
    lake = make_lake(tmp_path / "lake")
    values = {"first": 1, "last": 2, "best": "demo/B02T0", "step": 1.0}
    before = Content.load(lake, "demo").result("traces", BATCH_TRACES, **values).rows
    row = lake.records(GraspRow, batch=2)[0]
    asked = row.model_copy(update={"grasp_id": "Kasked", "request_id": "Qasked", "setup_id": "Gfast"})
    (trace,) = lake.records(TraceRow, grasp_id=row.grasp_id)
    samples = trace.model_copy(update={"grasp_id": "Kasked", "force_n": 9.0 * trace.force_n})
    lake.append([samples, asked], Provenance(code_version="0", code_dirty=False))
    assert Content.load(lake, "demo").result("traces", BATCH_TRACES, **values).rows == before


def test_text_from_the_lake_is_escaped(tmp_path, no_figures):
    other = make_lake(tmp_path / "lake", n_measured_batches=0, n_batches=1)
    row = CampaignRow(campaign_id="demo", name="<script>alert(1)</script>", config_toml="a = '<b>'")
    other.append([row], Provenance(code_version="0", code_dirty=False))
    html = write_report(other, "demo", tmp_path / "out").read_text(encoding="utf-8")
    assert "<script" not in html
    assert "&lt;script&gt;" in html
    assert "&lt;b&gt;" in html


def test_unknown_campaign_is_one_sentence(lake, tmp_path):
    with pytest.raises(UsageError, match="There is no campaign `dem` .* did you mean `demo`?"):
        write_report(lake, "dem", tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_unwritable_folder_is_one_sentence(lake, tmp_path):
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(UsageError, match=r"out cannot be written \(Not a directory\); give another one\."):
        write_report(lake, "demo", tmp_path / "file" / "out")


def test_a_new_simulator_is_told_of(tmp_path, no_figures):
    lake = make_lake(tmp_path / "data")
    night = Night(
        stage=1,
        batch=2,
        old_version_id="V0",
        version_id="V1",
        change="Friction falls with slip was added",
        n_planned=500,
        n_done=412,
        worker_hours=2.34,
        n_tools=14,
        rank_before=0.61,
        rank_after=0.83,
        error_before_n=0.49,
        error_after_n=None,
    )
    payload = night.model_dump_json()
    row = EventRow(event_id="E", campaign_id="demo", kind="night", message=night.sentence, payload_json=payload)
    lake.append([row], Provenance(code_version="test", code_dirty=False))
    out = write_report(lake, "demo", tmp_path / "out")
    assert "B02 Friction falls with slip was added 0.49 \u2192 \u2013 0.61 \u2192 0.83 14 412 of 500 2.34" in text_of(
        out
    )
    assert ",0.61,0.83,0.49," in (out.parent / "data" / "nights.csv").read_text()


def test_a_version_is_told_in_words():
    theta = {"young_modulus_mpa": 9.75, "friction": 0.7079, "poisson_ratio": None}
    row = {"version_id": "V1", "tier": "production", "effects_json": "[]", "code": None, **theta}
    assert "(production, code 0, of an earlier program, E" in describe_version({**row, "code": "0"})
    assert describe_version(row) == "V1 (production, E 9.75 MPa, friction 0.708). No effect of the catalogue is in it."
    stalls = {"effect": "force_limited_closing", "parameters": {"max_force_n": 16.8901}}
    told = describe_version({**row, "effects_json": json.dumps([stalls, {"effect": "x", "parameters": {}}])})
    assert told.endswith("With: Pneumatic jaws stall at their largest force (max_force_n = 16.9); x.")
