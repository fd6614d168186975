"""When gap discovery speaks, and how sure it says that it is; the numbers are fitted by the study `gap`."""

import numpy as np

from fast.models.records import Record

LEAST_OVER_LINE = 0.3  # below it, how little is predicted says nothing more


class Thresholds(Record):
    """When gap discovery speaks.

    least_r2: share of the held-out squares below which an effect, or a pattern without a name, is no gap.
    effect_size, pattern_size: share of the force by which an effect, or a pattern, must change the traces; honest
    solvers differ by as much. law_share: of what the effects in the model change, a share that a pattern by object or
    tool has to exceed too: no law is exact.
    least_nats: evidence below which a pattern is none, and between predictions of two effects that are told apart.
    temperature: of evidence in nats between effects. gap_logit: intercept and slope of the log odds that an alarm is
    right, in ln(r2 / line). name_logit: intercept and slopes of the log odds that the named family is right, see
    `models.gap.naming.second_look.SecondLook.describe`.

    gap_logit is that of 245 worlds of public seeds on two panels that had been sealed before, and 10 null worlds of an
    independent solver: 52 with nothing hidden, 76 with one effect, 75 of them also with the effect taken out of the
    catalogue, 40 with what no catalogue lists, 12 with two. name_logit is that of 299 alarms with an effect to look at,
    on four panels that had been sealed before (decision 059). The lines were set on null worlds of all of these.
    """

    least_r2: float = 0.02
    effect_size: float = 0.01
    pattern_size: float = 0.015
    law_share: float = 0.15
    least_nats: float = 3.0
    temperature: float = 5.28
    gap_logit: tuple[float, float] = (0.746, 1.52)
    name_logit: tuple[float, ...] = (-0.893, 1.554, -0.63, 0.205, -1.257)

    def judge_gap(self, r2_over_line: float) -> float:
        """Probability that an alarm is right; r2_over_line: of what predicts best, over its line."""
        intercept, slope = self.gap_logit
        return _logistic(intercept + slope * float(np.log(max(r2_over_line, LEAST_OVER_LINE))))

    def judge_name(self, description: np.ndarray) -> float:
        """Probability that a named family is right."""
        return _logistic(float(np.array(self.name_logit) @ np.concatenate([[1.0], description])))


def _logistic(log_odds: float) -> float:
    return float(1.0 / (1.0 + np.exp(-np.clip(log_odds, -30.0, 30.0))))
