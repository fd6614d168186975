"""Once an effect is named: the grasps that shorten the interval of the parameter on which the ranking of designs hangs.

The hypotheses are draws of one posterior. A parameter matters as far as it moves the best tools against each other. The
interval of the one that matters most is what pairs of grasps are chosen for, by the nats a minute that they bring it:
outcomes and parameter are taken to be normal together, as the draws have them. Nothing is asked once the draws agree
on the order of the best tools.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from models.gap.ask.choose import Costs
from models.gap.ask.forecast import Forecast
from models.gap.ask.hypotheses import Hypothesis
from models.gap.ask.predict import Moved, Pair, forecast_pairs
from models.gap.bank.surrogate import FEATURES
from models.gap.fit.fit import axes_of

N_DRAWS = 96  # well above the number of parameters: fewer would seem to know each other
N_BEST = 3  # tools whose order counts
SURE_SHARE = 0.95  # of the draws with one order: more grasps would not change it
LEAST_NATS = 0.02  # that a pair brings the parameter; one that brings less is not made
_THETA = ("young_modulus_mpa", "friction", "poisson_ratio")
_PEAK = FEATURES.index("peak_n")


@dataclass(frozen=True, eq=False)
class Ranking:
    """How n draws rank t tools. quality_n: n x t, mean simulated peak. parameters: n x p, in standard deviations."""

    names: tuple[str, ...]
    parameters: np.ndarray
    quality_n: np.ndarray

    @property
    def best(self) -> np.ndarray:
        """The tools that are best by the mean of the draws, best first."""
        return np.argsort(-self.quality_n.mean(axis=0), kind="stable")[:N_BEST]

    @property
    def agreement(self) -> float:
        """Share of the draws that have the best tools in this order."""
        orders = np.argsort(-self.quality_n, axis=1, kind="stable")[:, : len(self.best)]
        return float((orders == self.best).all(axis=1).mean())

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
        slopes_n, *_ = np.linalg.lstsq(self.parameters, margins_n - margins_n.mean(axis=0), rcond=None)
        closeness = margins_n.std(axis=0) / np.maximum(np.abs(margins_n.mean(axis=0)), 1e-9)
        return np.asarray(np.sqrt((slopes_n**2 * np.minimum(closeness, 1.0) ** 2).sum(axis=1)))

    @property
    def by_weight(self) -> list[int]:
        """Numbers of the parameters, the one that matters most first."""
        return [int(place) for place in np.argsort(-self.weights, kind="stable")]


@dataclass(frozen=True, eq=False)
class Refinement:
    """What is asked for a parameter. counts: c, repetitions of each pair. sd_left: share of its sd that stays."""

    parameter: str
    counts: np.ndarray
    sd_left: float
    minutes: float


def rank_draws(named: Hypothesis, seed: int = 0) -> Ranking:
    """How draws of the posterior of a named effect rank the measured tools, as designs: each printed as usual."""
    surrogate = named.fit.features.surrogate
    grasps = surrogate.grasps
    is_usual = grasps.setup == grasps.setups.index(grasps.base_setup)
    cells = np.stack([grasps.tool, grasps.obj], axis=1)[is_usual]
    _, first = np.unique(cells, axis=0, return_index=True)
    rows = np.flatnonzero(is_usual)[first]
    axes = [(value.effect, axis) for value in named.fit.effects for axis in axes_of(value.effect)]
    parameters, quality_n = [], []
    for theta, effects, _ in named.draw(N_DRAWS, np.random.default_rng(seed)):
        values = {value.effect: value.parameters for value in effects}
        parameters.append([*theta, *(axis.inner(values[effect][axis.name]) for effect, axis in axes)])
        peak_n = surrogate.predict_features(theta, effects)[rows, _PEAK]
        quality_n.append(_average_by_tool(peak_n, grasps.tool[rows], len(grasps.tools)))
    drawn = np.array(parameters)
    drawn = (drawn - drawn.mean(axis=0)) / np.maximum(drawn.std(axis=0, ddof=1), 1e-12)
    return Ranking((*_THETA, *(f"{effect}.{axis.name}" for effect, axis in axes)), drawn, np.array(quality_n))


def refine(
    named: Hypothesis, pairs: Sequence[Pair], costs: Costs, most: int, moved: Moved | None = None, seed: int = 0
) -> Refinement | None:
    """The pairs to make, `most` repetitions in all; None if the ranking is settled, or no pair shortens any interval.

    A parameter that no pair tells anything of is passed over for the next one.
    """
    ranking = rank_draws(named, seed)
    if ranking.is_settled:
        return None
    forecast = forecast_pairs([replace(named, probability=1.0)], pairs, moved, seed, N_DRAWS)
    for place in ranking.by_weight:
        learner = Learner(forecast, ranking.parameters[:, place])
        counts = _choose(learner, costs, most)
        if counts.any():
            return Refinement(ranking.names[place], counts, learner.find_sd(counts), costs.total(counts))
    return None


def _choose(learner: "Learner", costs: Costs, most: int) -> np.ndarray:
    """Repetitions of each pair (c), always one more of that which brings the parameter most a minute."""
    n_pairs = len(costs.minutes)
    counts = np.zeros(n_pairs, dtype=int)
    while counts.sum() < most:
        before, spent = learner.find_sd(counts), costs.total(counts)
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
        """Standard deviation that the parameter has after so many repetitions (c), in units of that before."""
        made = np.flatnonzero(counts)
        if not len(made):
            return 1.0
        part = self.forecast.select([int(place) for place in made])
        _, (covariance,) = part.stack([int(counts[place]) for place in made])
        own = part.columns[0].reshape(len(covariance), -1)[:, : len(self.draws)]
        common = own @ self.draws / np.sqrt(len(self.draws) - 1.0)
        left = 1.0 - float(common @ np.linalg.solve(covariance, common))
        return float(np.sqrt(max(left, 1e-6)))


def _average_by_tool(values: np.ndarray, tool: np.ndarray, n_tools: int) -> np.ndarray:
    """Mean of each of the tools, t; of one without any, the least."""
    total = np.bincount(tool, weights=values, minlength=n_tools)
    n = np.bincount(tool, minlength=n_tools)
    return np.where(n > 0, total / np.maximum(n, 1), values.min())
