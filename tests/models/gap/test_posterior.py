"""The posterior of theta and effects: its gradient, the surface under it, and that it finds the truth."""

import numpy as np
import pytest
from scipy.stats import t

from fast.models.calibration.inference.settings import WITH_EFFECTS, CalibrationSettings
from fast.models.calibration.inference.summary import check_quality
from fast.models.gap.fit import posterior
from fast.models.gap.fit.fit import Fit
from fast.models.gap.fit.posterior import (
    SHAPE_APART,
    SIZE_APART,
    LikelihoodSurface,
    effects_at,
    sample_posterior,
)
from fast.models.gap.fit.recalibrate import recalibrate
from fast.models.gap.fit.whitened_features import COMMON_SHIFT_MM
from fast.models.records import EffectValue
from tests.synthetic.gap import GapTruth, made_up_gap
from tests.tasks.calibration.trace_lake import normal_draws

LAG = EffectValue(effect="load_cell_lag", parameters={"time_constant_s": 0.25})
FRICTION = EffectValue(effect="static_kinetic_friction", parameters={"kinetic_ratio": 0.7, "slip_scale_mm": 1.5})
JAWS = EffectValue(effect="force_limited_closing", parameters={"max_force_n": 5.0})
SETTINGS = CalibrationSettings(chains=4, draws=300, tune=50, workers=1)


def fit_of(*hidden: EffectValue) -> Fit:
    """A fit of the hidden effects to made-up grasps, from their neutral values."""
    # The simulator's own mesh: with another, parameters are off by more than their intervals say.
    data = made_up_gap(7, 6, 3, GapTruth(effects=hidden, mesh=0.0), n_repeats=2)
    return recalibrate(data.training, [EffectValue(effect=value.effect) for value in hidden])


@pytest.fixture(scope="module")
def lagging() -> Fit:
    return fit_of(LAG)


@pytest.mark.parametrize("hidden", [(LAG,), (FRICTION,), ()])
def test_the_gradient_is_that_of_the_density(hidden: tuple[EffectValue, ...]) -> None:
    surface = LikelihoodSurface.around(fit_of(*hidden), SETTINGS.priors)
    density = surface.density
    u = density.outside(surface.point + 0.4 * density.spread @ np.ones(len(surface.point)))
    steps = 1e-5 * np.eye(len(u))
    slopes = [(density(u + step)[0] - density(u - step)[0]) / 2e-5 for step in steps]
    np.testing.assert_allclose(density(u)[1], slopes, rtol=1e-4, atol=1e-3)


def worth_of_effects(fit: Fit) -> np.ndarray:
    return np.array(fit.worth[len(fit.columns) - fit.n_effect_columns :])


def test_the_surface_is_the_likelihood_where_the_posterior_is(lagging: Fit) -> None:
    surface = LikelihoodSurface.around(lagging, SETTINGS.priors)
    rng = np.random.default_rng(1)
    points = surface.point + rng.standard_normal((12, len(surface.point))) @ surface.density.spread.T
    assert surface.error_nats(points) < 0.3
    far = surface.point + 30.0 * rng.standard_normal((12, len(surface.point))) @ surface.density.spread.T
    inside = np.clip(far, surface.density.lower + 1e-3, surface.density.upper - 1e-3)
    assert surface.error_nats(inside) > 1.0


def test_theta_and_the_effect_are_found_together(lagging: Fit, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(posterior, "sample", normal_draws)
    result = sample_posterior(lagging, SETTINGS)
    assert result.names == ("young_modulus_mpa", "friction", "poisson_ratio", "load_cell_lag.time_constant_s")
    assert result.method == WITH_EFFECTS
    assert check_quality(result) == ""
    low, high = np.quantile(result.of("load_cell_lag.time_constant_s"), [0.01, 0.99])
    assert low < 0.25 < high
    assert high - low < 0.3  # the law of the lag is free, and a quarter of the data counts
    for name, truth in (("young_modulus_mpa", 9.2), ("friction", 0.66), ("poisson_ratio", 0.43)):
        low, high = np.quantile(result.of(name), [0.002, 0.998])
        assert low < truth < high, name


def test_an_effect_beyond_its_prior_keeps_its_size(monkeypatch: pytest.MonkeyPatch) -> None:
    """The data say how large an effect is, however free its law: the prior would have a softening of 0.05 +- 0.06."""
    monkeypatch.setattr(posterior, "sample", normal_draws)
    hidden = EffectValue(effect="mullins_softening", parameters={"softening": 0.25, "scale_repeats": 1.5})
    data = made_up_gap(7, 6, 3, GapTruth(effects=(hidden,), mesh=0.0))
    found = sample_posterior(recalibrate(data.training, [hidden]), SETTINGS)
    softening, repeats = (found.of(f"mullins_softening.{name}") for name in ("softening", "scale_repeats"))
    after_two = np.median(softening * -np.expm1(-2.0 / repeats))
    assert after_two == pytest.approx(0.25 * (1.0 - np.exp(-2.0 / 1.5)), rel=0.15)


def test_parameters_are_given_back_to_their_effects() -> None:
    names = ("friction", "load_cell_lag.time_constant_s", "static_kinetic_friction.kinetic_ratio")
    assert effects_at(names, (0.5, 0.25, 0.7)) == (
        LAG,
        EffectValue(effect="static_kinetic_friction", parameters={"kinetic_ratio": 0.7}),
    )


def half_width(draws: np.ndarray) -> np.ndarray:
    """Half the width of intervals of 90 % of draws (... x k), k."""
    low, high = np.quantile(draws.reshape(-1, draws.shape[-1]), (0.05, 0.95), axis=0)
    return np.asarray(0.5 * (high - low))


def of_so_few_tools(surface: LikelihoodSurface) -> float:
    """Half the width of an interval of 90 % for a standard deviation of 1, with the tools of a surface."""
    return float(t.ppf(0.95, len(np.unique(surface.fit.features.tool)) - 1))


def test_data_do_not_learn_how_late_another_solver_is() -> None:
    hidden = EffectValue(effect="lift_misalignment", parameters={"shift_mm": 0.5})
    surface = LikelihoodSurface.around(fit_of(hidden), SETTINGS.priors)
    ((axis,), worth) = surface.density.axes, worth_of_effects(surface.fit)
    assert axis.sd * worth[-1, -1] == pytest.approx(COMMON_SHIFT_MM, rel=0.1), "a shift is made up for by a shift"
    v = np.tile(surface.point, (2, 4000, 1))
    spread = surface.spread_by_solvers(v, np.random.default_rng(1))
    assert half_width(spread)[-1] == pytest.approx(of_so_few_tools(surface) * np.linalg.norm(worth), rel=0.05)
    np.testing.assert_allclose(np.median(spread, axis=(0, 1)), surface.point, atol=0.05)
    assert (spread[..., :3] == surface.point[:3]).all(), "theta is that of this simulator"
    near_end = surface.spread_by_solvers(np.tile(surface.density.upper - 1e-6, (2, 4000, 1)), np.random.default_rng(1))
    assert (near_end <= surface.density.upper).all(), "nothing beyond the bounds"


def test_solvers_are_apart_in_effects_that_are_simulated() -> None:
    surface = LikelihoodSurface.around(fit_of(FRICTION), SETTINGS.priors)
    v = np.tile(surface.point, (2, 4000, 1))
    apart = half_width(surface.spread_by_solvers(v, np.random.default_rng(1)))[3:]
    errors = np.linalg.norm(worth_of_effects(surface.fit), axis=1)
    expected = np.hypot(errors, [SIZE_APART * abs(surface.point[3]), SHAPE_APART])
    np.testing.assert_allclose(apart, of_so_few_tools(surface) * expected, rtol=0.05)


def test_a_limit_of_the_force_is_no_further_apart_than_numerical_errors() -> None:
    surface = LikelihoodSurface.around(fit_of(JAWS), SETTINGS.priors)
    v = np.tile(surface.point, (2, 4000, 1))
    apart = half_width(surface.spread_by_solvers(v, np.random.default_rng(1)))[3:]
    expected = of_so_few_tools(surface) * np.linalg.norm(worth_of_effects(surface.fit), axis=1)
    np.testing.assert_allclose(apart, expected, rtol=0.05)
