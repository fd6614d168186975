"""Theta of traces without effects: recovery, the two thetas, and what it says about bad data."""

from dataclasses import replace

import numpy as np
import pytest

from fast.models.calibration.inference.optimise import approximate_at_mode
from fast.models.calibration.inference.result import find_unit_warnings
from fast.models.calibration.inference.settings import CalibrationSettings, ThetaPriors
from fast.models.calibration.inference.summary import check_quality
from fast.models.calibration.means.problem import THETA
from fast.models.errors import UsageError
from fast.models.gap.bank.surrogate import Surrogate
from fast.models.gap.data import GapData
from fast.models.gap.fit import posterior
from fast.models.gap.fit.recalibrate import recalibrate
from fast.models.gap.fit.theta import (
    FRICTION_SHIFT,
    MODULUS_SHIFT,
    RATIO_SHIFT,
    calibrate_theta,
    make_grid_bank,
    of_bench,
)
from fast.models.records import Theta
from fast.models.traces.step_noise import SensorNoise
from tests.synthetic.gap import GapTruth, made_up_gap
from tests.tasks.calibration.trace_lake import normal_draws

SETTINGS = CalibrationSettings(chains=2, draws=600, tune=50, workers=1)
TRUTH = GapTruth().theta


def of_grid(data: GapData) -> Surrogate:
    """The data as a calibration has them: no other meshes, closings or effects."""
    return replace(data, bank=make_grid_bank(data.grasps.cells, data.bank.grid_steps_n, data.bank.grid_lead_n)).training


@pytest.fixture(scope="module")
def training() -> Surrogate:
    return of_grid(made_up_gap(6, 5, 2, GapTruth(mesh=0.0), n_repeats=2))


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(posterior, "sample", normal_draws)


def test_theta_is_found_without_noise() -> None:
    quiet = GapTruth(tool_sd=0.0, cell_sd=0.0, repeat_sd=0.0, mesh=0.0, noise=SensorNoise(1e-6, 0.05, 80.0))
    fit = recalibrate(of_grid(made_up_gap(5, 4, 0, quiet, n_repeats=1)))
    np.testing.assert_allclose(fit.theta, [TRUTH.young_modulus_mpa, TRUTH.friction, TRUTH.poisson_ratio], rtol=0.03)
    np.testing.assert_allclose(fit.tool_factor, 1.0, atol=0.02)


def test_truth_is_in_the_interval_and_the_result_passes_the_gate(training: Surrogate) -> None:
    result = calibrate_theta(training, SETTINGS)
    assert (result.names, result.method, check_quality(result)) == (THETA, "trace", "")
    for name in THETA:
        low, high = np.quantile(result.of(name), [0.005, 0.995])
        assert low < getattr(TRUTH, name) < high, name


def test_theta_of_the_bench_is_wider_within_its_range(training: Surrogate) -> None:
    of_simulator = calibrate_theta(training, SETTINGS)
    bench = of_bench(of_simulator, training.bank.grid)
    change = {name: bench.of(name) - of_simulator.of(name) for name in THETA}
    friction = of_simulator.of("friction")
    assert (change["young_modulus_mpa"] / of_simulator.of("young_modulus_mpa")).std() == pytest.approx(
        MODULUS_SHIFT, rel=0.1
    )
    assert (change["friction"] / friction).std() == pytest.approx(FRICTION_SHIFT, rel=0.1)
    assert change["poisson_ratio"].std() == pytest.approx(RATIO_SHIFT, rel=0.15)
    assert bench.of("poisson_ratio").max() <= training.bank.grid[:, 1].max()
    beside = replace(of_simulator, draws=of_simulator.draws.copy())
    beside.draws[..., 2] = 0.489
    assert of_bench(beside, training.bank.grid).of("poisson_ratio").max() <= 0.49


def test_a_pair_that_lies_far_off_is_named(training: Surrogate) -> None:
    grasps = training.grasps
    snapped = np.where(((grasps.tool == 2) & (grasps.obj == 1))[:, None], 0.3, 1.0) * grasps.steps_n
    result = calibrate_theta(replace(training, grasps=replace(grasps, steps_n=snapped)), SETTINGS)
    (sentence,) = [said for said in result.warnings if "lie far from" in said]
    assert sentence.startswith("1 of 30 pairs of a tool and an object")
    assert f"most of all T2 on object {grasps.objects[1]}; they count for little" in sentence
    assert np.median(result.of("friction")) == pytest.approx(TRUTH.friction, abs=0.12)


def test_draws_at_the_end_of_the_range_are_said() -> None:
    truth = GapTruth(theta=Theta(young_modulus_mpa=9.0, friction=0.6, poisson_ratio=0.49), mesh=0.0)
    result = calibrate_theta(of_grid(made_up_gap(6, 5, 1, truth, n_repeats=2)), SETTINGS)
    assert any("of the draws of poisson_ratio lie at the end of its range, 0.49" in said for said in result.warnings)


def test_too_few_tools_and_a_prior_off_the_grid_are_refused(training: Surrogate) -> None:
    with pytest.raises(UsageError, match="2 tools have measured traces .* needs at least 3; measure more"):
        calibrate_theta(of_grid(made_up_gap(2, 4, 0, n_repeats=1)), SETTINGS)
    high = SETTINGS.model_copy(update={"priors": ThetaPriors(poisson_ratio_lower=0.495)})
    with pytest.raises(UsageError, match="Poisson ratios end at 0.49 and the prior's begin at 0.495"):
        calibrate_theta(training, high)


def test_a_wrong_unit_is_suspected_and_a_factor_of_a_thousand_refused() -> None:
    assert find_unit_warnings(10.2 * 2.0, ThetaPriors()) == []
    (sentence,) = find_unit_warnings(10.2 / 9.81, ThetaPriors())
    assert "a factor of 9.81 is suspected: check that forces are in N, not in kg" in sentence
    (sentence,) = find_unit_warnings(8.0 * 1000.0 / 9.81, ThetaPriors())
    assert "a factor of 102 is suspected: check that forces are in N, not in grams" in sentence
    for factor in (1000.0, 0.001):
        with pytest.raises(UsageError, match="a factor of about 1000 is suspected in the unit of the forces"):
            find_unit_warnings(10.2 * factor, ThetaPriors())


def test_the_normal_approximation_of_a_normal_is_itself() -> None:
    precision = np.array([[4.0, 1.0], [1.0, 2.0]])
    mode, covariance = approximate_at_mode(
        lambda z: (-0.5 * float((z - 1.0) @ precision @ (z - 1.0)), -precision @ (z - 1.0)), np.zeros(2)
    )
    np.testing.assert_allclose(mode, 1.0, atol=1e-4)
    np.testing.assert_allclose(covariance, np.linalg.inv(precision), rtol=1e-4)
