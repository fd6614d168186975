"""What is fitted: theta, tools, numerical error and effects, each effect's parameters on axes of their own."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from fast.models.gap.fit.whitened_features import WhitenedFeatures
from fast.models.records import EffectValue
from fast.models.simulation.effects.catalogue import CATALOGUE

HELD = 1e6  # the precision of a coordinate that is at its bound
# Features of a cell and cells of a tool are no independent witnesses, though whitened: this share of them counts.
DEFLATION = 0.25


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
        """Return the coordinate of a value; about one unit is what it may plausibly vary by."""
        return (self._transform(value) - self.middle) / self.sd

    def value(self, inner: float) -> float:
        """Return the value of a coordinate, within the bounds."""
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

    def _transform(self, value: float) -> float:
        if self.kind == "linear":
            return value
        return float(np.log(value)) if self.kind == "log" else 1.0 / value


def axes_of(effect: str) -> list[Axis]:
    """List the axes of an effect's parameters: shapes logarithmic, a limit that is neutral at infinity inverse."""
    axes = []
    for place, p in enumerate(CATALOGUE[effect].parameters):
        if p.is_limit:
            kind, middle, sd = "inverse", 0.0, 2.0 / p.prior_median
        elif p.neutral == p.prior_median and p.lower > 0 and place > 0:
            kind, middle, sd = "log", float(np.log(p.prior_median)), 1.0
        else:
            kind, middle, sd = "linear", p.neutral, 2.0 * (abs(p.prior_median - p.neutral) + p.prior_sd)
        axes.append(Axis(effect, p.name, kind, p.lower, p.upper, middle, sd))
    return axes


@dataclass(frozen=True, eq=False)
class Fit:
    """A fit to m grasps with t tools and v numerical errors."""

    features: WhitenedFeatures
    """What is fitted: f whitened features of each grasp."""
    theta: np.ndarray
    """3, Young's modulus in MPa, friction, Poisson ratio."""
    tool_log: np.ndarray
    """t, logarithm of the tools' moduli over Young's modulus."""
    numerical: np.ndarray
    """v, of unit variance."""
    effects: tuple[EffectValue, ...]
    """That are fitted, with their values."""
    modelled: np.ndarray
    """m x 16, features at the fit, not whitened."""
    raw: np.ndarray
    """m x f, the whitened residual."""
    weight: np.ndarray
    """m x 1, roots of its weights."""
    columns: np.ndarray
    """c x m x f, weighted slopes by theta, tools, numerical errors and effects' parameters in this order."""
    precision: np.ndarray
    """c, of their priors."""
    pull: np.ndarray
    """c, slopes of their penalties."""
    loss: float
    """Negative log density, but for a constant."""

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
    def deflated_covariance(self) -> np.ndarray:
        """The covariance if only `DEFLATION` of the data count, c x c."""
        flat = self.columns.reshape(len(self.columns), -1)
        return np.asarray(np.linalg.inv(DEFLATION * flat @ flat.T + np.diag(self.precision)))

    @property
    def worth(self) -> np.ndarray:
        """How far coordinates (c) go to make up for each of v numerical errors of unit size, c x v; the errors do not.

        All others are free to go along.
        """
        first = len(self.theta) + len(self.tool_log)
        own = np.arange(first, first + len(self.numerical))
        flat = self.columns.reshape(len(self.columns), -1)
        errors, others = flat[own], np.delete(flat, own, axis=0)
        curvature = DEFLATION * others @ others.T + np.diag(np.delete(self.precision, own))
        found = np.zeros((len(flat), len(own)))
        found[np.delete(np.arange(len(flat)), own)] = np.linalg.solve(curvature, DEFLATION * others @ errors.T)
        return found

    @property
    def tool_factor(self) -> np.ndarray:
        """Moduli of tools over Young's modulus, t."""
        return np.exp(self.tool_log)

    @property
    def n_effect_columns(self) -> int:
        """How many of the last columns are parameters of effects."""
        return sum(len(CATALOGUE[value.effect].parameters) for value in self.effects)

    def add_columns(self, columns: np.ndarray, sd: float) -> "Fit":
        """Add more columns (k x m x f) to the fit, whose coefficients have the prior N(0, sd^2).

        They come before those of the effects' parameters, which stay the last. Nothing is fitted again.
        """
        place = len(self.columns) - self.n_effect_columns

        def put(values: np.ndarray, more: np.ndarray) -> np.ndarray:
            return np.concatenate([values[:place], more, values[place:]])

        return replace(
            self,
            columns=put(self.columns, columns),
            precision=put(self.precision, np.full(len(columns), sd**-2.0)),
            pull=put(self.pull, np.zeros(len(columns))),
        )

    def predict_features(self, effects: Sequence[EffectValue] | None = None) -> np.ndarray:
        """Predict features at the fit, with these effects instead of its own, m x f, not whitened."""
        return self.features.surrogate.predict_features(
            self.theta, self.effects if effects is None else effects, self.tool_factor
        )
