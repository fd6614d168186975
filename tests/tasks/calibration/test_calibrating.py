import sys
from types import SimpleNamespace

import numpy as np
import pytest

from fast.lake.query.lineage import find_lineage
from fast.lake.store import Lake
from fast.lake.tables.campaign import (
    CalibrationRow,
    CampaignRow,
    GraspRow,
    PosteriorDrawsRow,
    SimulationRow,
    SimulatorVersionRow,
    ToolRow,
)
from fast.lake.tables.catalogue_rows import missing_version_rows
from fast.lake.tables.requests import setup_columns
from fast.models.errors import UsageError
from fast.models.gap.grasps import Cells
from fast.models.records import EffectValue, GraspSetup
from fast.models.simulation.version import SimulatorVersion
from fast.tasks.calibration.calibrate import calibrate_once, infer
from fast.tasks.calibration.mean_data import find_base_version, make_problem, read_measured_tools, read_simulated_points
from fast.tasks.calibration.means import gather, plan_verification, regather, verify
from fast.tasks.gap.bank import plan_theta_grid
from fast.tasks.gap.trace_rows import find_base_setup
from tests.tasks.calibration.calibration_lake import (
    OBJECTS,
    PROVENANCE,
    SETTINGS,
    SETUP,
    TRUTH,
    calibration_lake,
    made_up_result,
    measured_rows,
    simulated_rows,
    simulation_row,
)


@pytest.fixture(scope="module")
def kept(tmp_path_factory):
    return calibration_lake(tmp_path_factory.mktemp("kept") / "lake")


@pytest.fixture
def calibrate(monkeypatch):
    """Put made-up draws in the place of the sampler; `calls` are the problems it was given."""
    answers = SimpleNamespace(calls=[], theta=TRUTH, changes={})

    def made_up(problem, settings, progress=None):
        answers.calls.append(problem)
        return made_up_result(problem, settings, answers.theta, **answers.changes)

    monkeypatch.setitem(sys.modules, "fast.models.calibration.means.calibrate", SimpleNamespace(calibrate=made_up))
    return answers


def test_repeats_are_averaged_then_objects_and_tools_count_as_printed(tmp_path):
    lake = calibration_lake(tmp_path / "lake", n_tools=6, n_points=0)
    (tool,) = lake.records(ToolRow, tool_id="small/B01T2")
    lake.append([tool.model_copy(update={"measured_rib_thickness_mm": 2.75})], PROVENANCE)
    (lost,) = lake.records(GraspRow, tool_id="small/B01T3", object_id=14, repeat=1)
    lake.append([lost.model_copy(update={"status": "failed", "peak_force_n": None})], PROVENANCE)
    found = read_measured_tools(lake, "small")
    assert found.tool_ids == tuple(f"small/B01T{slot}" for slot in range(6))
    assert (found.object_ids, found.setup) == (OBJECTS, SETUP)
    peaks = [row["peak_force_n"] for row in lake.rows(GraspRow, tool_id="small/B01T0", object_id=24)]
    assert found.forces_n[0, 2] == pytest.approx(np.mean(peaks))
    (one,) = [r["peak_force_n"] for r in lake.rows(GraspRow, tool_id="small/B01T3", object_id=14, status="ok")]
    assert found.forces_n[3, 1] == one
    assert found.points[2, 6] == pytest.approx(0.75)  # rib thickness as a person measured it
    assert len(found.grasp_ids) == 6 * 3 * 2 - 1


def test_a_tool_with_few_objects_is_left_out_and_said(tmp_path):
    lake = calibration_lake(tmp_path / "lake", n_tools=7, n_points=0)
    rows = [row for row in lake.records(GraspRow, tool_id="small/B01T4") if row.object_id != 2]
    lake.append([row.model_copy(update={"status": "failed", "peak_force_n": None}) for row in rows], PROVENANCE)
    found = read_measured_tools(lake, None)
    assert "small/B01T4" not in found.tool_ids
    assert found.warnings == ("tool small/B01T4 is measured on fewer than half of the objects and left out.",)


def test_simulated_means_are_those_of_each_theta(kept):
    measured, base = read_measured_tools(kept, "small"), SimulatorVersion()
    found = read_simulated_points(kept, base, measured)
    assert found.points.shape == (40, 9)
    assert found.forces_n.shape == (40, 3)
    problem = make_problem(measured, found, base)
    assert problem.scales_with_modulus
    assert problem.y_sim == pytest.approx(found.forces_n.mean(axis=1))
    per_mpa = problem.y_sim / problem.theta_sim[:, 0]
    assert per_mpa.max() / per_mpa.min() < 0.2 * problem.y_sim.max() / problem.y_sim.min()


@pytest.mark.parametrize(("n", "said"), [(1.0, ""), (1 / 9.80665, "in N, not in kg"), (1000 / 9.80665, "not in grams")])
def test_means_in_kg_or_g_are_warned_of(tmp_path, n, said):
    assert [said in warning for warning in gather(lake_in_units(tmp_path, n), None, None, 0).warnings] == [True] * (
        said != ""
    )


def test_means_in_mn_or_kn_are_refused(tmp_path):
    for name, n in (("mN", 1000.0), ("kN", 0.001)):
        with pytest.raises(UsageError, match="a factor of about 1000 is suspected in the unit of the forces: give"):
            gather(lake_in_units(tmp_path / name, n), None, None, 0)


def lake_in_units(root, n):
    """A lake whose measured forces are n times what they are in N."""
    lake = Lake.open(root / "lake", create=True)
    measured = [
        row.model_copy(update={"peak_force_n": n * row.peak_force_n}) if isinstance(row, GraspRow) else row
        for row in measured_rows(15)
    ]
    lake.append([*measured, *simulated_rows(40)], PROVENANCE)
    return lake


def test_missing_simulations_are_imputed_per_mpa(tmp_path):
    lake = calibration_lake(tmp_path / "lake", n_tools=6, n_points=30)
    softest = min(lake.records(SimulatorVersionRow), key=lambda row: row.young_modulus_mpa)
    (lost,) = lake.records(SimulationRow, version_id=softest.version_id, object_id=14)
    lake.append([lost.model_copy(update={"status": "failed", "peak_force_n": None})], PROVENANCE)
    measured = read_measured_tools(lake, None)
    problem = make_problem(measured, read_simulated_points(lake, SimulatorVersion(), measured), SimulatorVersion())
    row = int(np.argmin(problem.theta_sim[:, 0]))
    assert problem.variance_sim[row] > 0
    assert np.count_nonzero(problem.variance_sim) == 1
    others = [r.peak_force_n for r in lake.records(SimulationRow, version_id=softest.version_id, status="ok")]
    assert problem.y_sim[row] < 10 * np.mean(others)  # not the mean of designs at 100 MPa


def test_versions_that_somebody_believes_in_are_not_part_of_the_hypercube(tmp_path):
    lake = calibration_lake(tmp_path / "lake", n_tools=6, n_points=25)
    base = SimulatorVersion()
    design = read_measured_tools(lake, None).designs[0]
    lake.append([simulation_row(design, object_id, base) for object_id in OBJECTS], PROVENANCE)
    assert len(read_simulated_points(lake, base, read_measured_tools(lake, None)).points) == 25
    half = [row for row in simulated_rows(1, seed=9) if getattr(row, "object_id", 2) == 2]
    lake.append(half, PROVENANCE)
    assert (
        len(read_simulated_points(lake, base, read_measured_tools(lake, None)).points) == 25
    )  # not on every object yet


def test_the_grid_of_a_calibration_on_traces_is_not_part_of_the_hypercube(tmp_path):
    lake = calibration_lake(tmp_path / "lake", n_tools=6, n_points=0)
    measured = read_measured_tools(lake, None)
    for design, version in plan_theta_grid(
        SimulatorVersion(), Cells.full(measured.designs[:2], OBJECTS, measured.setup)
    )[0].points:
        rows = [simulation_row(design, object_id, version) for object_id in OBJECTS]
        lake.append([*missing_version_rows(lake, version), *rows], PROVENANCE)
    sentence = refused(lake)
    assert "has no design that is simulated with a theta of its own" in sentence
    assert "simulator versions" not in sentence
    lake.append(simulated_rows(25), PROVENANCE)
    assert len(read_simulated_points(lake, SimulatorVersion(), measured).points) == 25


def test_a_calibration_is_written_with_draws_version_and_lineage(tmp_path, calibrate):
    lake = calibration_lake(tmp_path / "lake")
    data = gather(lake, None, None, SETTINGS.seed)
    row, result = infer(lake, data, SETTINGS)
    assert lake.records(CalibrationRow) == [row]
    assert (row.status, row.n_designs, row.n_held_out, row.n_simulations, row.n_objects) == ("ok", 12, 3, 40, 3)
    assert row.young_modulus_median_mpa == pytest.approx(np.median(result.of("young_modulus_mpa")))
    assert row.friction_q05 < row.friction_mode < row.friction_q95
    assert len(lake.ids(PosteriorDrawsRow)) == 2 * len(result.names)
    (version,) = lake.records(SimulatorVersionRow, version_id=row.version_id)
    assert version.friction == pytest.approx(row.friction_median, rel=1e-5)
    assert version.version.model_copy(update={"theta": data.base.theta}) == data.base
    joint = lake.query(f"SELECT * FROM posterior('{row.calibration_id}') ORDER BY chain, draw").to_pydict()
    assert joint["friction"] == pytest.approx(result.of("friction").ravel())
    tables = {node.table for node in find_lineage(lake, row.version_id, depth=2).rows}
    assert {"calibrations", "grasps", "simulations"} <= tables
    made = find_lineage(lake, row.calibration_id, forward=True, depth=1).rows
    assert {node.table for node in made} == {"calibrations", "posterior_draws", "simulator_versions"}


def test_theta_found_predicts_held_out_designs_better(tmp_path, calibrate):
    row, _ = infer_new(calibration_lake(tmp_path / "lake"))
    assert row.held_out_by == "emulator"
    assert row.rmse_after_n < 0.5 * row.rmse_before_n
    (problem,) = calibrate.calls
    assert problem.n_real == 12  # the held-out designs were never seen


def test_scores_of_the_simulator_take_the_place_of_the_emulators_once(tmp_path, calibrate):
    lake = calibration_lake(tmp_path / "lake")
    data = gather(lake, None, None, SETTINGS.seed)
    row, _ = infer(lake, data, SETTINGS)
    plan = plan_verification(lake, data, row)
    assert len(plan.points) == 2 * row.n_held_out
    assert verify(lake, data, row, plan) == row  # nothing is simulated yet
    wanted = [simulation_row(design, number, version) for design, version in plan.points for number in OBJECTS]
    lake.append(wanted, PROVENANCE)
    verified = verify(lake, data, row, plan)
    truth = dict(zip(data.measured.design_ids, data.problem.y_real, strict=True))
    told = dict.fromkeys(version.version_id for _, version in plan.points)
    for version_id in told:
        mine = [one for one in wanted if one.version_id == version_id]
        means = {
            one.design_id: np.mean([two.peak_force_n for two in mine if two.design_id == one.design_id]) for one in mine
        }
        told[version_id] = np.sqrt(np.mean([(mean - truth[design_id]) ** 2 for design_id, mean in means.items()]))
    assert [verified.rmse_before_n, verified.rmse_after_n] == pytest.approx(list(told.values()))
    assert (verified.held_out_by, row.held_out_by) == ("simulator", "emulator")
    assert lake.records(CalibrationRow) == [verified]
    files = len(list((lake.root / "calibrations").rglob("*.parquet")))
    assert verify(lake, data, verified, plan) == verified
    assert len(list((lake.root / "calibrations").rglob("*.parquet"))) == files == 2


def infer_new(lake, settings=SETTINGS):
    return infer(lake, gather(lake, None, None, settings.seed), settings)


def test_the_same_data_and_settings_are_the_same_calibration(tmp_path, calibrate):
    lake = calibration_lake(tmp_path / "lake")
    row, _ = infer_new(lake)
    data = gather(lake, None, None, SETTINGS.seed)
    once = calibrate_once(lake, data, SETTINGS)
    assert (once.row, once.is_new) == (row, False)
    more_workers = SETTINGS.model_copy(update={"workers": 7})
    assert data.calibration_id(more_workers) == row.calibration_id
    for change in ({"seed": 1}, {"rho": "free"}, {"draws": 300}):
        assert data.calibration_id(SETTINGS.model_copy(update=change)) != row.calibration_id
    lake.append(measured_rows(1, first=40), PROVENANCE)
    assert gather(lake, None, None, 0).calibration_id(SETTINGS) != row.calibration_id


def test_scatter_between_prints_makes_the_strongest_tools_the_least_certain(tmp_path, calibrate):
    lake = calibration_lake(tmp_path / "lake")
    settings = SETTINGS.model_copy(update={"print_scatter": 0.05})
    equal = gather(lake, None, None, settings.seed)
    data = gather(lake, None, None, settings.seed, print_scatter=0.05)
    added = data.problem.variance_real - equal.problem.variance_real
    assert np.sqrt(added) == pytest.approx(0.05 * data.problem.y_real)
    row, _ = infer(lake, data, settings)
    again = regather(lake, row.calibration_id)
    assert again is not None
    assert again.problem.variance_real == pytest.approx(data.problem.variance_real)


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"r_hat": dict.fromkeys(("young_modulus_mpa", "friction", "poisson_ratio"), 1.2)}, "has not converged"),
        ({"k_hat": 0.9}, "importance weights cannot be trusted"),
    ],
)
def test_no_simulator_is_built_on_draws_that_cannot_be_trusted(tmp_path, calibrate, changes, reason):
    calibrate.changes = changes
    lake = calibration_lake(tmp_path / "lake")
    row, _ = infer_new(lake)
    assert (row.status, row.version_id) == ("failed", None)
    assert reason in row.reason
    assert len(lake.ids(SimulatorVersionRow)) == 40


def test_what_the_sampler_warns_of_is_kept(tmp_path, calibrate):
    calibrate.changes = {"warnings": ("3 divergences.",)}
    lake = calibration_lake(tmp_path / "lake")
    row, _ = infer_new(lake)
    assert lake.records(CalibrationRow)[0].warnings == row.warnings == ("3 divergences.",)


def test_a_fallback_is_not_refused_for_the_k_hat_of_what_it_replaced(tmp_path, calibrate):
    calibrate.changes = {"method": "joint", "k_hat": 1.1}
    row, _ = infer_new(calibration_lake(tmp_path / "lake"))
    assert (row.status, row.sampler, row.k_hat) == ("ok", "joint", 1.1)


def test_drift_since_the_last_calibration_is_a_warning(tmp_path, calibrate):
    lake = calibration_lake(tmp_path / "lake")
    first, _ = infer_new(lake)
    assert not any("drifted" in sentence for sentence in first.warnings)
    lake.append(measured_rows(5, first=20), PROVENANCE)
    calibrate.theta = TRUTH.model_copy(update={"young_modulus_mpa": 14.0})
    second, _ = infer_new(lake)
    (sentence,) = [s for s in second.warnings if "drifted" in s]
    assert sentence.startswith("Young's modulus has drifted: ")
    assert first.calibration_id in sentence


def refused(lake, **options):
    with pytest.raises(UsageError) as caught:
        gather(lake, options.get("campaign"), options.get("version"), 0)
    sentence = str(caught.value)
    assert sentence.endswith(".")
    return sentence


def test_nothing_measured_or_simulated_is_one_sentence(tmp_path):
    lake = Lake.open(tmp_path / "lake", create=True)
    assert "has no measured grasps" in refused(lake)
    lake.append(measured_rows(3), PROVENANCE)
    assert "has 3 measured tools, a calibration needs at least 5" in refused(lake)
    lake.append(measured_rows(9), PROVENANCE)
    assert "add --simulate 100." in refused(lake)
    screening = SimulatorVersion(tier="screening")
    lake.append(simulated_rows(30, screening), PROVENANCE)
    assert "(30 simulator versions of another mesh, tier, effect or code are there)" in refused(lake)
    lake.append(simulated_rows(8), PROVENANCE)
    assert "8 simulations, it needs at least 20" in refused(lake)


def test_measurements_that_cannot_be_compared_are_one_sentence(tmp_path):
    lake = calibration_lake(tmp_path / "lake", n_points=0)
    lake.append(measured_rows(6, "other", first=30, tier="reference"), PROVENANCE)
    assert "consult simulators that differ in more than theta" in refused(lake)
    assert "consult" not in refused(lake, campaign="other")
    (row, *_) = lake.records(GraspRow, campaign_id="other")
    lake.append([row.model_copy(update={"world_hash": "W2"})], PROVENANCE)
    assert "2 benches (virtual W1, virtual W2)" in refused(lake)
    lake.append([row.model_copy(update={"world_hash": "W2", "lab": "delft"})], PROVENANCE)  # of another lab
    assert "benches" not in refused(lake)
    lake.append([row.model_copy(update={"object_id": 30})], PROVENANCE)
    assert "different objects (small: 3, other: 4)" in refused(lake)
    lake.append([row.model_copy(update={"design_id": "Dlost"})], PROVENANCE)
    assert "(Dlost) are not in the table of designs" in refused(lake, campaign="other")
    assert "simulator version `V0` is not in" in refused(lake, campaign="small", version="V0")


def test_a_campaign_that_was_stopped_early_counts_with_the_objects_of_its_config(tmp_path):
    lake = calibration_lake(tmp_path / "lake", n_tools=15, n_points=0)
    for name, first, reached in (("two", 30, OBJECTS[:2]), ("one", 50, OBJECTS[:1])):
        rows = measured_rows(6, name, first=first)
        lake.append([r for r in rows if not isinstance(r, GraspRow) or r.object_id in reached], PROVENANCE)
    measured = read_measured_tools(lake, None)
    assert measured.object_ids == OBJECTS
    assert np.isnan(measured.forces_n).sum(axis=0).tolist() == [0, 0, 6]  # 15 + 6 tools, none of `one`
    assert len(measured.tool_ids) == 21
    assert measured.warnings == (
        "6 tools (one/B06T0, ...) are measured on fewer than half of the objects and left out.",
    )


def test_the_base_setup_is_that_of_most_ordinary_grasps():
    """Neither grasps that somebody asked for nor those with the object elsewhere have a say, if there are others."""
    asked, moved = {"request_id": "Q1"}, {"offset_x_mm": 2.0}
    rows = [
        row.model_copy(update=setup_columns(GraspSetup(dwell_s=dwell_s)) | more)
        for row in [next(row for row in measured_rows(1) if isinstance(row, GraspRow))]
        for dwell_s, n, more in [(1.0, 2, {}), (2.0, 3, asked), (3.0, 4, moved), (4.0, 1, {})]
        for _ in range(n)
    ]
    assert find_base_setup(rows).dwell_s == 1.0
    assert find_base_setup(rows[2:9]).dwell_s == 3.0


def test_means_are_compared_at_the_base_setup_and_what_is_left_out_is_said(tmp_path):
    lake = calibration_lake(tmp_path / "lake", n_points=0)
    usual = read_measured_tools(lake, None)
    (row, *_) = lake.records(GraspRow, tool_id=usual.tool_ids[0])
    other = setup_columns(GraspSetup(lift_speed_mm_per_s=20.0))
    faster = row.model_copy(update={"grasp_id": "Kfast", "peak_force_n": 99.0, **other})
    asked = row.model_copy(update={"grasp_id": "Kasked", "peak_force_n": 99.0, "request_id": "I1"})
    lake.append([faster, asked], PROVENANCE)
    found = read_measured_tools(lake, None)
    np.testing.assert_array_equal(found.forces_n, usual.forces_n)
    assert found.setup == usual.setup
    n_all = len(usual.grasp_ids) + 2
    assert found.warnings[0].startswith(f"means are compared at one grasp setup: 2 of {n_all} grasps")


def test_an_imported_campaign_is_compared_with_the_programs_simulator(tmp_path):
    lake = calibration_lake(tmp_path / "lake")
    lake.append([CampaignRow(campaign_id="small", name="small", config_toml='kind = "imported"\n')], PROVENANCE)
    assert find_base_version(lake, ["small"], None) == SimulatorVersion()


def test_jaws_that_stall_make_young_modulus_an_input(tmp_path):
    lake = calibration_lake(tmp_path / "lake", n_points=0)
    limit = EffectValue(effect="force_limited_closing", parameters={"max_force_n": 60.0})
    stalling = SimulatorVersion(effects=(limit,))
    lake.append(simulated_rows(25, stalling), PROVENANCE)
    measured = read_measured_tools(lake, None)
    assert not make_problem(measured, read_simulated_points(lake, stalling, measured), stalling).scales_with_modulus
