"""Features as polynomials of friction and Poisson ratio, one surface a cell, with their error by cross-validation.

Chebyshev polynomials fitted to the grid by least squares. Principal components of the features would change nothing:
the fit is linear in them. Young's modulus stays outside, as a factor.
"""

from dataclasses import dataclass

import numpy as np
from numpy.polynomial import chebyshev

from models.calibration.traces.problem import TraceProblem, degrees

_SOLVABLE = 1e10  # condition number up to which the points of a cell determine its surface


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
    def of(problem: TraceProblem) -> "ResponseSurfaces":
        """Fit the surfaces of a problem to its grid."""
        lower, upper = problem.grid.min(axis=0), problem.grid.max(axis=0)
        terms = tuple(degrees(problem.grid))
        basis = _basis(_scaled(problem.grid, lower, upper), terms)[0]
        t, o, _, f = problem.simulated.shape
        coefficients, error = np.zeros((t, o, len(terms), f)), np.zeros((t, o, f, f))
        for cell in zip(*np.nonzero(problem.is_measured), strict=True):
            coefficients[cell], error[cell] = _fit(basis, problem.simulated[cell])
        return ResponseSurfaces(lower, upper, problem.modulus_mpa, problem.is_force, terms, coefficients, error)

    def features(self, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Features at theta (Young's modulus in MPa, friction, Poisson ratio), t x o x f, and slopes 3 x t x o x f."""
        share = theta[0] / self.modulus_mpa
        factor = np.where(self.is_force, share, 1.0)
        rows, by_friction, by_ratio = _basis(_scaled(theta[None, 1:], self.lower, self.upper), self.terms)
        scale = 2.0 / (self.upper - self.lower)
        stacked = np.concatenate([rows, scale[0] * by_friction, scale[1] * by_ratio])
        value, friction_slope, ratio_slope = np.moveaxis(stacked @ self.coefficients, -2, 0) * factor
        return value, np.stack([np.where(self.is_force, value, 0.0) / theta[0], friction_slope, ratio_slope])


def _fit(basis: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Coefficients (k x f) of the simulations there are (g x f), and the mean outer product of left-out errors."""
    known = np.isfinite(values).all(axis=1)
    rows, y = basis[known], values[known]
    q, r = np.linalg.qr(rows)
    coefficients = np.linalg.solve(r, q.T @ y)
    leverage = np.minimum((q**2).sum(axis=1), 1.0 - 1e-6)
    left_out = (y - rows @ coefficients) / (1.0 - leverage)[:, None]
    return coefficients, left_out.T @ left_out / len(y)


def _scaled(points: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
    return np.asarray(2.0 * (points - lower) / (upper - lower) - 1.0)


def _basis(points: np.ndarray, terms: tuple[tuple[int, int], ...]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Products of Chebyshev polynomials at points (n x 2) in the square -1 to 1, n x k, and their two slopes."""
    first, second = np.array(terms).T
    highest = max(int(first.max()), int(second.max()))
    values = chebyshev.chebvander(points, highest)
    slopes = np.stack([chebyshev.chebval(points, chebyshev.chebder(row)) for row in np.eye(highest + 1)], axis=-1)
    u, v, du, dv = values[:, 0, first], values[:, 1, second], slopes[:, 0, first], slopes[:, 1, second]
    return u * v, du * v, u * dv
