"""Theta, tools, numerical error and effects fitted together: penalised least squares on whitened features.

Gauss-Newton with finite differences of the predictor, weighted again at each step (`models.gap.fit.robust`).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from models.gap.fit.robust import damped, root_weights
from models.gap.fit.whiten import IS_LIFT, Working
from models.records import EffectValue
from models.simulation.effects.catalogue import CATALOGUE

TOOL_SD = 0.04  # of the modulus from print to print: notes/gap.md section 3
_SHIFT_SD = np.array([1.0, 0.5, 0.15])  # weak priors about the bank's centre: ln E, friction, Poisson ratio
_STEP = np.array([0.02, 0.01, 0.005])  # of finite differences of theta
_RATIO_MARGIN = 1e-3
_N_THETA = 3
_STEPS, _HALVINGS, _SETTLED = 12, 4, 1e-3
_PARAMETER_STEP = 0.04
_NEAR, HELD = 0.99, 1e6  # a bound of one, and the precision of a coordinate that is there


@dataclass(frozen=True, eq=False)
class Axis:
    """One parameter of one effect on an axis on which it is fitted: linear, logarithmic or inverse."""

    effect: str
    name: str
    kind: str
    lower: float
    upper: float
    middle: float
    sd: float

    def inner(self, value: float) -> float:
        """The coordinate of a value; about one unit is what it may plausibly vary by."""
        return (self._transformed(value) - self.middle) / self.sd

    def value(self, inner: float) -> float:
        """The value of a coordinate, within the bounds."""
        at = self.middle + self.sd * inner
        if self.kind == "log":
            at = float(np.exp(at))
        elif self.kind == "inverse":
            at = 1.0 / max(at, 1.0 / self.upper)
        return float(np.clip(at, self.lower, self.upper))

    @property
    def limits(self) -> tuple[float, float]:
        """Coordinates of the bounds, in order."""
        ends = (self.inner(self.lower), self.inner(self.upper))
        return min(ends), max(ends)

    def _transformed(self, value: float) -> float:
        if self.kind == "linear":
            return value
        return float(np.log(value)) if self.kind == "log" else 1.0 / value


def axes_of(effect: str) -> list[Axis]:
    """Axes of an effect's parameters: shapes are logarithmic, a limit that is neutral at infinity is inverse."""
    axes = []
    for place, p in enumerate(CATALOGUE[effect].parameters):
        if p.neutral >= 1e5:
            kind, middle, sd = "inverse", 0.0, 2.0 / p.prior_median
        elif p.neutral == p.prior_median and p.lower > 0 and place > 0:
            kind, middle, sd = "log", float(np.log(p.prior_median)), 1.0
        else:
            kind, middle, sd = "linear", p.neutral, 2.0 * (abs(p.prior_median - p.neutral) + p.prior_sd)
        axes.append(Axis(effect, p.name, kind, p.lower, p.upper, middle, sd))
    return axes


@dataclass(frozen=True, eq=False)
class Fit:
    """A fit to m grasps with t tools and v numerical errors.

    theta: 3. tool_log: t, logarithm of the tools' moduli over Young's modulus. numerical: v, of unit variance.
    raw: m x f, the whitened residual; weight: m x 1, roots of its weights; residual: their product. columns: c x m x f,
    weighted slopes by theta, tools, numerical errors and effects' parameters in this order; precision: c, of their
    priors; pull: c, slopes of their penalties. loss: negative log density, but for a constant.
    """

    working: Working
    theta: np.ndarray
    tool_log: np.ndarray
    numerical: np.ndarray
    effects: tuple[EffectValue, ...]
    modelled: np.ndarray
    raw: np.ndarray
    weight: np.ndarray
    columns: np.ndarray
    precision: np.ndarray
    pull: np.ndarray
    loss: float

    @property
    def residual(self) -> np.ndarray:
        """The whitened and weighted residual, m x f."""
        return self.raw * self.weight

    @property
    def covariance(self) -> np.ndarray:
        """Inverse of the curvature, c x c."""
        flat = self.columns.reshape(len(self.columns), -1)
        return np.asarray(np.linalg.inv(flat @ flat.T + np.diag(self.precision)))

    @property
    def tool_factor(self) -> np.ndarray:
        """Moduli of tools over Young's modulus, t."""
        return np.exp(self.tool_log)

    @property
    def n_effect_columns(self) -> int:
        """How many of the last columns are parameters of effects."""
        return sum(len(CATALOGUE[value.effect].parameters) for value in self.effects)

    def predicted(self, effects: Sequence[EffectValue] | None = None) -> np.ndarray:
        """Features at the fit, with these effects instead of its own, m x f, not whitened."""
        return self.working.predictor.features(
            self.theta, self.effects if effects is None else effects, self.tool_factor
        )


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
    """Fits effects to working data, starting from a theta."""

    def __init__(self, working: Working, theta: np.ndarray, effects: Sequence[EffectValue] = ()) -> None:
        self.working = working
        self.n_tools = len(working.predictor.grasps.tools)
        self.names = tuple(value.effect for value in effects)
        self.axes = [axis for name in self.names for axis in axes_of(name)]
        known = {value.effect: CATALOGUE[value.effect].neutral.parameters | value.parameters for value in effects}
        inner = [axis.inner(known[axis.effect][axis.name]) for axis in self.axes]
        nothing = np.zeros(self.n_tools + len(working.numerical))
        start = np.concatenate([[np.log(theta[0])], theta[1:], nothing, inner])
        self._shift = _N_THETA + len(nothing) - 1  # the last numerical error, between -1 and 1
        self.start = _Point(start, self.n_tools, len(working.numerical))
        surfaces = working.predictor.surfaces
        self.lower, self.upper = surfaces.lower, surfaces.upper - np.array([0.0, _RATIO_MARGIN])
        centre = working.predictor.centre
        at = np.array([np.log(centre.young_modulus_mpa), centre.friction, centre.poisson_ratio])
        self.middle = np.concatenate([at, nothing, np.zeros(len(inner))])
        self.precision = np.concatenate(
            [
                _SHIFT_SD**-2.0,
                np.full(self.n_tools, TOOL_SD**-2.0),
                np.ones(len(working.numerical)),
                np.full(len(inner), 0.25),
            ]
        )

    def fit(self, n_steps: int = _STEPS) -> Fit:
        """The fit; Gauss-Newton until a step changes no coordinate by much against its standard deviation."""
        point, residual = self.start, self._residual(self.start)
        loss = self._loss(point, residual)
        columns = self._columns(point)
        for _ in range(n_steps):
            weight = root_weights(residual)
            step, sd = self._step(point, columns * weight, residual * weight)
            point, residual, loss, moved = self._searched(point, residual, loss, step)
            if not moved:
                break
            columns = self._columns(point)
            if (np.abs(step) < _SETTLED + 0.05 * sd).all():
                break
        weight = root_weights(residual)
        precision = self._held(point)
        return Fit(
            working=self.working,
            theta=point.theta,
            tool_log=point.tool_log,
            numerical=point.numerical,
            effects=self._effects(point),
            modelled=self._predicted(point),
            raw=residual,
            weight=weight,
            columns=columns * weight,
            precision=precision,
            pull=np.where(precision == HELD, 0.0, precision * (point.vector - self.middle)),
            loss=loss,
        )

    def _searched(
        self, point: _Point, residual: np.ndarray, loss: float, step: np.ndarray
    ) -> tuple[_Point, np.ndarray, float, bool]:
        """The first of ever shorter steps that lowers the loss, and whether there is one."""
        for halving in range(_HALVINGS):
            tried = self._inside(replace(point, vector=point.vector + 0.5**halving * step))
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
        """Precisions; the shift of all traces is held at the most that it may be."""
        precision = self.precision.copy()
        if abs(point.vector[self._shift]) > _NEAR:
            precision[self._shift] = HELD
        return precision

    def _residual(self, point: _Point) -> np.ndarray:
        return self.working.whitened(self.working.measured - self._predicted(point))

    def _predicted(self, point: _Point) -> np.ndarray:
        tool_factor = np.exp(point.tool_log)
        features = self.working.predictor.features(point.theta, self._effects(point), tool_factor)
        return features + np.tensordot(point.numerical, self._numerical(point), 1)

    def _numerical(self, point: _Point) -> np.ndarray:
        stiffer = point.theta[0] / self.working.predictor.centre.young_modulus_mpa
        return np.asarray(self.working.numerical * np.where(IS_LIFT, 1.0, stiffer))

    def _columns(self, point: _Point) -> np.ndarray:
        """Whitened slopes of the prediction by every coordinate."""
        base = self._predicted(point)
        rows = [(self._predicted(self._moved(point, i, h)) - base) / h for i, h in enumerate(_STEP)]
        tools = [np.where((self.working.tool == tool)[:, None], rows[0], 0.0) for tool in range(self.n_tools)]
        first = len(point.vector) - len(self.axes)
        inner = []
        for place, axis in enumerate(self.axes):
            # Away from the nearer bound, since a limit that is not reached has no slope.
            low, high = axis.limits
            h = _PARAMETER_STEP if point.inner[place] - low < high - point.inner[place] else -_PARAMETER_STEP
            inner.append((self._predicted(self._moved(point, first + place, h)) - base) / h)
        return self.working.whitened(np.array([*rows, *tools, *self._numerical(point), *inner]))

    def _moved(self, point: _Point, place: int, step: float) -> _Point:
        vector = point.vector.copy()
        vector[place] += step
        return replace(point, vector=vector)

    def _inside(self, point: _Point) -> _Point:
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
        squares = (damped(residual) ** 2).sum()
        return float(0.5 * squares + 0.5 * (self.precision * (point.vector - self.middle) ** 2).sum())
