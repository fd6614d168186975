import numpy as np
import pytest
from scipy import stats

from fast.models.calibration.inference.parameter import estimate_density, find_prior, summarise
from fast.models.calibration.inference.settings import ThetaPriors
from fast.models.calibration.inference.summary import correlate_ranks, summarise_all, summarise_theta
from fast.models.calibration.means.checks import check_calibration, measure_emulator_relevance, measure_relevance
from fast.models.calibration.means.predict import condition_models, predict_measured, score_mixture
from fast.models.calibration.means.problem import THETA, Standardised
from tests.models.calibration.calibration_draws import made_up_result
from tests.synthetic.calibration import make_up_problem

THETA_BEFORE = np.array([11.5, 0.56, 0.45])


@pytest.fixture(scope="module")
def problem():
    return make_up_problem(60, 14, seed=2)


@pytest.fixture(scope="module")
def result(problem):
    return made_up_result(problem)


def test_density_reaches_the_bounds():
    rng = np.random.default_rng(0)
    flat = estimate_density(rng.uniform(0.2, 0.5, 20_000))
    assert flat.density[[0, -1]] == pytest.approx(1 / 0.3, rel=0.12)
    falling = estimate_density(rng.exponential(size=20_000))
    assert falling.mode < 0.15
    assert estimate_density(np.full(10, 3.0)).mode == 3.0


def test_table_2_of_a_gamma_distribution():
    draws = np.random.default_rng(1).gamma(6.6, 0.1, size=(8, 8000))
    summary = summarise(draws, find_prior("friction", ThetaPriors()))
    exact = stats.gamma(6.6, scale=0.1)
    assert summary.mean == pytest.approx(0.66, abs=0.005)
    assert summary.sd == pytest.approx(exact.std(), rel=0.02)
    assert (summary.q05, summary.median, summary.q95) == pytest.approx(exact.ppf((0.05, 0.5, 0.95)), rel=0.01)
    assert summary.mode == pytest.approx(0.56, abs=0.03)
    assert summary.overlap == pytest.approx(1.0, abs=0.02)
    assert summary.shrinkage == pytest.approx(0.0, abs=0.04)


def test_overlap_is_the_common_area():
    rng, normal = np.random.default_rng(0), stats.norm(0.0, 1.0)
    assert summarise(10.0 + rng.standard_normal(4000), normal).overlap < 0.01
    assert summarise(1.0 + rng.standard_normal(4000), normal).overlap == pytest.approx(0.617, abs=0.03)


def test_priors_are_those_of_table_3():
    priors = ThetaPriors()
    modulus = find_prior("young_modulus_mpa", priors)
    assert modulus.median() == pytest.approx(np.exp(16.138) / 1e6)
    assert np.log(modulus.ppf(stats.norm.cdf(1.0)) / modulus.median()) == pytest.approx(1.0)
    assert find_prior("poisson_ratio", priors).support() == (0.2, 0.5)
    assert find_prior("sd_e_n", priors) is None
    assert find_prior("sd_e_n", priors, 4.0).median() == pytest.approx(1.2)


def test_summary_has_every_parameter(problem, result):
    summary = summarise_all(result, Standardised.of(problem).force_scale_n)
    assert tuple(summary) == result.names
    assert summarise_theta(result) == {name: summary[name] for name in THETA}
    assert all(row.q05 <= row.median <= row.q95 for row in summary.values())
    assert summary["young_modulus_mpa"].shrinkage > 0.9
    assert all(row.overlap is not None for row in summary.values())


def test_correlations_are_of_ranks(result):
    names, correlations = correlate_ranks(result)
    assert names == ("young_modulus_mpa", "friction", "poisson_ratio", "sd_e_n", "noise_sd_n")
    expected = stats.spearmanr(result.flat("young_modulus_mpa", "friction")).statistic
    assert correlations[0, 1] == pytest.approx(expected)


def test_permutation_relevance_is_the_total_sobol_index():
    points = np.random.default_rng(3).random((20_000, 3))
    relevance = measure_relevance(lambda z: 2 * z[:, 0] + z[:, 1] ** 2, points, np.random.default_rng(0))
    variances = np.array([4 / 12, 1 / 5 - 1 / 9, 0.0])
    assert relevance == pytest.approx(variances / variances.sum(), abs=0.02)
    assert measure_relevance(lambda z: np.ones(len(z)), points, np.random.default_rng(0)).max() == 0


def test_friction_matters_most_to_the_emulator(problem, result):
    model = next(condition_models(problem, result, 1))
    relevance = measure_emulator_relevance(model, np.random.default_rng(0))
    assert relevance.shape == (12,)
    assert relevance[10] > 3 * np.median(relevance)


def test_checks_predict_each_design_from_the_others(problem, result):
    checks = check_calibration(problem, result, THETA_BEFORE, n_draws=40)
    assert checks.relevance_h.shape == (40, 12)
    assert checks.relevance_e.shape == (40, 9)
    np.testing.assert_allclose(checks.predicted.weights.sum(axis=0), 1.0)
    assert checks.k_hat.shape == (14,)
    # Reweighting can only lose what the design itself taught: near the answer of leaving it out of the data.
    without = np.arange(14) != 5
    direct = predict_measured(problem.take_real(without), result, problem.x_real[[5]], n_draws=40)
    assert checks.predicted.mean[5] == pytest.approx(direct.mean[0], abs=direct.sd[0])
    assert checks.predicted.sd[5] == pytest.approx(direct.sd[0], rel=0.3)
    assert score_mixture(checks.predicted, problem.y_real).n == 14
