"""What came of the grasps and readings that were asked for, and how likely each hypothesis makes it."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from fast.models.gap.ask.forecast import MOST_NATS, Forecast, weigh
from fast.models.gap.ask.hypotheses import Hypothesis
from fast.models.gap.ask.person import forecast_readings
from fast.models.gap.ask.predict import Moved, Pair, forecast_pairs
from fast.models.gap.ask.settings import Setting
from fast.models.gap.bank.surrogate import features_of_steps
from fast.models.gap.grasps import Grasps
from fast.models.records import Record


class Reading(Record):
    """What a person measured: the kind of `models.gap.ask.person`, and the number."""

    kind: str
    value: float


@dataclass(frozen=True, eq=False)
class Answers:
    """Grasps that were asked for, in pairs, and readings of persons.

    grasps: of the same tools and objects as the search's, which has none of them. pairs: p x 2, rows of a grasp as
    usual and of the changed one.
    """

    grasps: Grasps
    pairs: np.ndarray
    readings: tuple[Reading, ...] = ()

    @property
    def n_grasps(self) -> int:
        """How many were made."""
        return len(self.grasps.grasp_ids)

    @cached_property
    def experiments(self) -> dict[Pair, np.ndarray]:
        """Outcomes (r x f) of each experiment: features of the changed grasp less those of the usual one."""
        grasps = self.grasps
        features = features_of_steps(grasps.steps_n)
        found: dict[Pair, list[np.ndarray]] = {}
        for usual, changed in self.pairs:
            setup, placement = grasps.setups[grasps.setup[changed]], grasps.placements[grasps.placement[changed]]
            setting = Setting.of(grasps.base_setup, setup, placement)
            pair = Pair(int(grasps.tool[changed]), int(grasps.obj[changed]), setting)
            found.setdefault(pair, []).append(features[changed] - features[usual])
        return {pair: np.array(rows) for pair, rows in found.items()}

    def weigh(self, hypotheses: Sequence[Hypothesis], moved: Moved | None = None) -> np.ndarray:
        """Log likelihoods of the hypotheses (h) by the grasps, but for a constant; in the order of the list.

        Readings are facts of the evidence, from which the hypotheses come.
        """
        total = np.zeros(len(hypotheses))
        if self.experiments:
            forecast = forecast_pairs(hypotheses, list(self.experiments), moved)
            total += weigh(forecast, list(self.experiments.values()))
        return total


def forecast_measurements(hypotheses: Sequence[Hypothesis]) -> tuple[tuple, Forecast]:
    """Forecast what a person can measure that any hypothesis has a say in, and what each predicts."""
    names = [one.name for one in hypotheses]
    probability = np.array([one.probability for one in hypotheses])
    return forecast_readings(names, probability, {one.name: one.estimate_parameters() for one in hypotheses})


def believe(hypotheses: Sequence[Hypothesis], likelihood: np.ndarray) -> tuple[Hypothesis, ...]:
    """Return the hypotheses with their probabilities after answers with these log likelihoods (h).

    Of no two more than `MOST_NATS` are believed: no model of errors is right far out.
    """
    below = np.maximum(likelihood - likelihood.max(), -MOST_NATS)
    after = np.array([one.probability for one in hypotheses]) * np.exp(below)
    return tuple(replace(one, probability=float(p)) for one, p in zip(hypotheses, after / after.sum(), strict=True))


def merge_forms(hypotheses: Sequence[Hypothesis]) -> dict[str, float]:
    """Sum the probability by name: of forms of one hypothesis together."""
    found: dict[str, float] = {}
    for one in hypotheses:
        found[one.name] = found.get(one.name, 0.0) + one.probability
    return found
