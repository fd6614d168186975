"""From a lake to a calibration on traces: what is read and refused, what is written, and which theta goes where."""

from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from fast.lake.query.lineage import find_lineage
from fast.lake.store import Lake
from fast.lake.tables.campaign import (
    CalibrationRow,
    DesignRow,
    GraspRow,
    PosteriorDrawsRow,
    SimulatorVersionRow,
    TraceRow,
)
from fast.lake.tables.row import Row
from fast.models.calibration.inference.result import CalibrationResult
from fast.models.calibration.inference.settings import CalibrationSettings
from fast.models.calibration.means.problem import THETA
from fast.models.errors import UsageError
from fast.models.gap.fit import posterior, theta
from fast.models.gap.fit.theta import MODULUS_SHIFT, calibrate_theta
from fast.models.records import EffectValue, Theta
from fast.models.simulation.version import SimulatorVersion
from fast.tasks.calibration.calibrate import calibrate_once, infer
from fast.tasks.calibration.drift import read_theta_history
from fast.tasks.calibration.means import regather
from fast.tasks.gap.data import read_grasps
from fast.tasks.gap.theta import TraceData, gather_traces, plan_grid
from fast.tasks.simulation.plan import missing_objects
from tests.tasks.calibration.trace_lake import (
    BASE,
    DESIGNS,
    N_REPEATS,
    OBJECTS,
    PROVENANCE,
    TRUTH,
    measured_rows,
    normal_draws,
    simulated_rows,
    trace_lake,
)

SETTINGS = CalibrationSettings(chains=2, draws=250, tune=150, workers=1)


def gathered(lake: Lake, campaign_id: str | None = None) -> TraceData:
    return gather_traces(lake, read_grasps(lake, campaign_id), BASE, campaign_id)


class Inferred(NamedTuple):
    """A lake with a calibration, and what the sampler found of the simulator's theta."""

    lake: Lake
    data: TraceData
    row: CalibrationRow
    result: CalibrationResult
    of_simulator: CalibrationResult


@pytest.fixture(scope="module")
def inferred(tmp_path_factory: pytest.TempPathFactory) -> Inferred:
    lake = trace_lake(tmp_path_factory.mktemp("traces") / "lake")
    found: list[CalibrationResult] = []

    def listening(*arguments, **options):
        found.append(calibrate_theta(*arguments, **options))
        return found[-1]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(theta, "calibrate_theta", listening)
        patch.setattr(posterior, "sample", normal_draws)
        data = gathered(lake)
        row, result = infer(lake, data, SETTINGS)
    return Inferred(lake, data, row, result, found[0])


def test_a_calibration_is_written_with_draws_version_and_lineage(inferred: Inferred) -> None:
    lake, data, row, result, _ = inferred
    assert lake.records(CalibrationRow) == [row]
    assert (row.data, row.status, row.sampler, row.noise_sd_n) == ("trace", "ok", "trace", None)
    assert (row.n_designs, row.n_objects, row.n_simulations, row.n_held_out) == (4, 3, 4 * 3 * 12, 0)
    assert row.warnings == ()
    assert len(data.grasp_ids) == 4 * 3 * 2
    assert len(lake.ids(PosteriorDrawsRow)) == 2 * len(result.names)
    joint = lake.query(f"SELECT * FROM posterior('{row.calibration_id}') ORDER BY chain, draw").to_pydict()
    assert joint["friction"] == pytest.approx(result.of("friction").ravel())
    for name in THETA:
        assert np.median(result.of(name)) == pytest.approx(getattr(TRUTH, name), rel=0.15), name
    tables = {node.table for node in find_lineage(lake, str(row.version_id), depth=2).rows}
    assert {"calibrations", "grasps", "simulations"} <= tables


def test_the_version_gets_theta_of_the_simulator_and_the_draws_that_of_the_bench(inferred: Inferred) -> None:
    lake, _, row, result, of_simulator = inferred
    (version,) = lake.records(SimulatorVersionRow, version_id=row.version_id)
    assert version.version.model_copy(update={"theta": BASE.theta}) == BASE
    for name in THETA:
        assert getattr(version, name) == pytest.approx(np.median(of_simulator.of(name)), rel=1e-5)
    shift = result.of("young_modulus_mpa") / of_simulator.of("young_modulus_mpa") - 1.0
    assert shift.std() == pytest.approx(MODULUS_SHIFT, rel=0.15)
    assert row.young_modulus_sd_mpa == pytest.approx(result.of("young_modulus_mpa").std(), rel=0.01)
    assert row.young_modulus_sd_mpa > of_simulator.of("young_modulus_mpa").std()
    assert (result.of("poisson_ratio") < 0.49).all()


def test_the_same_data_and_settings_are_the_same_calibration(inferred: Inferred) -> None:
    lake, _, row, _, _ = inferred
    again = gathered(lake)
    once = calibrate_once(lake, again, SETTINGS)
    assert (once.row, once.is_new) == (row, False)
    other = SETTINGS.model_copy(update={"seed": 1})
    assert again.calibration_id(other) != row.calibration_id


def test_traces_and_means_are_not_taken_for_each_other(inferred: Inferred) -> None:
    lake, _, row, _, _ = inferred
    assert [past.calibration_id for past in read_theta_history(lake, BASE.version_id, None, "trace")] == [
        row.calibration_id
    ]
    assert read_theta_history(lake, BASE.version_id, None, "design_mean") == []
    assert regather(lake, row.calibration_id) is None


@pytest.fixture(scope="module")
def gappy(tmp_path_factory: pytest.TempPathFactory) -> Lake:
    """Four tools on three objects; one design is not simulated on object 30, one grasp made twice, one not lifted."""
    lake = Lake.open(tmp_path_factory.mktemp("trace") / "lake", create=True)
    measured = [
        row
        for number, design in enumerate(DESIGNS)
        for object_id in OBJECTS
        for repeat in range(N_REPEATS)
        for row in measured_rows(design, f"demo/B01T{number}", object_id, repeat)
    ]
    rows: list[Row] = [*(DesignRow.of(design) for design in DESIGNS), *measured]
    rows += measured_rows(DESIGNS[0], "demo/B01T0", 4, 0, attempt=1)
    trace, stuck = measured_rows(DESIGNS[1], "demo/B01T1", 7, N_REPEATS)
    assert isinstance(trace, TraceRow)
    rows += [trace.model_copy(update={"lift_mm": 0.0 * trace.lift_mm}), stuck]
    lake.append(rows, PROVENANCE)
    points = plan_grid(read_grasps(lake, "demo"), BASE)[0].points
    made: list[Row] = list({version.version_id: SimulatorVersionRow.of(version) for _, version in points}.values())
    # Another friction belongs to no grid of the base.
    other = BASE.model_copy(update={"theta": Theta(friction=0.111)})
    for design, version in (*points, (DESIGNS[0], other)):
        objects = OBJECTS[:2] if design == DESIGNS[3] else OBJECTS
        made += [row for object_id in objects for row in simulated_rows(design, version, object_id)]
    lake.append([*made, SimulatorVersionRow.of(other)], PROVENANCE)
    return lake


def test_what_was_measured_and_simulated_is_gathered_and_what_is_left_out_is_said(gappy: Lake) -> None:
    data = gathered(gappy, "demo")
    grasps = data.training.grasps
    assert grasps.tools == tuple(f"demo/B01T{number}" for number in range(4))
    assert grasps.objects == OBJECTS
    assert data.training.bank.grid_steps_n.shape == (4, 3, 12, 120)
    assert len(data.grasp_ids) == 22
    assert len(data.simulation_ids) == 11 * 12
    assert data.summary == "22 traces of 4 tools on 3 objects, 132 simulated grasps around them"
    assert [sentence.partition(" have ")[0] for sentence in data.warnings] == ["1 of 25 grasps", "2 of 24 grasps"]
    assert GraspRow.make_id("demo/B01T0", 4, 0, 1) in data.grasp_ids


def test_what_to_simulate_follows_from_what_was_measured(gappy: Lake) -> None:
    (plan,) = plan_grid(read_grasps(gappy, "demo"), BASE)
    assert plan.n_grasps == 4 * 12 * 3
    assert len({version.version_id for _, version in plan.points}) == 12
    missing = missing_objects(gappy, plan)
    assert {design.design_id for (design, _), _ in missing} == {DESIGNS[3].design_id}
    assert [objects for _, objects in missing] == [[30]] * 12


def test_what_cannot_be_calibrated_is_refused_in_one_sentence(gappy: Lake, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="campaign other has no measured grasps; measure tools, or import data"):
        read_grasps(gappy, "other")
    measured = read_grasps(gappy, "demo")
    with pytest.raises(UsageError, match="none of the 12 pairs .* simulate the 12 points of the grid"):
        gather_traces(gappy, measured, SimulatorVersion(tier="reference"), "demo")
    stalling = EffectValue(effect="force_limited_closing", parameters={"max_force_n": 40.0})
    with pytest.raises(UsageError, match="with `force_limited_closing` forces do not scale with Young's modulus"):
        plan_grid(measured, SimulatorVersion(effects=(stalling,)))
    mixed = Lake.open(tmp_path / "mixed", create=True)
    rows = [*measured_rows(DESIGNS[0], "demo/B01T0", 4, 0), *measured_rows(DESIGNS[1], "demo/B01T1", 4, 0)]
    rows[-1] = rows[-1].model_copy(update={"world_hash": "W2"})
    mixed.append(rows, PROVENANCE)
    with pytest.raises(UsageError, match=r"has grasps of 2 benches \(virtual, virtual W2\)"):
        read_grasps(mixed, "demo")
