"""Log posterior of theta and three scales given traces, with its gradient; the random effects are integrated out.

    y_to = F(theta; t, o) (1 + b_t) + H a_o + c_to + e_to,    b_t ~ N(0, tool_sd^2), a_o ~ N(0, object_sd^2 1),

y: features of tool t on object o, mean over repeats. b: modulus from print to print. H a: what the simulator has wrong
about the object, in shares of the cell's amplitude and correlated over the lift, covariance object_sd^2 C = H H'.
c: the same in this cell alone, covariance cell_sd^2 C. e: sensor noise, repeats, response surface and mesh, of known
covariance.

Of F only the forces scale with b. In whitened coordinates (`Frame`) a cell has independent features of variance
1 + cell_sd^2 d. What couples cells are the effects u = (b, a), integrated out by Woodbury's identity; their precision
is an arrow, since each cell has one tool and one object, and is eliminated object by object. The gradient follows from
Fisher's identity: that of the joint density of y and u, averaged over u given y.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.special import expit, logit

from models.calibration.settings import ThetaPriors
from models.calibration.traces.frame import Frame
from models.calibration.traces.surface import ResponseSurfaces
from models.errors import UsageError

SCALES = ("tool_sd", "object_sd", "cell_sd")
NAMES = (*SCALES, "young_modulus_mpa", "friction", "poisson_ratio")
# (median, sd of the logarithm): notes/gap.md, 3 Data model; relative.
SCALE_PRIORS = ((0.04, 0.5), (0.03, 0.7), (0.03, 0.7))


@dataclass(frozen=True, eq=False)
class _Cells:
    """Whitened cells at given parameters.

    terms: 3 x k, of the surfaces, with slopes. force, residual: t x o x f, predicted forces, and measured less
    predicted features. slack, weight: t x o x f, variance beyond 1, and precision.
    """

    terms: np.ndarray
    force: np.ndarray
    residual: np.ndarray
    slack: np.ndarray
    weight: np.ndarray


@dataclass(frozen=True, eq=False)
class _Effects:
    """Effects u given y: means and covariances. b: t. b_cov: t x t. a: o x f. a_cov: o x f x f. ab_cov: o x f x t.

    log_det: of the precision of u times its prior covariance. explained: squares of y that u takes up.
    """

    b: np.ndarray
    b_cov: np.ndarray
    a: np.ndarray
    a_cov: np.ndarray
    ab_cov: np.ndarray
    log_det: float
    explained: float


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
        values = self.constrained(vector)
        cells = self._cells(values[3:], values[2])
        effects = self._effects(cells, values[0], values[1])
        return effects.b, np.sqrt(np.diag(effects.b_cov))

    @cached_property
    def _whitened(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Measured features (t x o x f) and terms of forces and of lifts (k x t x o x f each), whitened."""
        whitener, coefficients = self.frame.whitener, self.surfaces.coefficients
        measured = (whitener @ self.frame.measured[..., None])[..., 0]
        transposed = np.swapaxes(whitener, -1, -2)
        forces = np.where(self.surfaces.is_force, coefficients, 0.0) @ transposed
        lifts = np.where(self.surfaces.is_force, 0.0, coefficients) @ transposed
        return measured, np.moveaxis(forces, 2, 0).copy(), np.moveaxis(lifts, 2, 0).copy()

    def _cells(self, theta: np.ndarray, cell_sd: float) -> _Cells:
        measured, forces, lifts = self._whitened
        terms = self.surfaces.basis(theta[1], theta[2])
        force = theta[0] / self.surfaces.modulus_mpa * np.tensordot(terms[0], forces, 1)
        residual = measured - force - np.tensordot(terms[0], lifts, 1)
        slack = cell_sd**2 * self.frame.slack
        return _Cells(terms, force, residual, slack, self.frame.is_measured[..., None] / (1.0 + slack))

    def _log_likelihood(self, values: np.ndarray) -> tuple[float, np.ndarray]:
        """Value, and slopes by log scales and by theta (6)."""
        theta, (tool_sd, object_sd, cell_sd) = values[3:], values[:3]
        cells = self._cells(theta, cell_sd)
        effects = self._effects(cells, tool_sd, object_sd)
        squares = (cells.weight * cells.residual**2).sum() - effects.explained
        value = -0.5 * (squares + np.log1p(cells.slack).sum() + effects.log_det)
        # From here on averages over the effects given y.
        obj, b, force = self.frame.obj, effects.b[:, None, None], cells.force
        left = cells.residual - force * b - (obj @ effects.a[..., None])[..., 0]
        with_b = force * np.diag(effects.b_cov)[:, None, None]
        with_b = with_b + (obj @ effects.ab_cov.transpose(2, 0, 1)[..., None])[..., 0]
        of_a = ((obj @ effects.a_cov) * obj).sum(axis=-1)
        variance = force * (2.0 * with_b - force * np.diag(effects.b_cov)[:, None, None]) + of_a
        by_cell = (cells.slack * cells.weight * (cells.weight * (left**2 + variance) - 1.0)).sum()
        by_tool = (effects.b @ effects.b + np.trace(effects.b_cov)) / tool_sd**2 - effects.b.size
        offsets = (effects.a**2).sum() + np.trace(effects.a_cov, axis1=1, axis2=2).sum()
        by_object = offsets / object_sd**2 - effects.a.size
        by_theta = self._by_theta(theta, cells.terms, cells.weight * (left * (1.0 + b) - with_b), cells.weight * left)
        return float(value), np.array([by_tool, by_object, by_cell, *by_theta])

    def _by_theta(self, theta: np.ndarray, terms: np.ndarray, by_force: np.ndarray, by_lift: np.ndarray) -> np.ndarray:
        """Slopes by theta (3) from those by the whitened predictions of forces and of lifts (t x o x f each)."""
        _, forces, lifts = self._whitened
        force_terms, lift_terms = np.tensordot(forces, by_force, 3), np.tensordot(lifts, by_lift, 3)
        share = theta[0] / self.surfaces.modulus_mpa
        by_modulus = terms[0] @ force_terms / self.surfaces.modulus_mpa
        return np.array([by_modulus, *(terms[1:] @ (share * force_terms + lift_terms))])

    def _effects(self, cells: _Cells, tool_sd: float, object_sd: float) -> _Effects:
        """Effects u given y, by elimination of the objects, which leaves the tools."""
        obj, force, weight = self.frame.obj, cells.force, cells.weight
        t, o, f = force.shape
        transposed = np.swapaxes(weight[..., None] * obj, -1, -2)
        precision = (transposed @ obj).sum(axis=0) + np.eye(f) / object_sd**2
        sides = transposed @ np.stack([force, cells.residual], axis=-1)
        coupling, own = sides[..., 0].transpose(1, 2, 0), sides[..., 1].sum(axis=0)
        log_det = 2.0 * np.log(np.diagonal(np.linalg.cholesky(precision), axis1=1, axis2=2)).sum()
        inverse = np.linalg.inv(precision)
        towards = inverse @ coupling
        schur = np.diag((weight * force**2).sum(axis=(1, 2)) + 1.0 / tool_sd**2)
        schur = schur - np.tensordot(coupling, towards, axes=([0, 1], [0, 1]))
        b_cov = np.linalg.inv(schur)
        pull = (weight * force * cells.residual).sum(axis=(1, 2))
        b = b_cov @ (pull - np.tensordot(own, towards, 2))
        a = (inverse @ own[..., None])[..., 0] - towards @ b
        ab_cov = -towards @ b_cov
        log_det += np.linalg.slogdet(schur)[1] + 2.0 * (t * np.log(tool_sd) + o * f * np.log(object_sd))
        a_cov = inverse - ab_cov @ np.swapaxes(towards, 1, 2)
        return _Effects(b, b_cov, a, a_cov, ab_cov, float(log_det), float(pull @ b + (own * a).sum()))

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
