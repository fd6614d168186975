"""How simulated forces go on the whole: the unit in which they are emulated where Young's modulus is a factor.

A stationary process has the same uncertainty everywhere, in its own unit. Forces per MPa are small where friction is,
and E times their uncertainty then grows along the ridge on which E and friction trade: a likelihood favours the end
where the emulator claims to be surer. In units of a trend the uncertainty is a share of the force, alike along the
ridge; and what is left to be emulated bends less, so that the same simulations say more.
"""

from dataclasses import dataclass

import numpy as np

from fast.models.design.space import PARAMETERS

FRICTION_OFFSET = 0.3  # friction at which ln(friction + offset) turns from a line into a logarithm
_RIDGE = 1e-3  # share of the mean weight: coefficients that the simulations do not determine stay near zero
_ITERATIONS = 50
_TOLERANCE = 1e-8
_STEEPEST = 30.0  # logarithm of force over mean force at which an early iteration is cut, against overflow


@dataclass(frozen=True)
class ForceTrend:
    """Forces per MPa go as tau(x) q(friction, Poisson's ratio); both are 1 where all coefficients are 0.

    ln tau = b (x - 1/2) over the nine design variables in the unit cube. ln q = c_0 u + c_1 u^2 + c_2 nu with
    u = ln(friction + offset) less its mean over the simulations.
    """

    by_design: tuple[float, ...] = (0.0,) * len(PARAMETERS)
    by_theta: tuple[float, ...] = (0.0, 0.0, 0.0)
    center: float = 0.0

    @staticmethod
    def fit(x: np.ndarray, friction: np.ndarray, poisson_ratio: np.ndarray, force: np.ndarray) -> "ForceTrend":
        """Fit to forces per MPa (n) of unit-cube designs x (n x 9); negative ones count as zero.

        A log-linear model whose variance grows with its mean (quasi-likelihood; McCullagh and Nelder 1989, chapter 9):
        forces of zero are data like others.
        """
        center = float(np.mean(np.log(friction + FRICTION_OFFSET)))
        terms = [np.ones((len(x), 1)), x - 0.5, _theta_terms(friction, poisson_ratio, center)]
        found = _log_linear(np.column_stack(terms), np.maximum(force, 0.0)).tolist()
        return ForceTrend(tuple(found[1:-3]), tuple(found[-3:]), center)

    def of_designs(self, x: np.ndarray) -> np.ndarray:
        """Return the factor tau of unit-cube designs (n x 9), n."""
        return np.asarray(np.exp((x - 0.5) @ np.array(self.by_design)))

    def of_theta(self, friction: np.ndarray, poisson_ratio: np.ndarray) -> np.ndarray:
        """Return the factor q, of the shape of the arguments."""
        return np.asarray(np.exp(_theta_terms(friction, poisson_ratio, self.center) @ np.array(self.by_theta)))

    def log_slopes(self, friction: float) -> np.ndarray:
        """Return the slopes of ln q by friction and by Poisson's ratio, 2."""
        u = np.log(friction + FRICTION_OFFSET) - self.center
        by_friction = (self.by_theta[0] + 2.0 * self.by_theta[1] * u) / (friction + FRICTION_OFFSET)
        return np.array([by_friction, self.by_theta[2]])


def _theta_terms(friction: np.ndarray, poisson_ratio: np.ndarray, center: float) -> np.ndarray:
    u = np.log(np.asarray(friction) + FRICTION_OFFSET) - center
    return np.stack([u, u**2, np.asarray(poisson_ratio)], axis=-1)


def _log_linear(terms: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Fit coefficients b (k) of mean values exp(terms b), terms n x k, by iteratively reweighted least squares."""
    b = np.zeros(terms.shape[1])
    b[0] = np.log(max(float(values.mean()), np.finfo(float).tiny))
    for _ in range(_ITERATIONS):
        mean = np.exp(np.minimum(terms @ b, b[0] + _STEEPEST))
        hessian = terms.T @ (terms * mean[:, None])
        hessian += _RIDGE * float(mean.mean()) * np.eye(len(b))
        step = np.linalg.solve(hessian, terms.T @ (values - mean))
        b += step
        if np.abs(step).max() < _TOLERANCE:
            break
    return b
