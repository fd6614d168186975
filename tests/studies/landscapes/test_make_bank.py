"""The bank of landscapes: hidden truths, and a night that finds theta and an effect from the initial tools alone."""

import numpy as np
import pytest

from fast.models.design.space import random_unit
from fast.models.errors import UsageError
from fast.models.records import EffectValue, Theta
from fast.models.simulation.effects.catalogue import CATALOGUE, build_effects
from tests.studies.benchmarks.base import Options
from tests.studies.gap.grasp_laws.truth import GRASP_LAWS
from tests.studies.landscapes.make_bank import (
    LAWS,
    MODULI_MPA,
    OBJECTS,
    Simulator,
    draw_truths,
    measure_landscape_bank,
)
from tests.studies.landscapes.night import TRIED, Night, theta_model

X = random_unit(16, np.random.default_rng(3))


class MadeUpGrasps:
    """Forces by a formula: proportional to E, growing with friction, and cut by a limit."""

    def bins_n(self, simulator: Simulator, x: np.ndarray) -> np.ndarray:
        theta, profile = simulator.theta, np.linspace(1.0, 0.1, 13)
        design_n = 2.0 + 12.0 * x[:, 0]
        friction = (theta.friction / 0.56) ** np.linspace(0.2, 0.9, len(OBJECTS))[:, None]
        ratio = 1.0 + 0.3 * (theta.poisson_ratio - 0.45) * np.cos(np.arange(13.0))
        force_n = theta.young_modulus_mpa / 11.5 * design_n[:, None, None] * friction * (profile * ratio)
        for effect in (*simulator.effects, *simulator.laws):
            limit_n = effect.parameters["max_force_n"]
            force_n = limit_n * np.tanh(force_n / limit_n)
        return np.asarray(force_n)

    def tell(self, line: str) -> None:
        """Nobody listens."""


def night_of(truth: Simulator) -> Night:
    grasps = MadeUpGrasps()
    return Night(grasps, theta_model(grasps, X), truth, X, tuple(law.effect for law in truth.laws), print_seed=2)


def test_eight_truths_hide_every_law_once_or_twice():
    truths = draw_truths()
    names = [law.effect for truth in truths for law in truth.laws]
    assert [len({law.effect for law in truth.laws}) for truth in truths] == [1, 2, 3, 1, 2, 3, 1, 2]
    assert {names.count(name) for name in LAWS} <= {1, 2}
    assert all(MODULI_MPA[0] < truth.theta.young_modulus_mpa < MODULI_MPA[1] for truth in truths)
    assert truths == draw_truths()


def test_a_truth_is_another_formula_than_the_simulator_of_its_night():
    for name in LAWS:
        assert GRASP_LAWS[name].kind is not CATALOGUE[name].kind
    for name, (parameter, values) in TRIED.items():
        for value in values:  # none is out of the catalogue's bounds
            assert build_effects([EffectValue(effect=name, parameters={parameter: value})])


def test_a_night_finds_theta():
    night = night_of(Simulator(Theta(young_modulus_mpa=8.0, friction=0.7, poisson_ratio=0.4)))
    theta = night.fit_theta()
    assert theta.young_modulus_mpa == pytest.approx(8.0, rel=0.06)
    assert theta.friction == pytest.approx(0.7, rel=0.06)


def test_a_night_finds_an_effect_that_theta_cannot_stand_for():
    """It comes nearer to forces of designs that it never saw than theta alone does."""
    limit = EffectValue(effect="force_limited_closing", parameters={"max_force_n": 9.0})
    truth = Simulator(Theta(young_modulus_mpa=9.0, friction=0.6, poisson_ratio=0.4), laws=(limit,))
    night = night_of(truth)
    theta, found = night.fit_theta(), night.fit_effects()
    assert found.effects[0].parameters["max_force_n"] == pytest.approx(9.0, rel=0.1)
    true_n, with_effect_n = (MadeUpGrasps().bins_n(simulator, X[10:]) for simulator in (truth, found))
    theta_n = MadeUpGrasps().bins_n(Simulator(theta), X[10:])
    assert np.abs(with_effect_n - true_n).mean() < 0.5 * np.abs(theta_n - true_n).mean()


def test_a_bank_needs_a_file():
    with pytest.raises(UsageError, match="give --results"):
        measure_landscape_bank(Options())
