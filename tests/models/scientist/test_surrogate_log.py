"""The surrogate of logarithms of forces, and simulations that mislead."""

import numpy as np
import pytest

from fast.models.design.space import random_unit, to_unit
from fast.models.scientist.propose import NO_PENDING, Rule, propose
from fast.models.scientist.surrogate.fit import fit_surrogate, trust_simulations
from fast.models.scientist.surrogate.health import health_of, predict_left_out
from fast.models.scientist.surrogate.observations import REAL, SIM, ObservationSet
from fast.models.scientist.surrogate.posterior import Surrogate


def observed(seed: int, *, is_true: bool) -> ObservationSet:
    """25 measured and 80 simulated designs; the simulator is off by a factor, or has nothing to do with the bench."""
    rng = np.random.default_rng(seed)
    real, sim = random_unit(25, rng), random_unit(80, rng)
    measured_n = force_n(real) * np.exp(0.03 * rng.normal(size=25))
    simulated_n = 2.0 * force_n(sim) if is_true else force_n(random_unit(80, rng))
    x, s = np.concatenate([sim, real]), np.repeat([SIM, REAL], [80, 25])
    return ObservationSet(x, s, np.concatenate([simulated_n, measured_n]), np.full(105, 0.01))


def force_n(x: np.ndarray) -> np.ndarray:
    return np.exp(1.0 + 1.5 * x[:, 0] + np.sin(3.0 * x[:, 1]))


def test_logarithms_and_back():
    data = observed(0, is_true=True)
    logs = data.in_logs()
    assert logs.is_log
    assert logs.sims_first().take(logs.s == REAL).is_log
    np.testing.assert_allclose(logs.force_n(logs.y), data.y, rtol=1e-12)
    np.testing.assert_allclose(np.sqrt(logs.noise_variance), 0.1 / (1.0 + data.y), rtol=1e-12)
    below = ObservationSet(data.x[:1], data.s[:1], np.array([-2.0]), np.zeros(1)).in_logs()
    assert below.y[0] == 0.0


def test_the_errors_of_the_health_card_are_forces():
    surrogate = fit_surrogate(observed(0, is_true=True).in_logs())
    health, loo = health_of(surrogate), predict_left_out(surrogate)
    is_real = surrogate.data.s == REAL
    error_n = np.expm1(surrogate.data.y[is_real]) - np.expm1(loo.mean[is_real])
    assert health.loo_rmse_n == pytest.approx(float(np.sqrt(np.mean(error_n**2))))


@pytest.mark.parametrize("seed", range(4))
def test_simulations_that_mislead_are_left_aside(seed):
    good = fit_surrogate(observed(seed, is_true=True).in_logs())
    assert trust_simulations(good) is good
    data = observed(seed, is_true=False).in_logs()
    believed = fit_surrogate(data).parameters.model_copy(update={"rho": 1.0, "sd_e": 0.01})  # an early fit that trusts
    bad = trust_simulations(Surrogate.condition(data, believed))
    assert (bad.data.n_real, bad.data.n_sim, bad.data.is_log) == (25, 0, True)
    x = random_unit(300, np.random.default_rng(seed + 50))
    error_good, error_bad = (np.abs(one.mean(x, REAL) - np.log1p(force_n(x))).mean() for one in (good, bad))
    assert error_good < error_bad


def test_the_first_tools_are_those_with_the_largest_predicted_force():
    surrogate = fit_surrogate(observed(1, is_true=True).in_logs())
    proposals = propose(surrogate, REAL, 5, NO_PENDING, np.random.default_rng(0), Rule(n_best=2))
    x = to_unit([proposal.design for proposal in proposals])
    predicted = surrogate.mean(x, REAL)
    assert [proposal.value for proposal in proposals[:2]] == [0.0, 0.0]
    assert all(proposal.value > 0.0 for proposal in proposals[2:])
    assert predicted[:2].min() > np.quantile(surrogate.mean(random_unit(2000, np.random.default_rng(1)), REAL), 0.99)
    apart = np.linalg.norm(x[:, None] - x[None, :], axis=-1)[np.triu_indices(5, 1)]
    assert apart.min() >= 0.05
    only_best = propose(surrogate, REAL, 2, NO_PENDING, np.random.default_rng(0), Rule(n_best=4))
    assert [proposal.design for proposal in only_best] == [proposal.design for proposal in proposals[:2]]
