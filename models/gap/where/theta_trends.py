"""Trends of theta: a constant that varies with something known is the most readable clue to what is missing.

Measured less predicted force is regressed on the prediction (a change of Young's modulus, which is a factor on the
force) and on its slope by friction, both times what they may vary with (Atamturktur and Brown 2015: state-aware
calibration).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fast.models.gap.where.residuals import Residuals
from fast.models.gap.where.variance_components import jackknife
from fast.models.simulation.effects.catalogue import CATALOGUE

LEVEL = 0.99  # of trends that are called clues: about a dozen are looked at
LEAST_CHANGE = 0.03

_WORDS = {"young_modulus_mpa": "Young's modulus", "friction": "Friction"}
_AGAINST = {
    "walls": "from tools with thin walls to tools with thick ones",
    "repeat": "from the first to the last repeat",
    "order": "from early to late grasps",
    "force": "from weak to strong grasps",
}


@dataclass(frozen=True)
class ThetaTrend:
    """Relative change of a fitted constant between the ends of what it was plotted against."""

    parameter: str
    against: str
    change: float
    interval: tuple[float, float]
    is_clue: bool
    sentence: str


def fit_theta_trends(residuals: Residuals, friction_slope_n: np.ndarray | None = None) -> tuple[ThetaTrend, ...]:
    """Trends of the fitted constants against wall thickness, repeat, order and predicted force.

    friction_slope_n: n x steps, the prediction's slope by the logarithm of friction; without it only the modulus has
    trends.
    """
    regression = _Regression.of(residuals, friction_slope_n)
    walls = [place for place, name in enumerate(residuals.tool_features) if name.endswith("_thickness_mm")]
    walls_mm = residuals.tool_table[:, walls].mean(axis=1) if walls else np.zeros(len(residuals.tools))
    covariates = {
        "walls": walls_mm[residuals.tool],
        "repeat": residuals.repeat.astype(float),
        "order": residuals.order,
        "force": np.log(residuals.amplitude_n),
    }
    found = []
    for against, x in covariates.items():
        low, high = np.quantile(x, (0.1, 0.9)) if against != "repeat" else (x.min(), x.max())
        if high > low:
            found += _trend(regression, against, (x - 0.5 * (low + high)) / (high - low))
    return tuple(found)


@dataclass(frozen=True, eq=False)
class _Regression:
    """Residuals (n x steps) and regressors (p of n x steps) over the amplitude; the tool's own modulus is left in."""

    names: tuple[str, ...]
    tool: np.ndarray
    obj: np.ndarray
    left: np.ndarray
    regressors: np.ndarray

    @staticmethod
    def of(residuals: Residuals, friction_slope_n: np.ndarray | None) -> "_Regression":
        factor = residuals.tool_factor[residuals.tool][:, None]
        common_n = residuals.predicted_n / factor
        over = residuals.amplitude_n[:, None]
        regressors = [common_n / over]
        if friction_slope_n is not None:
            regressors.append(friction_slope_n / factor / over)
        names = ("young_modulus_mpa", "friction")[: len(regressors)]
        left = (residuals.measured_n - common_n) / over
        return _Regression(names, residuals.tool, residuals.obj, left, np.stack(regressors))

    def moments(self, columns: Sequence[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
        """Normal equations grasp by grasp: n x p x p and n x p, of which any group is a sum."""
        X = np.stack(columns)
        return np.einsum("pns,qns->npq", X, X), np.einsum("pns,ns->np", X, self.left)


def _solve(squares: np.ndarray, products: np.ndarray) -> np.ndarray:
    """Least squares, hardly held towards zero: data without slip say nothing of friction."""
    scale = np.sqrt(np.maximum(np.diag(squares), 1e-12))
    return np.asarray(
        np.linalg.solve(squares / np.outer(scale, scale) + 1e-6 * np.eye(len(scale)), products / scale) / scale
    )


def _trend(regression: _Regression, against: str, x: np.ndarray) -> list[ThetaTrend]:
    """Change of each constant over a range of 1 of the covariate (n), which is centred."""
    plain = list(regression.regressors)
    squares, products = regression.moments([*plain, *(column * x[:, None] for column in plain)])

    def fitted(mask: np.ndarray) -> np.ndarray:
        return _solve(squares[mask].sum(axis=0), products[mask].sum(axis=0))[len(plain) :]

    value, low, high = jackknife(fitted, regression.tool, regression.obj, LEVEL)
    found = []
    for parameter, v, a, b in zip(regression.names, value, low, high, strict=True):
        is_clue = bool(a * b > 0 and abs(v) >= LEAST_CHANGE)
        verb = "rises" if v > 0 else "falls"
        ends = sorted(np.sign(v) * 100 * np.array([a, b]))
        size = f"{abs(100 * v):.0f} % [{ends[0]:.0f}, {ends[1]:.0f}]"
        sentence = f"{_WORDS[parameter]} that fits {verb} by {size} {_AGAINST[against]}"
        hint = _find_hint(parameter, against) if is_clue else ""
        sentence += f", as with {hint}." if hint else "."
        found.append(ThetaTrend(parameter, against, float(v), (float(a), float(b)), is_clue, sentence))
    return found


def _find_hint(parameter: str, against: str) -> str:
    """Effects without which a constant seems to vary with this, in words; empty if there are none."""
    names = [name.replace("_", " ") for name, spec in CATALOGUE.items() if (parameter, against) in spec.trends]
    return " or ".join(part for part in (", ".join(names[:-1]), *names[-1:]) if part)
