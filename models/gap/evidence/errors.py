"""What honest simulators, prints, placements and sensors differ by, as covariances of what the likelihood reads.

Nothing here is fitted on panels of known truth. What two simulators of the same physics differ by is taken from the
bank's own numerical variants, and from what its surfaces over theta miss at the points that they were fitted to.
"""

from dataclasses import dataclass

import numpy as np

from fast.models.gap.bank.bank import DEEPER_MM
from fast.models.gap.bank.surrogate import Surrogate
from fast.models.gap.bank.sensor_effects import N_LEAD
from fast.models.gap.evidence.reading import OF_BINS, OF_CONTRASTS, Reading

TOOL_SD = 0.04  # of the modulus of a print, relative
TARE_SD_N = 0.03  # what taring leaves
PLACEMENT_SD_MM = 0.15  # of the height at which an object stands
_LEAST_SHARE = 1e-3  # of the peak: an error that every simulator has
_LEAST_FORCE = 0.1  # of the median cell's: below it, changes do not grow with the force of a cell


@dataclass(frozen=True)
class Scatter:
    """Relative standard deviations of what varies by itself: of cells and of repeats of a cell."""

    cell: float = 0.02
    repeat: float = 0.01


@dataclass(frozen=True, eq=False)
class Errors:
    """Errors of c cells at the bank's centre.

    solver: b x b, covariance over the peak of a cell squared. variants: c x v x b, what each numerical variant changes,
    N. placed: c x b, what 1 mm higher changes, N. noise, contrast_noise: covariances of one grasp's noise, N^2. size_n:
    c, root mean square of the centre's force.
    """

    solver: np.ndarray
    variants: np.ndarray
    placed: np.ndarray
    noise: np.ndarray
    contrast_noise: np.ndarray
    size_n: np.ndarray

    @staticmethod
    def of(surrogate: Surrogate, reading: Reading) -> "Errors":
        """The errors of these cells, from the bank of the surrogate."""
        bank, grasps = surrogate.bank, reading.grasps
        known = np.isfinite(bank.centre_steps_n).all(axis=-1)
        centre = bank.centre_steps_n @ OF_BINS.T
        peak = np.abs(centre).max(axis=-1)[..., None, None]
        numerical = bank.numerical_steps_n @ OF_BINS.T - centre[:, :, None]
        missed = _find_missed(surrogate) @ OF_BINS.T
        solver = _pool(numerical / peak, known) + _pool(missed / peak, known, is_mean=True)
        tool, column = grasps.tool[reading.rows], surrogate.column[reading.rows]
        placed = (bank.placed_steps_n[:, :, 1] - bank.placed_steps_n[:, :, 0]) @ OF_BINS.T / (DEEPER_MM[1] - DEEPER_MM[0])
        speed = float(np.median(grasps.lift_speed_mm_per_s))
        of_steps = grasps.noise.step_covariance(OF_BINS.shape[1], speed)
        size = np.sqrt((centre**2).mean(axis=-1))
        return Errors(
            solver=solver + _LEAST_SHARE**2 * np.eye(len(solver)),
            variants=np.nan_to_num(numerical[tool, column]),
            placed=np.nan_to_num(placed[tool, column]),
            noise=OF_BINS @ of_steps @ OF_BINS.T,
            contrast_noise=OF_CONTRASTS @ of_steps @ OF_CONTRASTS.T,
            size_n=np.maximum(size, _LEAST_FORCE * np.nanmedian(size))[tool, column],
        )

    def of_means(self, force_n: np.ndarray, grows: np.ndarray, n_repeats: np.ndarray, scatter: Scatter) -> np.ndarray:
        """Covariances of means of cells, c x b x b; force_n: c x b, as predicted; grows: c, over the centre's."""
        b = force_n.shape[1]
        peak = np.abs(force_n).max(axis=1)[:, None, None]
        moved = PLACEMENT_SD_MM * self.placed * grows[:, None]
        relative = (scatter.cell**2 + scatter.repeat**2 / n_repeats)[:, None, None]
        of_grasps = self.noise + TARE_SD_N**2 * np.ones((b, b))
        return np.asarray(
            self.solver * peak**2
            + moved[:, :, None] * moved[:, None]
            + relative * force_n[:, :, None] * force_n[:, None]
            + of_grasps / n_repeats[:, None, None]
        )

    def of_contrasts(self, force_n: np.ndarray, scatter: Scatter) -> np.ndarray:
        """Covariances of contrasts of repeats, r x d x d; force_n: r x d, of their cells."""
        d = force_n.shape[1]
        of_grasps = self.contrast_noise + TARE_SD_N**2 * np.ones((d, d))
        return np.asarray(scatter.repeat**2 * force_n[:, :, None] * force_n[:, None] + of_grasps)


def _find_missed(surrogate: Surrogate) -> np.ndarray:
    """What the surfaces miss at the grid's points, t x k x g x 120, as large as at points that were not fitted."""
    bank, surfaces = surrogate.bank, surrogate.surfaces
    basis = surfaces.rows(bank.grid[:, 0], bank.grid[:, 1])
    fitted = np.einsum("gk,tokf->togf", basis, surfaces.coefficients[..., N_LEAD:])
    q, _ = np.linalg.qr(basis)
    leverage = np.minimum((q**2).sum(axis=1), 1.0 - 1e-6)
    return np.asarray((fitted - bank.grid_steps_n) / np.sqrt(1.0 - leverage)[:, None])


def _pool(shares: np.ndarray, known: np.ndarray, *, is_mean: bool = False) -> np.ndarray:
    """Outer product over cells (t x k x v x b), mean over cells; summed over variants, or their mean."""
    rows = shares[known]
    rows = rows[np.isfinite(rows).all(axis=(1, 2))]
    total = np.einsum("cvb,cvd->bd", rows, rows) / max(len(rows), 1)
    return np.asarray(total / shares.shape[2] if is_mean else total)
