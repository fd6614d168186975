"""Laws that are not the catalogue's, on the small panel: curves hold them, and kin are told from strangers."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from fast.flows.challenge.hidden.panel_file import read_small
from fast.flows.challenge.hidden.worlds import WorldKey, Worlds
from fast.models.gap.fit.effect_states import QUANTITIES
from fast.models.gap.fit.fit import Fit, axes_of
from fast.models.gap.fit.law_freedom import compute_law_curve, estimate_freed_parameters
from fast.models.gap.fit.recalibrate import recalibrate
from fast.models.gap.naming.candidates import FittedCandidate, Score, fit_effect
from fast.models.gap.naming.families import WORDS, Families, find_families
from fast.models.gap.naming.rank_effects import LEAST_NATS, rank_effects
from fast.models.simulation.effects.catalogue import CATALOGUE

SMALL = Path(__file__).parents[2] / "data" / "gap-small.npz"
SLIP, RELAXATION = "static_kinetic_friction", "stress_relaxation"
HIDDEN_SLIP_MM = 2.18  # at which half of the fall has happened
NO_SCORE = Score(np.zeros((0, 0)), np.zeros((0, 0)), 0.0)


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
    ranking = rank_effects(base, effects)
    return base, [fit_effect(base, ranking, effect) for effect in effects]


def find(base: Fit, fits: Sequence[Fit]) -> Families:
    candidates = [FittedCandidate((fit.effects[-1].effect,), fit, NO_SCORE, 0.0) for fit in fits]
    return find_families(base, candidates)


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
        law = QUANTITIES[RELAXATION].law(fit.effects[0].parameters, time_s, 5.0)
        bare.append((np.abs(law - hidden) < 0.2 * half).mean())
        assert half.max() < 0.3 * (1.0 - hidden.min())
    assert np.mean(held) > 0.8
    assert np.mean(bare) < 0.5


def test_slip_friction_is_no_kin_of_walls(worlds: Worlds) -> None:
    """Friction falls rationally; the interval of its slip scale holds the hidden one only when the law is free."""
    base, fits = fit_world(worlds, SLIP, [SLIP, "wall_thickness_offset"], seed=13)
    axis, sd = axes_of(SLIP)[1], np.sqrt(fits[0].covariance[-1, -1])
    inner = axis.inner(fits[0].effects[0].parameters["slip_scale_mm"])
    low, high = estimate_freed_parameters(fits[0], SLIP)["slip_scale_mm"].ci90
    assert high - low > 1.5 * (axis.value(inner + 1.645 * sd) - axis.value(inner - 1.645 * sd))
    assert low < HIDDEN_SLIP_MM < high
    families = find(base, fits)
    assert families.nats[0, 1] > 3.0 * LEAST_NATS
    assert families.kin_of(SLIP) == ()


def test_a_delay_may_be_a_lag_a_shift_or_a_late_start(worlds: Worlds) -> None:
    """The hidden transmitter averages: none of the three has its law, and a compliant post is something else."""
    effects = ["load_cell_lag", "lift_misalignment", "lift_start_error", "object_post_compliance"]
    families = find(*fit_world(worlds, "load_cell_lag", effects))
    assert set(families.kin_of("lift_misalignment")) == {"load_cell_lag", "lift_start_error"}
    assert families.kin_of("object_post_compliance") == ()
    assert np.array_equal(families.nats, families.nats.T)


def test_a_zero_that_is_off_may_be_a_weight_and_is_no_drift(worlds: Worlds) -> None:
    """A weight differs little from tool to tool; a drift grows over the batch."""
    effects = ["load_cell_offset", "tool_weight", "load_cell_drift"]
    families = find(*fit_world(worlds, "load_cell_offset", effects, 0.03))
    assert families.kin_of("load_cell_offset") == ("tool_weight",)
    assert families.nats[0, 2] > 3.0 * LEAST_NATS


def test_every_effect_of_the_catalogue_has_the_words_of_a_family() -> None:
    """And three delays share theirs."""
    assert WORDS.keys() == CATALOGUE.keys()
    assert WORDS["load_cell_lag"] == WORDS["lift_misalignment"] == WORDS["lift_start_error"]
