"""Normal approximation of the emulator's parameters phi at the mode of the joint posterior."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from models.calibration.inference.optimise import covariance_of
from models.calibration.inference.processes import spread
from models.calibration.means.joint_density import JointDensity

_STEP = 0.02  # of the central differences, in logarithms: a fifth of a typical posterior standard deviation


@dataclass(frozen=True, eq=False)
class NormalPhi:
    """N(mean, root root'): mean n_phi, root n_phi x n_phi."""

    mean: np.ndarray
    root: np.ndarray

    def draw(self, n: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        """Draws, n x n_phi, and their log densities without the constant, n."""
        white = rng.standard_normal((n, len(self.mean)))
        return self.mean + white @ self.root.T, -0.5 * np.sum(white**2, axis=1)


def approximate_phi(
    density: JointDensity,
    mode: np.ndarray,
    n_workers: int,
    progress: Callable[[str], None] | None = None,
) -> tuple[NormalPhi, float]:
    """Normal approximation of phi given psi at the joint mode (n_phi + n_psi), and CPU seconds of other processes.

    One gradient of the joint density for each of the 2 n_phi differences.
    """
    n_phi = density.layout.n_phi
    rows, cpu_s = spread(_row, (density, mode), list(range(n_phi)), n_workers, progress, "curvature of the emulator")
    return NormalPhi(mode[:n_phi], np.linalg.cholesky(covariance_of(np.array(rows)[:, :n_phi]))), cpu_s


def _row(shared: tuple[JointDensity, np.ndarray], i: int) -> np.ndarray:
    """Row i of the negative Hessian of the log density."""
    density, mode = shared
    step = np.zeros_like(mode)
    step[i] = _STEP
    return (density(mode - step)[1] - density(mode + step)[1]) / (2.0 * _STEP)
