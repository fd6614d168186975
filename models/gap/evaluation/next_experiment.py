"""The experiment that separates a set of effects, and how many grasps it takes (Box and Hill 1967).

Two effects i and j that change force by r_i and r_j under a setting are told apart by D = (r_i - r_j)^2 / (2 sd^2) a
comparison, sd its scatter. The setting with the largest sum of P_i P_j D_ij over its cost is asked for.
"""

from collections.abc import Mapping, Sequence
from itertools import combinations

import numpy as np

from models.gap.evaluation.diagnostic_protocol import SETTINGS, Setting
from models.gap.findings import NextExperiment
from models.simulation.effects.catalogue import CATALOGUE

ENOUGH = 3.0  # nats: odds of 20 to 1
FEWEST = 3  # comparisons: another tool and another object should agree
MOST = 200


def next_experiment(
    effects: Sequence[str],
    parameters: Mapping[str, Mapping[str, float]] | None = None,
    probabilities: Mapping[str, float] | None = None,
    settings: Sequence[Setting] = SETTINGS,
) -> NextExperiment | None:
    """What to measure so that a confusable set of effects falls apart; None if no setting of the bench does it.

    parameters: fitted values by effect (prior medians where missing). probabilities: of the effects (equal if missing).
    """
    names = [name for name in effects if name in CATALOGUE]
    if len(names) < 2:
        return None
    responses = {s.name: {n: s.respond(n, _whole(n, (parameters or {}).get(n, {}))) for n in names} for s in settings}
    weights = {n: (probabilities or {}).get(n, 1.0 / len(names)) for n in names}
    best = max(settings, key=lambda s: _gain(responses[s.name], weights, s.sd) / s.cost)
    separated, n_comparisons = _separated(responses[best.name], best.sd)
    if not separated:
        return None
    n_grasps = best.n_grasps * n_comparisons
    return NextExperiment(
        setting=best.name,
        separates=separated,
        n_grasps=n_grasps,
        sentence=_sentence(best, responses[best.name], separated, n_grasps),
    )


def _gain(responses: Mapping[str, float], weights: Mapping[str, float], sd: float) -> float:
    pairs = combinations(responses, 2)
    # Odds beyond a few nats are worth nothing more.
    return sum(weights[i] * weights[j] * min(_nats(responses[i], responses[j], sd), ENOUGH) for i, j in pairs)


def _nats(a: float, b: float, sd: float) -> float:
    return float((a - b) ** 2 / (2.0 * sd**2))


def _separated(responses: Mapping[str, float], sd: float) -> tuple[tuple[str, ...], int]:
    """Effects that fall apart within `MOST` comparisons, and how many that takes."""
    needed = {
        pair: int(np.ceil(ENOUGH / max(_nats(responses[pair[0]], responses[pair[1]], sd), 1e-9)))
        for pair in combinations(responses, 2)
    }
    possible = {pair: n for pair, n in needed.items() if n <= MOST}
    if not possible:
        return (), 0
    names = tuple(n for n in responses if any(n in pair for pair in possible))
    return names, max(FEWEST, *possible.values())


def _sentence(setting: Setting, responses: Mapping[str, float], separated: Sequence[str], n_grasps: int) -> str:
    changes = ", ".join(f"{_title(n)} {100 * responses[n]:+.0f} %" for n in separated)
    unit = f"about {n_grasps} grasps, on {FEWEST} tools or objects" if n_grasps else "no grasps"
    words = setting.words[0].upper() + setting.words[1:]
    return f"{words}: {unit}. What each then changes: {changes}."


def _title(effect: str) -> str:
    return effect.replace("_", " ")


def _whole(effect: str, parameters: Mapping[str, float]) -> dict[str, float]:
    medians = {p.name: p.prior_median for p in CATALOGUE[effect].parameters}
    return medians | dict(parameters)
