"""What stays fixed while theta and the scales are sampled: known covariances and the shapes of the random effects.

They are taken at a first estimate of theta, so that the log density has the covariance as a function of three scales
only. Around the posterior they change by a few per cent.
"""

from dataclasses import dataclass, replace

import numpy as np

from models.calibration.traces.problem import LEAST_AMPLITUDE, TraceProblem
from models.calibration.traces.response_surface import ResponseSurfaces

_GUESSED_SHARE = 0.05  # of the amplitude: error of a feature while nothing is known
_N_FRICTION, _N_RATIO = 25, 7


@dataclass(frozen=True, eq=False)
class Frame:
    """Whitened random effects of t tools and o objects; everything is 0 in cells that were not measured.

    theta: the first estimate (3). whitener: t x o x f x f, W with W K W' = 1 and W C W' = diag(slack), K the known
    covariance of a cell's mean over repeats and C the shape of its scatter. slack: t x o x f. obj: t x o x f x f, W
    times the effect H of f independent causes of what the simulator has wrong about an object, H H' = C.
    shared: t x o x f x f, W times the numerical error that all grasps share, in f independent causes.
    spread: t x o, factors on both covariances of a cell. repeat_sd: scatter from grasp to grasp, relative.
    """

    theta: np.ndarray
    measured: np.ndarray
    is_measured: np.ndarray
    whitener: np.ndarray
    slack: np.ndarray
    obj: np.ndarray
    shared: np.ndarray
    spread: np.ndarray
    repeat_sd: float

    @staticmethod
    def of(problem: TraceProblem, surfaces: ResponseSurfaces) -> "Frame":
        """The frame of a problem."""
        theta = first_estimate(problem, surfaces)
        predicted = surfaces.features(theta)
        force = np.where(problem.is_force, predicted, 0.0)
        unit = _unit(problem, predicted)
        repeat_sd = _repeat_sd(problem, force)
        averaged = np.sqrt(np.maximum(problem.n_averaged, 1))[..., None]
        correlation = problem.correlation()
        numerical = problem.numerical * unit / averaged
        known = _known_covariance(problem, surfaces, theta, force, repeat_sd)
        known = known + numerical[..., :, None] * numerical[..., None, :] * correlation
        root = (unit / averaged)[..., None] * np.linalg.cholesky(correlation)
        whitener, slack = _whiten(known, root @ np.swapaxes(root, -1, -2))
        mask = problem.is_measured
        whitener, slack = whitener * mask[..., None, None], slack * mask[..., None]
        return Frame(
            theta=theta,
            measured=problem.mean_over_repeats(),
            is_measured=mask,
            whitener=whitener,
            slack=slack,
            obj=whitener @ root,
            shared=whitener @ ((problem.numerical * unit)[..., None] * np.linalg.cholesky(correlation)),
            spread=np.ones(mask.shape),
            repeat_sd=repeat_sd,
        )

    def spread_by(self, factor: np.ndarray) -> "Frame":
        """The frame with other factors on the covariances of its cells (t x o)."""
        change = np.sqrt(self.spread / factor)[..., None, None]
        return replace(
            self,
            whitener=change * self.whitener,
            obj=change * self.obj,
            shared=change * self.shared,
            spread=factor,
        )


def first_estimate(problem: TraceProblem, surfaces: ResponseSurfaces) -> np.ndarray:
    """Least squares over a lattice of friction and Poisson ratio, with the best Young's modulus at each point (3)."""
    measured, mask = problem.mean_over_repeats(), problem.is_measured
    force = problem.is_force
    amplitude = np.abs(np.where(force & (problem.unit == 1.0), measured, 0.0)).max(axis=-1, keepdims=True)
    variance = (_GUESSED_SHARE * _floored(amplitude, mask) * problem.unit) ** 2
    variance = variance + np.diagonal(problem.noise, axis1=2, axis2=3) / np.maximum(problem.n_repeats, 1)[..., None]
    weight = mask[..., None] / np.where(mask[..., None], variance, 1.0)
    best, lowest = np.zeros(3), np.inf
    for friction in np.linspace(surfaces.lower[0], surfaces.upper[0], _N_FRICTION):
        for ratio in np.linspace(surfaces.lower[1], surfaces.upper[1], _N_RATIO):
            unscaled = surfaces.features(np.array([problem.modulus_mpa, friction, ratio]))
            gain = (weight * measured * unscaled)[..., force].sum() / (weight * unscaled**2)[..., force].sum()
            gain = max(float(gain), 1e-3)
            misfit = float((weight * (measured - np.where(force, gain, 1.0) * unscaled) ** 2).sum())
            if misfit < lowest:
                best, lowest = np.array([gain * problem.modulus_mpa, friction, ratio]), misfit
    return best


def _unit(problem: TraceProblem, predicted: np.ndarray) -> np.ndarray:
    """Size of a relative error of 1, t x o x f: the amplitude of the cell for forces, a fixed length for lifts."""
    is_amplitude = problem.is_force & (problem.unit == 1.0)
    amplitude = np.abs(np.where(is_amplitude, predicted, 0.0)).max(axis=-1, keepdims=True)
    return np.where(problem.is_force, _floored(amplitude, problem.is_measured), 1.0) * problem.unit


def _floored(amplitude: np.ndarray, mask: np.ndarray) -> np.ndarray:
    return np.maximum(amplitude, LEAST_AMPLITUDE * np.median(amplitude[mask]))


def _repeat_sd(problem: TraceProblem, force: np.ndarray) -> float:
    """Relative scatter of the force from grasp to grasp, by moments of the repeats less their sensor noise."""
    is_present = np.isfinite(problem.measured).all(axis=-1)
    n = problem.n_repeats
    deviation = np.where(is_present[..., None], problem.measured - problem.mean_over_repeats()[:, :, None], 0.0)
    square = np.maximum((force**2).sum(axis=-1), 1e-12)
    along = np.einsum("torf,tof->tor", deviation, force) / square[..., None]
    noise = np.einsum("tof,tofg,tog->to", force, problem.noise, force) / square**2
    repeated = n > 1
    freedom = (n - 1)[repeated].sum()
    if freedom == 0:
        return 0.0
    # Weak cells have noisy ratios; each counts by what it knows.
    weight = np.where(repeated, 1.0 / (1e-4 + noise) ** 2, 0.0)
    variance = (along**2).sum(axis=2) / np.maximum(n - 1, 1) - noise
    return float(np.sqrt(max((weight * (n - 1) * variance).sum() / (weight * (n - 1)).sum(), 0.0)))


def _known_covariance(
    problem: TraceProblem,
    surfaces: ResponseSurfaces,
    theta: np.ndarray,
    force: np.ndarray,
    repeat_sd: float,
) -> np.ndarray:
    """Sensor noise and repeats over their number, and the surfaces' errors at theta, t x o x f x f."""
    n = np.maximum(problem.n_repeats, 1)[..., None, None]
    repeats = repeat_sd**2 * force[..., :, None] * force[..., None, :]
    factor = np.where(problem.is_force, theta[0] / surfaces.modulus_mpa, 1.0)
    error = surfaces.error * np.outer(factor, factor)
    noise = np.where(problem.is_measured[..., None, None], problem.noise, 0.0)
    return np.asarray((noise + repeats) / n + error)


def _whiten(known: np.ndarray, shape: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """W and d (... x f) with W known W' = 1 and W shape W' = diag(d), of positive definite ... x f x f."""
    inverse_root = np.linalg.inv(np.linalg.cholesky(known))
    slack, vectors = np.linalg.eigh(inverse_root @ shape @ np.swapaxes(inverse_root, -1, -2))
    return np.swapaxes(vectors, -1, -2) @ inverse_root, np.maximum(slack, 0.0)
