"""NUTS through PyMC on densities with known answers."""

import os

import numpy as np
import pytest

from fast.models.calibration.inference.parallel_chains import sample
from fast.models.calibration.inference.settings import CalibrationSettings
from fast.models.errors import FastError, UsageError

SETTINGS = CalibrationSettings(draws=400, tune=300, seed=3, workers=1)


class Gaussian:
    """Correlated normal density with mean 1, 2, ... ."""

    def __init__(self, k):
        roots = np.random.default_rng(0).standard_normal((k, k))
        self.precision = roots @ roots.T + np.eye(k)
        self.covariance = np.linalg.inv(self.precision)
        self.mean = np.arange(1.0, k + 1)

    def __call__(self, z):
        slope = -self.precision @ (z - self.mean)
        return float(0.5 * (z - self.mean) @ slope), slope


def funnel(z):
    """Neal's funnel in three dimensions: hard enough for divergences at a loose step size."""
    value = -0.5 * z[0] ** 2 / 9 - z[0] - 0.5 * np.exp(-z[0]) * (z[1] ** 2 + z[2] ** 2)
    squares = 0.5 * np.exp(-z[0]) * (z[1] ** 2 + z[2] ** 2)
    return value, np.array([-z[0] / 9 - 1 + squares, -np.exp(-z[0]) * z[1], -np.exp(-z[0]) * z[2]])


@pytest.mark.parametrize("has_scale", [True, False])
def test_a_correlated_normal_is_found_with_and_without_a_first_metric(has_scale):
    density = Gaussian(6)
    samples = sample(density, np.zeros((2, 6)), SETTINGS, scale=density.covariance if has_scale else None)
    sd = np.sqrt(np.diag(density.covariance))
    assert samples.draws.shape == (2, 400, 6)
    assert samples.n_divergences == 0
    assert np.abs((samples.flat.mean(axis=0) - density.mean) / sd).max() < 0.25
    assert np.abs(samples.flat.std(axis=0) / sd - 1).max() < 0.15
    assert samples.n_gradients > samples.draws[..., 0].size


def test_processes_change_no_draw_and_seeds_do():
    density = Gaussian(3)
    settings = SETTINGS.model_copy(update={"draws": 100, "tune": 50})
    one = sample(density, np.zeros((3, 3)), settings)
    two = sample(Gaussian(3), np.zeros((3, 3)), settings.model_copy(update={"workers": 2}))
    np.testing.assert_array_equal(one.draws, two.draws)
    other = sample(density, np.zeros((3, 3)), settings.model_copy(update={"seed": 4}))
    assert (one.draws != other.draws).any()
    assert (one.draws[0] != one.draws[1]).any()


def test_progress_names_draws_divergences_and_time_left(monkeypatch):
    monkeypatch.setattr("fast.models.calibration.inference.parallel_chains._REPORT_S", 0.0)
    heard = []
    sample(Gaussian(3), np.zeros((2, 3)), SETTINGS, progress=heard.append)
    assert heard[-1] == "NUTS: 1,400 of 1,400 draws in 2 chains, 0 divergences, about 0 s left"


def test_divergences_are_counted():
    settings = SETTINGS.model_copy(update={"target_accept": 0.5})
    assert sample(funnel, np.zeros((2, 3)), settings).n_divergences > 0


def test_a_start_outside_the_support_is_refused():
    with pytest.raises(UsageError, match="the log density is -inf .* start of chain 1"):
        sample(lambda z: (0.0 if z[0] >= 0 else -np.inf, 0 * z), np.array([[0.0], [-1.0]]), SETTINGS)


class Deadly(Gaussian):
    """Ends the process that unpickles it."""

    def __reduce__(self):
        return os._exit, (3,)


def test_a_dead_process_is_one_sentence():
    with pytest.raises(FastError, match="a process that worked on chains died, .* fewer workers"):
        sample(Deadly(3), np.zeros((2, 3)), SETTINGS.model_copy(update={"workers": 2}))


class Refusing(Gaussian):
    """Raises where it is sampled, and not where it is checked."""

    n_calls = 0

    def __call__(self, z):
        self.n_calls += 1
        if self.n_calls > 20:
            raise UsageError("no density today.")
        return super().__call__(z)


def test_an_error_of_the_density_reaches_the_caller():
    with pytest.raises(UsageError, match="no density today"):
        sample(Refusing(3), np.zeros((1, 3)), SETTINGS)
