"""When gap discovery speaks, and how sure it says that it is; the numbers are fitted by the study `gap`."""

from collections.abc import Mapping

import numpy as np

from fast.models.records import Record

LEAST_OVER_LINE = 0.05  # below it, how little is predicted says nothing more
ANY_FAMILY = "any other family"


class Thresholds(Record):
    """When gap discovery speaks.

    least_r2: share of the held-out squares below which an effect, or a pattern without a name, is no gap.
    effect_size, pattern_size: share of the force by which an effect, or a pattern, must change the traces; honest
    solvers differ by as much. law_share: of what the effects in the model change, a share that a pattern by object or
    tool has to exceed too: no law is exact.
    least_nats: evidence below which a pattern is none, or nothing changes from grasp to grasp, and between predictions
    of two effects that are told apart.
    drift_r2: share of the squares of contrasts of repeats that a drift (`drifts`) has to predict; no simulator makes
    contrasts, so no size is asked for.
    temperature: of evidence in nats between effects.

    none_logit, alarm_logit: intercepts and slopes of the log odds, in ln(r2 / line), that the answer *none* is right,
    and that there is a gap if there is an alarm. Between them lies a step: lines were set so that null worlds stay
    below.
    name_logit: intercept and slopes of the log odds that the named family is right, see
    `models.gap.naming.second_look.SecondLook.describe`.

    least_unknown, least_name: probabilities of a wrong and of a right name from which *not in the catalogue*, and a
    name by its family, are in the conformal set of an alarm. They are set class by class, so that nine in ten alarms
    of each kind of truth have it in their set (split conformal prediction with classes, Vovk 2012; decision 065).

    none_logit, alarm_logit and floors of sets are those of seven panels that had been sealed before: 2,492 answers,
    672 of them with nothing hidden, 1,074 with an alarm. name_logit is that of 299 alarms with an effect to look at, on
    four of them (decision 059). The lines were set on null worlds of panels before these.
    """

    least_r2: float = 0.02
    effect_size: float = 0.01
    pattern_size: float = 0.015
    law_share: float = 0.15
    least_nats: float = 3.0
    drift_r2: float = 0.01
    temperature: float = 5.28
    none_logit: tuple[float, float] = (0.47, -0.278)
    alarm_logit: tuple[float, float] = (1.841, 3.319)
    name_logit: tuple[float, ...] = (-0.893, 1.554, -0.63, 0.205, -1.257)
    least_unknown: float = 0.1267
    least_name: Mapping[str, float] = {
        ANY_FAMILY: 0.0,
        "closing force that gives way": 0.0738,
        "compliance in series": 0.4419,
        "constant force of the load cell": 0.8391,
        "delay between lift and force": 0.7582,
        "friction or adhesion that varies with pressure": 0.0,
        "friction that varies with sliding": 0.5845,
        "shape of the objects' edges": 0.8094,
        "stiffness that changes from grasp to grasp": 0.636,
    }

    def judge_gap(self, r2_over_line: float) -> float:
        """Probability that there is a gap; r2_over_line: of what predicts best, over its line, an alarm above 1."""
        log_over = float(np.log(max(r2_over_line, LEAST_OVER_LINE)))
        if r2_over_line > 1.0:
            intercept, slope = self.alarm_logit
            return _logistic(intercept + slope * log_over)
        intercept, slope = self.none_logit
        return _logistic(-intercept - slope * log_over)

    def is_unknown_possible(self, name: float) -> bool:
        """Whether a cause outside the catalogue is in the conformal set; name: of `judge_name`."""
        return 1.0 - name >= self.least_unknown

    def is_name_possible(self, name: float, family: str) -> bool:
        """Whether the effects looked at, of a family, are in the conformal set; name: of `judge_name`."""
        return name >= self.least_name.get(family, self.least_name[ANY_FAMILY])

    def judge_name(self, description: np.ndarray) -> float:
        """Probability that a named family is right."""
        return _logistic(float(np.array(self.name_logit) @ np.concatenate([[1.0], description])))


def _logistic(log_odds: float) -> float:
    return float(1.0 / (1.0 + np.exp(-np.clip(log_odds, -30.0, 30.0))))
