"""Laws that are not the catalogue's, on the small panel: curves and intervals hold them."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from fast.flows.challenge.hidden.panel_file import read_small
from fast.flows.challenge.hidden.worlds import WorldKey, Worlds
from fast.models.gap.evidence.laws import list_secants
from fast.models.gap.fit.fit import Fit, axes_of
from fast.models.gap.fit.law_freedom import compute_law_curve, estimate_freed_parameters
from fast.models.gap.fit.recalibrate import recalibrate
from fast.models.gap.naming.decide import fit_effect
from fast.models.simulation.effects.catalogue import build_effects

SMALL = Path(__file__).parents[2] / "data" / "gap-small.npz"
SLIP, RELAXATION = "static_kinetic_friction", "stress_relaxation"
HIDDEN_SLIP_MM = 2.18  # at which half of the fall has happened


@pytest.fixture(scope="module")
def worlds() -> Worlds:
    """Worlds of the small panel from a public seed."""
    return Worlds(*read_small(SMALL), seed=5)


def make_key(worlds: Worlds, hidden: str, strength: float, seed: int) -> WorldKey:
    key = WorldKey(group="single", number=0, seed=seed, base="base-0", young_modulus_mpa=9.7)
    return worlds.with_effect(key, hidden, strength, np.random.default_rng(0))


def hidden_amplitude(worlds: Worlds, hidden: str, strength: float, seed: int) -> float:
    return make_key(worlds, hidden, strength, seed).effects[0].amplitude


def fit_world(
    worlds: Worlds, hidden: str, effects: Sequence[str], strength: float = 0.1, seed: int = 3
) -> tuple[Fit, list[Fit]]:
    """A world that hides an effect: the fit without any, and those of candidates."""
    base = recalibrate(worlds.problem(make_key(worlds, hidden, strength, seed)).training)
    starts = [list_secants(effect) for effect in effects]
    fits = [[fit_effect(base, value) for value in values[:2]] for values in starts]
    return base, [min(own, key=lambda fit: fit.loss) for own in fits]


def test_the_band_holds_a_law_that_the_catalogue_has_not(worlds: Worlds) -> None:
    """The force relaxes by a power law: the band of the freed law holds it, that of the bare exponential does not."""
    held, bare = [], []
    for seed in (3, 13):
        base, (fit,) = fit_world(worlds, RELAXATION, [RELAXATION], 0.05, seed)
        fit = recalibrate(base.features.surrogate, fit.effects)
        curve = compute_law_curve(fit, RELAXATION)
        assert curve is not None
        time_s, half = np.array(curve.at), 0.5 * (np.array(curve.high) - np.array(curve.low))
        hidden = (1.0 + time_s) ** -hidden_amplitude(worlds, RELAXATION, 0.05, seed)
        held.append((np.abs(np.array(curve.median) - hidden) < half).mean())
        law = build_effects(fit.effects)[0].law(time_s)
        bare.append((np.abs(law - hidden) < 0.2 * half).mean())
        assert half.max() < 0.6 * (1.0 - hidden.min())
    assert np.mean(held) > 0.8
    assert np.mean(bare) < 0.5


def test_the_interval_of_a_law_that_is_free_holds_the_hidden_one(worlds: Worlds) -> None:
    """Friction falls rationally; the interval of its slip scale holds the hidden one only when the law is free."""
    _, (fit,) = fit_world(worlds, SLIP, [SLIP], seed=3)
    axis, sd = axes_of(SLIP)[1], np.sqrt(fit.covariance[-1, -1])
    inner = axis.inner(fit.effects[0].parameters["slip_scale_mm"])
    low, high = estimate_freed_parameters(fit, SLIP)["slip_scale_mm"].ci90
    assert high - low > 1.5 * (axis.value(inner + 1.645 * sd) - axis.value(inner - 1.645 * sd))
    assert low < HIDDEN_SLIP_MM < high
