import dataclasses
import re
import sys
import warnings
from html import unescape
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pyarrow.csv as csv
import pytest

from fast.flows.report.calibration.data import Evidence, StoredCalibration
from fast.flows.report.calibration.page import write_calibration_report
from fast.flows.report.calibration.posterior_figures import chains_figure, pairs_figure
from fast.flows.report.calibration.prediction_figures import Cloud, Plot, before_after_figure, sensitivity_figure
from fast.flows.report.campaign.page import write_report
from fast.lake.provenance import Provenance
from fast.lake.store import Lake
from fast.lake.tables.campaign import CalibrationRow, PosteriorDrawsRow
from fast.models.calibration.inference.summary import summarise_theta
from fast.models.calibration.means.predict import Mixture
from fast.models.calibration.means.problem import THETA
from fast.models.errors import UsageError
from fast.tasks.calibration.calibrate import infer
from fast.tasks.calibration.means import gather
from tests.flows.cli.cli_lakes import Fast
from tests.flows.synthetic_lake import Campaign, build
from tests.models.calibration.calibration_draws import made_up_result
from tests.synthetic.calibration import make_up_problem
from tests.tasks.calibration.calibration_lake import SETTINGS, calibration_lake, measured_rows, simulated_rows
from tests.tasks.calibration.calibration_lake import made_up_result as draws_of_lake

BEFORE = np.array([11.5, 0.56, 0.45])
UNMEASURED = Campaign(n_measured_batches=0, n_batches=1)
PROVENANCE = Provenance(code_version="0.1.0+abc1234", code_dirty=False)


def calibration_rows(calibration_id: str, result, n_designs: int, shift: float = 1.0) -> list:
    """Rows of a calibration, draws first; `shift` scales the medians of the row alone."""
    summary = summarise_theta(result)
    unit = {"young_modulus_mpa": "_mpa"}
    table_2 = {
        f"{name.removesuffix('_mpa')}_{column}{unit.get(name, '')}": shift * getattr(summary[name], column)
        for name in THETA
        for column in ("mean", "sd", "q05", "median", "q95", "mode")
    }
    row = CalibrationRow(
        calibration_id=calibration_id, campaign_id="demo", base_version_id="V0", data="design_mean", status="ok",
        n_designs=n_designs, n_objects=4, n_simulations=40, n_chains=len(result.draws), n_draws=result.draws.shape[1],
        n_tune=100, sampler="made up", k_hat=0.31, n_divergences=0, **table_2,
    )  # fmt: skip
    draws = [
        PosteriorDrawsRow.of(calibration_id, chain, name, result.of(name)[chain])
        for chain in range(len(result.draws))
        for name in result.names
    ]
    return [*draws, row]


@pytest.fixture(scope="module")
def evidence() -> Evidence:
    problem = make_up_problem(40, 15, seed=3)
    held_out = np.arange(15) % 5 == 0
    return Evidence(
        problem.take_real(~held_out),
        BEFORE,
        problem.x_real[held_out],
        problem.y_real[held_out],
        problem.variance_real[held_out],
    )


@pytest.fixture(scope="module")
def result(evidence):
    return made_up_result(evidence.fitted, n_chains=4, n_draws=60, rho="free", spread=0.2)


@pytest.fixture(scope="module")
def lake(tmp_path_factory, result, evidence):
    lake = build(Lake.open(tmp_path_factory.mktemp("lake") / "data", create=True), UNMEASURED)
    lake.append(calibration_rows("C000000000001", result, evidence.fitted.n_real, shift=0.8), PROVENANCE)
    lake.append(calibration_rows("C000000000002", result, evidence.fitted.n_real), PROVENANCE)
    return lake


@pytest.fixture(scope="module")
def report(lake, evidence, tmp_path_factory):
    out = tmp_path_factory.mktemp("report") / "out"
    return write_calibration_report(lake, "C000000000002", out, evidence=evidence, n_predicted=30)


def text_of(index: Path) -> str:
    html = re.sub(r"<(style|details).*?</\1>", " ", index.read_text(encoding="utf-8"), flags=re.S)
    return re.sub(r"\s+", " ", unescape(re.sub(r"<[^>]+>", " ", html)))


def test_every_section_and_every_file_it_names_is_there(report):
    html = report.read_text(encoding="utf-8")
    assert re.findall(r'<section id="(\w+)"', html) == [
        "theta", "agreement", "supplement", "chains", "drift", "provenance",
    ]  # fmt: skip
    named = re.findall(r'(?:src|href)="([^"#]+)"', html)
    assert len(named) > 15
    assert [name for name in named if not (report.parent / name).is_file()] == []
    for drawing in (report.parent / "figures").glob("*.svg"):
        assert drawing.with_suffix(".png").is_file(), drawing.name


def test_draws_come_back_from_the_lake_in_the_order_of_the_layout(lake, result):
    stored = StoredCalibration.load(lake, "C000000000002").result
    assert stored.names == result.names
    np.testing.assert_array_equal(stored.draws, result.draws)
    assert max(stored.r_hat.values()) < 1.1


def test_table_2_is_that_of_the_draws(report, result):
    rows = {row["parameter"]: row for row in csv.read_csv(report.parent / "data" / "parameters.csv").to_pylist()}
    assert set(rows) == set(result.names)
    assert rows["friction"]["mean"] == pytest.approx(result.of("friction").mean())
    seen = text_of(report)
    assert f"{np.quantile(result.of('young_modulus_mpa'), 0.95):.2f}" in seen
    assert "mode at 3.75 MPa" in seen


def test_held_out_designs_are_scored(report, evidence):
    rows = csv.read_csv(report.parent / "data" / "left_out_designs.csv").to_pylist()
    held_out = [row for row in rows if row["designs"] == "held out" and row["panel"] == "before calibration"]
    assert sorted(row["measured_n"] for row in held_out) == pytest.approx(sorted(evidence.y_held_out))
    assert len(rows) == 3 * 15
    assert "each left out 12" in text_of(report)


def test_archive_is_read_by_arviz(report, result, evidence):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FutureWarning)
        import arviz
    archive = arviz.from_netcdf(str(report.parent / "data" / "posterior.nc"))
    np.testing.assert_array_equal(archive.posterior["friction"].values, result.of("friction"))
    lengths = archive.posterior["lengthscale_h"].sel(input_h="young_modulus_mpa").values
    np.testing.assert_array_equal(lengths, result.of("lengthscale_h.young_modulus_mpa"))
    np.testing.assert_array_equal(archive.constant_data["x_real"].values, evidence.fitted.x_real)
    np.testing.assert_array_equal(archive.observed_data["y_real_n"].values, evidence.fitted.y_real)
    assert archive.posterior.attrs["calibration_id"] == "C000000000002"
    assert archive.posterior["noise_sd_n"].attrs["units"] == "N"
    archive.close()


def test_theta_over_time_shows_both_calibrations(report, lake):
    past = StoredCalibration.load(lake, "C000000000002").past
    assert [interval.intervals["friction"][1] for interval in past][0] < past[1].intervals["friction"][1]
    assert "Median and 90 % interval of 2 calibrations." in text_of(report)
    first = StoredCalibration.load(lake, "C000000000001")
    assert len(first.past) == 1


def test_without_its_data_a_calibration_still_shows_theta(lake, tmp_path, capsys):
    answer = Fast(capsys)("report", "C000000000001", "--lake", lake.root, "--out", tmp_path / "out", "--json")
    index = tmp_path / "out" / "index.html"
    assert answer.json == {"calibration": "C000000000001", "report": str(index)}
    seen = text_of(index)
    assert "cannot be found in the lake as they were" in seen
    assert "This is the first calibration of this simulator" in seen


def test_data_of_a_calibration_are_found_again_when_the_lake_has_grown(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "fast.models.calibration.means.calibrate", SimpleNamespace(calibrate=lake_draws))
    lake = calibration_lake(tmp_path / "lake", n_tools=15, n_points=30)
    data = gather(lake, None, None, seed=3)
    row, _ = infer(lake, data, SETTINGS.model_copy(update={"seed": 3}))
    lake.append([*measured_rows(4, first=40)[1:], *simulated_rows(5, seed=9)], PROVENANCE)
    assert gather(lake, None, None, seed=3).problem.n_real == 19
    found = Evidence.of(lake, row.calibration_id)
    np.testing.assert_array_equal(found.fitted.y_real, data.fitted.y_real)
    np.testing.assert_array_equal(found.fitted.y_sim, data.fitted.y_sim)
    np.testing.assert_array_equal(found.y_held_out, data.problem.y_real[data.held_out])
    stored = StoredCalibration.load(lake, row.calibration_id, n_predicted=10)
    assert [panel.clouds[0].scores.n for panel in stored.held_out_plots] == [3, 3, 3]
    assert stored.result.warnings == row.warnings


def lake_draws(problem, settings, progress=None):
    """In the place of the sampler."""
    return draws_of_lake(problem, settings)


def test_campaign_report_shows_the_newest_calibration(result, tmp_path):
    lake = build(Lake.open(tmp_path / "lake", create=True), UNMEASURED)
    lake.append(calibration_rows("C000000000001", result, 12), PROVENANCE)
    lake.append(calibration_rows("C000000000002", result, 12), PROVENANCE)
    index = write_report(lake, "demo", tmp_path / "out")
    assert "Calibration C000000000002 of" in text_of(index)
    assert (tmp_path / "out" / "figures" / "calibration_pairs.svg").is_file()


def test_a_calibration_on_traces_of_an_older_version_is_shown(result, tmp_path, no_figures):
    """It has scatters among its draws, and settings that name a method there is no more."""
    places = [result.names.index(name) for name in THETA]
    scatter = np.random.default_rng(0).lognormal(np.log(0.04), 0.2, (*result.draws.shape[:2], 1))
    draws = np.concatenate([result.draws[:, :, places], scatter], axis=2)
    old = dataclasses.replace(result, names=(*THETA, "tool_sd"), draws=draws)
    lake = Lake.open(tmp_path / "lake", create=True)
    *rows, row = calibration_rows("C1", old, 12)
    changes = {"data": "trace", "sampler": "trace", "settings_json": '{"method": "blocked", "rho": "fixed"}'}
    lake.append([*rows, row.model_copy(update=changes)], PROVENANCE)
    seen = text_of(write_calibration_report(lake, "C1", tmp_path / "out", n_predicted=10))
    assert "modulus from print to print (relative sd)" in seen
    assert "Compared were force traces" in seen
    assert StoredCalibration.load(lake, "C1").result.names == (*THETA, "tool_sd")


def test_campaign_report_survives_a_calibration_without_draws(result, tmp_path, no_figures):
    lake = build(Lake.open(tmp_path / "lake", create=True), UNMEASURED)
    lake.append(calibration_rows("C000000000003", result, 12)[-1:], PROVENANCE)
    assert "is stored without any draws" in text_of(write_report(lake, "demo", tmp_path / "out"))


def test_unknown_calibration_is_one_sentence(lake, tmp_path):
    with pytest.raises(UsageError, match="There is no calibration `C00000000002` .* did you mean `C000000000002`?"):
        write_calibration_report(lake, "C00000000002", tmp_path / "out")


def test_calibration_without_draws_is_one_sentence(tmp_path, result):
    lake = Lake.open(tmp_path / "lake", create=True)
    lake.append(calibration_rows("C1", result, 12)[-1:], PROVENANCE)
    with pytest.raises(UsageError, match="is stored without any draws; run `fast calibrate` again"):
        StoredCalibration.load(lake, "C1")


def test_pair_plot_has_a_panel_for_each_pair(result):
    figure = pairs_figure(result)
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["posterior", "prior"]
    assert len(figure.axes) == 9


def test_before_after_prints_correlation_and_error():
    y = np.array([1.0, 2.0, 4.0])
    cloud = Cloud("held out", Mixture.equal(np.array([[1.5, 2.0, 3.5]]), np.full((1, 3), 0.04)), y)
    figure = before_after_figure([Plot("before", "simulated", [cloud]), Plot("after", "simulated", [cloud], True)])
    said = figure.axes[0].get_title(loc="left")
    expected = np.corrcoef([1.5, 2.0, 3.5], y)[0, 1]
    assert said == f"before\nheld out: r {expected:.2f}, RMSE 0.41 N"
    assert "inside" in figure.axes[1].get_title(loc="left")
    assert figure.axes[0].get_xlim() == figure.axes[0].get_ylim()


def test_other_figures_draw_their_numbers(result):
    relevance = np.tile([0.5, 0.1], (20, 1))
    figure = sensitivity_figure(["rib_count", "height_mm"], relevance, np.full((30, 2), 2.0), "#000000")
    assert [bar.get_width() for bar in figure.axes[0].patches] == [0.5, 0.1]
    assert [label.get_text() for label in figure.axes[0].get_yticklabels()] == ["rib count", "height"]
    chains = chains_figure(result, ["friction"])
    ranks = chains.axes[1].patches
    assert len(ranks) == 4
    assert sum(patch.get_data().values.sum() for patch in ranks) == pytest.approx(4 * 20)
