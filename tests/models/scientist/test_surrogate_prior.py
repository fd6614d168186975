"""Measurements of prior campaigns in the surrogate: likelihood, prediction, and what they bring."""

import numpy as np
import pytest
from scipy.optimize import approx_fprime

from fast.models.design.space import random_unit
from fast.models.gaussian_process.matern import matern52
from fast.models.scientist.surrogate.fit import fit_surrogate, trust_prior
from fast.models.scientist.surrogate.likelihood import log_posterior
from fast.models.scientist.surrogate.observations import REAL, SIM, ObservationSet
from fast.models.scientist.surrogate.parameters import PriorLink, Standardisation, SurrogateParameters, Vector
from fast.models.scientist.surrogate.posterior import Surrogate, pull_back

LINKS = (PriorLink(correlation=0.8, gain=1.5, mean=20.0), PriorLink(correlation=0.3, gain=0.7, mean=9.0))
PARAMETERS = SurrogateParameters(
    rho=0.7,
    lengthscales_h=tuple(np.linspace(0.5, 1.5, 9)),
    lengthscales_e=tuple(np.linspace(1.2, 0.6, 9)),
    sd_h=3.0,
    sd_e=1.0,
    noise_sd=0.2,
    nugget=0.1,
    mean_sim=12.0,
    mean_real=10.0,
    priors=LINKS,
)


def made_up(n_sim=6, n_real=5, n_priors=(4, 3), seed=0):
    """Sims first, as the likelihood wants them."""
    rng = np.random.default_rng(seed)
    s = np.repeat(range(2 + len(n_priors)), [n_sim, n_real, *n_priors])
    return ObservationSet(random_unit(len(s), rng), s, rng.normal(10.0, 3.0, len(s)), rng.uniform(0.0, 0.1, len(s)))


def test_the_gradient_is_that_of_finite_differences():
    data = made_up()
    units = Standardisation.of(data)
    vector, standardised = Vector.from_parameters(PARAMETERS, units), units.apply(data)
    numeric = approx_fprime(vector.values, lambda v: log_posterior(Vector(v, 2), standardised)[0], 1e-7)
    np.testing.assert_allclose(log_posterior(vector, standardised)[1], numeric, rtol=2e-4, atol=2e-4)


def test_parameters_survive_the_vector_form():
    units = Standardisation.of(made_up())
    links = Vector.from_parameters(PARAMETERS, units).to_parameters(units).priors
    assert [link.correlation for link in links] == pytest.approx([0.8, 0.3])
    assert [link.mean for link in links] == [units.mean_prior[0], units.mean_prior[1]]


def outcome_covariance(x1, x2, s1, s2):
    """Covariance of two outcomes, from the words of `PriorLink` and Eq. 3."""
    h = float(matern52(x1[None], x2[None], np.array(PARAMETERS.lengthscales_h), PARAMETERS.sd_h)[0, 0])
    e = float(matern52(x1[None], x2[None], np.array(PARAMETERS.lengthscales_e), PARAMETERS.sd_e)[0, 0])
    real = PARAMETERS.rho**2 * h + e
    kinds = sorted((int(s1), int(s2)))
    gain = {s: LINKS[s - 2].gain for s in kinds if s >= 2}
    r = {s: LINKS[s - 2].correlation for s in kinds if s >= 2}
    if kinds == [SIM, SIM]:
        return h
    if kinds[0] == SIM:
        return PARAMETERS.rho * h * gain.get(kinds[1], 1.0) * r.get(kinds[1], 1.0)
    if kinds[0] == kinds[1]:
        return gain.get(kinds[0], 1.0) ** 2 * real
    return real * np.prod([gain.get(s, 1.0) * r.get(s, 1.0) for s in kinds])


def test_predictions_are_those_of_the_joint_normal():
    data = made_up()
    surrogate = Surrogate.condition(data, PARAMETERS)
    points = random_unit(3, np.random.default_rng(9))
    noise = np.array([0.1, 0.2, 1.5 * 0.2, 0.7 * 0.2])[data.s] ** 2 + data.noise_variance
    observed = list(zip(data.x, data.s, strict=True))
    K = np.array([[outcome_covariance(a, b, s, t) for b, t in observed] for a, s in observed])
    means = np.array([12.0, 10.0, 20.0, 9.0])
    for fidelity in (SIM, REAL):
        k = np.array([[outcome_covariance(a, p, s, fidelity) for p in points] for a, s in observed])
        solved = np.linalg.solve(K + np.diag(noise), np.column_stack([data.y - means[data.s], k]))
        prior = np.array([[outcome_covariance(p, q, fidelity, fidelity) for q in points] for p in points])
        mean, covariance = surrogate.posterior(points, fidelity)
        np.testing.assert_allclose(mean, means[fidelity] + k.T @ solved[:, 0], rtol=1e-9)
        np.testing.assert_allclose(covariance, prior - k.T @ solved[:, 1:], atol=1e-9)
        np.testing.assert_allclose(surrogate.predict(points, fidelity)[1] ** 2, np.diag(covariance), rtol=1e-7)


def test_the_gradient_of_the_posterior_sees_prior_campaigns():
    surrogate = Surrogate.condition(made_up(), PARAMETERS)
    x, s = random_unit(2, np.random.default_rng(3))[None], np.array([[REAL, SIM]])
    weights = np.array([[1.0, 0.5]]), np.array([[[0.3, 0.2], [0.2, 0.1]]])

    def value(flat):
        mean, covariance = surrogate.posterior(flat.reshape(2, 9), s[0])
        return float(weights[0][0] @ mean + (weights[1][0] * covariance).sum())

    numeric = approx_fprime(x.ravel(), value, 1e-6)
    np.testing.assert_allclose(pull_back(surrogate, x, s, *weights).ravel(), numeric, rtol=1e-3, atol=1e-4)


def landscape_n(x, tilt=0.0):
    """A hill that all campaigns climb, and what differs between them."""
    return 20.0 * np.exp(-2.0 * np.sum((x[:, :4] - 0.6) ** 2, axis=1)) + tilt * x[:, 5]


def errors_n(prior_n, n_real=8, seed=1):
    """Error of the mean at unseen designs without and with a prior campaign of 60 tools, and its correlation."""
    rng = np.random.default_rng(seed)
    own, prior, unseen = random_unit(n_real, rng), random_unit(60, rng), random_unit(200, rng)
    y = landscape_n(own) + 0.2 * rng.normal(size=n_real)
    y_prior = prior_n(prior, rng) + 0.2 * rng.normal(size=60)
    x, s = np.concatenate([own, prior]), np.repeat([REAL, 2], [n_real, 60])
    with_prior = fit_surrogate(ObservationSet(x, s, np.concatenate([y, y_prior]), np.zeros(len(s))))
    alone = fit_surrogate(with_prior.data.of_this_campaign())
    chosen = trust_prior(with_prior)
    found = [float(np.sqrt(np.mean((fit.mean(unseen, REAL) - landscape_n(unseen)) ** 2))) for fit in (alone, chosen)]
    return *found, with_prior.parameters.priors[0].correlation


def test_a_campaign_in_other_units_halves_the_error():
    """Another bench that shows 1.4 times the force and 5 N more: the order of designs is the same."""
    alone_n, with_prior_n, correlation = errors_n(lambda x, rng: 5.0 + 1.4 * landscape_n(x, tilt=1.0))
    assert with_prior_n < 0.5 * alone_n
    assert correlation > 0.8


def test_a_campaign_about_something_else_does_little_harm():
    ratios, correlations = [], []
    for seed in range(4):
        alone_n, with_prior_n, correlation = errors_n(lambda x, rng: rng.normal(10.0, 4.0, len(x)), 20, seed)
        ratios.append(with_prior_n / alone_n)
        correlations.append(correlation)
    assert np.mean(ratios) < 1.1
    assert np.mean(correlations) < 0.75


def test_own_measurements_are_compared_from_three_on(monkeypatch):
    fitted = []
    monkeypatch.setattr("fast.models.scientist.surrogate.fit.fit_surrogate", lambda data, **_: fitted.append(data))
    monkeypatch.setattr("fast.models.scientist.surrogate.fit._better", lambda whole, without: without)
    for n_real, n_fits in ((2, 0), (3, 1)):
        whole = Surrogate.condition(made_up(n_sim=4, n_real=n_real), PARAMETERS)
        assert (trust_prior(whole) is whole) == (n_fits == 0)
        assert len(fitted) == n_fits
    assert fitted[0].n_prior == 0
