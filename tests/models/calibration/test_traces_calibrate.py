"""Calibration on traces: the density against brute force, recovery, and what it says about bad data."""

from dataclasses import replace

import numpy as np
import pytest

from models.calibration.inference.settings import CalibrationSettings, ThetaPriors
from models.calibration.traces.calibrate import (
    FRICTION_SHIFT,
    MODULUS_SHIFT,
    RATIO_SHIFT,
    calibrate_traces,
    laplace,
    spread_outliers,
    trace_density,
    unit_warnings,
    with_numerical_shift,
)
from models.calibration.traces.density import NAMES, TraceDensity
from models.calibration.traces.problem import TraceProblem
from models.calibration.traces.response_surface import ResponseSurfaces
from models.calibration.traces.theta_grid import ThetaGrid
from models.errors import UsageError
from models.traces.step_features import PEAK
from models.traces.step_noise import SensorNoise
from tests.synthetic.traces import TraceTruth, made_up_traces

QUIET = TraceTruth(tool_sd=0.0, repeat_sd=0.0, noise=SensorNoise(1e-6, 0.05, 80.0))
QUICK = CalibrationSettings(chains=2, draws=60, tune=60, workers=1)


@pytest.fixture(scope="module")
def gappy() -> TraceProblem:
    """A small problem with a cell that was not measured, one with a repeat missing, one with a simulation missing."""
    problem = made_up_traces(4, 3, 0, TraceTruth(object_sd=0.02, cell_sd=0.02))
    problem.measured[1, 2] = np.nan
    problem.measured[0, 0, 1] = np.nan
    problem.simulated[2, 1, 5] = np.nan
    return problem


def test_density_is_that_of_one_large_gaussian(gappy: TraceProblem) -> None:
    density = trace_density(gappy, ThetaPriors())
    other = density.start + np.array([0.3, -0.2, 0.4, 0.1, 0.2, -0.3])
    difference = density(other)[0] - density(density.start)[0]
    assert difference == pytest.approx(brute_force(density, other) - brute_force(density, density.start), abs=1e-6)


def test_gradient_is_that_of_the_value(gappy: TraceProblem) -> None:
    density = trace_density(gappy, ThetaPriors())
    at = density.start + 0.1
    steps = 1e-5 * np.eye(len(NAMES))
    slopes = [(density(at + step)[0] - density(at - step)[0]) / 2e-5 for step in steps]
    np.testing.assert_allclose(density(at)[1], slopes, rtol=1e-5, atol=1e-4)


def test_surfaces_scale_forces_with_the_modulus_and_say_how_wrong_they_are(gappy: TraceProblem) -> None:
    surfaces = ResponseSurfaces.of(gappy)
    one, two = surfaces.features(np.array([5.0, 0.5, 0.4])), surfaces.features(np.array([10.0, 0.5, 0.4]))
    force = gappy.is_force
    np.testing.assert_allclose(two[..., force], 2.0 * one[..., force])
    np.testing.assert_allclose(two[..., ~force], one[..., ~force])
    at_grid = np.array([surfaces.features(np.array([10.0, *point])) for point in gappy.grid])
    error = np.sqrt(np.diagonal(surfaces.error, axis1=2, axis2=3))[0, 0, : force.argmin()]
    misfit = np.abs(at_grid[:, 0, 0] - gappy.simulated[0, 0]).max(axis=0)[: force.argmin()]
    assert (misfit < 2.0 * error).all()
    assert (error < 0.02 * np.abs(gappy.simulated[0, 0, :, gappy.features.index(PEAK)]).max()).all()


def test_theta_is_found_without_noise() -> None:
    density = trace_density(made_up_traces(6, 6, 0, QUIET), ThetaPriors())
    found = density.constrained(laplace(density)[0])[3:]
    np.testing.assert_allclose(found, QUIET.theta, rtol=0.03)


def test_the_modulus_of_each_tool_is_found() -> None:
    density = trace_density(made_up_traces(6, 6, 4, replace(QUIET, tool_sd=0.05)), ThetaPriors())
    best, _ = laplace(density)
    mean, sd = density.tool_moduli(best)
    true = np.exp(0.05 * np.random.default_rng(4).standard_normal(6))
    modulus_mpa = density.constrained(best)[3] * (1.0 + mean)
    np.testing.assert_allclose(modulus_mpa, 9.2 * true, rtol=0.03)
    assert (sd < 0.05).all()


def test_a_pair_that_lies_far_off_counts_for_little() -> None:
    problem = made_up_traces(6, 5, 0)
    problem.measured[2, 3] *= 1.0 + 0.6 * problem.is_force
    plain = trace_density(problem, ThetaPriors())
    robust = spread_outliers(plain)
    spread = robust.frame.spread
    assert np.unravel_index(spread.argmax(), spread.shape) == (2, 3)
    assert spread[2, 3] > 5.0 > np.delete(spread.ravel(), 2 * 5 + 3).max()
    friction = [density.constrained(laplace(density)[0])[4] for density in (plain, robust)]
    assert abs(friction[1] - 0.62) < abs(friction[0] - 0.62)
    assert abs(friction[1] - 0.62) < 0.05


def test_numerical_shift_widens_theta_within_its_range(gappy: TraceProblem) -> None:
    density = trace_density(gappy, ThetaPriors())
    low, high = density.limits
    draws = np.tile(np.array([0.04, 0.03, 0.03, 9.0, 0.6, high[1] - 0.001]), (2, 3000, 1))
    shifted = with_numerical_shift(draws, density, np.random.default_rng(0))
    np.testing.assert_array_equal(shifted[..., :3], draws[..., :3])
    assert shifted[..., 3].std() == pytest.approx(MODULUS_SHIFT * 9.0, rel=0.05)
    assert shifted[..., 4].std() == pytest.approx(FRICTION_SHIFT * 0.6, rel=0.05)
    assert shifted[..., 5].std() > 0.5 * RATIO_SHIFT
    assert ((shifted[..., 4:] >= low) & (shifted[..., 4:] <= high)).all()


def test_truth_is_in_the_interval_and_traces_know_more_than_peaks() -> None:
    scores, widths = [], {"traces": [], "peaks": [], "means": []}
    for seed in range(4):
        problem = made_up_traces(8, 6, seed, TraceTruth(object_sd=0.01, cell_sd=0.01))
        peaks = problem.only([PEAK])
        for name, data in {"traces": problem, "peaks": peaks, "means": peaks.mean_over_objects()}.items():
            density = trace_density(data, ThetaPriors())
            best, covariance = laplace(density)
            draws = np.random.default_rng(0).multivariate_normal(best, covariance, size=1000)
            theta = density.constrained(draws)[:, 3:]
            widths[name].append(theta.std(axis=0))
            if name == "traces":
                scores.append(np.abs(theta.mean(axis=0) - TraceTruth().theta) / theta.std(axis=0))
    assert np.median(np.array(scores)) < 1.5
    traces, peaks_sd, means = (np.mean(widths[name], axis=0) for name in ("traces", "peaks", "means"))
    assert (traces < peaks_sd).all()
    assert (peaks_sd[:2] < means[:2]).all()


def test_a_calibration_reports_like_any_other(gappy: TraceProblem) -> None:
    result = calibrate_traces(gappy, QUICK)
    assert result.names == NAMES
    assert result.draws.shape == (2, 60, 6)
    assert result.method == "trace"
    assert any("ESS" in sentence for sentence in result.warnings)
    assert 0.2 < result.of("friction").min() < result.of("friction").max() < 1.4


@pytest.mark.parametrize(("factor", "match"), [(1 / 9.81, "factor of 9.81 is suspected"), (30.0, "check the unit")])
def test_a_wrong_unit_is_suspected(gappy: TraceProblem, factor: float, match: str) -> None:
    priors = ThetaPriors()
    modulus_mpa = trace_density(in_unit(gappy, factor), priors).frame.theta[0]
    (sentence,) = unit_warnings(modulus_mpa, priors)
    assert match in sentence
    assert unit_warnings(9.0, priors) == []


@pytest.mark.parametrize("factor", [1000.0, 0.001])
def test_a_factor_of_a_thousand_is_refused(gappy: TraceProblem, factor: float) -> None:
    with pytest.raises(UsageError, match="factor of about 1000 is suspected in the unit of the forces: give them in N"):
        calibrate_traces(in_unit(gappy, factor), QUICK)


def test_too_little_or_ill_shaped_data_are_refused(gappy: TraceProblem) -> None:
    with pytest.raises(UsageError, match="2 tools have measured traces, a calibration on traces needs at least 3"):
        gappy.take(np.array([0, 1]))
    simulated = gappy.simulated.copy()
    simulated[2, 1, :3] = np.nan
    with pytest.raises(
        UsageError, match="tool T2 on object 1 has 8 simulations of the grid, its response surface needs 10"
    ):
        replace(gappy, simulated=simulated)
    with pytest.raises(UsageError, match=r"measured has shape .* give \(4, 3, 3, 14\)"):
        replace(gappy, measured=gappy.measured[..., :5])
    with pytest.raises(UsageError, match="there is no feature `work`"):
        gappy.only(["work"])
    with pytest.raises(UsageError, match="friction is 0.5 to 0.4; give an increasing range"):
        ThetaGrid(friction=(0.5, 0.4))
    priors = ThetaPriors(poisson_ratio_lower=0.495)
    with pytest.raises(UsageError, match="simulate a grid within the prior"):
        trace_density(gappy, priors)


def in_unit(problem: TraceProblem, factor: float) -> TraceProblem:
    """The problem with measured forces, and their noise, times a factor."""
    scale = np.where(problem.is_force, factor, 1.0)
    return replace(problem, measured=problem.measured * scale, noise=problem.noise * np.outer(scale, scale))


def brute_force(density: TraceDensity, vector: np.ndarray) -> float:
    """Log density from the dense covariance of all features of all cells."""
    values, frame = density.constrained(vector), density.frame
    tool_sd, object_sd, cell_sd = values[:3]
    predicted = density.surfaces.features(values[3:])
    cells = [tuple(cell) for cell in np.argwhere(frame.is_measured)]
    back = {cell: np.linalg.inv(frame.whitener[cell]) for cell in cells}
    force = np.where(density.surfaces.is_force, predicted, 0.0)

    def block(one: tuple[int, int], two: tuple[int, int]) -> np.ndarray:
        total = (back[one] @ frame.shared[one]) @ (back[two] @ frame.shared[two]).T
        if one[0] == two[0]:
            total += tool_sd**2 * np.outer(force[one], force[two])
        if one[1] == two[1]:
            total += object_sd**2 * (back[one] @ frame.obj[one]) @ (back[two] @ frame.obj[two]).T
        if one == two:
            total += back[one] @ np.diag(1.0 + cell_sd**2 * frame.slack[one]) @ back[one].T
        return total

    covariance = np.block([[block(one, two) for two in cells] for one in cells])
    residual = np.concatenate([(frame.measured - predicted)[cell] for cell in cells])
    likelihood = -0.5 * (residual @ np.linalg.solve(covariance, residual) + np.linalg.slogdet(covariance)[1])
    return float(likelihood + density._log_prior(vector, values)[0])
