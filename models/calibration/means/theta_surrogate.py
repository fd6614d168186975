"""A cheap stand-in for log p(y_R | psi, phi) at one phi: the emulator's m(t) and V(t) as polynomials of theta.

m and the packed V are interpolated on a Chebyshev grid of t (2 or 3 inputs). V needs few matrices: the grid's V are
whitened by Q at a typical psi, and kept are the singular directions above a tolerance, so that what is dropped changes
the log density by little. Outside its box, t is bent smoothly into a margin: the density stays differentiable twice,
and whoever sees draws outside the box builds a larger one.
"""

from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from numpy.polynomial import chebyshev
from scipy.linalg import eigh, solve_triangular

from fast.models.calibration.means import psi_density
from fast.models.calibration.means.emulator import Emulator
from fast.models.calibration.means.psi_density import Measurements

MARGIN = 0.15  # of the box's width, on either side: the room t is bent into
TOLERANCE = 0.001  # root mean square over the grid of the whitened norm of what is dropped of V

N_TEST, MAX_ERROR = 24, 0.05
FIRST_NODES, NODES_PER_LENGTHSCALE, MAX_NODES = 4, 4.0, 16


@dataclass(frozen=True, eq=False)
class Box:
    """Range of the inputs t, lower and upper (k each), in which the stand-in is accurate."""

    lower: np.ndarray
    upper: np.ndarray

    @property
    def margin(self) -> np.ndarray:
        """Room on either side, k."""
        return MARGIN * (self.upper - self.lower)

    def bend(self, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Bend inputs t (k) into the margin, unchanged inside the box, and return the slope of that (k) too."""
        inside = np.clip(t, self.lower, self.upper)
        bend = np.tanh((t - inside) / self.margin)
        return inside + self.margin * bend, 1.0 - bend**2

    def is_outside(self, t: np.ndarray) -> np.ndarray:
        """Tell by row of t (n x k) and side whether it is outside: n x 2 x k, below the box and above it."""
        return np.stack([t < self.lower, t > self.upper], axis=1)

    def grown(self, sides: np.ndarray) -> "Box":
        """Return the box, half as wide again on every side marked in `sides` (2 x k)."""
        width = 0.5 * (self.upper - self.lower)
        return Box(self.lower - sides[0] * width, self.upper + sides[1] * width)


@dataclass(frozen=True, eq=False)
class ThetaSurrogate:
    """log p(y_R | psi, phi) + log p(psi) of one phi, as a function of the vector form of psi (n_psi).

    coefficients: (n + rank) x number of Chebyshev products, of m and of the weights of `basis` (rank x p), which
    adds to `center` (p) to make the packed V. orders: number of polynomials by input. error: standard deviation of the
    error of the log density at draws like the posterior's, where that was looked at.
    """

    measured: Measurements
    box: Box
    degrees: tuple[int, ...]
    coefficients: np.ndarray
    center: np.ndarray
    basis: np.ndarray
    error: float = np.nan

    def __call__(self, values: np.ndarray) -> tuple[float, np.ndarray]:
        """Return value and gradient; minus infinity and zero where the covariance is numerically singular."""
        psi = self.measured.parameters.psi(values)
        terms, term_slopes = self._terms(self.measured.inputs(psi.theta))
        weights = self.coefficients @ terms
        n = self.measured.n
        amplitude = self.measured.data.amplitude(psi.theta, psi.rho)
        slopes = self.measured.slopes(psi, amplitude, weights[:n], self.center + weights[n:] @ self.basis)
        if slopes is None:
            return -np.inf, np.zeros_like(values)
        by_weights = np.concatenate([slopes.mean, self.basis @ slopes.covariance])
        by_inputs = term_slopes @ (by_weights @ self.coefficients)
        prior, gradient = self.measured.parameters.log_prior_psi(values)
        return slopes.value + prior, gradient + self.measured.psi_gradient(slopes, by_inputs, psi.theta, psi.rho)

    def log_likelihood(self, values: np.ndarray) -> float:
        """Return the value without the prior."""
        return self(values)[0] - self.measured.parameters.log_prior_psi(values)[0]

    def mean_force(self, t: np.ndarray) -> tuple[float, np.ndarray]:
        """Average tau mean + m(t) over the measured designs, standardised; give its derivatives by t (k) too."""
        terms, slopes = self._terms(t)
        average = self.coefficients[: self.measured.n].mean(axis=0)
        data = self.measured.data
        return float(data.mean * data.trend_real.mean() + average @ terms), slopes @ average

    def _terms(self, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return products of Chebyshev polynomials at t, and their derivatives (k x products)."""
        bent, bend_slope = self.box.bend(t)
        center, half = 0.5 * (self.box.lower + self.box.upper), _half_width(self.box)
        unit = (bent - center) / half
        rows = [_chebyshev(u, n) for u, n in zip(unit, self.degrees, strict=True)]
        slopes = np.array([_product([row[int(i == k)] for i, row in enumerate(rows)]) for k in range(len(rows))])
        return _product([row[0] for row in rows]), slopes * (bend_slope / half)[:, None]


def build_accurate_surrogate(
    emulator: Emulator,
    measured: Measurements,
    box: Box,
    mode: np.ndarray,
    covariance: np.ndarray,
    rng: np.random.Generator,
) -> ThetaSurrogate:
    """Build the stand-in with as many nodes as it takes.

    Its error is measured at draws of psi (n_psi) from a normal around `mode`, as far as they are inside the box.
    """
    drawn = rng.multivariate_normal(mode, covariance, N_TEST, method="cholesky")
    draws = [
        psi for psi in drawn if not box.is_outside(measured.inputs(measured.parameters.theta(psi[-3:]))[None]).any()
    ]
    exact = np.array([psi_density.log_likelihood(psi, emulator, measured) for psi in draws])
    width = 2.0 * _half_width(box) / emulator.phi.lengthscales[-len(box.lower) :]
    degrees = np.clip(np.ceil(FIRST_NODES + NODES_PER_LENGTHSCALE * width).astype(int), FIRST_NODES, MAX_NODES)
    while True:
        found = build_surrogate(emulator, measured, box, tuple(degrees.tolist()), mode)
        error = _spread([found.log_likelihood(psi) for psi in draws] - exact)
        if error <= MAX_ERROR or degrees.min() >= MAX_NODES:
            return replace(found, error=error)
        degrees = np.minimum(degrees + 2, MAX_NODES)


def _spread(errors: np.ndarray) -> float:
    """Compute the standard deviation; infinite where a likelihood is, as between nodes that are too far apart."""
    if len(errors) < 2:
        return 0.0
    return float(np.std(errors)) if np.isfinite(errors).all() else np.inf


def build_surrogate(
    emulator: Emulator, measured: Measurements, box: Box, degrees: tuple[int, ...], typical: np.ndarray
) -> ThetaSurrogate:
    """Interpolate m and V in `box` with `degrees` nodes by input; `typical` (n_psi) sets what may be dropped of V."""
    nodes = [chebyshev.chebpts1(n) for n in degrees]
    center, half = 0.5 * (box.lower + box.upper), _half_width(box)
    grid = center + half * np.array(list(product(*nodes)))
    pairs = [psi_density.predict(t, emulator, measured) for t in grid]
    means, covariances = np.array([mean for mean, _ in pairs]), np.array([V for _, V in pairs])
    middle = covariances.mean(axis=0)
    covariances -= middle
    directions = _directions(covariances, middle, measured, typical)
    to_coefficients = _interpolation(degrees)
    values = np.column_stack([means, directions])
    return ThetaSurrogate(
        measured, box, degrees, np.ascontiguousarray((to_coefficients @ values).T), middle, directions.T @ covariances
    )


def _directions(covariances: np.ndarray, middle: np.ndarray, measured: Measurements, typical: np.ndarray) -> np.ndarray:
    """Find orthonormal combinations of the grid's covariances (nodes x p) that matter, nodes x rank."""
    psi = measured.parameters.psi(typical)
    amplitude = measured.data.amplitude(psi.theta, psi.rho)
    root = measured.root(psi, amplitude, middle)
    whitened = np.array([_whiten(amplitude**2 * measured.unpack(row), root) for row in covariances])
    whitened = whitened.reshape(len(covariances), -1)
    energy, vectors = eigh(whitened @ whitened.T)
    dropped = np.cumsum(np.maximum(energy, 0.0)) / len(energy)  # mean square norm when the first are dropped
    return np.asarray(vectors[:, dropped > TOLERANCE**2][:, ::-1])


def _whiten(matrix: np.ndarray, root: np.ndarray) -> np.ndarray:
    """Compute R^-1 M R^-T for a lower triangular root R."""
    half = solve_triangular(root, matrix, lower=True, check_finite=False)
    return np.asarray(solve_triangular(root, half.T, lower=True, check_finite=False))


def _interpolation(degrees: tuple[int, ...]) -> np.ndarray:
    """Return the matrix from values on the grid to coefficients of the products of polynomials."""
    matrix = np.ones((1, 1))
    for n in degrees:
        matrix = np.kron(matrix, np.linalg.inv(chebyshev.chebvander(chebyshev.chebpts1(n), n - 1)))
    return matrix


def _half_width(box: Box) -> np.ndarray:
    return 0.5 * (box.upper - box.lower) + box.margin


def _chebyshev(u: float, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Compute T_0 .. T_{n-1} at u in [-1, 1], and their derivatives."""
    values, slopes = np.ones(n), np.zeros(n)
    if n > 1:
        values[1], slopes[1] = u, 1.0
    for k in range(2, n):
        values[k] = 2.0 * u * values[k - 1] - values[k - 2]
        slopes[k] = 2.0 * values[k - 1] + 2.0 * u * slopes[k - 1] - slopes[k - 2]
    return values, slopes


def _product(rows: list[np.ndarray]) -> np.ndarray:
    """Return all products of one entry of each row, the last row fastest."""
    result = rows[0]
    for row in rows[1:]:
        result = np.multiply.outer(result, row).ravel()
    return result
