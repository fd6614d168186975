"""What a person can measure where no grasp of the bench tells: a number, which each hypothesis predicts.

An effect whose own parameter is measured predicts its fitted value; all others predict that nothing is there. So a
reading is an experiment like any other: it has a forecast, it promises nats, and it is weighed by the same rules. What
can be measured of an effect, its entry in the catalogue says.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from fast.models.gap.ask.forecast import Forecast
from fast.models.gap.findings import UNKNOWN
from fast.models.simulation.effects.catalogue import CATALOGUE
from fast.models.simulation.effects.spec import EffectSpec, Measurement


def find_measurement(kind: str) -> Measurement | None:
    """The measurement of this kind, if there is one."""
    return next((one for _, one in _list_measurements() if one.kind == kind), None)


def forecast_readings(
    names: Sequence[str], probability: np.ndarray, parameters: Mapping[str, Mapping[str, tuple[float, float]]]
) -> tuple[tuple[Measurement, ...], Forecast]:
    """Measurements that any of the hypotheses has a say in, and what each of them (h) predicts of them.

    parameters: of each effect, value and standard deviation. What nobody in the catalogue explains may be seen by a
    person or not: *unknown* predicts anything that an effect might.
    """
    known = [(spec, one) for spec, one in _list_measurements() if one.parameter in parameters.get(spec.effect, {})]
    means, columns = np.zeros((len(names), len(known), 1)), []
    for place, name in enumerate(names):
        spread = np.zeros((len(known), 1, len(known)))
        for at, (spec, one) in enumerate(known):
            value, sd = parameters[spec.effect][one.parameter]
            is_own = name == spec.effect
            means[place, at] = value if is_own else 0.0
            spread[at, 0, at] = sd if is_own else _imagine(spec, one) if name == UNKNOWN else 0.0
        columns.append(spread)
    noise = np.array([[[one.sd**2]] for _, one in known]).reshape(len(known), 1, 1)
    is_sharp = np.array([name != UNKNOWN for name in names])
    forecast = Forecast(tuple(names), probability, is_sharp, means, tuple(columns), np.zeros_like(noise), noise)
    return tuple(one for _, one in known), forecast


def _list_measurements() -> list[tuple[EffectSpec, Measurement]]:
    return [(spec, spec.measurement) for spec in CATALOGUE.values() if spec.measurement is not None]


def _imagine(spec: EffectSpec, one: Measurement) -> float:
    """How far a reading may be from nothing if something is wrong that the catalogue does not know."""
    own = next(p for p in spec.parameters if p.name == one.parameter)
    return float(abs(own.prior_median - own.neutral) + own.prior_sd)
