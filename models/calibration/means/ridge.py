"""The ridge between Young's modulus and friction made fit for NUTS: straight, and without deep passes.

Where E is a factor, forces are E times what friction and Poisson ratio make of a design: measurements fix the product,
and the posterior is a curved ridge along which NUTS takes small steps. *Reparameterised*: with ln E + g(t) in the place
of ln E, where g is the logarithm of the mean emulated force, the ridge runs along an axis. The map is a shear, of
Jacobian 1 for any g.

*Tempered*: friction is hardly known, and the emulator's errors make hills along the ridge, often several nats apart,
which NUTS does not cross. Chains run on the density with a share of its profile over friction taken off; the importance
weights put it back (umbrella sampling; Torrie and Valleau 1977).
"""

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.interpolate import PchipInterpolator

from fast.models.calibration.inference.optimise import LogDensity, climb
from fast.models.calibration.means.theta_surrogate import ThetaSurrogate

_N_GRID = 40
_COUNTS = 7.0  # nats below the highest summit at which another one still matters
_PASS = 2.0  # nats that chains may have to climb down to a pass
_FRICTION = -2  # place of ln friction in the vector of psi
_FLOOR = 0.05  # of the mean force: keeps g smooth and finite where the emulated mean is near zero


def temper_ridge(log_density: LogDensity, mode: np.ndarray, ends: tuple[float, float]) -> PchipInterpolator | None:
    """Find nats to take off a density of psi (n_psi), a curve of ln friction, from its profile between `ends`.

    None where there is one summit, or the passes between them are low enough.
    """
    grid = np.linspace(*ends, _N_GRID)
    share, floor = find_share_taken_off(values := find_profile(log_density, mode, grid))
    if share == 0.0:
        return None
    return PchipInterpolator(grid, share * (np.maximum(values, floor) - values.max()))


def find_profile(log_density: LogDensity, mode: np.ndarray, grid: np.ndarray) -> np.ndarray:
    """Find the largest log density at each ln friction of a grid (n), outwards from the mode (n_psi), n."""
    values = np.empty(len(grid))
    first = int(np.argmin(np.abs(grid - mode[_FRICTION])))
    for places in (range(first, len(grid)), range(first, -1, -1)):
        rest = np.delete(mode, len(mode) + _FRICTION)
        for place in places:
            best = climb(_held(log_density, float(grid[place])), [rest])[0]
            values[place], rest = best.value, best.vector
    return values


def find_share_taken_off(values: np.ndarray) -> tuple[float, float]:
    """Find the share of a profile (n) leaving passes of `_PASS`, and the lowest pass's height, below which it stays."""
    inner = np.concatenate([[-np.inf], values, [-np.inf]])
    summits = np.flatnonzero((values > inner[:-2]) & (values >= inner[2:]) & (values > values.max() - _COUNTS))
    deepest, floor = 0.0, float(values.max())
    for one, other in combinations(summits, 2):
        lowest = float(values[one : other + 1].min())
        deepest = max(deepest, float(min(values[one], values[other])) - lowest)
        floor = min(floor, lowest)
    return (1.0 - _PASS / deepest if deepest > _PASS else 0.0), floor


def _held(log_density: LogDensity, log_friction: float) -> LogDensity:
    """Return the density with ln friction held, over the rest of psi (n_psi - 1)."""

    def density(rest: np.ndarray) -> tuple[float, np.ndarray]:
        place = len(rest) + 1 + _FRICTION
        value, gradient = log_density(np.insert(rest, place, log_friction))
        return value, np.delete(gradient, place)

    return density


@dataclass(frozen=True, eq=False)
class RidgeDensity:
    """The stand-in's density over reparameterised vectors (n_psi); where E is an input, over psi itself.

    tempering: taken off, so that chains cross from one summit of the ridge to another; level beyond its ends.
    """

    surrogate: ThetaSurrogate
    tempering: PchipInterpolator | None = None

    def __call__(self, values: np.ndarray) -> tuple[float, np.ndarray]:
        """Return value and gradient, as those of the stand-in less `tempering`."""
        value, gradient = self._of_stand_in(values)
        if self.tempering is not None:
            value -= self.taken_off(values)
            inside = _inside(self.tempering, values)
            gradient[_FRICTION] -= float(self.tempering(inside, 1)) if inside == values[_FRICTION] else 0.0
        return value, gradient

    def taken_off(self, psi: np.ndarray) -> float:
        """Return the nats taken off at a vector of psi (n_psi), reparameterised or not."""
        return 0.0 if self.tempering is None else float(self.tempering(_inside(self.tempering, psi)))

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
        """Return reparameterised vectors of psi, ... x n_psi."""
        return self._moved(vectors, 1.0)

    def to_psi(self, vectors: np.ndarray) -> np.ndarray:
        """Undo `from_psi`."""
        return self._moved(vectors, -1.0)

    def covariance(self, covariance: np.ndarray, at: np.ndarray) -> np.ndarray:
        """Return the covariance of reparameterised vectors (n_psi x n_psi) from psi's, to first order at a psi."""
        jacobian = np.eye(len(at))
        if self._is_sheared:
            jacobian[-3, -2:] = self._log_mean(at)[1]
        return np.asarray(jacobian @ covariance @ jacobian.T)

    @property
    def _is_sheared(self) -> bool:
        return self.surrogate.measured.data.scales_with_modulus

    def _moved(self, vectors: np.ndarray, sign: float) -> np.ndarray:
        moved = np.array(vectors, dtype=float)
        if self._is_sheared:
            rows = moved.reshape(-1, moved.shape[-1])
            rows[:, -3] += sign * np.array([self._log_mean(row)[0] for row in rows])
        return moved

    def _log_mean(self, values: np.ndarray) -> tuple[float, np.ndarray]:
        """Return G at the friction and Poisson ratio of a vector, and its slopes by their unconstrained forms (2)."""
        measured = self.surrogate.measured
        theta = measured.parameters.theta(values[-3:])
        mean, by_inputs = self.surrogate.mean_force(measured.inputs(theta))
        floor = _FLOOR * max(abs(measured.data.mean), 1.0)
        squared = mean**2 + floor**2
        slopes = mean / squared * by_inputs * measured.input_slopes(theta)
        slopes += (measured.data.amplitude_slopes(theta) * measured.parameters.theta_slopes(theta))[1:]
        return 0.5 * float(np.log(squared)) + float(np.log(measured.data.amplitude(theta, 1.0) / theta[0])), slopes


def _inside(profile: PchipInterpolator, psi: np.ndarray) -> float:
    """Return ln friction of a vector of psi, kept between the ends of a profile."""
    return float(np.clip(psi[_FRICTION], profile.x[0], profile.x[-1]))
