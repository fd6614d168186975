"""Laws that are not the catalogue's, on the small panel: curves hold them, and kin are told from strangers."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from models.gap.fit.fit import Fit, axes_of
from models.gap.fit.law_freedom import compute_law_curve, estimate_freed_parameters
from models.gap.fit.recalibrate import recalibrate
from models.gap.naming.candidates import FittedCandidate, Score, fit_effect
from models.gap.naming.families import WORDS, Families, find_families, group_families, separates
from models.gap.naming.rank_effects import LEAST_NATS, rank_effects
from models.simulation.effects.catalogue import CATALOGUE
from tests.studies.gap.small import read_small
from tests.studies.gap.worlds import WorldKey, Worlds

SMALL = Path(__file__).parents[2] / "data" / "gap-small.npz"
SLIP = "static_kinetic_friction"
NO_SCORE = Score(np.zeros((0, 0)), np.zeros((0, 0)), 0.0)


@pytest.fixture(scope="module")
def worlds() -> Worlds:
    """Worlds of the small panel from a public seed."""
    return Worlds(*read_small(SMALL), seed=5)


def fit_world(
    worlds: Worlds, hidden: str, effects: Sequence[str], strength: float = 0.1, seed: int = 3
) -> tuple[Fit, list[Fit]]:
    """A world that hides an effect: the fit without any, and those of candidates."""
    key = WorldKey(group="single", number=0, seed=seed, base="base-0", young_modulus_mpa=9.7)
    key = worlds.with_effect(key, hidden, strength, np.random.default_rng(0))
    base = recalibrate(worlds.problem(key).training)
    ranking = rank_effects(base, effects)
    return base, [fit_effect(base, ranking, effect) for effect in effects]


def find(base: Fit, fits: Sequence[Fit]) -> Families:
    candidates = [FittedCandidate((fit.effects[-1].effect,), fit, NO_SCORE, 0.0) for fit in fits]
    return find_families(base, candidates)


def test_slip_friction_by_another_law(worlds: Worlds) -> None:
    """Friction falls rationally: the band of the curve holds it where points have slid, the exponential's does not.

    Slip friction is no stranger's kin: walls cannot stand in for it.
    """
    held, before, after = [], [], []
    for seed in (3, 13):
        base, fits = fit_world(worlds, f"{SLIP}-strong", [SLIP, "wall_thickness_offset"], seed=seed)
        fit = recalibrate(fits[0].features.surrogate, fits[0].effects)
        curve = compute_law_curve(fit, SLIP)
        assert curve is not None
        slip_mm = np.array(curve.at)
        hidden = 0.91 + 0.09 / (1.0 + (slip_mm / 1.5) ** 2)
        is_held = (np.array(curve.low) < hidden) & (hidden < np.array(curve.high))
        held.append(is_held[slip_mm > 0.9].mean())
        assert np.max(np.array(curve.high) - np.array(curve.low)) < 0.09  # the fall itself
        axis, half = axes_of(SLIP)[1], 1.645 * np.sqrt(fit.covariance[-1, -1])
        inner = axis.inner(fit.effects[0].parameters["slip_scale_mm"])
        before.append(axis.value(inner + half) - axis.value(inner - half))
        interval = estimate_freed_parameters(fit, SLIP)
        after.append(np.ptp(interval["slip_scale_mm"].ci90))
        low, high = interval["kinetic_ratio"].ci90
        assert low < 0.91 < high < 1.0
        assert separates(*fits) > 10.0 * LEAST_NATS
        assert find(base, fits).kin_of(SLIP) == ()
    assert np.mean(held) > 0.8
    assert min(np.array(after) / before) > 1.5


def test_a_delay_may_be_a_lag_a_shift_or_a_late_start(worlds: Worlds) -> None:
    """The hidden transmitter averages: none of the three has its law, and a compliant post is something else."""
    effects = ["load_cell_lag", "lift_misalignment", "lift_start_error", "object_post_compliance"]
    families = find(*fit_world(worlds, "load_cell_lag", effects))
    family = families.family_of("load_cell_lag")
    assert family.members == ("load_cell_lag", "lift_misalignment", "lift_start_error")
    assert family.name == "delay between lift and force"
    assert families.family_of("object_post_compliance").members == ("object_post_compliance",)
    assert np.array_equal(families.nats, families.nats.T)


def test_a_zero_that_is_off_may_be_a_weight_and_is_no_drift(worlds: Worlds) -> None:
    """A weight differs little from tool to tool; a drift grows over the batch."""
    effects = ["load_cell_offset", "tool_weight", "load_cell_drift"]
    families = find(*fit_world(worlds, "load_cell_offset", effects, 0.05))
    assert families.kin_of("load_cell_offset") == ("tool_weight",)
    assert families.nats[0, 2] > 3.0 * LEAST_NATS


def test_families_hang_together_and_have_words() -> None:
    """The first and the last are kin by the one between them; every effect of the catalogue has words."""
    far = 10.0 * LEAST_NATS
    nats = np.array([[0.0, 1.0, far, far], [1.0, 0.0, 1.0, far], [far, 1.0, 0.0, far], [far, far, far, 0.0]])
    effects = ("load_cell_lag", "lift_misalignment", "object_post_compliance", "tool_weight")
    first, second = group_families(effects, nats)
    assert first.members == effects[:3]
    assert first.name == "delay between lift and force, or compliance in series"
    assert second.name == "constant force of the load cell"
    assert WORDS.keys() == CATALOGUE.keys()
