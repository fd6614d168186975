"""From a lake to a calibration on traces: what is written, and which theta goes where."""

from typing import NamedTuple

import numpy as np
import pytest

from lake.query.lineage import find_lineage
from lake.store import Lake
from lake.tables.campaign import CalibrationRow, PosteriorDrawsRow, SimulatorVersionRow
from models.calibration.inference.result import CalibrationResult
from models.calibration.inference.settings import CalibrationSettings
from models.calibration.means.problem import THETA
from models.calibration.traces import calibrate as sampler
from models.calibration.traces.calibrate import MODULUS_SHIFT, calibrate_traces
from tasks.calibration.calibrate import find_calibration, infer
from tasks.calibration.drift import theta_history
from tasks.calibration.means import regather
from tasks.calibration.traces import TraceCalibrationData, gather_traces
from tests.tasks.calibration.trace_lake import BASE, TRUTH, normal_draws, trace_lake

SETTINGS = CalibrationSettings(chains=2, draws=250, tune=150, workers=1)


class Inferred(NamedTuple):
    """A lake with a calibration, and what the sampler found of the simulator's theta."""

    lake: Lake
    data: TraceCalibrationData
    row: CalibrationRow
    result: CalibrationResult
    of_simulator: CalibrationResult


@pytest.fixture(scope="module")
def inferred(tmp_path_factory: pytest.TempPathFactory) -> Inferred:
    lake = trace_lake(tmp_path_factory.mktemp("traces") / "lake")
    found: list[CalibrationResult] = []

    def listening(*arguments, **options):
        found.append(calibrate_traces(*arguments, **options))
        return found[-1]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sampler, "calibrate_traces", listening)
        patch.setattr(sampler, "sample", normal_draws)
        data = gather_traces(lake, None, None)
        row, result = infer(lake, data, SETTINGS)
    return Inferred(lake, data, row, result, found[0])


def test_a_calibration_is_written_with_draws_version_and_lineage(inferred: Inferred) -> None:
    lake, data, row, result, _ = inferred
    assert lake.records(CalibrationRow) == [row]
    assert (row.data, row.status, row.sampler, row.noise_sd_n) == ("trace", "ok", "trace", None)
    assert (row.n_designs, row.n_objects, row.n_simulations, row.n_held_out) == (4, 3, 4 * 3 * 12, 0)
    assert len(data.grasp_ids) == 4 * 3 * 2
    assert len(lake.ids(PosteriorDrawsRow)) == 2 * len(result.names)
    joint = lake.query(f"SELECT * FROM posterior('{row.calibration_id}') ORDER BY chain, draw").to_pydict()
    assert joint["friction"] == pytest.approx(result.of("friction").ravel())
    for name, truth in zip(THETA, TRUTH, strict=True):
        assert np.median(result.of(name)) == pytest.approx(truth, rel=0.15), name
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


def test_the_same_data_and_settings_are_the_same_calibration(inferred: Inferred) -> None:
    lake, _, row, _, _ = inferred
    again = gather_traces(lake, None, None)
    assert find_calibration(lake, again.calibration_id(SETTINGS)) == row
    other = SETTINGS.model_copy(update={"seed": 1})
    assert again.calibration_id(other) != row.calibration_id


def test_traces_and_means_are_not_taken_for_each_other(inferred: Inferred) -> None:
    lake, _, row, _, _ = inferred
    assert [past.calibration_id for past in theta_history(lake, BASE.version_id, None, "trace")] == [row.calibration_id]
    assert theta_history(lake, BASE.version_id, None, "design_mean") == []
    assert regather(lake, row.calibration_id) is None
