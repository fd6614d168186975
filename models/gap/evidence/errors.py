"""What honest simulators, prints, placements and sensors differ by, as covariances of what the likelihood reads.

Nothing here is fitted on panels of known truth. What two simulators of the same physics differ by is taken from the
bank's own numerical variants, and from what its surfaces over theta miss at the points that they were fitted to; how
much cells and repeats scatter is estimated from the data. A few cells show a few of the ways in which simulators
differ, and would leave no room for the others: what they lack is filled up with what simulators usually differ by.
"""

from dataclasses import dataclass

import numpy as np

from fast.models.gap.bank.bank import DEEPER_MM
from fast.models.gap.bank.sensor_effects import N_LEAD
from fast.models.gap.bank.surrogate import Surrogate
from fast.models.gap.evidence.reading import MIDDLES_MM, N_BINS, OF_BINS, OF_CONTRASTS, Reading

TAILS = 8.0  # degrees of freedom of errors: of a cell's, and of a fact's
TARE_SD_N = 0.03  # what taring leaves
PLACEMENT_SD_MM = 0.15  # of the height at which an object stands, and again of each of its cells
_LEAST_SHARE = 1e-3  # of the peak: an error that every simulator has
_ENOUGH = 2 * N_BINS  # variants of cells that make a covariance of all bins; 21 cells have as many
# What simulators usually differ by, of the peak: where the lift begins, and later; how far the first reaches, and along
# how much lift an error stays alike. The public panel's variants have 0.10, 0.013, 1.3 mm and 1.6 mm; two meshes of
# another code differ by 0.025.
_USUAL_START, _USUAL, _START_MM, _ALIKE_MM = 0.08, 0.02, 1.5, 2.0
_LEAST_FORCE = 0.1  # of the median cell's: below it, changes do not grow with the force of a cell


@dataclass(frozen=True)
class Scatter:
    """Relative standard deviations of what varies by itself: of cells, and of repeats of a cell.

    solver: how many times larger than the bank's own variants the simulator's errors are.
    """

    cell: float = 0.02
    repeat: float = 0.01
    solver: float = 1.0


@dataclass(frozen=True, eq=False)
class Errors:
    """Errors of c cells at the bank's centre.

    solver: b x b, covariance over the peak of a cell squared. variants_n: c x v x 120, what each numerical variant
    changes; missed_n: c x g x 120, what the surfaces miss; placed_n: c x 120, what 1 mm deeper changes. noise,
    contrast_noise: covariances of one grasp's noise, N^2. size_n: c, root mean square of the centre's force.
    """

    solver: np.ndarray
    variants_n: np.ndarray
    missed_n: np.ndarray
    placed_n: np.ndarray
    noise: np.ndarray
    contrast_noise: np.ndarray
    size_n: np.ndarray

    @staticmethod
    def of(surrogate: Surrogate, reading: Reading) -> "Errors":
        """Make the errors of these cells, from the bank of the surrogate."""
        bank, grasps = surrogate.bank, reading.grasps
        centre_n = bank.centre_steps_n
        known = np.isfinite(centre_n).all(axis=-1)
        peak_n = np.abs(centre_n @ OF_BINS.T).max(axis=-1)[..., None, None]
        variants_n, missed_n = bank.numerical_steps_n - centre_n[:, :, None], _find_missed(surrogate)
        solver = _pool(variants_n @ OF_BINS.T / peak_n, known).sum(axis=0)
        solver = solver + _pool(missed_n @ OF_BINS.T / peak_n, known).mean(axis=0)
        tool, column = grasps.tool[reading.rows], surrogate.column[reading.rows]
        solver = _fill_up(solver, int(known.sum()) * variants_n.shape[2])
        less_n, more_n = np.moveaxis(bank.placed_steps_n, 2, 0)
        of_steps = grasps.noise.step_covariance(OF_BINS.shape[1], float(np.median(grasps.lift_speed_mm_per_s)))
        size_n = np.sqrt(((centre_n @ OF_BINS.T) ** 2).mean(axis=-1))
        return Errors(
            solver=solver + _LEAST_SHARE**2 * np.eye(len(solver)),
            variants_n=np.nan_to_num(variants_n[tool, column]),
            missed_n=np.nan_to_num(missed_n[tool, column]),
            placed_n=np.nan_to_num((more_n - less_n)[tool, column]) / (DEEPER_MM[1] - DEEPER_MM[0]),
            noise=OF_BINS @ of_steps @ OF_BINS.T,
            contrast_noise=OF_CONTRASTS @ of_steps @ OF_CONTRASTS.T,
            size_n=np.maximum(size_n, _LEAST_FORCE * np.nanmedian(size_n[known]))[tool, column],
        )

    def grow(self, force_n: np.ndarray) -> np.ndarray:
        """Compute how many times larger the forces of cells (c x b) are than at the centre, c."""
        return np.asarray(np.sqrt((force_n**2).mean(axis=1)) / self.size_n)

    def cover_means(self, force_n: np.ndarray, n_repeats: np.ndarray, scatter: Scatter) -> np.ndarray:
        """Compute covariances of means of cells (c x b x b) with these forces (c x b)."""
        peak_n = np.abs(force_n).max(axis=1)[:, None, None]
        moved_n = PLACEMENT_SD_MM * (self.placed_n @ OF_BINS.T) * self.grow(force_n)[:, None]
        relative = (scatter.cell**2 + scatter.repeat**2 / n_repeats)[:, None, None]
        found = scatter.solver**2 * self.solver * peak_n**2
        found += moved_n[:, :, None] * moved_n[:, None]
        found += (relative * force_n[:, :, None]) * force_n[:, None]
        found += (self.noise + TARE_SD_N**2) / n_repeats[:, None, None]
        return np.asarray(found)

    def cover_contrasts(self, force_n: np.ndarray, scatter: Scatter) -> np.ndarray:
        """Compute covariances of contrasts of repeats (r x d x d) of cells with these forces (r x d)."""
        relative = scatter.repeat**2 * force_n[:, :, None] * force_n[:, None]
        return np.asarray(relative + self.contrast_noise + TARE_SD_N**2)


def _find_missed(surrogate: Surrogate) -> np.ndarray:
    """Find what surfaces miss at the grid's points, t x k x g x 120, as large as at points that were not fitted."""
    bank, surfaces = surrogate.bank, surrogate.surfaces
    basis = surfaces.rows(bank.grid[:, 0], bank.grid[:, 1])
    fitted_n = np.einsum("gk,tokf->togf", basis, surfaces.coefficients[..., N_LEAD:])
    q, _ = np.linalg.qr(basis)
    leverage = np.minimum((q**2).sum(axis=1), 1.0 - 1e-6)
    return np.asarray((fitted_n - bank.grid_steps_n) / np.sqrt(1.0 - leverage)[:, None])


def _fill_up(solver: np.ndarray, n: int) -> np.ndarray:
    """Fill up a covariance (b x b) of n variants of cells: what n lacks of enough is what is usual."""
    if n >= _ENOUGH:
        return solver
    sd = _USUAL_START * np.exp(-MIDDLES_MM / _START_MM) + _USUAL
    apart_mm = np.abs(MIDDLES_MM[:, None] - MIDDLES_MM)
    usual = sd[:, None] * sd * np.exp(-apart_mm / _ALIKE_MM)
    return np.asarray((n * solver + (_ENOUGH - n) * usual) / _ENOUGH)


def _pool(shares: np.ndarray, known: np.ndarray) -> np.ndarray:
    """Pool outer products of errors (t x k x v x b) by variant, v x b x b: means over the cells where each is known."""
    rows = shares[known]
    is_known = np.isfinite(rows).all(axis=2)
    rows = np.where(is_known[..., None], rows, 0.0)
    return np.asarray(np.einsum("cvb,cvd->vbd", rows, rows) / np.maximum(is_known.sum(axis=0), 1)[:, None, None])
