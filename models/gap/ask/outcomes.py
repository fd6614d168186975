"""What each outcome of an experiment would mean, in words: the feature in which the hypotheses differ most."""

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from fast.models.gap.ask.forecast import Forecast
from fast.models.gap.ask.hypotheses import Hypothesis
from fast.models.gap.bank.surrogate import FEATURES
from fast.models.gap.findings import UNKNOWN, Outcome
from fast.models.simulation.effects.catalogue import CATALOGUE
from fast.models.units import spell_number

MEANS = "What it would mean: "  # stands in a question before its outcomes
_CLEAR_SD = 3.0
_UNSEEN_SD = 1.0  # of the mean of a chosen experiment: less is said to stay


def describe_pairs(hypotheses: Sequence[Hypothesis], forecast: Forecast, place: int, n: int) -> tuple[Outcome, ...]:
    """Tell what comes of an experiment made n times if each hypothesis is true; of *unknown* nobody can say it."""
    named = [number for number, one in enumerate(hypotheses) if forecast.is_sharp[number] and one.name != UNKNOWN]
    means = forecast.means[:, place]
    sd = np.sqrt(np.diagonal(forecast.scatter[place] + forecast.noise[place] / n))
    apart = np.zeros(len(sd))
    for i, j in combinations(named, 2):
        weight = hypotheses[i].probability * hypotheses[j].probability
        apart += weight * np.minimum(np.abs(means[i] - means[j]) / sd, _CLEAR_SD)
    feature = int(np.argmax(apart))
    found = []
    for number in named:
        words = _say_change(FEATURES[feature], float(means[number, feature]), float(sd[feature]))
        found.append(Outcome(effect=hypotheses[number].name, sentence=words))
    return tuple(found)


def describe_reading(
    hypotheses: Sequence[Hypothesis], forecast: Forecast, place: int, label: str
) -> tuple[Outcome, ...]:
    """Describe what a person would read if each hypothesis is true; of *unknown* nobody can say it."""
    return tuple(
        Outcome(
            effect=one.name, sentence=f"the reading ({label}) is about {spell_number(forecast.means[number, place, 0])}"
        )
        for number, one in enumerate(hypotheses)
        if forecast.is_sharp[number] and one.name != UNKNOWN
    )


def _say_change(feature: str, change: float, sd: float) -> str:
    """Say what changes by how much; sd: of its mean over the asked grasps."""
    what, unit, more, less = _name_feature(feature)
    said = (
        f"{more if change > 0 else less} {spell_number(abs(change))} {unit}"
        if abs(change) > _UNSEEN_SD * sd
        else "stays"
    )
    return f"{what} {said}, give or take {spell_number(sd, 1)} {unit}"


def _name_feature(feature: str) -> tuple[str, str, str, str]:
    """Name a feature: what it is, its unit, and what a positive and a negative change does."""
    if feature == "lift_at_peak_mm":
        return "the peak", "mm", "comes later by", "comes earlier by"
    named = {
        "peak_n": "the peak force",
        "dip_n": "the least force at the start",
        "tail_n_mm": "what is left after 40 mm",
    }
    if feature in named:
        return named[feature], "N mm" if feature == "tail_n_mm" else "N", "grows by", "falls by"
    low, high = feature.removeprefix("force_").removesuffix("_mm_n").split("_")
    return f"the force from {low} to {high} mm of lift", "N", "grows by", "falls by"


def join_outcomes(outcomes: Sequence[Outcome]) -> str:
    """Say what each outcome would mean, in a sentence: effects of which the same comes stand together."""
    by_words: dict[str, list[str]] = {}
    for one in outcomes:
        by_words.setdefault(one.sentence, []).append(_title(one.effect))
    parts = [f"if {words}: {' or '.join(titles)}" for words, titles in by_words.items()]
    return f"{'; '.join(parts)}; anything else: not in the catalogue"


def _title(name: str) -> str:
    return CATALOGUE[name].title if name in CATALOGUE else "nothing is missing"
