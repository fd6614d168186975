"""Log posterior of theta and three scales given traces, with its gradient; the random effects are integrated out.

    y_to = F(theta; t, o) + F b_t + H a_o + c_to + e_to,    b_t ~ N(0, tool_sd^2), a_o ~ N(0, object_sd^2 1),

y: features of tool t on object o, mean over repeats. b: modulus from print to print. a: offsets of every feature of an
object, relative to the cell's amplitude H: what the simulator has wrong about the object. c: scatter of the cell, of
covariance cell_sd^2 C. e: sensor noise, repeats, response surface and mesh, of known covariance.

In whitened coordinates (`Frame`) a cell has independent features of variance 1 + cell_sd^2 d. What couples cells are
the effects u = (b, a), integrated out by Woodbury's identity; their precision is an arrow, since each cell has one
tool and one object, and is eliminated object by object. The gradient follows from Fisher's identity: that of the
joint density of y and u, averaged over u given y.
"""

from dataclasses import dataclass

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
class _Effects:
    """Effects u given y. b: t, mean; b_cov: t x t. a: o x f. a_cov: o x f x f. ab_cov: o x f x t."""

    b: np.ndarray
    b_cov: np.ndarray
    a: np.ndarray
    a_cov: np.ndarray
    ab_cov: np.ndarray


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
        """Relative modulus of each tool given the parameters: mean and standard deviation (t, t)."""
        values = self.constrained(vector)
        predicted, _ = self.surfaces.features(values[3:])
        residual, weight = self._whitened(predicted), self._weight(values[2])
        effects, _, _ = self._effects(residual, weight, values[0], values[1])
        return effects.b, np.sqrt(np.diag(effects.b_cov))

    def _whitened(self, predicted: np.ndarray) -> np.ndarray:
        difference = np.where(self.frame.is_measured[..., None], self.frame.measured - predicted, 0.0)
        return np.asarray((self.frame.whitener @ difference[..., None])[..., 0])

    def _weight(self, cell_sd: float) -> np.ndarray:
        """Precision of a whitened feature; 0 in cells that were not measured."""
        return np.asarray(self.frame.is_measured[..., None] / (1.0 + cell_sd**2 * self.frame.slack))

    def _log_likelihood(self, values: np.ndarray) -> tuple[float, np.ndarray]:
        """Value, and slopes by log scales and by theta (6)."""
        frame, (tool_sd, object_sd, cell_sd) = self.frame, values[:3]
        predicted, slopes = self.surfaces.features(values[3:])
        residual, weight = self._whitened(predicted), self._weight(cell_sd)
        effects, log_det, explained = self._effects(residual, weight, tool_sd, object_sd)
        slack = cell_sd**2 * frame.slack
        value = -0.5 * ((weight * residual**2).sum() - explained + np.log1p(slack).sum() + log_det)
        left = residual - frame.tool * effects.b[:, None, None] - (frame.obj @ effects.a[None, :, :, None])[..., 0]
        by_theta = np.einsum("tof,tofg,ptog->p", weight * left, frame.whitener, slopes, optimize=True)
        squared = left**2 + self._variance(effects)
        by_cell = (slack * (weight**2 * squared - weight)).sum()
        n_tools, n_offsets = len(effects.b), effects.a.size
        by_tool = ((effects.b**2).sum() + np.trace(effects.b_cov)) / tool_sd**2 - n_tools
        offsets = (effects.a**2).sum() + np.trace(effects.a_cov, axis1=1, axis2=2).sum()
        by_object = offsets / object_sd**2 - n_offsets
        return float(value), np.array([by_tool, by_object, by_cell, *by_theta])

    def _effects(
        self, residual: np.ndarray, weight: np.ndarray, tool_sd: float, object_sd: float
    ) -> tuple[_Effects, float, float]:
        """Effects given y; log det of prior covariance times precision; and what they explain of the squares."""
        tool, obj = self.frame.tool, self.frame.obj
        t, o, f = tool.shape
        weighted = (weight[..., None] * obj).transpose(1, 0, 2, 3).reshape(o, t * f, f)
        flat = obj.transpose(1, 0, 2, 3).reshape(o, t * f, f)
        precision = np.swapaxes(weighted, 1, 2) @ flat + np.eye(f) / object_sd**2
        coupling = np.einsum("otfg,tof->ogt", weighted.reshape(o, t, f, f), tool)
        own = np.einsum("otfg,tof->og", weighted.reshape(o, t, f, f), residual)
        root = np.linalg.cholesky(precision)
        a_own = np.linalg.inv(precision)
        towards = a_own @ coupling
        tool_precision = np.diag((weight * tool**2).sum(axis=(1, 2)) + 1.0 / tool_sd**2)
        schur = tool_precision - np.einsum("ogt,ogs->ts", coupling, towards)
        b_cov = np.linalg.inv(schur)
        pull = (weight * tool * residual).sum(axis=(1, 2))
        b = b_cov @ (pull - np.einsum("ogt,og->t", towards, own))
        a = (a_own @ own[..., None])[..., 0] - towards @ b
        ab_cov = -towards @ b_cov
        effects = _Effects(b, b_cov, a, a_own - ab_cov @ np.swapaxes(towards, 1, 2), ab_cov)
        log_det = 2.0 * np.log(np.diagonal(root, axis1=1, axis2=2)).sum() + np.linalg.slogdet(schur)[1]
        log_det += 2.0 * (t * np.log(tool_sd) + o * f * np.log(object_sd))
        return effects, float(log_det), float(pull @ b + (own * a).sum())

    def _variance(self, effects: _Effects) -> np.ndarray:
        """Variance, given y, of what the effects add to each whitened feature, t x o x f."""
        tool, obj = self.frame.tool, self.frame.obj
        own = tool**2 * np.diag(effects.b_cov)[:, None, None]
        both = 2.0 * tool * np.einsum("tofg,ogt->tof", obj, effects.ab_cov, optimize=True)
        return np.asarray(own + both + ((obj @ effects.a_cov[None]) * obj).sum(axis=-1))

    def _log_prior(self, vector: np.ndarray, values: np.ndarray) -> tuple[float, np.ndarray]:
        """Priors with the Jacobians of the transforms, and their slopes by the unconstrained vector."""
        medians, sds = np.array([*SCALE_PRIORS, (self.priors.young_modulus_median_mpa, self.priors.young_modulus_log_sd)]).T
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
