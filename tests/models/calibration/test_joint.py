"""Full joint NUTS on small problems: priors come back without information; repeated designs; optima."""

import dataclasses

import numpy as np
import pytest
from scipy import stats

from fast.models.calibration.inference.optimise import climb, find_laplace_covariance
from fast.models.calibration.inference.settings import CalibrationSettings
from fast.models.calibration.means.joint import calibrate_joint
from fast.models.errors import FastError
from tests.synthetic.calibration import make_up_problem

SETTINGS = CalibrationSettings(chains=2, tune=80, draws=80, target_accept=0.8, workers=1)


def test_measurements_without_information_return_the_prior():
    problem = make_up_problem(20, 5, seed=1)
    problem = dataclasses.replace(problem, variance_real=np.full(5, 1e8))
    settings = SETTINGS.model_copy(update={"tune": 100, "draws": 200, "rho": "free"})
    result = calibrate_joint(problem, settings)
    priors = {
        "young_modulus_mpa": stats.lognorm(1.0, scale=settings.priors.young_modulus_median_mpa),
        "friction": stats.gamma(6.6, scale=0.1),
        "poisson_ratio": stats.uniform(0.2, 0.3),
        "rho": stats.norm(1.0, 0.1),
        "lengthscale_e.rib_count": stats.lognorm(1.0, scale=np.exp(0.5)),
    }
    for name, prior in priors.items():
        ranks = prior.cdf(result.of(name).ravel())
        error = 1.0 / np.sqrt(result.ess_bulk[name])
        assert abs(ranks.mean() - 0.5) < 4 * error * np.sqrt(1 / 12), name
        assert abs(np.mean(ranks < 0.1) - 0.1) < 4 * error * 0.3, name
        assert abs(np.mean(ranks > 0.9) - 0.1) < 4 * error * 0.3, name
    # 400 draws of two chains may leave one of the three a hair under the limit.
    assert sum("posterior and prior overlap" in sentence for sentence in result.warnings) >= 2


def test_repeated_designs_with_other_forces_are_the_nuggets_and_the_noises():
    problem = make_up_problem(30, 8, seed=5)
    problem = dataclasses.replace(
        problem,
        x_sim=problem.x_sim[np.arange(30) // 2],
        theta_sim=problem.theta_sim[np.arange(30) // 2],
        y_sim=problem.y_sim[np.arange(30) // 2] + 0.5 * np.tile([-1.0, 1.0], 15),
    )
    result = calibrate_joint(problem, SETTINGS.model_copy(update={"draws": 60, "tune": 60}))
    nugget_n = result.of("nugget") * np.std(problem.y_sim, ddof=1)
    assert 0.3 < np.median(nugget_n) < 1.2


def test_the_normal_approximation_of_a_normal_is_exact_and_no_density_is_refused():
    precision = np.array([[4.0, 1.0], [1.0, 2.0]])

    def density(z):
        return -0.5 * (z - 1) @ precision @ (z - 1), -precision @ (z - 1)

    best = climb(density, [np.zeros(2), np.full(2, 5.0)])[0]
    np.testing.assert_allclose(best.vector, 1.0, atol=1e-4)
    np.testing.assert_allclose(find_laplace_covariance(density, best.vector), np.linalg.inv(precision), rtol=1e-6)
    with pytest.raises(FastError, match="repeated designs with contradicting forces"):
        climb(lambda z: (-np.inf, np.zeros(2)), [np.zeros(2)])
