"""What a person can measure where no grasp of the bench tells: a number, which each hypothesis predicts.

An effect whose own parameter is measured predicts its fitted value; all others predict that nothing is there. So a
reading is an experiment like any other: it has a forecast, it promises nats, and it is weighed by the same rules. What
can be measured of an effect, its entry in the catalogue says.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from fast.models.gap.ask.forecast import Forecast
from fast.models.gap.findings import UNKNOWN
from fast.models.question import Question, Slip, apart_of, ask_of, slips_of_factor
from fast.models.simulation.effects.catalogue import CATALOGUE
from fast.models.simulation.effects.spec import EffectSpec, Measurement
from fast.models.units import STANDARD_GRAVITY_M_PER_S2


def find_measurement(kind: str) -> Measurement | None:
    """Find the measurement of this kind, if there is one."""
    return next((one for _, one in list_measurements() if one.kind == kind), None)


def forecast_readings(
    names: Sequence[str], probability: np.ndarray, parameters: Mapping[str, Mapping[str, tuple[float, float]]]
) -> tuple[tuple[Measurement, ...], Forecast]:
    """Return the measurements that any of the hypotheses has a say in, and what each of them (h) predicts of them.

    parameters: of each effect, value and standard deviation. What nobody in the catalogue explains may be seen by a
    person or not: *unknown* predicts anything that an effect might.
    """
    known = [(spec, one) for spec, one in list_measurements() if one.parameter in parameters.get(spec.effect, {})]
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


def list_measurements() -> list[tuple[EffectSpec, Measurement]]:
    """List what a person can measure, with the effect that it tells of."""
    return [(spec, spec.measurement) for spec in CATALOGUE.values() if spec.measurement is not None]


def _imagine(spec: EffectSpec, one: Measurement) -> float:
    """Return how far a reading may be from nothing if something is wrong that the catalogue does not know."""
    own = next(p for p in spec.parameters if p.name == one.parameter)
    return float(abs(own.prior_median - own.neutral) + own.prior_sd)


_FAR_SD = 4.0  # of what any simulator had to be put right by; a reading farther out is strange
_WALLS_MM = (1.5, 5.0)  # of a whole wall, in place of what it has more than drawn
_LEAST_OF_SMALL = 2.0  # per cents and grams that anybody tells
_PUSH_N = 20.0  # with which a person pushes
_LENGTHS_MM = {"um": 1e-3}


def find_reading_questions(kind: str, value: float, known: tuple[float, float] | None = None) -> list[Question]:
    """Find questions about a reading; `known`: what the lake says it should be, with its sd, where it says anything."""
    found = next(((spec, one) for spec, one in list_measurements() if one.kind == kind), None)
    if found is None:
        return []
    effect, one = found
    spec = next(p for p in effect.parameters if p.name == one.parameter)
    wide = float(np.hypot(spec.prior_sd, one.sd))
    expected, sd = known if known is not None else (spec.prior_median, wide)
    lowest, highest = one.values
    unit = one.label.rpartition(", ")[2]
    unit = unit if unit in ("mm", "N", "mm/N") else ""
    is_possible = lowest <= value <= highest
    slips = _list_slips(kind, value) + (slips_of_factor(value, {}) if known is not None else [])
    told = f"{value:g} {unit}".rstrip()
    told += f", measured walls of tools say {expected:.3g}" if known is not None else f", usual is {expected:g} or so"
    asked = ask_of(kind, told, 0, slips, apart_of(expected, sd), unit)
    if is_possible and abs(value - expected) <= _FAR_SD * sd:
        return []
    is_in_bounds = spec.lower - _FAR_SD * one.sd <= value <= spec.upper + _FAR_SD * one.sd
    if is_possible and known is None and is_in_bounds and asked.kind == "outlier":
        return []  # no simulator was ever so wrong, but it may be
    if asked.kind == "outlier":
        asked = ask_of(kind, told, 0, slips_of_factor(value, {}), apart_of(expected, sd), unit)
    if kind == "walls" and _WALLS_MM[0] <= value <= _WALLS_MM[1]:
        asked = Question("another quantity", f"{kind}: {told}, the whole wall? Tell what it has more than drawn", (0,))
    if not is_possible:
        text = f"{asked.sentence} (it is {lowest:g} to {highest:g} {unit}".rstrip() + ")"
        asked = asked._replace(kind="impossible", sentence=text)
    return [asked]


def _list_slips(kind: str, value: float) -> list[Slip]:
    """List usual slips of a reading but for the decimal point: units, and telling the whole, not the difference."""
    if kind == "dead_weight":
        kilogram, gram = STANDARD_GRAVITY_M_PER_S2, 1e-3 * STANDARD_GRAVITY_M_PER_S2
        return [
            Slip("another quantity", "the whole reading", value - kilogram),
            Slip("unit", "the whole reading in kg", kilogram * (value - 1.0)),
            Slip("unit", "the whole reading in g", gram * (value - 1000.0)),
            *([Slip("unit", "g", gram * value)] if abs(value) >= _LEAST_OF_SMALL else []),
        ]
    if kind == "tensile_bar":
        ratio = Slip("another quantity", "the ratio itself", value - 1.0)
        per_cent = [
            Slip("unit", "per cent", value / 100),
            Slip("unit", "the ratio in per cent", value / 100 - 1.0),
        ]
        return [ratio, *(per_cent if abs(value) >= _LEAST_OF_SMALL else [])]
    if kind in ("jaw_push", "post_push"):
        inverse = [Slip("another quantity", "N/mm", 1.0 / value)] if value else []
        whole = Slip("another quantity", f"the way at {_PUSH_N:g} N", value / _PUSH_N)
        return [whole, *inverse, Slip("unit", "um/N", value / 1000.0)]
    return [Slip("unit", name, value * factor) for name, factor in _LENGTHS_MM.items()]
