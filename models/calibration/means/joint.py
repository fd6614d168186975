"""The joint log posterior of all calibration parameters (Eq. 12) with a hand-written gradient, and NUTS on it.

y_S = g(z) + nugget,   y_R = c (mean + g([x_R, t])) + eps(x_R) + noise,   c = a tau   (`problem.Standardised`), so that

    K = [[H_SS, c' H_SR], [c H_RS, c c' H_RR + E_RR]] + diag(v_S + nugget^2 | v_R + noise_sd^2)
    r = (y_S, y_R - c mean)

with Matern-5/2 covariances H (12 or 11 inputs) and E (9 inputs). With alpha = K^-1 r, W = (alpha alpha' - K^-1) / 2,
c = 1 for simulations, the slope G of H (`models.gaussian_process.matern`) and M = W * G * c c':

    d/dlog l_h  as in `gaussian.lengthscale_gradient`        d/dlog s = 2 <W, its covariance>
    d/dt_k = -(2 / l_k^2) sum_{i in R, j in S} M_ij (t_k - z_jk)
    d/da   = sum_{i in R} tau_i (2 sum_j W_ij c_j H_ij + mean alpha_i)

One gradient costs O((n + m)^3): NUTS is exact, and affordable up to some hundred designs; `factorised` serves the
paper's 1,579.
"""

import time
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from fast.models.blas import one_blas_thread
from fast.models.calibration.inference.optimise import climb, draw_starts, find_laplace_covariance
from fast.models.calibration.inference.parallel_chains import Progress, Samples, sample
from fast.models.calibration.inference.result import CalibrationResult, SamplerCounts, make_result
from fast.models.calibration.inference.settings import CalibrationSettings
from fast.models.calibration.means.parameters import (
    LENGTHSCALE,
    N_DESIGN,
    NOISE_SD,
    NUGGET,
    RHO_MEAN,
    SD_E,
    SD_H,
    Parameters,
    Phi,
    Psi,
)
from fast.models.calibration.means.problem import CalibrationProblem, Standardised, unit_theta, unit_theta_slopes
from fast.models.gaussian_process.density import Factored, half_weights, lengthscale_gradient, log_normal
from fast.models.gaussian_process.matern import MaternWithSlope, matern52_with_slope

_START_MODULI_MPA = (5.0, 10.0, 30.0)


@dataclass(frozen=True, eq=False)
class JointDensity:
    """Log posterior density of the unconstrained vector (phi, psi), for samplers and optimisers."""

    data: Standardised
    parameters: Parameters

    def __call__(self, values: np.ndarray) -> tuple[float, np.ndarray]:
        """Return the value, without the priors' constants, and the gradient (n_phi + n_psi).

        Minus infinity (gradient zero) where the covariance is numerically singular.
        """
        n_phi = self.parameters.n_phi
        with np.errstate(over="ignore", invalid="ignore"):
            phi, psi = self.parameters.phi(values[:n_phi]), self.parameters.psi(values[n_phi:])
            terms = _Terms.of(self.data, phi, psi)
            factored = terms.density()
        if factored is None or not np.isfinite(factored.value):
            return -np.inf, np.zeros_like(values)
        prior_phi, slope_phi = self.parameters.log_prior_phi(values[:n_phi])
        prior_psi, slope_psi = self.parameters.log_prior_psi(values[n_phi:])
        by_phi, by_psi = terms.gradient(factored, self.parameters)
        value = factored.value + prior_phi + prior_psi
        return value, np.concatenate([by_phi + slope_phi, by_psi + slope_psi])


@dataclass(frozen=True, eq=False)
class _Terms:
    """Covariances of one vector. z: (n + m) x d, inputs of simulations, then of measurements at theta."""

    data: Standardised
    phi: Phi
    psi: Psi
    amplitude: float
    z: np.ndarray
    h: MaternWithSlope
    e: MaternWithSlope

    @staticmethod
    def of(data: Standardised, phi: Phi, psi: Psi) -> "_Terms":
        t = unit_theta(psi.theta[None, :], data.scales_with_modulus)
        at_theta = np.column_stack([data.x_real, np.repeat(t, len(data.y_real), axis=0)])
        z = np.concatenate([data.z_sim, at_theta])
        h = matern52_with_slope(z, phi.lengthscales, phi.sd)
        e = matern52_with_slope(data.x_real, psi.lengthscales, psi.sd)
        return _Terms(data, phi, psi, data.amplitude(psi.theta, psi.rho), z, h, e)

    @property
    def c(self) -> np.ndarray:
        """Factor of the emulated process in every output, n + m."""
        return np.concatenate([np.ones(len(self.data.y_sim)), self.amplitude * self.data.trend_real])

    def covariance(self) -> np.ndarray:
        """Return K of all outputs, in Fortran order."""
        data, n_sim = self.data, len(self.data.y_sim)
        K = np.multiply(self.h.covariance, self.c[:, None] * self.c[None, :], order="F")
        K[n_sim:, n_sim:] += self.e.covariance
        sim, real = data.variance_sim + self.phi.nugget**2, data.variance_real + self.psi.noise_sd**2
        K[np.diag_indices_from(K)] += np.concatenate([sim, real])
        return K

    def density(self) -> Factored | None:
        """Return the density of all outputs."""
        in_simulator = self.c[len(self.data.y_sim) :] * self.data.mean
        residual = np.concatenate([self.data.y_sim, self.data.y_real - in_simulator])
        return log_normal(self.covariance(), residual)

    def gradient(self, factored: Factored, parameters: Parameters) -> tuple[np.ndarray, np.ndarray]:
        """Return the gradient by phi (n_phi) and psi (n_psi) in their unconstrained form."""
        n_sim, c = len(self.data.y_sim), self.c
        W = half_weights(factored)
        noise, W_real = np.diagonal(W).copy(), W[n_sim:, n_sim:].copy()
        by_row = (W * self.h.covariance) @ c
        W *= self.h.slope
        W *= c[:, None]
        W *= c[None, :]  # this is M now
        by_phi = np.concatenate(
            [
                lengthscale_gradient(W, self.z, self.phi.lengthscales),
                [2.0 * c @ by_row, 2.0 * self.phi.nugget**2 * noise[:n_sim].sum()],
            ]
        )
        by_amplitude = float(self.data.trend_real @ (2.0 * by_row[n_sim:] + self.data.mean * factored.alpha[n_sim:]))
        per_rho = self.data.amplitude(self.psi.theta, 1.0)
        by_psi = np.concatenate(
            [
                lengthscale_gradient(W_real * self.e.slope, self.data.x_real, self.psi.lengthscales),
                [2.0 * np.vdot(W_real, self.e.covariance), 2.0 * self.psi.noise_sd**2 * noise[n_sim:].sum()],
                [by_amplitude * per_rho] if parameters.has_rho else [],
                self._by_theta(W[n_sim:, :n_sim].sum(axis=0), by_amplitude, parameters),
            ]
        )
        return by_phi, by_psi

    def _by_theta(self, M: np.ndarray, by_amplitude: float, parameters: Parameters) -> np.ndarray:
        """Return the gradient by the unconstrained theta (3); `M` is summed over the measurements, n."""
        z_theta = self.data.z_sim[:, N_DESIGN:]
        t, lengthscales = self.z[-1, N_DESIGN:], self.phi.lengthscales[N_DESIGN:]
        by_unit = -2.0 / lengthscales**2 * (t * M.sum() - M @ z_theta)
        by_theta = by_amplitude * self.amplitude * self.data.amplitude_slopes(self.psi.theta)
        by_theta[-len(t) :] += by_unit * unit_theta_slopes(self.psi.theta, self.data.scales_with_modulus)
        return np.asarray(by_theta * parameters.theta_slopes(self.psi.theta))


def calibrate_joint(
    problem: CalibrationProblem, settings: CalibrationSettings, progress: Progress | None = None
) -> CalibrationResult:
    """Find the posterior of every parameter (Eq. 12), without approximation besides that of finitely many draws."""
    data = Standardised.of(problem)
    parameters = Parameters.of(data, settings)
    samples, steps = sample_joint(data, parameters, settings, progress)
    draws = parameters.constrain(samples.draws, data.force_scale_n)
    counts = SamplerCounts(samples.n_divergences, samples.n_deepest, samples.n_gradients)
    result = make_result(problem, parameters.names, draws, settings, "joint", counts)
    return replace(result, cpu_s=sum(steps.values()), steps=steps)


def sample_joint(
    data: Standardised, parameters: Parameters, settings: CalibrationSettings, progress: Progress | None = None
) -> tuple[Samples, Mapping[str, float]]:
    """Draw the unconstrained vector (phi, psi); give CPU seconds by step too."""
    density = JointDensity(data, parameters)
    started = time.process_time()
    with one_blas_thread():
        optima = climb(density, guess_starts(parameters))
        covariance = find_laplace_covariance(density, optima[0].vector)
        rng = np.random.default_rng([settings.seed, 1])
        starts = draw_starts(density, optima, covariance, settings.chains, rng)
        found_s = time.process_time() - started
        if progress is not None:
            progress(f"joint NUTS: optimum found in {found_s:.1f} s of CPU; sampling {settings.chains} chains")
        samples = sample(density, starts, settings, scale=covariance, progress=progress)
    return samples, {"optimum": found_s, "sampling": samples.cpu_s}


def guess_starts(parameters: Parameters) -> list[np.ndarray]:
    """Guess starts: medians of the priors, with a soft, a likely and a hard material."""
    phi = [LENGTHSCALE[0]] * parameters.n_inputs + [SD_H[0], NUGGET[0]]
    psi = [LENGTHSCALE[0]] * N_DESIGN + [SD_E[0], NOISE_SD[0]] + [RHO_MEAN] * parameters.has_rho
    friction = parameters.priors.friction_shape / parameters.priors.friction_rate
    poisson_ratio = 0.5 * (parameters.priors.poisson_ratio_lower + parameters.priors.poisson_ratio_upper)
    theta = np.array([(modulus, friction, poisson_ratio) for modulus in _START_MODULI_MPA])
    return [np.array([*phi, *psi, *row]) for row in parameters.unconstrained_theta(theta)]
