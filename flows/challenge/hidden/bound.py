"""What no method can beat: how surely the likelihood ratio tells a world's cause from nothing.

It is given all that an entrant is not: what the cause changes in every grasp, the scatters of prints, cells and
repeats, noise, and by how much the solver behind the worlds differs from the simulator. Theta and the moduli of prints
alone are fitted. The log likelihood ratio is then normal with mean -d^2 / 2 or d^2 / 2 and standard deviation d, so its
share of alarms at a share of false ones is a normal probability (Neyman and Pearson 1933).
"""

from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr, ndtri

from fast.flows.challenge.hidden.panels import MODULUS_MPA, bank_slopes, modulus_factor
from fast.flows.challenge.hidden.worlds import WorldKey, Worlds
from fast.models.gap.evidence.reading import OF_BINS, OF_CONTRASTS, Reading
from fast.models.gap.grasps import Grasps

FALSE_ALARMS = 0.02  # of worlds with nothing hidden
_FLOOR = 1e-3  # of the peak, that no error is below


@dataclass(frozen=True, eq=False)
class Bound:
    """Of a panel. differs: b x b, covariance of what solvers differ by, over the square of the peak of a cell."""

    worlds: Worlds
    differs: np.ndarray

    @staticmethod
    def of(worlds: Worlds) -> "Bound":
        """Make the bound from the panel's true grasps with nothing hidden, theta fitted to them."""
        panels, bank, rests = worlds.panels, worlds.bank, []
        for name in panels.bases:
            theta = panels.sets[name].theta
            true_n = panels.steps_n[name]
            force_n = _predict(worlds, theta)
            columns_n = np.array([force_n, *(_rescale(worlds) * slope for slope in bank_slopes(bank, theta))])
            known = np.isfinite(true_n).all(axis=-1) & np.isfinite(columns_n).all(axis=(0, -1))
            peak_n = np.abs(true_n[known] @ OF_BINS.T).max(axis=1)[:, None]
            free = np.array([(column[known] @ OF_BINS.T / peak_n).ravel() for column in columns_n])
            target = ((true_n - force_n)[known] @ OF_BINS.T / peak_n).ravel()
            left = target - np.linalg.lstsq(free.T, target, rcond=None)[0] @ free
            rests.append(left.reshape(len(peak_n), -1))
        rest = np.concatenate(rests)
        differs, kept = rest.T @ rest / len(rest), len(rest) / (len(rest) + rest.shape[1])
        apart = np.diag(np.diag(differs)) + _FLOOR**2 * np.eye(len(differs))
        return Bound(worlds, kept * differs + (1.0 - kept) * apart)  # few cells do not tell how bins go together

    def measure_power(self, key: WorldKey, grasps: Grasps) -> float:
        """Return how likely what a key's world hides is seen in these grasps of it; 0 where nothing is hidden."""
        if not key.effects:
            return 0.0
        return float(ndtr(self._measure_distance(key, grasps) - ndtri(1.0 - FALSE_ALARMS)))

    def _measure_distance(self, key: WorldKey, grasps: Grasps) -> float:
        """Return by how many standard deviations a world is from one hiding nothing, at the best theta and moduli."""
        change_n, force_n = self._list_changes(key, grasps)
        return float(np.sqrt(max(self.multiply(key, grasps, change_n[None], force_n)[0, 0], 0.0)))

    def multiply(self, key: WorldKey, grasps: Grasps, changes_n: np.ndarray, force_n: np.ndarray) -> np.ndarray:
        """Multiply changes of forces with each other, over their errors and with theta and moduli fitted, k x k.

        changes_n: k x n x 120, in the grasps of a world; force_n: n x 120, of these grasps with nothing hidden. Grasps
        of which either is not known (NaN) are left out.
        """
        known = np.flatnonzero(np.isfinite(changes_n).all(axis=(0, 2)) & np.isfinite(force_n).all(axis=1))
        if not len(known):
            return np.zeros((len(changes_n), len(changes_n)))
        grasps, changes_n, force_n = grasps.select(known), changes_n[:, known], force_n[known]
        own, how, reading = self.worlds.of(key), key.nuisance, Reading.of(grasps)
        rows, n_repeats = reading.rows, reading.n_repeats[:, None, None]
        tool, obj = grasps.tool[rows], grasps.obj[rows]
        means_n, own_n = reading.average(force_n), (force_n @ OF_CONTRASTS.T)[rows][reading.of_cell]
        of_steps = grasps.noise.step_covariance(OF_BINS.shape[1], float(np.median(grasps.lift_speed_mm_per_s)))
        tare = how.tare_n**2 / 3.0  # of a uniform distribution
        squares = means_n[:, :, None] * means_n[:, None]
        covariances = (
            self.differs * np.abs(means_n).max(axis=1)[:, None, None] ** 2
            + (how.cell_sd**2 + how.repeat_sd**2 / n_repeats) * squares
            + (OF_BINS @ of_steps @ OF_BINS.T + tare) / n_repeats
        )
        theta = self.worlds.panels.sets[key.base].theta
        factor = modulus_factor(key.young_modulus_mpa) * _rescale(own)
        slopes = [factor * np.nan_to_num(slope[tool, obj]) @ OF_BINS.T for slope in bank_slopes(own.bank, theta)]
        prints = [how.tool_sd * means_n * (tool == one)[:, None] for one in np.unique(tool)]
        changes = [reading.average(change_n) for change_n in changes_n]
        white = _whiten(covariances, np.array([*changes, means_n, *slopes, *prints]))
        target, free = white[: len(changes)], white[len(changes) :]
        held = np.diag([1e-9] * (1 + len(slopes)) + [1.0] * len(prints))
        along = free @ target.T
        products = target @ target.T - along.T @ np.linalg.solve(free @ free.T + held, along)
        contrasts = np.array([reading.contrast(change_n) for change_n in changes_n])
        if contrasts.shape[1]:
            scatter = how.repeat_sd**2 * own_n[:, :, None] * own_n[:, None]
            white = _whiten(scatter + OF_CONTRASTS @ of_steps @ OF_CONTRASTS.T + tare, contrasts)
            products = products + white @ white.T
        return np.asarray(products)

    def _list_changes(self, key: WorldKey, grasps: Grasps) -> tuple[np.ndarray, np.ndarray]:
        """Return what all that is hidden changes in these grasps, and their forces without it (n x 120 each)."""
        own = self.worlds.of(key)
        changes = [own.change_by(key, hidden) for hidden in key.effects]
        places = {(site.tool, site.obj, site.context.repeat): n for n, site in enumerate(changes[0].sites)}
        sites = zip(grasps.tool.tolist(), grasps.obj.tolist(), grasps.contexts, strict=True)
        rows = [places[tool, obj, context.repeat] for tool, obj, context in sites]
        return np.sum([change.change_n for change in changes], axis=0)[rows], changes[0].force_n[rows]


def _whiten(covariances: np.ndarray, changes_n: np.ndarray) -> np.ndarray:
    """Divide changes (k x m x b) by the errors of their parts, of covariances m x b x b; k x (m b)."""
    white = np.linalg.solve(np.linalg.cholesky(covariances), np.moveaxis(changes_n, 0, 2))
    return np.asarray(white.transpose(2, 0, 1).reshape(len(changes_n), -1))


def _rescale(worlds: Worlds) -> float:
    """Return the forces at the modulus of true grasps over those of the bank."""
    return MODULUS_MPA / worlds.bank.centre.young_modulus_mpa


def _predict(worlds: Worlds, theta: tuple[float, float]) -> np.ndarray:
    """Predict the bank's forces at a friction and Poisson's ratio, t x o x 120, by a quadratic through its grid."""
    grid = worlds.bank.grid
    middle, spread = grid.mean(axis=0), grid.std(axis=0)

    def rows(points: np.ndarray) -> np.ndarray:
        at = (points - middle) / spread
        return np.column_stack([np.ones(len(at)), at, at**2, at[:, :1] * at[:, 1:]])

    weights = rows(np.array([theta])) @ np.linalg.pinv(rows(grid))
    return np.asarray(_rescale(worlds) * np.einsum("g,togs->tos", weights[0], worlds.bank.grid_steps_n))
