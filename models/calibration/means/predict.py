"""What a calibration predicts: forces of designs, simulated and measured, at posterior draws (Eq. 12).

At one joint draw everything is a Gaussian process conditioned on the simulations and then on the measurements:

    g | y_S:    m(z) = k_h(z, Z) alpha,  V(z, z') = k_h(z, z') - k_h(z, Z) (K_SS)^-1 k_h(Z, z')
    Q           = a a' V + k_e(X_R, X_R) + diag(v_R + noise^2),     b = Q^-1 (y_R - a (mean + m))
    measured(x) = a (mean + m(x)) + C b,  variance a^2 V(x, x) + k_e(x, x) - C Q^-1 C' + noise^2
    C           = a a' V(x, X_R) + k_e(x, X_R)

with the names of `problem.Standardised`; a is the amplitude times the trend of each design. A prediction of the
calibration is the mixture over draws.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_solve, solve_triangular
from scipy.special import ndtr

from fast.models.blas import one_blas_thread
from fast.models.calibration.inference.result import CalibrationResult
from fast.models.calibration.means.emulator import Emulator, find_root, sum_squares
from fast.models.calibration.means.parameters import N_DESIGN, Phi, Psi
from fast.models.calibration.means.problem import CalibrationProblem, Standardised
from fast.models.gaussian_process.matern import matern52
from fast.models.records import Record

N_DRAWS = 200  # enough for a 5 % quantile to 1.5 %; each costs a Cholesky factor of the simulations
_BISECTIONS = 60
_BRACKET_SD = 10.0
_ROWS_AT_ONCE = 16  # of the pairwise term of the score, which is designs x draws x draws


@dataclass(frozen=True, eq=False)
class Mixture:
    """m predictions, each a weighted mixture of as many normals as draws.

    means, sds: draws x m, N. weights: draws x m, each column sums to 1.
    """

    means: np.ndarray
    sds: np.ndarray
    weights: np.ndarray

    @staticmethod
    def equal(means: np.ndarray, variances: np.ndarray) -> "Mixture":
        """Mix equally likely draws, from means (draws x m, N) and variances (draws x m, N^2)."""
        return Mixture(means, np.sqrt(np.maximum(variances, 0.0)), np.full(means.shape, 1.0 / len(means)))

    def reweighted(self, weights: np.ndarray) -> "Mixture":
        """Return the same draws with other weights, draws x m."""
        return Mixture(self.means, self.sds, weights)

    @property
    def mean(self) -> np.ndarray:
        """Predicted mean, m, N."""
        return np.asarray((self.weights * self.means).sum(axis=0))

    @property
    def sd(self) -> np.ndarray:
        """Predicted standard deviation, m, N: within draws and between them."""
        variance = (self.weights * (self.sds**2 + (self.means - self.mean) ** 2)).sum(axis=0)
        return np.asarray(np.sqrt(variance))

    def cdf(self, y: np.ndarray) -> np.ndarray:
        """Return the probability of a value of at most y (m, N), m."""
        # A draw without spread is a step; a tiny spread stands for it.
        sds = np.maximum(self.sds, 1e-12)
        return np.asarray((self.weights * ndtr((y - self.means) / sds)).sum(axis=0))

    def quantile(self, probability: float) -> np.ndarray:
        """Find values that are not exceeded with this probability, m, N; by bisection."""
        lower = (self.means - _BRACKET_SD * self.sds).min(axis=0)
        upper = (self.means + _BRACKET_SD * self.sds).max(axis=0)
        for _ in range(_BISECTIONS):
            middle = 0.5 * (lower + upper)
            is_below = self.cdf(middle) < probability
            lower, upper = np.where(is_below, middle, lower), np.where(is_below, upper, middle)
        return np.asarray(0.5 * (lower + upper))

    def interval(self, level: float = 0.9) -> tuple[np.ndarray, np.ndarray]:
        """Lower and upper end of the central interval of this probability, m each, N."""
        return self.quantile(0.5 * (1 - level)), self.quantile(0.5 * (1 + level))

    def crps(self, y: np.ndarray) -> np.ndarray:
        """Score by continuous ranked probability at outcomes y (m, N), m, N; lower is better (Grimit et al. 2006)."""
        near = (self.weights * _absolute_mean(y - self.means, self.sds)).sum(axis=0)
        return np.asarray(near - 0.5 * self._spread())

    def _spread(self) -> np.ndarray:
        """Compute the mean distance of two independent values of each prediction, m, N."""
        spread = np.zeros(self.means.shape[1])
        for start in range(0, len(self.means), _ROWS_AT_ONCE):
            rows = slice(start, start + _ROWS_AT_ONCE)
            difference = self.means[rows, None, :] - self.means[None, :, :]
            sds = np.sqrt(self.sds[rows, None, :] ** 2 + self.sds[None, :, :] ** 2)
            weights = self.weights[rows, None, :] * self.weights[None, :, :]
            spread += (weights * _absolute_mean(difference, sds)).sum(axis=(0, 1))
        return spread


class Scores(Record):
    """How well n predictions agree with n outcomes. The correlation is Pearson's, None below three pairs.

    The error is predicted minus measured; coverage and CRPS judge the whole predicted distribution.
    """

    n: int
    correlation: float | None
    rmse_n: float
    bias_n: float
    coverage_90: float
    crps_n: float


def score_mixture(predicted: Mixture, y: np.ndarray) -> Scores:
    """Score predictions at outcomes y (m, N)."""
    mean, (lower, upper) = predicted.mean, predicted.interval(0.9)
    varies = len(y) > 2 and np.ptp(mean) > 0 and np.ptp(y) > 0
    return Scores(
        n=len(y),
        correlation=float(np.corrcoef(mean, y)[0, 1]) if varies else None,
        rmse_n=float(np.sqrt(np.mean((mean - y) ** 2))),
        bias_n=float(np.mean(mean - y)),
        coverage_90=float(np.mean((lower <= y) & (y <= upper))),
        crps_n=float(np.mean(predicted.crps(y))),
    )


def _absolute_mean(mean: np.ndarray, sd: np.ndarray) -> np.ndarray:
    """Compute the mean of |X| for normal X."""
    z = mean / np.maximum(sd, 1e-12)
    return np.asarray(2 * sd * np.exp(-0.5 * z**2) / np.sqrt(2 * np.pi) + mean * (2 * ndtr(z) - 1))


@dataclass(frozen=True, eq=False)
class DrawnModel:
    """All processes at one joint draw, conditioned on all data. Public results are in N and N^2.

    z_real, whitened_real: inputs (m x d) and L^-1 k_h(Z, z_real) of the measured designs at the draw's theta.
    factor: lower Cholesky factor of Q. weights: b. factor and weights are m x m and m.
    """

    emulator: Emulator
    psi: Psi
    z_real: np.ndarray
    whitened_real: np.ndarray
    factor: np.ndarray
    weights: np.ndarray

    @staticmethod
    def condition(emulator: Emulator, psi: Psi) -> "DrawnModel":
        """Condition on the measurements too.

        Raises:
            FastError: the covariance stays singular even with jitter.
        """
        data, phi = emulator.data, emulator.phi
        z = emulator.inputs(data.x_real, psi.theta)
        whitened = emulator.whitened(z)
        a = data.amplitude(psi.theta, psi.rho) * data.trend_real
        Q = np.outer(a, a) * (matern52(z, z, phi.lengthscales, phi.sd) - whitened.T @ whitened)
        Q += matern52(data.x_real, data.x_real, psi.lengthscales, psi.sd)
        Q[np.diag_indices_from(Q)] += data.variance_real + psi.noise_sd**2
        factor = find_root(Q, "measurements")
        residual = data.y_real - a * (data.mean + emulator.mean(z))
        return DrawnModel(emulator, psi, z, whitened, factor, cho_solve((factor, True), residual, check_finite=False))

    def measured(self, x: np.ndarray, variance: np.ndarray | float = 0.0) -> tuple[np.ndarray, np.ndarray]:
        """Give mean and variance of a new measurement of designs x (m x 9); `variance` of missing objects (m, N^2)."""
        data, phi, psi = self.emulator.data, self.emulator.phi, self.psi
        amplitude = data.amplitude(psi.theta, psi.rho)
        a = amplitude * data.trend.of_designs(x)
        z = self.emulator.inputs(x, psi.theta)
        A = self.emulator.whitened(z)
        cross = np.outer(a, amplitude * data.trend_real)
        cross *= matern52(z, self.z_real, phi.lengthscales, phi.sd) - A.T @ self.whitened_real
        cross += matern52(x, data.x_real, psi.lengthscales, psi.sd)
        mean = a * (data.mean + self.emulator.mean(z)) + cross @ self.weights
        prior = a**2 * (phi.sd**2 - sum_squares(A)) + psi.sd**2 + psi.noise_sd**2
        return self.emulator.data.to_newton(mean, prior - self._explained(cross), variance)

    def simulated(self, x: np.ndarray, theta: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Return `Emulator.simulated` at theta (3) or at the draw's own."""
        return self.emulator.simulated(x, self.psi.theta if theta is None else np.asarray(theta, dtype=float))

    def discrepancy(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return mean and variance of what the calibrated simulator misses at designs x (m x 9)."""
        cross = matern52(x, self.emulator.data.x_real, self.psi.lengthscales, self.psi.sd)
        scale = self.emulator.data.force_scale_n
        return scale * (cross @ self.weights), scale**2 * (self.psi.sd**2 - self._explained(cross))

    def discrepancy_mean(self, x: np.ndarray) -> np.ndarray:
        """Return the mean of `discrepancy` alone."""
        return self.discrepancy(x)[0]

    def leave_one_out(self) -> tuple[np.ndarray, np.ndarray]:
        """Find each measurement's mean and variance given all others and this draw (Rasmussen & Williams, Eq. 5.12)."""
        inverse = cho_solve((self.factor, True), np.eye(len(self.weights)), check_finite=False)
        precision = np.diagonal(inverse)
        return self.emulator.data.to_newton(self.emulator.data.y_real - self.weights / precision, 1.0 / precision)

    def _explained(self, cross: np.ndarray) -> np.ndarray:
        """Compute the diagonal of C Q^-1 C' for cross covariances C (p x m), p."""
        return sum_squares(solve_triangular(self.factor, cross.T, lower=True, check_finite=False))


def condition_models(problem: CalibrationProblem, result: CalibrationResult, n: int = N_DRAWS) -> Iterator[DrawnModel]:
    """Yield the model at n draws spread evenly over the chains; draws that share phi share its Cholesky factor.

    The order is by phi, not by draw.
    """
    data = Standardised.of(problem)
    draws = thinned(result, n)
    n_phi = count_emulator_parameters(result)
    phis, group = np.unique(draws[:, :n_phi], axis=0, return_inverse=True)
    for number, phi in enumerate(phis):
        with one_blas_thread():
            emulator = Emulator.condition(data, Phi(phi[:-2], float(phi[-2]), float(phi[-1])))
        for row in draws[group == number]:
            with one_blas_thread():
                model = DrawnModel.condition(emulator, _psi(row[n_phi:], data.force_scale_n))
            yield model


def predict_measured(
    problem: CalibrationProblem,
    result: CalibrationResult,
    x: np.ndarray,
    variance: np.ndarray | float = 0.0,
    n_draws: int = N_DRAWS,
) -> Mixture:
    """Predict the forces that would be measured with designs x (m x 9, unit cube): simulator, discrepancy and noise.

    `problem` is what was calibrated, without the designs that are predicted. `variance` (m, N^2): of objects that
    were missing in the measurements to compare with.
    """
    parts = [model.measured(x, variance) for model in condition_models(problem, result, n_draws)]
    return Mixture.equal(*_stacked(parts))


def predict_simulated(
    problem: CalibrationProblem,
    result: CalibrationResult,
    x: np.ndarray,
    theta: np.ndarray | None = None,
    n_draws: int = N_DRAWS,
) -> Mixture:
    """Predict forces the simulator would give for designs x (m x 9, unit cube), at theta (3) or each draw's theta."""
    parts = [model.simulated(x, theta) for model in condition_models(problem, result, n_draws)]
    return Mixture.equal(*_stacked(parts))


def thinned(result: CalibrationResult, n: int) -> np.ndarray:
    """Return joint draws spread evenly over all chains (at most n, all where there are fewer), n x len(names)."""
    flat = result.draws.reshape(-1, result.draws.shape[2])
    rows = np.unique(np.linspace(0, len(flat) - 1, n).round().astype(int))
    return np.asarray(flat[rows])


def count_emulator_parameters(result: CalibrationResult) -> int:
    """Count how many of the leading names belong to the emulator: its lengthscales, sd and nugget."""
    return sum(name.startswith("lengthscale_h.") for name in result.names) + 2


def _psi(row: np.ndarray, force_scale_n: float) -> Psi:
    """Make psi from constrained values in the order of `Parameters.names`; sd and noise in N become standardised."""
    rho = float(row[N_DESIGN + 2]) if len(row) == N_DESIGN + 6 else 1.0
    sd, noise = row[N_DESIGN] / force_scale_n, row[N_DESIGN + 1] / force_scale_n
    return Psi(row[:N_DESIGN], float(sd), float(noise), rho, row[-3:])


def _stacked(parts: list[tuple[np.ndarray, np.ndarray]]) -> tuple[np.ndarray, np.ndarray]:
    means, variances = zip(*parts, strict=True)
    return np.array(means), np.array(variances)
