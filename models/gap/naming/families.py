"""Families: effects that the data cannot tell apart once neither has to obey the catalogue's law to the letter.

A transmitter that lags, a clock that is late and a gantry that starts slowly all delay the force. Two of them with
their catalogue laws may lie tens of nats apart, but so does the bench from either. So the distance of two fitted
candidates is what is left of the change that the better one makes when the other stands in for it, with theta, tools
and numerical error, its parameters, its other shapes and its law free (`models.gap.fit.law_freedom`), each at the cost
of its prior. Below `LEAST_NATS` they are kin. Membership is measured in these data; only the words for a family are
fixed, in the catalogue.
"""

from collections.abc import Sequence, Set
from dataclasses import dataclass

import numpy as np

from fast.models.gap.fit.fit import DEFLATION, Axis, Fit, axes_of
from fast.models.gap.fit.law_freedom import LAW_SD, LawFreedom
from fast.models.gap.naming.candidates import FittedCandidate
from fast.models.gap.naming.rank_effects import LEAST_NATS, list_secants
from fast.models.records import EffectValue
from fast.models.simulation.effects.base import USUAL_LIFT_MM_PER_S
from fast.models.simulation.effects.catalogue import CATALOGUE, build_effects
from fast.models.simulation.effects.sensor import LIFT_MISALIGNMENT

_PARAMETER_PRECISION = 0.25  # of a coordinate, as in a fit
_STEP = 0.04  # of finite differences, of a coordinate
_DELAY_SHARES = (0.25, 0.5, 0.75, 1.0, 1.25, 1.5, 2.0, 3.0)
_MIXTURE_SD = 3.0  # of what an effect and shares of its delay add: next to no prior


@dataclass(frozen=True, eq=False)
class Families:
    """What the data can tell apart among n candidates, with freedom of their laws.

    effects: n, of each candidate. nats: n x n, between their predictions.
    """

    effects: tuple[tuple[str, ...], ...]
    nats: np.ndarray

    def kin_of(self, effect: str) -> tuple[str, ...]:
        """The single effects that the data cannot tell from this one, the nearest first; without itself."""
        place = self.effects.index((effect,))
        near = [other for other in np.argsort(self.nats[place]) if other != place]
        return tuple(
            self.effects[other][0]
            for other in near
            if self.nats[place, other] < LEAST_NATS and len(self.effects[other]) == 1
        )


def find_families(base: Fit, candidates: Sequence[FittedCandidate]) -> Families:
    """Which of the candidates these data cannot tell apart. base: the fit without them."""
    return Families(tuple(candidate.effects for candidate in candidates), compute_kinship(base, candidates))


def compute_kinship(base: Fit, candidates: Sequence[FittedCandidate]) -> np.ndarray:
    """Nats between n candidates, n x n: what is left if the worse of two stands in for the better.

    The worse may change its parameters, within their priors, its shape, and its law. The better keeps its own: a law
    that is free could as well shrink to nothing, as could a candidate that explains little stand for nothing. base: the
    fit without them, whose effects all of them have.
    """
    known = {value.effect for value in base.effects}
    nats = np.zeros((len(candidates), len(candidates)))
    for place, first in enumerate(candidates):
        for other in range(place):
            nats[place, other] = nats[other, place] = _separate(first.fit, candidates[other].fit, known)
    return nats


def _separate(first: Fit, second: Fit, known: Set[str]) -> float:
    """Of two fits with effects besides those that are known."""
    better, worse = (first, second) if first.loss <= second.loss else (second, first)
    rest = [value for value in better.effects if value.effect in known]
    goal = better.predict_features() - better.predict_features(rest)
    values = [value for value in worse.effects if value.effect not in known]
    stand_ins = [values]
    if len(values) == 1:
        stand_ins += [[value] for value in _list_shapes(values[0])]
    return min(_stand_in(better, rest, goal, stand_in) for stand_in in stand_ins)


def _stand_in(fit: Fit, rest: Sequence[EffectValue], goal: np.ndarray, values: Sequence[EffectValue]) -> float:
    """Nats that are left of a change (m x f) where effects with these parameters and free laws stand in for it."""
    whiten, base = fit.features.whiten, fit.predict_features(rest)
    change = fit.predict_features([*rest, *values]) - base
    by_parameter, by_law = [], []
    for place, value in enumerate(values):
        for axis in axes_of(value.effect):
            moved = [*values[:place], _move(value, axis), *values[place + 1 :]]
            by_parameter.append((fit.predict_features([*rest, *moved]) - base - change) / _step_of(axis, value))
        own = change if len(values) == 1 else fit.predict_features([*rest, value]) - base
        freedom = LawFreedom.of(fit, value.effect, own)
        if freedom is not None:
            by_law.append(LAW_SD * freedom.columns(fit) / fit.weight)
        by_law.append(_MIXTURE_SD * whiten(_list_delays(fit, rest, value)))
    is_free = np.ones(len(fit.columns), dtype=bool)
    names = [value.effect for value in fit.effects for _ in axes_of(value.effect)]
    is_free[len(fit.columns) - len(names) :] = [name in {value.effect for value in rest} for name in names]
    columns = np.concatenate(
        [fit.columns[is_free], fit.weight * whiten(np.array(by_parameter)), *(fit.weight * law for law in by_law)]
    )
    tied = [fit.precision[is_free], np.full(len(by_parameter), _PARAMETER_PRECISION)]
    precision = np.concatenate([*tied, np.ones(len(columns) - sum(map(len, tied)))])
    flat, wanted = columns.reshape(len(columns), -1), (whiten(goal - change) * fit.weight).ravel()
    along = DEFLATION * flat @ wanted
    inside = along @ np.linalg.solve(DEFLATION * flat @ flat.T + np.diag(precision), along)
    return float(0.5 * (DEFLATION * wanted @ wanted - inside))


def _list_delays(fit: Fit, rest: Sequence[EffectValue], value: EffectValue) -> np.ndarray:
    """What an effect that delays the force changes, and what shares of its delay do, each per delay, d x m x f.

    A transmitter may answer at once but slowly, or late but at once: how a delay is spread is not known at all, so
    these mix as they please. Nothing for other effects.
    """
    base, speeds = fit.predict_features(rest), fit.features.surrogate.grasps.lift_speed_mm_per_s
    (effect,) = build_effects([value])
    late_mm = {speed: effect.delay_mm(speed) for speed in np.unique(speeds)}
    if not any(late_mm.values()):
        return np.zeros((0, *base.shape))
    found = np.zeros((1 + len(_DELAY_SHARES), *base.shape))
    found[0] = fit.predict_features([*rest, value]) - base
    shift = LIFT_MISALIGNMENT.parameters[0]
    for place, share in enumerate(_DELAY_SHARES, start=1):
        for speed, own_mm in late_mm.items():
            at_usual_mm = own_mm * USUAL_LIFT_MM_PER_S / speed
            shift_mm = float(np.clip(share * at_usual_mm, -shift.upper, shift.upper))
            shifted = EffectValue(effect=LIFT_MISALIGNMENT.effect, parameters={shift.name: shift_mm})
            rows = speeds == speed
            found[place, rows] = (fit.predict_features([*rest, shifted]) - base)[rows] * at_usual_mm / shift_mm
    return found


def _move(value: EffectValue, axis: Axis) -> EffectValue:
    """The value with one parameter a step further along its axis."""
    inner = axis.inner(value.parameters[axis.name]) + _step_of(axis, value)
    return value.model_copy(update={"parameters": {**value.parameters, axis.name: axis.value(inner)}})


def _step_of(axis: Axis, value: EffectValue) -> float:
    """A step of the coordinate away from the nearer bound."""
    low, high = axis.limits
    inner = axis.inner(value.parameters[axis.name])
    return _STEP if inner - low < high - inner else -_STEP


def _list_shapes(value: EffectValue) -> list[EffectValue]:
    """The value with the other shapes at which its effect is tried (`list_secants`)."""
    amplitude = CATALOGUE[value.effect].parameters[0].name
    shapes: list[dict[str, float]] = []
    for secant in list_secants(value.effect):
        shape = {name: number for name, number in secant.parameters.items() if name != amplitude}
        if shape and shape not in shapes:
            shapes.append(shape)
    return [value.model_copy(update={"parameters": {**value.parameters, **shape}}) for shape in shapes]
