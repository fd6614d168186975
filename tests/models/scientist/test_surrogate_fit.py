"""The fit and the posterior against GPyTorch autograd, closed forms and explicit refits."""

import dataclasses

import gpytorch
import numpy as np
import pytest
import torch

from fast.models.design.space import random_unit
from fast.models.errors import UsageError
from fast.models.scientist.surrogate.fit import ObservationSet, fit_surrogate
from fast.models.scientist.surrogate.health import health_of
from fast.models.scientist.surrogate.likelihood import log_posterior
from fast.models.scientist.surrogate.parameters import (
    RHO_MEAN,
    RHO_SD,
    Standardisation,
    Vector,
    bounds,
    log_prior,
    prior_mode,
)
from fast.models.scientist.surrogate.posterior import Surrogate, observation_variance, prior_covariance
from tests.synthetic.scientist import BiFidelityKernel


def observations(n_real: int, n_sim: int, seed: int = 0, noise_sd: float = 0.1) -> ObservationSet:
    """A smooth pair: the real outcome is twice the simulated one plus a slow discrepancy, and sims are shifted."""
    rng = np.random.default_rng(seed)
    x = random_unit(n_real + n_sim, rng)
    s = np.r_[np.ones(n_real, int), np.zeros(n_sim, int)]
    h = 3 * np.sin(2 * x[:, 0] + x[:, 3]) + 2 * x[:, 7] * x[:, 1]
    y = np.where(s == 1, 20 + 2 * h + np.cos(2 * x[:, 2]) + noise_sd * rng.normal(size=len(x)), 5 + h)
    extra = np.where(rng.random(len(x)) < 0.2, 0.05, 0.0)
    return ObservationSet(x, s, y, extra)


def test_value_and_gradient_equal_torch_autograd_through_the_gpytorch_kernel():
    data = observations(14, 25).sims_first()
    data = Standardisation.of(data).apply(data)
    vector = Vector(prior_mode(9).values + 0.4 * np.random.default_rng(1).normal(size=23))
    value, gradient = log_posterior(vector, data)

    leaf = torch.tensor(vector.values, requires_grad=True)
    kernel = BiFidelityKernel(num_design_dims=9).double()
    sds = torch.exp(leaf[18:22])
    replaced = {
        "rho": leaf[22],
        "kernel_h.raw_outputscale": sds[0] ** 2,
        "kernel_e.raw_outputscale": sds[1] ** 2,
        "kernel_h.base_kernel.raw_lengthscale": torch.exp(leaf[:9])[None, :],
        "kernel_e.base_kernel.raw_lengthscale": torch.exp(leaf[9:18])[None, :],
    }
    # Invert each constraint so that autograd runs from our vector through GPyTorch's own parameters.
    for name, constraint in kernel.named_constraints():
        raw = name.removesuffix("_constraint")
        replaced[raw] = constraint.inverse_transform(replaced[raw])
    xs = torch.tensor(np.column_stack([data.x, data.s]))
    K = torch.func.functional_call(_Dense(kernel), {f"kernel.{k}": v for k, v in replaced.items()}, (xs,))
    s = torch.tensor(data.s)
    noise = torch.tensor(data.noise_variance) + torch.where(s == 1, sds[3] ** 2, sds[2] ** 2)
    normal = gpytorch.distributions.MultivariateNormal(torch.zeros(len(data)).double(), K + torch.diag(noise))
    with gpytorch.settings.fast_computations(False, False, False):
        likelihood = normal.log_prob(torch.tensor(data.y))
    likelihood.backward()
    prior, prior_gradient = log_prior(vector)
    assert value == pytest.approx(likelihood.item() + prior, abs=1e-8)
    np.testing.assert_allclose(gradient, leaf.grad.numpy() + prior_gradient, rtol=1e-6, atol=1e-7)


class _Dense(torch.nn.Module):
    def __init__(self, kernel: BiFidelityKernel) -> None:
        super().__init__()
        self.kernel = kernel

    def forward(self, xs: torch.Tensor) -> torch.Tensor:
        return self.kernel(xs).to_dense()


def test_prior_of_rho_is_the_stated_normal():
    away = prior_mode(9).values.copy()
    away[-1] += 2 * RHO_SD
    assert prior_mode(9).rho == RHO_MEAN
    assert log_prior(Vector(away))[0] == pytest.approx(-2.0)


def test_fit_ends_where_the_gradient_vanishes():
    data = observations(20, 40)
    surrogate = fit_surrogate(data)
    surrogate = fit_surrogate(data, surrogate.parameters)
    units = Standardisation.of(data)
    vector = Vector.from_parameters(surrogate.parameters, units)
    value, gradient = log_posterior(vector, units.apply(data.sims_first()))
    lower, upper = np.array(bounds(9)).T
    free = (vector.values > lower + 1e-6) & (vector.values < upper - 1e-6)
    assert value == pytest.approx(surrogate.log_posterior, abs=1e-6)
    assert np.abs(gradient[free]).max() < 0.05


def test_fit_finds_the_scale_between_the_fidelities_and_predicts_unseen_designs():
    surrogate = fit_surrogate(observations(40, 200))
    assert surrogate.parameters.rho == pytest.approx(2.0, abs=0.25)
    unseen = observations(200, 0, seed=9, noise_sd=0.0)
    mean, sd = surrogate.predict(unseen.x, 1)
    error = mean - unseen.y
    assert np.sqrt(np.mean(error**2)) < 0.25 * np.std(unseen.y)
    assert 0.75 < np.mean(np.abs(error) < 1.645 * sd) <= 1.0


def test_posterior_is_eq_5_and_6():
    surrogate = fit_surrogate(observations(15, 30))
    data, p = surrogate.data, surrogate.parameters
    rng = np.random.default_rng(3)
    x, s = random_unit(7, rng), np.array([0, 1, 1, 0, 1, 0, 1])
    K = prior_covariance(p, data.x, data.s, data.x, data.s)
    K += np.diag(data.noise_variance + observation_variance(p, data.s))
    cross = prior_covariance(p, data.x, data.s, x, s)
    centre = np.where(data.s == 1, p.mean_real, p.mean_sim)
    expected_mean = cross.T @ np.linalg.solve(K, data.y - centre) + np.where(s == 1, p.mean_real, p.mean_sim)
    expected = prior_covariance(p, x, s, x, s) - cross.T @ np.linalg.solve(K, cross)
    mean, covariance = surrogate.posterior(x, s)
    np.testing.assert_allclose(mean, expected_mean, rtol=1e-6)
    np.testing.assert_allclose(covariance, expected, atol=1e-6 * p.sd_h**2)
    np.testing.assert_allclose(surrogate.predict(x, s)[1] ** 2, np.diag(expected), atol=1e-6 * p.sd_h**2)


def test_leave_one_out_equals_refitting_without_each_observation():
    surrogate = fit_surrogate(observations(8, 12))
    loo = surrogate.leave_one_out()
    for row in (0, 11, 15):
        rest = surrogate.data.take(np.arange(len(surrogate.data)) != row)
        left = surrogate.updated(rest)
        one = surrogate.data.take(np.array([row]))
        mean, sd = left.predict(one.x, one.s)
        noise = one.noise_variance + observation_variance(surrogate.parameters, one.s)
        assert loo.mean[row] == pytest.approx(mean[0], rel=1e-7)
        assert loo.sd[row] == pytest.approx(np.sqrt(sd[0] ** 2 + noise[0]), rel=1e-6)


def test_health_of_a_good_fit():
    health = health_of(fit_surrogate(observations(40, 120)))
    assert (health.n_real, health.n_sim) == (40, 120)
    assert health.loo_q2 is not None
    assert health.loo_q2 > 0.8
    assert health.loo_coverage_90 is not None
    assert 0.75 <= health.loo_coverage_90 <= 1.0


@pytest.mark.parametrize(("n_real", "n_sim"), [(3, 0), (0, 3), (1, 2), (30, 0), (0, 40)])
def test_fit_works_with_little_or_one_sided_data(n_real: int, n_sim: int):
    data = observations(n_real, n_sim)
    surrogate = fit_surrogate(data)
    mean, covariance = surrogate.posterior(random_unit(5, np.random.default_rng(0)), 1)
    assert np.isfinite(mean).all()
    assert (np.diag(covariance) > 0).all()
    health = health_of(surrogate)
    assert (health.loo_rmse_n is None) == (n_real < 2)


def test_identical_forces_still_fit():
    data = dataclasses.replace(observations(3, 3), y=np.full(6, 12.0))
    mean, _ = fit_surrogate(data).posterior(data.x, data.s)
    np.testing.assert_allclose(mean, 12.0, atol=0.1)


def test_extra_variance_loosens_the_fit_at_that_observation():
    data = observations(20, 0)
    sure, surrogate = data, fit_surrogate(data)
    vague = dataclasses.replace(sure, noise_variance=sure.noise_variance + np.where(np.arange(20) == 4, 25.0, 0.0))
    here = data.x[4:5]
    assert surrogate.updated(vague).predict(here, 1)[1][0] > 2 * surrogate.predict(here, 1)[1][0]


def test_fit_is_deterministic_and_warm_start_is_no_worse():
    data = observations(30, 320)
    first, second = fit_surrogate(data, seed=5), fit_surrogate(data, seed=5)
    assert first.parameters == second.parameters
    warm = fit_surrogate(data, first.parameters, seed=5)
    assert warm.log_posterior >= first.log_posterior - 1e-6


def test_two_observations_are_too_few():
    with pytest.raises(UsageError, match="has 2 observations, it needs at least 3; measure or simulate more"):
        fit_surrogate(observations(1, 1))


def test_observations_are_checked_on_entry():
    data = observations(3, 0)
    with pytest.raises(UsageError, match="observation 1 has a y that is not finite"):
        dataclasses.replace(data, y=np.array([1.0, np.nan, 2.0]))
    with pytest.raises(UsageError, match=r"fidelities are \[-1, 1\]"):
        dataclasses.replace(data, s=np.array([1, -1, 1]))
    with pytest.raises(UsageError, match="variance is -1 N"):
        dataclasses.replace(data, noise_variance=np.array([0.0, -1.0, 0.0]))
    with pytest.raises(UsageError, match=r"x \(2, 9\)"):
        dataclasses.replace(data, x=data.x[:2])


def test_conditioning_survives_a_repeated_noise_free_design():
    surrogate = fit_surrogate(observations(0, 20))
    sure = surrogate.parameters.model_copy(update={"nugget": 1e-12})
    doubled = surrogate.data.take(np.r_[np.arange(20), 3])
    mean, _ = Surrogate.condition(doubled, sure).predict(doubled.x[3:4], 0)
    assert mean[0] == pytest.approx(doubled.y[3], abs=0.01)
