"""What a person can measure where no grasp of the bench tells: a number, which each hypothesis predicts.

An effect whose own parameter is measured predicts its fitted value; all others predict that nothing is there. So a
reading is an experiment like any other: it has a forecast, it promises nats, and it is weighed by the same rules.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from fast.models.gap.ask.forecast import Forecast
from fast.models.gap.findings import UNKNOWN
from fast.models.simulation.effects.catalogue import CATALOGUE


@dataclass(frozen=True)
class Measurement:
    """A number that a person measures. `sd`: of a reading; `minutes`: that it takes; `values`: bounds of a reading.

    It reads `parameter` of `effect`; without the effect it reads `nothing`.
    """

    kind: str
    words: str
    label: str
    effect: str
    parameter: str
    sd: float
    minutes: float
    values: tuple[float, float]
    nothing: float = 0.0


_WALLS = (
    "measure both walls and the ribs of three fingers with callipers, and take the mean of what is more than drawn; or "
    "measure those of every tool, and say them with `fast print measured`"
)
_BOW = "photograph three fingers from the side with a scale, and measure by how much the ribs are bowed"
_WEIGHT = "take the tool off, tare, hang 1 kg on the load cell, and note by how much it reads more than 9.81 N"
_BARS = "pull two tensile bars, printed upright and flat, and take the ratio of their moduli, upright over flat, less 1"
_JAW = "push against a jaw without a finger with 20 N, and read on a dial gauge how far it gives way per N"
_POST = "push up against an object on its post with 20 N, and read on a dial gauge how far it gives way per N"
_EDGE = "photograph an object's edge with a scale, and measure by how much its radius is larger than drawn"

MEASUREMENTS: tuple[Measurement, ...] = tuple(
    Measurement(*row)
    for row in (
        ("walls", _WALLS, "Walls, more than drawn, mm", "wall_thickness_offset", "offset_mm", 0.03, 6.0, (-1.0, 1.0)),
        ("photograph", _BOW, "Bow of the ribs, mm", "rib_imperfection", "bow_mm", 0.1, 8.0, (0.0, 3.0)),
        ("dead_weight", _WEIGHT, "Reading less 9.81 N, N", "load_cell_offset", "offset_n", 0.05, 10.0, (-5.0, 5.0)),
        ("tensile_bar", _BARS, "Ratio of moduli, less 1", "print_anisotropy", "rib_excess", 0.05, 60.0, (-0.9, 2.0)),
        ("jaw_push", _JAW, "Jaw, mm/N", "base_compliance", "compliance_mm_per_n", 0.005, 10.0, (0.0, 1.0)),
        ("post_push", _POST, "Post, mm/N", "object_post_compliance", "compliance_mm_per_n", 0.005, 10.0, (0.0, 1.0)),
        ("edge_photograph", _EDGE, "Radius, mm", "object_edge_radius", "extra_radius_mm", 0.1, 8.0, (-3.0, 5.0)),
    )
)


def find_measurement(kind: str) -> Measurement | None:
    """The measurement of this kind, if there is one."""
    return next((one for one in MEASUREMENTS if one.kind == kind), None)


def forecast_readings(
    names: Sequence[str], probability: np.ndarray, parameters: Mapping[str, Mapping[str, tuple[float, float]]]
) -> tuple[tuple[Measurement, ...], Forecast]:
    """Measurements that any of the hypotheses has a say in, and what each of them (h) predicts of them.

    parameters: of each effect, value and standard deviation. What nobody in the catalogue explains may be seen by a
    person or not: *unknown* predicts anything that an effect might.
    """
    known = tuple(one for one in MEASUREMENTS if one.parameter in parameters.get(one.effect, {}))
    means, columns = np.zeros((len(names), len(known), 1)), []
    for place, name in enumerate(names):
        spread = np.zeros((len(known), 1, len(known)))
        for at, one in enumerate(known):
            value, sd = parameters[one.effect][one.parameter]
            is_own = name == one.effect
            means[place, at] = value if is_own else one.nothing
            spread[at, 0, at] = sd if is_own else _imagine(one) if name == UNKNOWN else 0.0
        columns.append(spread)
    noise = np.array([[[one.sd**2]] for one in known]).reshape(len(known), 1, 1)
    is_sharp = np.array([name != UNKNOWN for name in names])
    return known, Forecast(tuple(names), probability, is_sharp, means, tuple(columns), np.zeros_like(noise), noise)


def _imagine(one: Measurement) -> float:
    """How far a reading may be from nothing if something is wrong that the catalogue does not know."""
    spec = next(p for p in CATALOGUE[one.effect].parameters if p.name == one.parameter)
    return float(abs(spec.prior_median - spec.neutral) + spec.prior_sd)
