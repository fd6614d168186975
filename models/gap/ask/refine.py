"""Once an effect is named: the grasps that shorten the interval of the parameter on which the ranking of designs hangs.

The hypotheses are draws of one posterior. A parameter matters as far as it moves the best designs against each other.
The interval of the one that matters most is what pairs of grasps are chosen for, by the nats a minute that they bring
it: outcomes and parameter are taken to be normal together, as the draws have them. Nothing is asked once the draws
agree on the order of the best designs. What a draw says of a design comes from simulations that the bank has: no new
one is made.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from fast.models.gap.ask.choose import Costs
from fast.models.gap.ask.forecast import Forecast
from fast.models.gap.ask.hypotheses import Hypothesis
from fast.models.gap.ask.predict import Pair, forecast_pairs, make_grasps
from fast.models.gap.ask.settings import Setting
from fast.models.gap.bank.surrogate import FEATURES, Surrogate
from fast.models.gap.fit.fit import axes_of
from fast.models.records import GraspContext

N_DRAWS = 96  # well above the number of parameters: fewer would seem to know each other
N_BEST = 10  # designs whose order counts
SURE_SHARE = 0.95  # of the draws with one order: more grasps would not change it
EQUAL_SHARE = 0.01  # of the force: designs that are no further apart than repeats of a grasp have no order
LEAST_NATS = 0.02  # that a pair brings the parameter; one that brings less is not made
MOST_LEFT = 0.9  # of the interval: a parameter that keeps more of it is not worth any grasp
_THETA = ("young_modulus_mpa", "friction", "poisson_ratio")
_SEED = 0
_PEAK = FEATURES.index("peak_n")


@dataclass(frozen=True, eq=False)
class Ranking:
    """How n draws rank t designs. quality_n: n x t, mean simulated peak. parameters: n x p, in standard deviations."""

    names: tuple[str, ...]
    parameters: np.ndarray
    quality_n: np.ndarray

    @property
    def best(self) -> np.ndarray:
        """The designs that are best by the mean of the draws, best first."""
        return np.argsort(-self.quality_n.mean(axis=0), kind="stable")[:N_BEST]

    @property
    def agreement(self) -> float:
        """Share of the draws in which no design is better than one above it, by more than repeats of a grasp differ."""
        ordered_n = self.quality_n[:, self.best]
        least_above_n = np.minimum.accumulate(ordered_n, axis=1)
        equal_n = EQUAL_SHARE * np.abs(ordered_n).mean(axis=1, keepdims=True)
        return float((ordered_n - least_above_n <= equal_n).all(axis=1).mean())

    @property
    def is_settled(self) -> bool:
        """Whether more grasps would not change the order."""
        return self.agreement >= SURE_SHARE

    @property
    def weights(self) -> np.ndarray:
        """How much each parameter moves neighbours of the order against each other, p, in N.

        Neighbours that lie close together count most.
        """
        margins_n = -np.diff(self.quality_n[:, self.best], axis=1)
        slopes_n = self._find_slopes(margins_n)
        closeness = margins_n.std(axis=0) / np.maximum(np.abs(margins_n.mean(axis=0)), 1e-9)
        return np.asarray(np.sqrt((slopes_n**2 * np.minimum(closeness, 1.0) ** 2).sum(axis=1)))

    @property
    def by_weight(self) -> list[int]:
        """Numbers of the parameters, the one that matters most first."""
        return [int(place) for place in np.argsort(-self.weights, kind="stable")]

    def shorten(self, place: int, sd_left: float) -> "Ranking":
        """Return the ranking once a parameter has so much of its standard deviation left; its middle stays."""
        slope_n = self._find_slopes(self.quality_n)[place]
        known = (1.0 - sd_left) * np.outer(self.parameters[:, place], slope_n)
        return replace(self, quality_n=self.quality_n - known)

    def _find_slopes(self, rows_n: np.ndarray) -> np.ndarray:
        """Find the change of each column of rows (n x c) by a standard deviation of each parameter, p x c."""
        return np.asarray(np.linalg.lstsq(self.parameters, rows_n - rows_n.mean(axis=0), rcond=None)[0])


@dataclass(frozen=True, eq=False)
class Refinement:
    """What is asked for a parameter. counts: c, repetitions of each pair. sd_left: share of its sd that stays."""

    parameter: str
    counts: np.ndarray
    sd_left: float


def rank_draws(named: Hypothesis) -> Ranking:
    """Rank the measured designs by draws of a named effect's posterior, each printed and grasped as usual."""
    surrogate = _take_all(named.fit.features.surrogate)
    axes = [(value.effect, axis) for value in named.fit.effects for axis in axes_of(value.effect)]
    parameters, quality_n = [], []
    for theta, effects, _ in named.draw(N_DRAWS, np.random.default_rng(_SEED)):
        values = {value.effect: value.parameters for value in effects}
        parameters.append([*theta, *(axis.inner(values[effect][axis.name]) for effect, axis in axes)])
        quality_n.append(_average_by_tool(surrogate, surrogate.predict_features(theta, effects)[:, _PEAK]))
    drawn = np.array(parameters)
    drawn = (drawn - drawn.mean(axis=0)) / np.maximum(drawn.std(axis=0, ddof=1), 1e-12)
    return Ranking((*_THETA, *(f"{effect}.{axis.name}" for effect, axis in axes)), drawn, np.array(quality_n))


def refine(
    named: Hypothesis,
    ranking: Ranking,
    pairs: Sequence[Pair],
    costs: Costs,
    most: int,
) -> Refinement | None:
    """Find the fewest pairs that are expected to settle a ranking of `rank_draws`, `most` repetitions in all.

    None if the ranking is settled, or no pairs shorten any interval by a tenth. A parameter of which they tell less is
    passed over for the next one.
    """
    if ranking.is_settled or not pairs:
        return None
    forecast = forecast_pairs([replace(named, probability=1.0)], pairs, seed=_SEED, n_draws=N_DRAWS)
    for place in ranking.by_weight:
        learner = Learner(forecast, ranking.parameters[:, place])
        counts = _choose(learner, costs, most, ranking, place)
        sd_left = learner.find_sd(counts)
        if sd_left <= MOST_LEFT:
            return Refinement(ranking.names[place], counts, sd_left)
    return None


def _choose(learner: "Learner", costs: Costs, most: int, ranking: Ranking, parameter: int) -> np.ndarray:
    """Choose repetitions of each pair (c), always one more of that which brings a ranking's parameter most a minute."""
    n_pairs = len(costs.minutes)
    counts = np.zeros(n_pairs, dtype=int)
    while counts.sum() < most:
        before, spent = learner.find_sd(counts), costs.total(counts)
        if counts.any() and ranking.shorten(parameter, before).is_settled:
            break
        gains, rates = np.zeros(n_pairs), np.zeros(n_pairs)
        for place in range(n_pairs):
            tried = counts.copy()
            tried[place] += 1
            gains[place] = np.log(before / learner.find_sd(tried))
            rates[place] = gains[place] / max(costs.total(tried) - spent, 1e-9)
        best = int(np.argmax(rates))
        if gains[best] < LEAST_NATS:
            break
        counts[best] += 1
    return counts


@dataclass(frozen=True, eq=False)
class Learner:
    """What pairs of grasps say of a parameter. draws: n, of the parameter, of mean 0 and standard deviation 1.

    forecast: of one hypothesis alone, by the same draws.
    """

    forecast: Forecast
    draws: np.ndarray

    def find_sd(self, counts: np.ndarray) -> float:
        """Find the parameter's standard deviation after so many repetitions (c), in units of that before."""
        made = np.flatnonzero(counts)
        if not len(made):
            return 1.0
        part = self.forecast.select([int(place) for place in made])
        _, (covariance,) = part.stack([int(counts[place]) for place in made])
        own = part.columns[0].reshape(len(covariance), -1)[:, : len(self.draws)]
        common = own @ self.draws / np.sqrt(len(self.draws) - 1.0)
        left = 1.0 - float(common @ np.linalg.solve(covariance, common))
        return float(np.sqrt(max(left, 1e-6)))


def _take_all(usual: Surrogate) -> Surrogate:
    """Make a surrogate of all tools on all objects if the bank has both, as usual, each the first of a new tool."""
    grasps = usual.grasps
    setting = Setting(grasps.base_setup)
    pairs = [Pair(tool, obj, setting) for tool in range(len(grasps.tools)) for obj in range(len(grasps.objects))]
    made = make_grasps(grasps, pairs).select(np.arange(len(pairs)))
    found = usual.at(replace(made, contexts=(GraspContext(),) * len(pairs)))
    return found.select(np.flatnonzero(found.is_usable))


def _average_by_tool(surrogate: Surrogate, peak_n: np.ndarray) -> np.ndarray:
    """Average each tool, t, over objects; where a cell is not known, the mean of the others on this object stands."""
    grasps = surrogate.grasps
    table = np.full((len(grasps.tools), len(grasps.objects)), np.nan)
    table[grasps.tool, grasps.obj] = peak_n
    known = table[:, np.isfinite(table).any(axis=0)]
    return np.asarray(np.where(np.isfinite(known), known, np.nanmean(known, axis=0)).mean(axis=1))
