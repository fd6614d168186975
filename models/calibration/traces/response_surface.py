"""Features as polynomials of friction and Poisson ratio, one surface a cell, with their error by cross-validation.

Chebyshev polynomials fitted to the grid by least squares. Principal components of the features would change nothing:
the fit is linear in them. Young's modulus stays outside, as a factor.

Errors that a simulator may make in features: their units, and how they go together.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fast.models.traces.step_features import CENTRES_MM

NEAR_MM = 10.0  # lift over which errors of the simulator are alike: a contact moves so far along the wall
OWN_SHARE = 0.1
AREA_MM, MOVE_MM = 20.0, 10.0  # the unit of areas, times the amplitude of the cell, and of lifts
LEAST_AMPLITUDE = 0.05  # of the median cell's: cells without grip say nothing in per cent


@dataclass(frozen=True, eq=False)
class ResponseSurfaces:
    """Surfaces of t x o cells and f features at `modulus_mpa`.

    coefficients: t x o x k x f; 0 in cells that were not measured. error: t x o x f x f, mean outer product of the
    errors at grid points that were left out. Friction and Poisson ratio are within `lower`, `upper` (2).
    """

    lower: np.ndarray
    upper: np.ndarray
    modulus_mpa: float
    is_force: np.ndarray
    terms: tuple[tuple[int, int], ...]
    coefficients: np.ndarray
    error: np.ndarray

    @staticmethod
    def fitted(
        grid: np.ndarray, simulated: np.ndarray, is_wanted: np.ndarray, modulus_mpa: float, is_force: np.ndarray
    ) -> "ResponseSurfaces":
        """Fit surfaces of the wanted cells (t x o) to values (t x o x g x f) simulated at a grid (g x 2).

        A cell needs at least one simulation more than the surface has terms.
        """
        lower, upper = grid.min(axis=0), grid.max(axis=0)
        terms = tuple(degrees(grid))
        basis = _basis(_scaled(grid, lower, upper), terms)
        t, o, _, f = simulated.shape
        coefficients, error = np.zeros((t, o, len(terms), f)), np.zeros((t, o, f, f))
        for cell in zip(*np.nonzero(is_wanted), strict=True):
            coefficients[cell], error[cell] = _fit(basis, simulated[cell])
        return ResponseSurfaces(lower, upper, modulus_mpa, is_force, terms, coefficients, error)

    def rows(self, friction: np.ndarray, poisson_ratio: np.ndarray | float) -> np.ndarray:
        """Return the values of the terms at n frictions and Poisson ratios, n x k."""
        return _basis(self._scaled(friction, poisson_ratio), self.terms)

    def _scaled(self, friction: np.ndarray | float, poisson_ratio: np.ndarray | float) -> np.ndarray:
        points = np.stack(np.broadcast_arrays(np.atleast_1d(friction), poisson_ratio), axis=-1)
        return _scaled(points, self.lower, self.upper)


def n_terms(grid: np.ndarray) -> int:
    """Count the terms of the response surface that a grid carries."""
    return len(degrees(grid))


def degrees(grid: np.ndarray) -> list[tuple[int, int]]:
    """List the terms' degrees in friction and Poisson ratio: those of the grid, up to the greater one in total.

    A cross says nothing of products, and has no point to spare: it is less curved in Poisson ratio.
    """
    first, second = (len(np.unique(grid[:, column])) - 1 for column in (0, 1))
    if len(grid) < (first + 1) * (second + 1):
        return [*((i, 0) for i in range(first + 1)), *((0, j) for j in range(1, second))]
    return [(i, j) for i in range(first + 1) for j in range(second + 1) if i + j <= max(first, second)]


def _fit(basis: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Fit coefficients (k x f) to the simulations there are (g x f); give left-out errors' mean outer product."""
    known = np.isfinite(values).all(axis=1)
    rows, y = basis[known], values[known]
    q, r = np.linalg.qr(rows)
    coefficients = np.linalg.solve(r, q.T @ y)
    leverage = np.minimum((q**2).sum(axis=1), 1.0 - 1e-6)
    left_out = (y - rows @ coefficients) / (1.0 - leverage)[:, None]
    return coefficients, left_out.T @ left_out / len(y)


def _scaled(points: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
    return np.asarray(2.0 * (points - lower) / (upper - lower) - 1.0)


def _basis(points: np.ndarray, terms: tuple[tuple[int, int], ...]) -> np.ndarray:
    """Multiply Chebyshev polynomials at points (n x 2) in the square -1 to 1, n x k: T_(j+1) = 2 x T_j - T_(j-1)."""
    first, second = np.array(terms).T
    values = [np.ones_like(points), points]
    for j in range(1, int(max(first.max(), second.max()))):
        values.append(2.0 * points * values[j] - values[j - 1])
    u, v = np.stack(values).T
    return np.asarray(u[:, first] * v[:, second])


def are_lifts(features: Sequence[str]) -> np.ndarray:
    """Tell which features are lifts, not forces, f."""
    return np.array([name.endswith("_mm") and not name.endswith("_n_mm") for name in features])


def units_of(features: Sequence[str]) -> np.ndarray:
    """Return features' units, f: of forces 1, of areas in mm, both times the amplitude of the cell; of lifts in mm."""
    area = np.array([AREA_MM if name.endswith("_n_mm") else 1.0 for name in features])
    return np.where(are_lifts(features), MOVE_MM, area)


def error_correlation(features: Sequence[str]) -> np.ndarray:
    """Return the correlation of the errors that a simulator may make in features of one object, f x f.

    Errors of forces are mostly common to the whole lift and shared by neighbouring bins (`NEAR_MM`), in equal
    parts; `OWN_SHARE` of their variance is of their own, as are those of lifts.
    """
    centres = np.array([CENTRES_MM.get(name, np.inf) for name in features])
    with np.errstate(invalid="ignore"):
        near = np.exp(-np.abs(np.subtract.outer(centres, centres)) / NEAR_MM)
    near = np.where(np.isfinite(near), near, 0.0)
    both = np.outer(~are_lifts(features), ~are_lifts(features))
    return np.where(np.eye(len(centres)) > 0, 1.0, np.where(both, 0.5 * (1.0 - OWN_SHARE) * (1.0 + near), 0.0))
