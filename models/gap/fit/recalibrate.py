"""Recalibration: theta, tools, numerical error and the parameters of effects fitted to grasps together.

Penalised least squares on whitened features: Gauss-Newton with finite differences of the surrogate, weighted again at
each step by the robust loss. A gap is only what is left after that.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from fast.models.gap.bank.surrogate import Surrogate
from fast.models.gap.fit.fit import HELD, Fit, axes_of
from fast.models.gap.fit.whitened_features import (
    IS_LIFT,
    WhitenedFeatures,
    apply_robust_loss,
    compute_root_weights,
    whiten_features,
)
from fast.models.records import EffectValue
from fast.models.simulation.effects.catalogue import CATALOGUE

TOOL_SD = 0.04  # of the modulus from print to print
_SHIFT_SD = np.array([1.0, 0.5, 0.15])  # weak priors about the bank's centre: ln E, friction, Poisson ratio
_STEP = np.array([0.02, 0.01, 0.005])  # of finite differences of theta
_RATIO_MARGIN = 1e-3
_N_THETA = 3
_STEPS, _HALVINGS, _SETTLED = 12, 4, 1e-3
_PARAMETER_STEP = 0.04
_NEAR = 0.99  # of a bound of one: a coordinate that is there is held
_N_FRICTION, _N_RATIO = 9, 4
_ROUNDS = 2  # errors are judged at the first estimate, then at the fit


def recalibrate(surrogate: Surrogate, effects: Sequence[EffectValue] = ()) -> Fit:
    """Fit theta, tools, numerical error and the parameters of effects to the grasps of a surrogate.

    effects: with the values at which the fit begins; without any, theta alone is fitted. Naming has no part in this:
    any grasps with a bank around them are calibrated so, and `models.gap.fit.posterior` draws from the posterior.
    """
    theta = estimate_theta(surrogate, effects)
    tool_factor = np.ones(len(surrogate.grasps.tools))
    starts = [theta, _start_at_centre(surrogate, effects)]
    for _ in range(_ROUNDS):
        predicted_n = surrogate.predict_with_lead(theta, effects, tool_factor)
        features = whiten_features(surrogate, predicted_n, theta[0] / surrogate.centre.young_modulus_mpa)
        fit = min((Fitter(features, start, effects).fit() for start in starts), key=lambda found: found.loss)
        theta, tool_factor, effects = fit.theta, fit.tool_factor, fit.effects
        starts = [theta]
    return fit


def estimate_theta(surrogate: Surrogate, effects: Sequence[EffectValue] = ()) -> np.ndarray:
    """Fit step means by least squares over a lattice of friction and Poisson ratio, the best modulus at each (3)."""
    lower, upper = surrogate.surfaces.lower, surrogate.surfaces.upper
    lattice = [
        _fit_modulus(surrogate, effects, friction, ratio)
        for friction in np.linspace(lower[0], upper[0], _N_FRICTION)
        for ratio in np.linspace(lower[1], upper[1], _N_RATIO)
    ]
    return min(lattice, key=lambda found: found[1])[0]


@dataclass(frozen=True, eq=False)
class _Point:
    """Where a fit stands: theta as (ln E, friction, Poisson ratio), tools, numerical errors, effects' coordinates."""

    vector: np.ndarray
    n_tools: int
    n_numerical: int

    @property
    def theta(self) -> np.ndarray:
        return np.array([np.exp(self.vector[0]), *self.vector[1:3]])

    @property
    def tool_log(self) -> np.ndarray:
        return self.vector[3 : 3 + self.n_tools]

    @property
    def numerical(self) -> np.ndarray:
        return self.vector[3 + self.n_tools :][: self.n_numerical]

    @property
    def inner(self) -> np.ndarray:
        return self.vector[3 + self.n_tools + self.n_numerical :]


class Fitter:
    """Fits effects to whitened features, starting from a theta."""

    def __init__(self, features: WhitenedFeatures, theta: np.ndarray, effects: Sequence[EffectValue] = ()) -> None:
        self.features = features
        self.n_tools = len(features.surrogate.grasps.tools)
        self.names = tuple(value.effect for value in effects)
        self.axes = [axis for name in self.names for axis in axes_of(name)]
        known = {value.effect: CATALOGUE[value.effect].neutral.parameters | value.parameters for value in effects}
        inner = [axis.inner(known[axis.effect][axis.name]) for axis in self.axes]
        nothing = np.zeros(self.n_tools + len(features.numerical))
        start = np.concatenate([[np.log(theta[0])], theta[1:], nothing, inner])
        self._shift = _N_THETA + len(nothing) - 1  # the last numerical error, between -1 and 1
        self.start = _Point(start, self.n_tools, len(features.numerical))
        surfaces = features.surrogate.surfaces
        self.lower, self.upper = surfaces.lower, surfaces.upper - np.array([0.0, _RATIO_MARGIN])
        centre = features.surrogate.centre
        at = np.array([np.log(centre.young_modulus_mpa), centre.friction, centre.poisson_ratio])
        self.middle = np.concatenate([at, nothing, np.zeros(len(inner))])
        self.precision = np.concatenate(
            [
                _SHIFT_SD**-2.0,
                np.full(self.n_tools, TOOL_SD**-2.0),
                np.ones(len(features.numerical)),
                np.full(len(inner), 0.25),
            ]
        )

    def fit(self, n_steps: int = _STEPS) -> Fit:
        """Fit by Gauss-Newton until a step changes no coordinate by much against its standard deviation."""
        point, residual = self.start, self._residual(self.start)
        loss = self._loss(point, residual)
        columns = self._columns(point)
        for _ in range(n_steps):
            weight = compute_root_weights(residual)
            step, sd = self._step(point, columns * weight, residual * weight)
            point, residual, loss, moved = self._search_along(point, residual, loss, step)
            if not moved:
                break
            columns = self._columns(point)
            if (np.abs(step) < _SETTLED + 0.05 * sd).all():
                break
        weight = compute_root_weights(residual)
        precision = self._held(point)
        return Fit(
            features=self.features,
            theta=point.theta,
            tool_log=point.tool_log,
            numerical=point.numerical,
            effects=self._effects(point),
            modelled=self._predict(point),
            raw=residual,
            weight=weight,
            columns=columns * weight,
            precision=precision,
            pull=np.where(precision == HELD, 0.0, precision * (point.vector - self.middle)),
            loss=loss,
        )

    def _search_along(
        self, point: _Point, residual: np.ndarray, loss: float, step: np.ndarray
    ) -> tuple[_Point, np.ndarray, float, bool]:
        """Find the first of ever shorter steps that lowers the loss, and whether there is one."""
        for halving in range(_HALVINGS):
            tried = self._clip(replace(point, vector=point.vector + 0.5**halving * step))
            after = self._residual(tried)
            lower = self._loss(tried, after)
            if lower < loss:
                return tried, after, lower, True
        return point, residual, loss, False

    def _step(self, point: _Point, columns: np.ndarray, residual: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        flat = columns.reshape(len(columns), -1)
        slope = flat @ residual.ravel() - self.precision * (point.vector - self.middle)
        gram = flat @ flat.T
        inverse = np.linalg.inv(gram + np.diag(self.precision))
        step = inverse @ slope
        if (self._held(point) != self.precision).any() and step[self._shift] * point.vector[self._shift] > 0:
            inverse = np.linalg.inv(gram + np.diag(self._held(point)))
            step = inverse @ np.where(np.arange(len(slope)) == self._shift, 0.0, slope)
        return step, np.sqrt(np.diag(inverse))

    def _held(self, point: _Point) -> np.ndarray:
        """Return precisions; the shift of all traces is held at the most that it may be."""
        precision = self.precision.copy()
        if abs(point.vector[self._shift]) > _NEAR:
            precision[self._shift] = HELD
        return precision

    def _residual(self, point: _Point) -> np.ndarray:
        return self.features.whiten(self.features.measured - self._predict(point))

    def _predict(self, point: _Point) -> np.ndarray:
        tool_factor = np.exp(point.tool_log)
        predicted = self.features.surrogate.predict_features(point.theta, self._effects(point), tool_factor)
        return predicted + np.tensordot(point.numerical, self._numerical(point), 1)

    def _numerical(self, point: _Point) -> np.ndarray:
        stiffer = point.theta[0] / self.features.surrogate.centre.young_modulus_mpa
        return np.asarray(self.features.numerical * np.where(IS_LIFT, 1.0, stiffer))

    def _columns(self, point: _Point) -> np.ndarray:
        """Compute whitened slopes of the prediction by every coordinate."""
        base = self._predict(point)
        rows = [(self._predict(self._move(point, i, h)) - base) / h for i, h in enumerate(_STEP)]
        tools = [np.where((self.features.tool == tool)[:, None], rows[0], 0.0) for tool in range(self.n_tools)]
        first = len(point.vector) - len(self.axes)
        inner = []
        for place, axis in enumerate(self.axes):
            # Away from the nearer bound, since a limit that is not reached has no slope.
            low, high = axis.limits
            h = _PARAMETER_STEP if point.inner[place] - low < high - point.inner[place] else -_PARAMETER_STEP
            inner.append((self._predict(self._move(point, first + place, h)) - base) / h)
        return self.features.whiten(np.array([*rows, *tools, *self._numerical(point), *inner]))

    def _move(self, point: _Point, place: int, step: float) -> _Point:
        vector = point.vector.copy()
        vector[place] += step
        return replace(point, vector=vector)

    def _clip(self, point: _Point) -> _Point:
        vector = point.vector.copy()
        vector[1:3] = np.clip(vector[1:3], self.lower, self.upper)
        vector[self._shift] = np.clip(vector[self._shift], -1.0, 1.0)
        if self.axes:
            limits = np.array([axis.limits for axis in self.axes])
            vector[-len(self.axes) :] = np.clip(point.inner, limits[:, 0], limits[:, 1])
        return replace(point, vector=vector)

    def _effects(self, point: _Point) -> tuple[EffectValue, ...]:
        values: dict[str, dict[str, float]] = {name: {} for name in self.names}
        for axis, inner in zip(self.axes, point.inner, strict=True):
            values[axis.effect][axis.name] = axis.value(float(inner))
        return tuple(EffectValue(effect=name, parameters=row) for name, row in values.items())

    def _loss(self, point: _Point, residual: np.ndarray) -> float:
        squares = (apply_robust_loss(residual) ** 2).sum()
        return float(0.5 * squares + 0.5 * (self.precision * (point.vector - self.middle) ** 2).sum())


def _start_at_centre(surrogate: Surrogate, effects: Sequence[EffectValue]) -> np.ndarray:
    """Return the bank's friction and Poisson ratio with the best modulus (3): plausible, however large the gap."""
    centre = surrogate.centre
    return _fit_modulus(surrogate, effects, centre.friction, centre.poisson_ratio)[0]


def _fit_modulus(
    surrogate: Surrogate, effects: Sequence[EffectValue], friction: float, ratio: float
) -> tuple[np.ndarray, float]:
    """Fit the modulus to the step means; return theta with the best one, and the squares that are left."""
    measured, modulus_mpa = surrogate.grasps.steps_n, surrogate.centre.young_modulus_mpa
    scale = np.abs(measured).max(axis=1, keepdims=True)
    weight = 1.0 / np.maximum(scale, 0.2 * np.median(scale)) ** 2
    predicted = surrogate.predict_steps(np.array([modulus_mpa, friction, ratio]), effects)
    gain = max(float((weight * measured * predicted).sum() / (weight * predicted**2).sum()), 1e-3)
    left = float((weight * (measured - gain * predicted) ** 2).sum())
    return np.array([gain * modulus_mpa, friction, ratio]), left
