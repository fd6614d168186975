"""Whitened features: features of grasps in the space where errors are alike, and what an error costs there.

A cell is a tool on an object. Its repeats share placement, mesh and surface errors, so their mean is known less well
than their differences: repeats are rotated to their mean and contrasts, and each is whitened with its own covariance.
Rows stay within their cell, so tools and objects can still be left out.

Errors have heavy tails. A finger that snaps on the bench and not in the simulator, or a peak that jumps to another
place, is off by many standard deviations in a whole row, and means little. So the mean of a cell and each contrast of
its repeats have errors of a multivariate t distribution (Lange, Little and Taylor 1989), with the degrees of freedom
that make null worlds likeliest.
"""

from dataclasses import dataclass

import numpy as np

from fast.models.calibration.traces.response_surface import (
    LEAST_AMPLITUDE,
    ResponseSurfaces,
    are_lifts,
    error_correlation,
    units_of,
)
from fast.models.gap.bank.bank import DEEPER_MM, Bank
from fast.models.gap.bank.sensor_effects import N_LEAD
from fast.models.gap.bank.surrogate import FEATURES, Surrogate, features_of_steps
from fast.models.gap.grasps import Grasps
from fast.models.simulation.effects.base import USUAL_LIFT_MM_PER_S
from fast.models.simulation.effects.sensor import LiftMisalignment
from fast.models.traces.step_features import BIN_EDGES_MM, LIFT_MM, STEP_MM
from fast.models.traces.step_noise import feature_noise

# Errors of a cell, with the weights (and the tails) that make 24 null worlds likeliest.
FLOOR_SHARE = 0.0066  # of the cell's largest force, common to neighbouring bins
OWN_SHARE = 0.0045  # the same, of each feature by itself
PLACEMENT_SHARE = 0.0166  # scatter of the force of a tool on an object, relative
SHIFT_MM = 0.02  # of the whole trace along the lift: where the lift starts
PLACED_MM = 0.15  # of the height at which a person or a bench places the object
UNPLACED_SHIFT_MM = 0.039  # of the trace along the lift in cells without simulations of placements: both of them
# Of all traces together, at most: what the stiffness of the contact leaves of how far it gives way before it slides.
COMMON_SHIFT_MM = 0.03
NUMERICAL_WEIGHT = 0.47  # of the variance that numerical variants show
SURFACE_WEIGHT = 0.06  # of the squared errors of surfaces at left-out grid points, which lie at the ends of the grid
CONTRAST_SHARE = 0.003  # what repeats of a cell differ by for no reason, relative
TARE_SD_N = 0.05  # zero of the load cell from grasp to grasp, as unloaded cells show
REPEAT_SD = 0.01  # scatter of the force from grasp to grasp, relative
FREEDOM = 5.0  # degrees of freedom of the tails

IS_LIFT = are_lifts(FEATURES)
_UNIT = units_of(FEATURES)
# What a constant force adds to each feature; the area is that beyond the bins.
OF_OFFSET = np.where(IS_LIFT, 0.0, np.where(_UNIT == 1.0, 1.0, LIFT_MM - BIN_EDGES_MM[-1]))
_IS_AMPLITUDE = ~IS_LIFT & (_UNIT == 1.0)


@dataclass(frozen=True, eq=False)
class WhitenedFeatures:
    """m measured grasps that may be learnt from, as f features.

    surrogate: of these grasps. measured: m x f, free of the bias of sensor noise. amplitude: m x f, what a relative
    error of 1 is. cells: rows of the repeats of the c cells
    with r of them, c x r for each r.
    whiteners: m x f x f. numerical: v x m x f, what numerical variants and, last, forces late by `COMMON_SHIFT_MM`
    change at the centre's modulus, not whitened.
    """

    surrogate: Surrogate
    measured: np.ndarray
    amplitude: np.ndarray
    cells: tuple[np.ndarray, ...]
    whiteners: np.ndarray
    numerical: np.ndarray

    @property
    def tool(self) -> np.ndarray:
        """Tool of each row, m."""
        return self.surrogate.grasps.tool

    @property
    def obj(self) -> np.ndarray:
        """Object of each row, m."""
        return self.surrogate.grasps.obj

    @property
    def is_mean(self) -> np.ndarray:
        """Which rotated rows are means of cells, m; the others are contrasts of repeats."""
        rows = np.zeros(len(self.measured), dtype=bool)
        for places in self.cells:
            rows[places[:, 0]] = True
        return rows

    def whiten(self, values: np.ndarray) -> np.ndarray:
        """Return features (... x m x f) in units of their standard deviations, repeats of a cell rotated."""
        rotated = np.zeros_like(values)
        for places in self.cells:
            rotated[..., places, :] = _rotation(places.shape[1]) @ values[..., places, :]
        return np.asarray((self.whiteners @ rotated[..., None])[..., 0])

    def unwhiten(self, values: np.ndarray) -> np.ndarray:
        """Invert `whiten`."""
        rotated = np.linalg.solve(self.whiteners, values[..., None])[..., 0]
        found = np.zeros_like(values)
        for places in self.cells:
            found[..., places, :] = _rotation(places.shape[1]).T @ rotated[..., places, :]
        return found


def whiten_features(surrogate: Surrogate, with_lead_n: np.ndarray, stiffer: float) -> WhitenedFeatures:
    """Whiten the features of a surrogate's grasps; errors are judged at what is predicted of the grasps (m x 132).

    with_lead_n: of `Surrogate.predict_with_lead`. stiffer: Young's modulus over the bank's.
    """
    predicted_n = with_lead_n[:, N_LEAD:]
    grasps, bank = surrogate.grasps, surrogate.bank
    cells, inverse = np.unique(np.stack([grasps.tool, surrogate.column], axis=1), axis=0, return_inverse=True)
    first = np.array([np.flatnonzero(inverse == number)[0] for number in range(len(cells))])
    bias, noise = _noise_by_setup(predicted_n, grasps, inverse)
    clean = features_of_steps(predicted_n[first])
    amplitude = find_amplitude(clean)
    force = np.where(IS_LIFT, 0.0, clean)
    at = (cells[:, 0], cells[:, 1])
    scatter = _outer(amplitude) * (FLOOR_SHARE**2 * error_correlation(FEATURES) + OWN_SHARE**2 * np.eye(len(FEATURES)))
    scatter = scatter + PLACEMENT_SHARE**2 * _outer(force) + _placed_scatter(bank, at, predicted_n[first], amplitude)
    scatter_of_variants = _numerical_scatter(bank.numerical_steps_n[at], bank.centre_steps_n[at], amplitude)
    in_unit = np.where(IS_LIFT, 1.0, stiffer)
    surface = _surface_error(bank, at) * np.outer(in_unit, in_unit)
    scatter = scatter + NUMERICAL_WEIGHT * scatter_of_variants + SURFACE_WEIGHT * surface
    contrast = _repeat_scatter(clean, amplitude) + noise
    whiteners, places = _whiteners(inverse, contrast, scatter)
    changed = _features(bank.numerical_steps_n) - _features(bank.centre_steps_n)[:, :, None]
    of_variants = np.moveaxis(np.nan_to_num(changed)[grasps.tool, surrogate.column], 1, 0)
    # A contact gives way by a length, whatever the speed.
    shifts = [LiftMisalignment(COMMON_SHIFT_MM * USUAL_LIFT_MM_PER_S / v) for v in grasps.lift_speed_mm_per_s]
    late_n = surrogate.apply_to_traces(shifts, with_lead_n)[:, N_LEAD:]
    late = (features_of_steps(late_n) - features_of_steps(predicted_n)) / in_unit
    return WhitenedFeatures(
        surrogate=surrogate,
        measured=features_of_steps(grasps.steps_n) - bias,
        amplitude=amplitude[inverse],
        cells=places,
        whiteners=whiteners,
        numerical=np.concatenate([of_variants, late[None]]),
    )


def estimate_repeat_noise(grasps: Grasps, predicted_n: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Estimate feature bias (m x f), and covariance by what repeats differ by (m x f x f); predicted_n: m x 120."""
    clean = features_of_steps(predicted_n)
    bias, noise = _noise_by_setup(predicted_n, grasps, np.arange(len(predicted_n)))
    return bias, _repeat_scatter(clean, find_amplitude(clean)) + noise


def _repeat_scatter(clean: np.ndarray, amplitude: np.ndarray) -> np.ndarray:
    """Compute the covariance of features (n x f) of repeats, but for noise of the load cell, n x f x f."""
    force = np.where(IS_LIFT, 0.0, clean)
    repeats = REPEAT_SD**2 * _outer(force) + TARE_SD_N**2 * _outer(OF_OFFSET)
    return np.asarray(repeats + CONTRAST_SHARE**2 * _outer(amplitude) * np.eye(len(FEATURES)))


def _noise_by_setup(predicted_n: np.ndarray, grasps: Grasps, cell: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Compute the bias of features by sensor noise of each grasp (m x f), and its covariance in each cell (c x f x f).

    A faster lift has fewer readings in a step. Of grasps of a cell at several setups the mean covariance counts.
    """
    pairs, inverse = np.unique(np.stack([cell, grasps.setup], axis=1), axis=0, return_inverse=True)
    first = np.array([np.flatnonzero(inverse == number)[0] for number in range(len(pairs))])
    counts = np.bincount(inverse)
    bias, noise = np.zeros((len(pairs), len(FEATURES))), np.zeros((cell.max() + 1, len(FEATURES), len(FEATURES)))
    for number in np.unique(grasps.setup):
        is_own = pairs[:, 1] == number
        speed = grasps.setups[number].lift_speed_mm_per_s
        bias[is_own], own = feature_noise(predicted_n[first[is_own]], grasps.noise, speed, of_steps=features_of_steps)
        np.add.at(noise, pairs[is_own, 0], own * counts[is_own, None, None])
    return bias[inverse], noise / np.bincount(cell)[:, None, None]


def compute_root_weights(residual: np.ndarray) -> np.ndarray:
    """Compute roots of the weights of iterated least squares, m x 1; residual: whitened, m x f."""
    return np.sqrt((FREEDOM + residual.shape[1]) / (FREEDOM + _squares(residual)))


def apply_robust_loss(residual: np.ndarray) -> np.ndarray:
    """Scale a whitened residual (m x f): half its squares are the negative log likelihood, but for a constant."""
    squares = _squares(residual)
    cost = (FREEDOM + residual.shape[1]) * np.log1p(squares / FREEDOM)
    return np.asarray(residual * np.sqrt(cost / np.maximum(squares, 1e-12)))


def _whiteners(
    inverse: np.ndarray, contrast: np.ndarray, scatter: np.ndarray
) -> tuple[np.ndarray, tuple[np.ndarray, ...]]:
    """Compute whitening matrices of rotated rows (m x f x f), and rows of cells with as many repeats (c x r each)."""
    counts = np.bincount(inverse)
    whiteners = np.zeros((len(inverse), *contrast.shape[1:]))
    of_contrast = np.linalg.inv(np.linalg.cholesky(contrast))
    order, starts = np.argsort(inverse, kind="stable"), np.concatenate([[0], np.cumsum(counts)])
    groups = []
    for n in np.unique(counts):
        numbers = np.flatnonzero(counts == n)
        places = np.array([order[starts[number] : starts[number + 1]] for number in numbers])
        of_mean = np.linalg.inv(np.linalg.cholesky(contrast[numbers] + n * scatter[numbers]))
        whiteners[places] = of_contrast[numbers][:, None]
        whiteners[places[:, 0]] = of_mean
        groups.append(places)
    return whiteners, tuple(groups)


def _rotation(n: int) -> np.ndarray:
    """Make an orthonormal n x n: the mean times the root of n first, then polynomials of the place."""
    powers = np.vander(np.arange(n) - 0.5 * (n - 1), n, increasing=True)
    q, r = np.linalg.qr(powers)
    return np.asarray((q * np.sign(np.diag(r))).T)


def find_amplitude(features: np.ndarray) -> np.ndarray:
    """Find what a relative error of 1 is in each feature (n x f): the largest force of the cell, or a length."""
    largest = np.abs(np.where(_IS_AMPLITUDE, features, 0.0)).max(axis=-1, keepdims=True)
    largest = np.maximum(largest, LEAST_AMPLITUDE * np.median(largest))
    return np.where(IS_LIFT, 1.0, largest) * _UNIT


def _slopes(steps_n: np.ndarray) -> np.ndarray:
    """Compute feature changes by a mm of later lift start, from a hold; ... x f, of step means (... x 120)."""
    later = np.concatenate([steps_n[..., :1], steps_n[..., :-1]], axis=-1)
    earlier = np.concatenate([steps_n[..., 1:], steps_n[..., -1:]], axis=-1)
    return np.asarray((_features(later) - _features(earlier)) / (2.0 * STEP_MM))


def _numerical_scatter(other_n: np.ndarray, centre_n: np.ndarray, amplitude: np.ndarray) -> np.ndarray:
    """Average the outer product of what numerical variants change in a cell, c x f x f, at the amplitude of its forces.

    A cell that snaps in one variant and not in another says little.
    """
    change = np.nan_to_num(_changes(other_n, centre_n, amplitude))
    return np.asarray(np.swapaxes(change, 1, 2) @ change / max(change.shape[1], 1))


def _placed_scatter(
    bank: Bank, at: tuple[np.ndarray, np.ndarray], predicted_n: np.ndarray, amplitude: np.ndarray
) -> np.ndarray:
    """Compute the covariance (c x f x f) of object height and lift start; predicted_n: c x 120.

    What a height changes is no mere shift: the finger bends and slips along another part of the object.
    """
    change = _changes(bank.placed_steps_n[at], bank.centre_steps_n[at], amplitude)
    is_known = np.isfinite(change).all(axis=-1)
    change = np.where(is_known[..., None], change, 0.0) * (PLACED_MM / np.abs(DEEPER_MM))[:, None]
    n = is_known.sum(axis=1)
    of_height = np.swapaxes(change, 1, 2) @ change / np.maximum(n, 1)[:, None, None]
    shift_mm = np.where(n > 0, SHIFT_MM, UNPLACED_SHIFT_MM)
    return np.asarray(of_height + shift_mm[:, None, None] ** 2 * _outer(_slopes(predicted_n)))


def _changes(other_n: np.ndarray, centre_n: np.ndarray, amplitude: np.ndarray) -> np.ndarray:
    """Compute feature changes by other simulations (c x v x 120) at the amplitude of a cell's forces, c x v x f."""
    centre = features_of_steps(centre_n)
    return (_features(other_n) - centre[:, None]) / find_amplitude(centre)[:, None] * amplitude[:, None]


def _surface_error(bank: Bank, at: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    """Compute the mean outer product of surfaces' feature errors at left-out grid points, c x f x f."""
    is_wanted = np.zeros(bank.grid_steps_n.shape[:2], dtype=bool)
    is_wanted[at] = True
    simulated = _features(bank.grid_steps_n)
    modulus_mpa = bank.centre.young_modulus_mpa
    return np.asarray(ResponseSurfaces.fitted(bank.grid, simulated, is_wanted, modulus_mpa, ~IS_LIFT).error[at])


def _features(steps_n: np.ndarray) -> np.ndarray:
    """Compute features of simulations some of which are missing (NaN)."""
    with np.errstate(invalid="ignore"):
        return features_of_steps(steps_n)


def _outer(rows: np.ndarray) -> np.ndarray:
    return rows[..., :, None] * rows[..., None, :]


def _squares(residual: np.ndarray) -> np.ndarray:
    return np.asarray((residual**2).sum(axis=1, keepdims=True))
