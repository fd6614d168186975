"""Coordinates in which the ridge between Young's modulus and friction is straight.

Where E is a factor, forces are E times what friction and Poisson ratio make of a design: measurements fix the product,
and the posterior is a curved ridge along which NUTS takes small steps. With ln E + g(t) in the place of ln E, where g
is the logarithm of the mean emulated force, the ridge runs along an axis. The map is a shear, of Jacobian 1 for any g.
"""

from dataclasses import dataclass

import numpy as np

from models.calibration.means.level import Level
from models.calibration.means.theta_surrogate import ThetaSurrogate

_FLOOR = 0.05  # of the mean force: keeps g smooth and finite where the emulated mean is near zero


@dataclass(frozen=True, eq=False)
class Straightened:
    """The stand-in's density over straightened vectors (n_psi); where E is an input, over psi itself."""

    surrogate: ThetaSurrogate
    level: Level | None = None  # taken off, so that chains cross from one summit of the ridge to another

    def __call__(self, values: np.ndarray) -> tuple[float, np.ndarray]:
        """Value and gradient, as those of the stand-in less `level`."""
        value, gradient = self._of_stand_in(values)
        if self.level is not None:
            value -= self.level(values)
            gradient[-2] -= self.level.slope(values)
        return value, gradient

    def _of_stand_in(self, values: np.ndarray) -> tuple[float, np.ndarray]:
        if not self._is_sheared:
            return self.surrogate(values)
        shift, slopes = self._log_mean(values)
        psi = values.copy()
        psi[-3] -= shift
        value, gradient = self.surrogate(psi)
        gradient[-2:] -= slopes * gradient[-3]
        return value, gradient

    def from_psi(self, vectors: np.ndarray) -> np.ndarray:
        """Straightened vectors of psi, ... x n_psi."""
        return self._moved(vectors, 1.0)

    def to_psi(self, vectors: np.ndarray) -> np.ndarray:
        """Inverse of `from_psi`."""
        return self._moved(vectors, -1.0)

    def covariance(self, covariance: np.ndarray, at: np.ndarray) -> np.ndarray:
        """Covariance of straightened vectors (n_psi x n_psi) from that of psi, to first order at a psi."""
        jacobian = np.eye(len(at))
        if self._is_sheared:
            jacobian[-3, -2:] = self._log_mean(at)[1]
        return np.asarray(jacobian @ covariance @ jacobian.T)

    @property
    def _is_sheared(self) -> bool:
        return self.surrogate.setting.data.scales_with_modulus

    def _moved(self, vectors: np.ndarray, sign: float) -> np.ndarray:
        moved = np.array(vectors, dtype=float)
        if self._is_sheared:
            rows = moved.reshape(-1, moved.shape[-1])
            rows[:, -3] += sign * np.array([self._log_mean(row)[0] for row in rows])
        return moved

    def _log_mean(self, values: np.ndarray) -> tuple[float, np.ndarray]:
        """G at the friction and Poisson ratio of a vector, and its slopes by their unconstrained forms (2)."""
        setting = self.surrogate.setting
        theta = setting.layout.theta(values[-3:])
        mean, by_inputs = self.surrogate.mean_force(setting.inputs(theta))
        floor = _FLOOR * max(abs(setting.data.mean), 1.0)
        squared = mean**2 + floor**2
        slopes = mean / squared * by_inputs * setting.input_slopes(theta)
        slopes += (setting.data.amplitude_slopes(theta) * setting.layout.theta_slopes(theta))[1:]
        return 0.5 * float(np.log(squared)) + float(np.log(setting.data.amplitude(theta, 1.0) / theta[0])), slopes
