"""The fewest experiments that promise enough between all that is still possible, by the time that they take."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fast.models.gap.ask.forecast import Forecast, Nats, compute_nats
from fast.models.gap.ask.hypotheses import POSSIBLE

ENOUGH_NATS = 3.0  # odds of 20 to 1
FEWEST_CELLS = 2  # a tool on an object may snap where the simulator does not: another one has to agree
_SHORTLIST, _OF_EACH_PAIR = 40, 3  # experiments that are tried together with others
_LEAST_GAIN = 0.01  # nats, of all pairs: less is no reason to go on
_SLACK = 1e-9


@dataclass(frozen=True, eq=False)
class Costs:
    """What c experiments cost. minutes: c, of one repetition. tool: c, which tool it takes. change: minutes of a tool.

    cell: c, number of the tool and object: experiments of one cell share what is wrong with it.
    """

    minutes: np.ndarray
    tool: np.ndarray
    cell: np.ndarray
    change: float = 0.0

    def total(self, counts: Sequence[int] | np.ndarray) -> float:
        """Return the minutes of all, with a change for each tool."""
        n = np.asarray(counts)
        return float(n @ self.minutes) + self.change * len(np.unique(self.tool[n > 0]))

    def select(self, rows: Sequence[int]) -> "Costs":
        """Select the costs of some of the experiments."""
        at = list(rows)
        return Costs(self.minutes[at], self.tool[at], self.cell[at], self.change)


@dataclass(frozen=True, eq=False)
class Choice:
    """How often each experiment is made (c), what that promises and what is expected (h x h), and its minutes."""

    counts: np.ndarray
    nats: np.ndarray
    expected: np.ndarray
    minutes: float

    @property
    def n(self) -> int:
        """How many repetitions there are of all experiments."""
        return int(self.counts.sum())


def choose_experiments(forecast: Forecast, costs: Costs, most: int) -> Choice:
    """Choose experiments one by one, always that with the greatest gain a minute, until all pairs are promised.

    The gain is the sum of P_i P_j min(D_ij, 3) over pairs of hypotheses, D the mean of what is expected and what
    is likely: the first repetitions promise nothing yet. Promised is what is likely. Experiments without which as much
    is promised are taken out again. `most`: repetitions of all. Where nothing tells, no experiment is chosen.
    """
    weight = _weigh_pairs(forecast)
    rows = _shortlist(forecast, costs, weight)
    chooser = _Chooser(forecast.select(rows), costs.select(rows), weight)
    counts = chooser.prune(chooser.add(most))
    whole = np.zeros(len(costs.minutes), dtype=int)
    whole[rows] = counts
    nats = chooser.predict(counts)
    return Choice(whole, nats.likely, nats.expected, chooser.costs.total(counts))


def list_open_pairs(forecast: Forecast, nats: np.ndarray) -> list[tuple[int, int]]:
    """List pairs of possible hypotheses between which there is less."""
    weight = _weigh_pairs(forecast)
    return [(i, j) for i in range(len(nats)) for j in range(i) if weight[i, j] > 0 and nats[i, j] < ENOUGH_NATS]


def _weigh_pairs(forecast: Forecast) -> np.ndarray:
    """Return P_i P_j of hypotheses that are possible, h x h; 0 for others, and between forms of the same."""
    is_possible = (forecast.probability >= POSSIBLE) & forecast.is_sharp
    possible = np.where(is_possible, forecast.probability, 0.0)
    names = np.array(forecast.names)
    return np.where(names[:, None] == names, 0.0, np.outer(possible, possible))


def _shortlist(forecast: Forecast, costs: Costs, weight: np.ndarray) -> list[int]:
    """List experiments that tell most a minute alone, and the best of each two hypotheses."""
    minutes = costs.minutes + costs.change
    alone = np.array([compute_nats(forecast.select([place]), [1]).expected for place in range(len(minutes))])
    value = (weight * np.minimum(alone, ENOUGH_NATS)).sum(axis=(1, 2)) / minutes
    chosen = list(np.argsort(-value, kind="stable")[:_SHORTLIST])
    for i, j in zip(*np.nonzero(np.triu(weight)), strict=True):
        chosen += list(np.argsort(-alone[:, i, j] / minutes, kind="stable")[:_OF_EACH_PAIR])
    return [int(place) for place in dict.fromkeys(chosen)]


@dataclass(frozen=True, eq=False)
class _Chooser:
    """Chooses among c experiments. weight: h x h, how much two hypotheses are worth telling apart."""

    forecast: Forecast
    costs: Costs
    weight: np.ndarray

    def predict(self, counts: np.ndarray) -> Nats:
        """Predict the nats between hypotheses."""
        return compute_nats(self.forecast, [int(n) for n in counts])

    def value(self, nats: Nats) -> float:
        """Return the weighted nats, of which no more count than are enough."""
        counted = np.minimum(nats.expected, ENOUGH_NATS) + np.minimum(nats.likely, ENOUGH_NATS)
        return 0.5 * float((self.weight * counted).sum())

    def n_cells(self, counts: np.ndarray) -> int:
        """Count how many cells take part."""
        return len(np.unique(self.costs.cell[counts > 0]))

    @property
    def fewest_cells(self) -> int:
        """How many have to."""
        return min(FEWEST_CELLS, len(np.unique(self.costs.cell)))

    def add(self, most: int) -> np.ndarray:
        """Add experiments until all is promised, or none gains anything, c."""
        counts = np.zeros(len(self.costs.minutes), dtype=int)
        while counts.sum() < most:
            best = self._find_best(counts)
            if best is None and 0 < self.n_cells(counts) < self.fewest_cells:
                best = self._find_other_cell(counts)
            if best is None:
                break
            counts[best] += 1
        return counts

    def prune(self, counts: np.ndarray) -> np.ndarray:
        """Prune what is not needed: what is promised stays, as far as it counts, and so does the number of cells."""
        counts = counts.copy()
        promised = np.minimum(self.predict(counts).likely, ENOUGH_NATS)
        n_cells = min(self.n_cells(counts), self.fewest_cells)
        for place in np.argsort(-self.costs.minutes, kind="stable"):
            while counts[place]:
                counts[place] -= 1
                left = np.minimum(self.predict(counts).likely, ENOUGH_NATS)
                if (left < promised - _SLACK)[self.weight > 0].any() or self.n_cells(counts) < n_cells:
                    counts[place] += 1
                    break
        return counts

    def _find_best(self, counts: np.ndarray) -> int | None:
        """Find the experiment with the greatest gain a minute; None if none gains anything that is still wanted."""
        before, spent = self.value(self.predict(counts)), self.costs.total(counts)
        rates = np.zeros(len(counts))
        for place in range(len(counts)):
            tried = counts.copy()
            tried[place] += 1
            gain = self.value(self.predict(tried)) - before
            if gain > _LEAST_GAIN * self.weight.sum():
                rates[place] = gain / max(self.costs.total(tried) - spent, 1e-9)
        return int(np.argmax(rates)) if rates.any() else None

    def _find_other_cell(self, counts: np.ndarray) -> int | None:
        """Find the experiment in a cell that takes no part which tells most a minute alone."""
        used = np.isin(self.costs.cell, self.costs.cell[counts > 0])
        alone = np.array([self.value(compute_nats(self.forecast.select([at]), [1])) for at in range(len(counts))])
        rates = np.where(used, 0.0, alone / (self.costs.minutes + self.costs.change))
        return int(np.argmax(rates)) if rates.any() else None
