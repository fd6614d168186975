"""Facts: numbers that a person measured of what an effect changes, such as walls by callipers or a dead weight.

A fact is an observation like any other: under an effect it is the effect's parameter and an error, under anything else
it is the parameter at which the effect is not there. So it draws an amplitude to what was measured, and speaks for or
against the effect as far as the number is surer than the grasps.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from fast.models.gap.evidence.errors import TAILS
from fast.models.records import EffectValue
from fast.models.simulation.effects.catalogue import CATALOGUE


@dataclass(frozen=True)
class Fact:
    """A parameter of an effect as it was measured, with its standard deviation."""

    effect: str
    parameter: str
    value: float
    sd: float

    def draw(self, true: Sequence[EffectValue], rng: np.random.Generator) -> "Fact":
        """Draw the same as it would be measured of true effects."""
        return replace(self, value=self.predict(true) + self.sd * float(rng.standard_normal()))

    def predict(self, effects: Sequence[EffectValue]) -> float:
        """Predict what it is with these effects, without an error."""
        spec = next(one for one in CATALOGUE[self.effect].parameters if one.name == self.parameter)
        own = (one.parameters for one in effects if one.effect == self.effect)
        return next((parameters.get(self.parameter, spec.neutral) for parameters in own), spec.neutral)


def list_facts(readings: Iterable[tuple[str, float]]) -> tuple[Fact, ...]:
    """List facts of readings (kind and number); a kind that no effect of the catalogue has is none."""
    specs = {spec.measurement.kind: (name, spec.measurement) for name, spec in CATALOGUE.items() if spec.measurement}
    known = ((*specs[kind], value) for kind, value in readings if kind in specs)
    return tuple(Fact(name, how.parameter, value, how.sd) for name, how, value in known)


def compare_facts(facts: Sequence[Fact], effects: Sequence[EffectValue]) -> np.ndarray:
    """Compute what was measured less what these effects make of it, in standard deviations, f."""
    return np.array([(one.value - one.predict(effects)) / one.sd for one in facts])


def weigh_rest(rest: np.ndarray) -> float:
    """Log likelihood of such differences (f), but for a constant: no error is normal far out."""
    return float(-0.5 * (TAILS + 1.0) * np.log1p(rest**2 / TAILS).sum())


def weigh_facts(facts: Sequence[Fact], effects: Sequence[EffectValue]) -> float:
    """Log likelihood of facts with these effects, but for a constant."""
    return weigh_rest(compare_facts(facts, effects))
