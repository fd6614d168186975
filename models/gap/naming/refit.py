"""The leading effects fitted in the simulator's stead: all their parameters, with theta, tools and numerical error."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from models.gap.fit.fit import Fit, Fitter
from models.gap.fit.frame import first_estimate
from models.gap.naming.screen import Screen
from models.records import EffectValue

N_LEADING = 6
_STARTS = 2  # secants from which an effect is fitted


@dataclass(frozen=True, eq=False)
class Refit:
    """New effects (one, or a pair) fitted with all that is in the model already."""

    effects: tuple[str, ...]
    fit: Fit

    @property
    def values(self) -> tuple[EffectValue, ...]:
        """The new effects with their parameters."""
        return tuple(value for value in self.fit.effects if value.effect in self.effects)


def leading(screen: Screen, n: int = N_LEADING) -> list[str]:
    """Effects by how well their best secant predicts what was left out, and the one that gains most in any case."""
    by_r2 = sorted(screen.names, key=lambda name: -screen.grouped_r2[screen.best(name)])
    by_gain = max(screen.names, key=lambda name: screen.gain[_of(screen, name)].max())
    return list(dict.fromkeys([*by_r2[: n - 1], by_gain, by_r2[n - 1] if len(by_r2) >= n else by_r2[-1]]))[:n]


def refitted(base: Fit, screen: Screen, effects: Sequence[str]) -> list[Refit]:
    """Each effect alone, in the order given, from its most promising secants."""
    found = []
    for name in effects:
        places = _of(screen, name)
        # A shape without its amplitude is the same secant again.
        _, other = np.unique(np.round(-screen.gain[places], 6), return_index=True)
        starts = places[other][:_STARTS]
        fits = [_fitted(base, [screen.values[place]]) for place in starts]
        found.append(Refit((name,), min(fits, key=lambda fit: fit.loss)))
    return found


def paired(base: Fit, refits: Sequence[Refit]) -> list[Refit]:
    """The first refitted effect with each of the others: one alone may hide behind another."""
    return [
        Refit((*refits[0].effects, *other.effects), _fitted(base, [*refits[0].values, *other.values]))
        for other in refits[1:]
    ]


def _fitted(base: Fit, values: Sequence[EffectValue]) -> Fit:
    """The best of two fits: from the theta without the effects, and from the one that fits best with them as given.

    A strong effect has led theta far away, from where no small step is an improvement.
    """
    effects = [*base.effects, *values]
    starts = (base.theta, first_estimate(base.working.predictor, effects))
    return min((Fitter(base.working, start, effects).fit() for start in starts), key=lambda fit: fit.loss)


def _of(screen: Screen, effect: str) -> np.ndarray:
    return np.array([place for place, name in enumerate(screen.effects) if name == effect])
