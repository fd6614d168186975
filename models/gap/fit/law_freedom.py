"""Freedom of a law: what a fit grants an effect for a law that is not quite the catalogue's.

The bench never has the catalogue's law: friction falls along a rational curve where an exponential is known. So what an
effect changes at the fit, g, may be g (1 + h) instead, with h a Gaussian process along the state of the effect
(`EffectSpec.state`): h ~ GP(0, `LAW_SD`^2 k), k squared-exponential with a length of `LENGTH_SHARE` of the range of
states that occur. It is one function for all grasps, so what it learns of some holds for the others. Written by its
values at a few knots, whitened by their covariance, it is linear: a fit with this freedom is a fit with a few columns
more. The data then decide on theta, parameters and law together, and a parameter is known no better than its law.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fast.models.gap.bank.surrogate import FEATURES, N_BINS
from fast.models.gap.findings import LawCurve, ParameterEstimate
from fast.models.gap.fit.fit import Axis, Fit, axes_of
from fast.models.gap.fit.whitened_features import IS_LIFT
from fast.models.simulation.effects.catalogue import CATALOGUE
from fast.models.simulation.effects.states import State
from fast.models.traces.step_features import CENTRES_MM, PEAK

LAW_SD = 0.3  # of h: how far the bench's law is from the catalogue's, relative to the effect
LENGTH_SHARE = 1.0 / 3.0  # of the range of states
N_KNOTS = 7
_JITTER = 1e-6
_SAME = 1e-6  # of singular values: parameters that change the same, such as one that has no effect here
_Z90 = 1.645
_N_STATES = 25
_STEP = 1e-3  # of finite differences, of a coordinate
_CHANGE = "change of the force over the largest of the grasp"
_LEAST_CHANGE = 0.02  # of the largest: states in which the effect changes less do not count for its range
_LIFT_AT_PEAK, _PEAK, _TAIL = (FEATURES.index(name) for name in ("lift_at_peak_mm", PEAK, "tail_n_mm"))


@dataclass(frozen=True, eq=False)
class LawFreedom:
    """The freedom of an effect's law at a fit, on k knots.

    change: m x f, what the effect changes in the features. knots: k, places of the state. root: k x k, the Cholesky
    factor of the knots' covariance, in which weights have unit variance times `LAW_SD`^2. seen: m x f, which features
    the effect changes enough to say anything about its law.
    """

    effect: str
    state: State
    change: np.ndarray
    at: np.ndarray
    seen: np.ndarray
    knots: np.ndarray
    root: np.ndarray

    @staticmethod
    def of(fit: Fit, effect: str) -> "LawFreedom | None":
        """Return the freedom of an effect at a fit; None if it has no law, or changes nothing here."""
        state = CATALOGUE[effect].state
        if state is None:
            return None
        others = [value for value in fit.effects if value.effect != effect]
        change = fit.predict_features() - fit.predict_features(others)
        at, size = state.place(read_state(fit, state)), np.abs(fit.features.whiten(change))
        seen = size > _LEAST_CHANGE * size.max()
        if not seen.any() or np.ptp(at[seen]) < 1e-9:
            return None
        knots = np.linspace(at[seen].min(), at[seen].max(), N_KNOTS)
        covariance = _kernel(knots, knots, np.ptp(knots)) + _JITTER * np.eye(N_KNOTS)
        return LawFreedom(effect, state, change, at, seen, knots, np.linalg.cholesky(covariance))

    def basis(self, at: np.ndarray) -> np.ndarray:
        """Compute what each weight adds to h at places (any shape), k x ...; constant beyond the knots."""
        inside = np.clip(at, self.knots[0], self.knots[-1])
        flat = _kernel(self.knots, inside.ravel(), np.ptp(self.knots))
        return np.asarray(np.linalg.solve(self.root, flat)).reshape(len(self.knots), *at.shape)

    def columns(self, fit: Fit) -> np.ndarray:
        """Return the columns of a fit (k x m x f, whitened and weighted)."""
        return np.asarray(fit.features.whiten(self.basis(self.at) * self.change) * fit.weight)


def free_law(fit: Fit, effect: str, *, is_apart: bool = False) -> Fit:
    """Free the law of one of a fit's effects: its freedom as further columns; the same fit if it has no law.

    is_apart: without what the effect's own parameters can do (Plumlee 2017), so that these are of the catalogue's law
    that fits best; else a law that is free to shrink or grow leaves their size to the prior. Nothing is fitted again:
    `solve_step` says where the freed fit goes.
    """
    freedom = LawFreedom.of(fit, effect)
    if freedom is None:
        return fit
    columns = freedom.columns(fit)
    if is_apart:
        places = [place for _, _, place in _list_axes(fit, effect)]
        own, free = (part.reshape(len(part), -1).T for part in (fit.columns[places], columns))
        columns = (free - own @ np.linalg.lstsq(own, free, rcond=_SAME)[0]).T.reshape(columns.shape)
    return fit.add_columns(columns, LAW_SD)


def solve_step(fit: Fit) -> np.ndarray:
    """Compute how far each coordinate of a fit (c) is from the best, to first order; 0 if no further columns."""
    flat = fit.columns.reshape(len(fit.columns), -1)
    return np.asarray(fit.covariance @ (flat @ fit.residual.ravel() - fit.pull))


def estimate_freed_parameters(fit: Fit, effect: str) -> dict[str, ParameterEstimate]:
    """Estimate values of the parameters of an effect of a fit, and their 90 % intervals when its law is free.

    The values are those of the catalogue's law that fits best, since that is what a simulator gets.
    """
    freed = free_law(fit, effect)
    sd = np.sqrt(np.diag(freed.deflated_covariance))
    found = {}
    for axis, value, place in _list_axes(freed, effect):
        ends = [axis.value(axis.inner(value) + side * _Z90 * float(sd[place])) for side in (-1.0, 1.0)]
        found[axis.name] = ParameterEstimate(median=value, ci90=(min(ends), max(ends)))
    return found


def compute_law_curve(fit: Fit, effect: str) -> LawCurve | None:
    """Compute the law of an effect of a fit as the data have it, with its 90 % band, over the states that occur.

    The curve is linear in parameters and h, as the freed fit is, so its posterior is normal: as wide as deflated data,
    and what other solvers are worth (`Fit.worth`), make it. Where the law is of a known quantity, its distance from no
    effect is multiplied by 1 + h; else the curve is the change of the force in such states. None for an effect that is
    a plain number, or changes nothing.
    """
    freedom = LawFreedom.of(fit, effect)
    if freedom is None:
        return None
    freed = fit.add_columns(freedom.columns(fit), LAW_SD)
    places = np.linspace(freedom.knots[0], freedom.knots[-1], _N_STATES)
    states = freedom.state.state_at(places)
    quantity = CATALOGUE[effect].quantity
    if quantity is None:
        neutral, (change, *slopes) = 0.0, _average_changes(freed, freedom, places)
    else:
        neutral, (change, *slopes) = quantity.neutral, _linearise_law(freed, effect, states, quantity.neutral)
    end = len(freed.columns) - freed.n_effect_columns
    first = _list_axes(freed, effect)[0][2]
    moved = np.zeros((len(places), len(freed.columns)))
    moved[:, end - N_KNOTS : end] = (freedom.basis(places) * change).T
    moved[:, first : first + len(slopes)] = np.array(slopes).T
    median = neutral + change + moved @ solve_step(freed)
    variance = ((moved @ freed.deflated_covariance) * moved).sum(axis=1) + ((moved @ freed.worth) ** 2).sum(axis=1)
    half = _Z90 * np.sqrt(variance)
    return LawCurve(
        quantity=_CHANGE if quantity is None else quantity.name,
        state=freedom.state.name,
        at=tuple(states.tolist()),
        median=tuple(median.tolist()),
        low=tuple((median - half).tolist()),
        high=tuple((median + half).tolist()),
    )


def _kernel(first: np.ndarray, second: np.ndarray, extent: float) -> np.ndarray:
    return np.asarray(np.exp(-0.5 * ((first[:, None] - second) / (LENGTH_SHARE * extent)) ** 2))


def _list_axes(fit: Fit, effect: str) -> Sequence[tuple[Axis, float, int]]:
    """List the axes of an effect's parameters, their values, and their columns in the fit."""
    place, found = len(fit.columns) - fit.n_effect_columns, []
    for value in fit.effects:
        for axis in axes_of(value.effect):
            if value.effect == effect:
                found.append((axis, value.parameters[axis.name], place))
            place += 1
    return found


def _linearise_law(fit: Fit, effect: str, states: np.ndarray, neutral: float) -> np.ndarray:
    """Compute the catalogue's law at k states, less no effect, and its slope by each parameter's coordinate, 1 + p x k.

    A law that has a speed in it is that of the base setup.
    """
    axes, speed = _list_axes(fit, effect), fit.features.surrogate.grasps.base_setup.lift_speed_mm_per_s
    kind, known = CATALOGUE[effect].kind, {axis.name: value for axis, value, _ in axes}
    here = kind(**known).law(states, speed)
    slopes = []
    for axis, value, _ in axes:
        inner = axis.inner(value)
        step = _STEP if inner + _STEP < axis.limits[1] else -_STEP
        moved = kind(**known | {axis.name: axis.value(inner + step)})
        slopes.append((moved.law(states, speed) - here) / step)
    return np.array([here - neutral, *slopes])


def _average_changes(fit: Fit, freedom: LawFreedom, places: np.ndarray) -> np.ndarray:
    """Average the change of force over the grasp's largest round k places of the state, and its slopes, 1 + p x k."""
    own = [place for _, _, place in _list_axes(fit, freedom.effect)]
    slopes = fit.features.unwhiten(fit.columns[own] / fit.weight)
    share = np.concatenate([freedom.change[None], slopes]) / fit.features.amplitude
    near = np.exp(-0.5 * ((freedom.at[..., None] - places) / (0.5 * LENGTH_SHARE * np.ptp(freedom.knots))) ** 2)
    near = near * (freedom.seen & ~IS_LIFT)[..., None]
    return np.asarray(np.einsum("cmf,mfk->ck", share, near) / near.sum(axis=(0, 1)))


def read_state(fit: Fit, state: State) -> np.ndarray:
    """Read the state at every feature of every grasp of a fit, m x f."""
    if not callable(state.read):
        along = {"lift": _read_lift, "held": _read_lift_time, "force": _read_force, "level": _read_level}
        return along[state.read](fit)
    grasps = fit.features.surrogate.grasps
    rows = zip(grasps.tool, grasps.setup, grasps.contexts, strict=True)
    values = np.array([state.read(grasps.designs[tool], grasps.setups[at], context) for tool, at, context in rows])
    return np.repeat(values[:, None], len(FEATURES), axis=1)


def _read_lift(fit: Fit) -> np.ndarray:
    """Lift that a feature is about, mm."""
    lift_mm = np.tile([CENTRES_MM.get(name, 0.0) for name in FEATURES], (len(fit.raw), 1))
    lift_mm[:, [_LIFT_AT_PEAK, _PEAK]] = np.clip(fit.modelled[:, [_LIFT_AT_PEAK]], 0.0, None)
    return lift_mm


def _read_lift_time(fit: Fit) -> np.ndarray:
    """Read the time of a feature since the end of closing, s."""
    grasps = fit.features.surrogate.grasps
    dwell_s = np.array([setup.dwell_s for setup in grasps.setups])[grasps.setup]
    return np.asarray(_read_lift(fit) / grasps.lift_speed_mm_per_s[:, None] + dwell_s[:, None])


def _read_level(fit: Fit) -> np.ndarray:
    """Compute the root mean square force of a grasp over the bins of its lift, N."""
    level_n = np.sqrt((fit.modelled[:, :N_BINS] ** 2).mean(axis=1))
    return np.repeat(level_n[:, None], len(FEATURES), axis=1)


def _read_force(fit: Fit) -> np.ndarray:
    """Read the size of the force where a feature is taken, N; of lengths and areas that of the peak."""
    force_n = np.abs(fit.modelled)
    force_n[:, [_LIFT_AT_PEAK, _TAIL]] = force_n[:, [_PEAK]]
    return force_n
