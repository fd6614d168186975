"""What is right in an answer to a world of known truth, and the probabilities that are fitted on such answers."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.optimize import minimize
from scipy.special import expit

from fast.flows.challenge.hidden.worlds import WorldKey
from fast.models.gap.naming.families import WORDS
from fast.models.gap.naming.thresholds import ANY_FAMILY, LEAST_OVER_LINE
from tests.studies.gap.answers import Answer

if TYPE_CHECKING:
    from fast.models.gap.naming.thresholds import Thresholds

VISIBLE = 0.02  # from this visible strength on, an effect is expected to be found
EXCLUDED = 0.1  # of the truths of a class, at most
FEWEST_OF_CLASS = 19  # alarms, for a floor of their own
LEAST_VISIBLE = 0.01  # below this one, it is not there for these data
_RIDGE = 1.0  # precision of intercept and slopes about none at all


@dataclass(frozen=True)
class Judged:
    """An answer with its key. left_out: the truth was not in the catalogue; twin_n: error of the world without it."""

    key: WorldKey
    said: Answer
    left_out: bool = False
    twin_n: float | None = None

    @property
    def families(self) -> set[str]:
        """Families of what is hidden; what no catalogue lists has none."""
        return {WORDS[name] for name in self.key.names if name in WORDS}

    @property
    def is_visible(self) -> bool:
        """Whether something is hidden, and all of it should be found."""
        return bool(self.key.effects) and all(hidden.visible_strength >= VISIBLE for hidden in self.key.effects)

    def is_family_right(self, name: str) -> bool:
        """Whether an effect is of a family that is hidden."""
        return WORDS.get(name) in self.families

    @property
    def is_right(self) -> bool:
        """Whether the first answer is right: a hidden family; unknown if there is none; nothing if nothing is there.

        What changes the traces by less than `LEAST_VISIBLE` once theta is fitted is nothing to these data.
        """
        first = self.said.rounds[0]
        if first.kind in ("effect", "set"):
            return any(self.is_family_right(name) for name in first.effects)
        if first.kind == "none":
            return all(hidden.visible_strength < LEAST_VISIBLE for hidden in self.key.effects)
        return bool(self.key.effects) and (self.left_out or not self.families)


def fit_probabilities(worlds: Sequence[Judged], base: "Thresholds") -> "Thresholds":
    """Thresholds whose probabilities are those of these worlds.

    That *none* is right, and that an alarm is: all answers on either side of the line. That a family is right: all
    alarms with a name looked at, but for effects taken out of the catalogue whose own family is looked at: there the
    family and *unknown* are both right.
    """
    gaps = {
        "none_logit": [(one.said.rounds[0].over_line, one.is_right) for one in worlds if not one.said.is_alarm],
        "alarm_logit": [(one.said.rounds[0].over_line, bool(one.key.effects)) for one in worlds if one.said.is_alarm],
    }
    looked = [(one, one.said.rounds[0]) for one in worlds if one.said.rounds[0].description]
    told = [(said.description, one.is_family_right(said.looked_at), one.left_out) for one, said in looked]
    counted = [(description, is_right) for description, is_right, is_left_out in told if not (is_right and is_left_out)]
    described, is_right = (np.array(part) for part in zip(*counted, strict=True))
    fitted = {"name_logit": _fit_logistic(described, is_right)}
    fitted |= {name: _fit_over_line(found) for name, found in gaps.items() if found}
    return fit_conformal(worlds, base.model_copy(update=fitted))


def fit_conformal(worlds: Sequence[Judged], base: "Thresholds") -> "Thresholds":
    """Thresholds whose conformal sets hold the truth in nine of ten alarms of visible effects, class by class.

    Alarms by differences of repeats alone have probabilities of their own and do not count. Classes: what is not in the
    catalogue, without effects taken out of it whose own family is looked at, since both answers are right there; each
    family with enough alarms; all others together.
    """
    outside: list[float] = []
    by_family: dict[str, list[float]] = {}
    for one in worlds:
        said = one.said.rounds[0]
        is_counted = one.key.group in ("single", "unlisted") and one.is_visible and one.said.is_alarm
        if not is_counted or said.is_by_drift:
            continue
        name = base.judge_name(np.array(said.description)) if said.description else 0.0
        is_family = one.is_family_right(said.looked_at)
        if one.left_out or not one.families:
            outside += [] if is_family else [1.0 - name]
        else:
            (family,) = one.families
            by_family.setdefault(family, []).append(name if is_family else 0.0)
    rare = [name for names in by_family.values() if len(names) < FEWEST_OF_CLASS for name in names]
    floors = {ANY_FAMILY: _find_floor(rare)}
    floors |= {family: _find_floor(names) for family, names in by_family.items() if len(names) >= FEWEST_OF_CLASS}
    return base.model_copy(update={"least_unknown": _find_floor(outside), "least_name": floors})


def _find_floor(scores: Sequence[float]) -> float:
    """The largest floor that one more score of the same kind reaches in nine cases of ten at least; 0 if too few."""
    place = int(EXCLUDED * (len(scores) + 1))
    return math.floor(1e4 * sorted(scores)[place - 1]) / 1e4 if place else 0.0


def _fit_over_line(found: Sequence[tuple[float, bool]]) -> tuple[float, ...]:
    """Intercept and slope in the logarithm of what is predicted over its line; found: with whether it is true."""
    over, is_true = (np.array(part) for part in zip(*found, strict=True))
    return _fit_logistic(np.log(np.maximum(over, LEAST_OVER_LINE))[:, None], is_true)


def _fit_logistic(inputs: np.ndarray, is_true: np.ndarray) -> tuple[float, ...]:
    """Intercept and slopes of a logistic regression with a ridge."""
    columns = np.column_stack([np.ones(len(inputs)), inputs])
    sign = np.where(is_true, 1.0, -1.0)

    def loss(at: np.ndarray) -> tuple[float, np.ndarray]:
        log_odds = sign * (columns @ at)
        value = np.logaddexp(0.0, -log_odds).sum() + 0.5 * _RIDGE * (at**2).sum()
        return float(value), -columns.T @ (sign * expit(-log_odds)) + _RIDGE * at

    found = minimize(loss, np.zeros(columns.shape[1]), jac=True, method="BFGS").x
    return tuple(round(float(value), 3) for value in found)
