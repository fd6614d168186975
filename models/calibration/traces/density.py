"""Log posterior of theta and three scales given traces, with its gradient; the random effects are integrated out.

    y_to = F(theta; t, o) (1 + b_t) + G g + H a_o + c_to + e_to,
    b_t ~ N(0, tool_sd^2), g ~ N(0, 1), a_o ~ N(0, object_sd^2 1).

y: features of tool t on object o, mean over repeats. b: modulus from print to print. G g: what mesh and contact law do
to all grasps alike, of known size. H a: what the simulator has wrong about the object, in shares of the cell's
amplitude and correlated over the lift, covariance object_sd^2 C = H H'. c: the same in this cell alone, covariance
cell_sd^2 C. e: sensor noise, repeats, response surface and mesh, of known covariance. Only forces scale with b.

In whitened coordinates (`Frame`) a cell has independent features of variance 1 + cell_sd^2 d. The effects b, g, a are
integrated out (`Effects`). The gradient follows from Fisher's identity: that of the joint density of y and effects,
averaged over the effects given y.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.special import expit, logit

from models.calibration.inference.settings import ThetaPriors
from models.calibration.traces.covariances import Frame
from models.calibration.traces.random_effects import Cells, Effects
from models.calibration.traces.response_surface import ResponseSurfaces
from models.errors import UsageError

SCALES = ("tool_sd", "object_sd", "cell_sd")
NAMES = (*SCALES, "young_modulus_mpa", "friction", "poisson_ratio")
# (median, sd of the logarithm): notes/gap.md, 3 Data model; relative.
SCALE_PRIORS = ((0.04, 0.5), (0.03, 0.7), (0.03, 0.7))


@dataclass(frozen=True, eq=False)
class TraceDensity:
    """The log posterior over the unconstrained vector: log scales, ln E, logits of friction and Poisson ratio.

    Friction and Poisson ratio are confined to where both the grid and the priors are.
    """

    frame: Frame
    surfaces: ResponseSurfaces
    priors: ThetaPriors

    def __post_init__(self) -> None:
        """Check that grid and priors meet.

        Raises:
            UsageError: the prior of Poisson's ratio leaves nothing of the grid.
        """
        low, high = self.limits
        if low[1] >= high[1]:
            raise UsageError(
                f"the grid's Poisson ratios end at {self.surfaces.upper[1]:g} and the prior's begin at "
                f"{self.priors.poisson_ratio_lower:g}; simulate a grid within the prior."
            )

    @property
    def limits(self) -> tuple[np.ndarray, np.ndarray]:
        """Least and greatest friction and Poisson ratio (2, 2)."""
        low = np.maximum(self.surfaces.lower, [0.0, self.priors.poisson_ratio_lower])
        return low, np.minimum(self.surfaces.upper, [np.inf, self.priors.poisson_ratio_upper])

    @property
    def start(self) -> np.ndarray:
        """Unconstrained vector of the first estimate of theta and the prior medians of the scales (6)."""
        low, high = self.limits
        share = np.clip((self.frame.theta[1:] - low) / (high - low), 0.05, 0.95)
        scales = np.log([median for median, _ in SCALE_PRIORS])
        return np.concatenate([scales, np.log(self.frame.theta[:1]), logit(share)])

    def constrained(self, vectors: np.ndarray) -> np.ndarray:
        """Parameters in the order and units of `NAMES` from unconstrained vectors, ... x 6."""
        low, high = self.limits
        return np.concatenate([np.exp(vectors[..., :4]), low + (high - low) * expit(vectors[..., 4:])], axis=-1)

    def __call__(self, vector: np.ndarray) -> tuple[float, np.ndarray]:
        """Log density without its constant, and gradient (6), at an unconstrained vector (6)."""
        values = self.constrained(vector)
        likelihood, slopes = self._log_likelihood(values)
        prior, prior_slopes = self._log_prior(vector, values)
        return likelihood + prior, slopes * self._jacobian(vector, values) + prior_slopes

    def tool_moduli(self, vector: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Modulus of each tool over Young's modulus, less 1, given the parameters: mean and sd (t, t)."""
        effects = self._effects(vector)
        return effects.b, np.sqrt(np.diag(effects.head_cov)[: len(effects.b)])

    def distances(self, vector: np.ndarray) -> np.ndarray:
        """Squared distance of cells from what is expected of them, if their spread were 1; usually about f, t x o."""
        effects = self._effects(vector)
        return np.asarray(self.frame.spread * (effects.cells.weight * effects.left**2).sum(axis=-1))

    def _effects(self, vector: np.ndarray) -> Effects:
        values = self.constrained(vector)
        terms = self.surfaces.basis(values[4], values[5])
        return Effects.of(self._cells(values[3], terms[0], values[2]), values[0], values[1])

    @cached_property
    def _whitened(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Measured features (t x o x f) and terms of forces and of lifts (k x t x o x f each), whitened."""
        whitener, coefficients = self.frame.whitener, self.surfaces.coefficients
        measured = (whitener @ self.frame.measured[..., None])[..., 0]
        transposed = np.swapaxes(whitener, -1, -2)
        forces = np.where(self.surfaces.is_force, coefficients, 0.0) @ transposed
        lifts = np.where(self.surfaces.is_force, 0.0, coefficients) @ transposed
        return measured, np.moveaxis(forces, 2, 0).copy(), np.moveaxis(lifts, 2, 0).copy()

    def _cells(self, modulus_mpa: float, terms: np.ndarray, cell_sd: float) -> Cells:
        measured, forces, lifts = self._whitened
        force = modulus_mpa / self.surfaces.modulus_mpa * np.tensordot(terms, forces, 1)
        weight = self.frame.is_measured[..., None] / (1.0 + cell_sd**2 * self.frame.slack)
        residual = measured - force - np.tensordot(terms, lifts, 1)
        return Cells(residual, weight, force, self.frame.shared, self.frame.obj)

    def _log_likelihood(self, values: np.ndarray) -> tuple[float, np.ndarray]:
        """Value, and slopes by log scales and by theta (6)."""
        theta, (tool_sd, object_sd, cell_sd) = values[3:], values[:3]
        terms = self.surfaces.basis(theta[1], theta[2])
        cells = self._cells(theta[0], terms[0], cell_sd)
        effects = Effects.of(cells, tool_sd, object_sd)
        slack, weight, left = cell_sd**2 * self.frame.slack, cells.weight, effects.left
        squares = (weight * cells.residual**2).sum() - effects.explained
        value = -0.5 * (squares + np.log1p(slack).sum() + effects.log_det)
        by_cell = (slack * weight * (weight * (left**2 + effects.variance) - 1.0)).sum()
        n_tools = len(effects.b)
        by_tool = (effects.b @ effects.b + np.trace(effects.head_cov[:n_tools, :n_tools])) / tool_sd**2 - n_tools
        offsets = (effects.a**2).sum() + np.trace(effects.a_cov, axis1=1, axis2=2).sum()
        by_object = offsets / object_sd**2 - effects.a.size
        by_force = weight * (left * (1.0 + effects.b[:, None, None]) - effects.with_tool)
        by_theta = self._by_theta(theta, terms, by_force, weight * left)
        return float(value), np.array([by_tool, by_object, by_cell, *by_theta])

    def _by_theta(self, theta: np.ndarray, terms: np.ndarray, by_force: np.ndarray, by_lift: np.ndarray) -> np.ndarray:
        """Slopes by theta (3) from those by the whitened predictions of forces and of lifts (t x o x f each)."""
        _, forces, lifts = self._whitened
        force_terms, lift_terms = np.tensordot(forces, by_force, 3), np.tensordot(lifts, by_lift, 3)
        share = theta[0] / self.surfaces.modulus_mpa
        by_modulus = terms[0] @ force_terms / self.surfaces.modulus_mpa
        return np.array([by_modulus, *(terms[1:] @ (share * force_terms + lift_terms))])

    def _log_prior(self, vector: np.ndarray, values: np.ndarray) -> tuple[float, np.ndarray]:
        """Priors with the Jacobians of the transforms, and their slopes by the unconstrained vector."""
        medians, sds = np.array(
            [*SCALE_PRIORS, (self.priors.young_modulus_median_mpa, self.priors.young_modulus_log_sd)]
        ).T
        deviation = (vector[:4] - np.log(medians)) / sds
        low, high = self.limits
        friction, shares = values[4], expit(vector[4:])
        shape, rate = self.priors.friction_shape, self.priors.friction_rate
        value = -0.5 * deviation @ deviation + (shape - 1.0) * np.log(friction) - rate * friction
        value += (np.log(shares) + np.log1p(-shares)).sum()
        slopes = np.concatenate([-deviation / sds, 1.0 - 2.0 * shares])
        span = (high - low) * shares * (1.0 - shares)
        slopes[4] += ((shape - 1.0) / friction - rate) * span[0]
        return float(value), slopes

    def _jacobian(self, vector: np.ndarray, values: np.ndarray) -> np.ndarray:
        """Slopes of log scales and of theta by the unconstrained vector (6)."""
        low, high = self.limits
        shares = expit(vector[4:])
        return np.concatenate([np.ones(3), values[3:4], (high - low) * shares * (1.0 - shares)])
