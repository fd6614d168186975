"""What each hypothesis predicts of pairs of grasps: draws of the posterior through the surrogate.

Means and spreads are of the draws. Beyond them the law of an effect may be off by `LAW_SD` of what it changes from the
usual setting to the changed one, and lie as far on the way to another law of its family; the simulator may be off by a
little at any other setting; and of *unknown* only the size of its pattern is known: at another setting it may vanish,
double, or move.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from fast.models.calibration.traces.response_surface import error_correlation
from fast.models.gap.ask.forecast import Forecast
from fast.models.gap.ask.hypotheses import Hypothesis
from fast.models.gap.ask.settings import Setting
from fast.models.gap.bank.surrogate import FEATURES, Surrogate, features_of_steps
from fast.models.gap.evidence.reading import KNOTS_MM
from fast.models.gap.fit.law_freedom import LAW_SD
from fast.models.gap.fit.whitened_features import FLOOR_SHARE, OWN_SHARE, estimate_repeat_noise, find_amplitude
from fast.models.gap.grasps import Grasps, number_distinct
from fast.models.records import EffectValue, GraspContext
from fast.models.simulation.effects.catalogue import CATALOGUE
from fast.models.traces.step_features import N_STEPS, STEP_MM

N_DRAWS = 16
_TIMING_SHARE = 0.3  # of the simulator's error: at another speed it simulates the same closing
_N_SHAPES = 5  # of errors over the features that are common to all cells


@dataclass(frozen=True)
class Pair:
    """A grasp of a tool on an object (numbers of `Grasps`) at a setting, and one of the same as usual."""

    tool: int
    obj: int
    setting: Setting


# Of a hypothesis and a pair: what another stroke or placement changes, 132, at the modulus of the bank's centre.
Moved = Mapping[tuple[str, Pair], np.ndarray]


def forecast_pairs(
    hypotheses: Sequence[Hypothesis],
    pairs: Sequence[Pair],
    moved: Moved | None = None,
    seed: int = 0,
    n_draws: int = N_DRAWS,
) -> Forecast:
    """Forecast one pair each, as differences of features (c x 16), changed less usual.

    moved: for settings that are not of timing alone. The first `n_draws` columns of a hypothesis are its draws.
    """
    sides = [_Sides.of(one, pairs, moved or {}) for one in hypotheses]
    bias, noise = sides[0].noise
    rng = np.random.default_rng(seed)
    means, columns = [], []
    for one, side in zip(hypotheses, sides, strict=True):
        drawn = np.array([side.difference(*draw) for draw in one.draw(n_draws, rng)])
        mean = drawn.mean(axis=0)
        means.append(mean + bias)
        own = [np.moveaxis(drawn - mean, 0, -1) / np.sqrt(n_draws - 1.0)]
        columns.append(np.concatenate([*own, *_list_doubts(one, side, pairs)], axis=-1))
    amplitude = sides[0].amplitude
    share = np.array([_TIMING_SHARE if pair.setting.is_timing else 1.0 for pair in pairs])
    own_n = OWN_SHARE * share[:, None] * amplitude
    floor = _spread_by_setting(FLOOR_SHARE * share[:, None] * amplitude, pairs)
    shared = [[*_list_kin(number, hypotheses, means), floor] for number in range(len(means))]
    return Forecast(
        names=tuple(one.name for one in hypotheses),
        probability=np.array([one.probability for one in hypotheses]),
        is_sharp=np.array([one.size == 0.0 for one in hypotheses]),
        means=np.array(means),
        columns=tuple(np.concatenate([own, *more], axis=-1) for own, more in zip(columns, shared, strict=True)),
        scatter=own_n[:, :, None] * own_n[:, None] * np.eye(own_n.shape[1]),
        noise=noise,
    )


def predict_first(hypothesis: Hypothesis, pair: Pair) -> np.ndarray:
    """Predict the step means of the changed grasp of a pair of timing alone, 120."""
    return np.asarray(_Sides.of(hypothesis, [pair], {}).steps_n[1])


@dataclass(frozen=True, eq=False)
class _Sides:
    """Both grasps of c pairs, as rows of a surrogate: as usual, then changed. theta: of the hypothesis' fit."""

    surrogate: Surrogate
    hypothesis: Hypothesis

    @staticmethod
    def of(hypothesis: Hypothesis, pairs: Sequence[Pair], moved: Moved) -> "_Sides":
        usual = hypothesis.fit.features.surrogate
        surrogate = usual.at(make_grasps(usual.grasps, pairs))
        moved_n = np.zeros_like(surrogate.rows_n[:, 0])
        for place, pair in enumerate(pairs):
            if not pair.setting.is_timing:
                moved_n[len(pairs) + place] = moved[hypothesis.name, pair]
        return _Sides(replace(surrogate, moved_n=moved_n), hypothesis)

    def difference(
        self, theta: np.ndarray, effects: Sequence[EffectValue], tool_factor: np.ndarray | None
    ) -> np.ndarray:
        """Compute the features of changed grasps less those of usual ones, c x f."""
        usual, changed = np.split(self.surrogate.predict_features(theta, effects, tool_factor), 2)
        return np.asarray(changed - usual)

    @property
    def steps_n(self) -> np.ndarray:
        """Step means at the fit, 2 c x 120."""
        fit = self.hypothesis.fit
        return self.surrogate.predict_steps(fit.theta, fit.effects, fit.tool_factor)

    @property
    def amplitude(self) -> np.ndarray:
        """What a relative error of 1 is in each feature, c x f."""
        usual, changed = np.split(find_amplitude(features_of_steps(self.steps_n)), 2)
        return np.maximum(usual, changed)

    @property
    def noise(self) -> tuple[np.ndarray, np.ndarray]:
        """Bias (c x f) of the difference of one pair by noise of the load cell, and its covariance (c x f x f).

        Covariance is by what repeats of a grasp differ by.
        """
        bias, noise = estimate_repeat_noise(self.surrogate.grasps, self.steps_n)
        (usual, changed), both = np.split(bias, 2), np.split(noise, 2)
        return changed - usual, np.asarray(both[0] + both[1])

    @property
    def own_change(self) -> np.ndarray:
        """What the effect of the hypothesis changes in the difference, c x f."""
        fit, own = self.hypothesis.fit, {value.effect for value in self.hypothesis.own}
        others = [value for value in fit.effects if value.effect not in own]
        with_all = self.difference(fit.theta, fit.effects, fit.tool_factor)
        return with_all - self.difference(fit.theta, others, fit.tool_factor)


def make_grasps(grasps: Grasps, pairs: Sequence[Pair]) -> Grasps:
    """Make the grasps of pairs that are not made yet, as usual and then changed, after all that were made."""
    both = [*pairs, *pairs]
    base = grasps.base_setup
    setups, setup = number_distinct([base] * len(pairs) + [pair.setting.setup for pair in pairs], base)
    usual = grasps.placements[0]
    placements, placement = number_distinct([usual] * len(pairs) + [p.setting.placement for p in pairs], usual)
    return replace(
        grasps,
        tool=np.array([pair.tool for pair in both], dtype=int),
        obj=np.array([pair.obj for pair in both], dtype=int),
        contexts=tuple(_find_context(grasps, pair) for pair in both),
        steps_n=np.zeros((len(both), grasps.steps_n.shape[1])),
        grasp_ids=tuple(f"asked {number}" for number in range(len(both))),
        setups=setups,
        setup=setup,
        placements=placements,
        placement=placement,
    )


def _find_context(grasps: Grasps, pair: Pair) -> GraspContext:
    """Find what comes before a grasp that is made after all others."""
    of_tool = grasps.tool == pair.tool
    known = [grasps.contexts[row] for row in np.flatnonzero(of_tool)]
    return GraspContext(
        repeat=int(np.count_nonzero(of_tool & (grasps.obj == pair.obj))),
        tool_grasps=max((context.tool_grasps + 1 for context in known), default=0),
        batch_grasps=max((context.batch_grasps + 1 for context in known), default=0),
        clock_s=max((context.clock_s for context in known), default=0.0),
    )


def _list_doubts(hypothesis: Hypothesis, side: _Sides, pairs: Sequence[Pair]) -> list[np.ndarray]:
    """List columns (c x f x k) of what a hypothesis does not know of itself besides its parameters."""
    if hypothesis.own:
        return [_spread_by_setting(LAW_SD * side.own_change, pairs)]
    if hypothesis.size == 0.0:
        return []
    changed_n = np.split(side.steps_n, 2)[1]
    found = [hypothesis.size * np.moveaxis(change, 0, -1) for change in _list_patterns(changed_n)]
    return [_part_by_setting(np.concatenate(found, axis=-1), pairs)]


def _list_kin(number: int, hypotheses: Sequence[Hypothesis], means: Sequence[np.ndarray]) -> list[np.ndarray]:
    """List columns (c x f x 1) by which a law of the trace may lie on the way to another one of its family.

    A transmitter that averages is between a lag of first order and a pure delay. Effects that need simulations of their
    own are different things, not ends of one law.
    """
    found = []
    for mean, one in zip(means, hypotheses, strict=True):
        if _is_kin(hypotheses[number].name, one.name):
            found.append(LAW_SD * (mean - means[number])[:, :, None])
    return found


def _is_kin(first: str, second: str) -> bool:
    if first == second or not {first, second} <= CATALOGUE.keys():
        return False
    one, other = CATALOGUE[first], CATALOGUE[second]
    acts_on_traces = not one.bank_runs and not other.bank_runs and one.state is not None
    return acts_on_traces and one.family == other.family and one.state == other.state


def _spread_by_setting(amplitude: np.ndarray, pairs: Sequence[Pair]) -> np.ndarray:
    """Make columns of errors of this size (c x f), alike in neighbouring features and common to a setting."""
    values, vectors = np.linalg.eigh(error_correlation(FEATURES))
    shapes = (vectors * np.sqrt(np.maximum(values, 0.0)))[:, -_N_SHAPES:]
    return _part_by_setting(amplitude[:, :, None] * shapes, pairs)


def _part_by_setting(columns: np.ndarray, pairs: Sequence[Pair]) -> np.ndarray:
    """Give columns (c x f x k) coefficients of their own for each of s settings, c x f x (s k)."""
    _, numbers = number_distinct([pair.setting for pair in pairs], pairs[0].setting)
    found = np.zeros((*columns.shape[:2], numbers.max() + 1, columns.shape[2]))
    found[np.arange(len(pairs)), :, numbers] = columns
    return found.reshape(*columns.shape[:2], -1)


def _list_patterns(steps_n: np.ndarray) -> list[np.ndarray]:
    """List feature changes (k x m x f) by a force as large as the median peak, or twice the force, about each knot."""
    peak_n = float(np.median(steps_n.max(axis=1)))
    changes = (np.full_like(steps_n, peak_n), steps_n)
    small, before = 1e-3, features_of_steps(steps_n)
    return [
        np.array([(features_of_steps(steps_n + small * hat * change_n) - before) / small for hat in _hats()])
        for change_n in changes
    ]


def _hats() -> np.ndarray:
    """Make straight-sided functions over the steps of the lift, one per knot, k x 120; constant beyond the last."""
    lift_mm = STEP_MM * (np.arange(N_STEPS) + 0.5)
    return np.array([np.interp(lift_mm, KNOTS_MM, row) for row in np.eye(len(KNOTS_MM))])
