"""Measured grasps as the likelihood reads them: means of cells over bins of lift, and contrasts of repeats.

A cell is a tool on a target by one setup. What its repeats share is compared with the simulator; what they differ by
needs none: mesh, contact law and print are the same in all of them.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from fast.models.gap.grasps import Grasps
from fast.models.traces.step_features import N_STEPS, STEP_MM

# Steps of 0.5 mm at which bins begin: fine at the start of the lift, where friction and zeros show, coarser later.
EDGES = np.concatenate([np.arange(0, 12), np.arange(12, 24, 2), np.arange(24, N_STEPS + 1, 4)])
# Contrasts are changes of what was simulated as a whole: fewer bins hold all of it.
CONTRAST_EDGES = np.array([0, 2, 4, 8, 16, 28, 44, 60, 90, N_STEPS])


def _averaging(edges: np.ndarray) -> np.ndarray:
    """Make the matrix (b x 120) that takes step means to means over bins."""
    rows = np.zeros((len(edges) - 1, N_STEPS))
    for row, (start, end) in zip(rows, zip(edges[:-1], edges[1:], strict=True), strict=True):
        row[start:end] = 1.0 / (end - start)
    return rows


OF_BINS, OF_CONTRASTS = _averaging(EDGES), _averaging(CONTRAST_EDGES)
N_BINS = len(OF_BINS)
KNOTS_MM = (0.0, 1.5, 5.0, 12.0, 25.0, 45.0)  # of the lift, where a pattern has a coefficient; straight between
MIDDLES_MM = OF_BINS @ (STEP_MM * (np.arange(N_STEPS) + 0.5))
SMOOTH = np.array([np.interp(MIDDLES_MM, KNOTS_MM, row) for row in np.eye(len(KNOTS_MM))])  # 6 x b


def compute_rms(values: np.ndarray) -> float:
    """Compute the root mean square."""
    return float(np.sqrt((values**2).mean()))


@dataclass(frozen=True, eq=False)
class Reading:
    """n grasps as c cells. cell: n, number of each grasp's cell. rows: first grasp of each cell (c). n_repeats: c.

    mix: r x n, orthonormal contrasts of the repeats of a cell, one row each, zero for other cells; of_cell: r, the cell
    of each contrast.
    """

    grasps: Grasps
    cell: np.ndarray
    rows: np.ndarray
    n_repeats: np.ndarray
    mix: np.ndarray
    of_cell: np.ndarray

    @staticmethod
    def of(grasps: Grasps) -> "Reading":
        """Find the cells of grasps, in the order of their first grasps."""
        keys = np.stack([grasps.tool, grasps.obj, grasps.setup, grasps.placement], axis=1)
        _, rows, cell = np.unique(keys, axis=0, return_index=True, return_inverse=True)
        cell = cell.reshape(-1)
        n_repeats = np.bincount(cell, minlength=len(rows))
        mix, of_cell = [], []
        for number in np.flatnonzero(n_repeats > 1):
            own = np.flatnonzero(cell == number)
            for place in range(1, len(own)):  # Helmert: each repeat against the mean of those before
                row = np.zeros(len(cell))
                row[own[:place]], row[own[place]] = -1.0 / place, 1.0
                mix.append(row / np.sqrt(1.0 + 1.0 / place))
                of_cell.append(number)
        return Reading(
            grasps, cell, rows, n_repeats, np.array(mix).reshape(-1, len(cell)), np.array(of_cell, dtype=int)
        )

    @property
    def n_cells(self) -> int:
        """Number of cells."""
        return len(self.rows)

    def average(self, steps_n: np.ndarray) -> np.ndarray:
        """Average cells over bins (c x b) from step means of grasps (n x 120)."""
        order, starts = self._by_cell
        total = np.add.reduceat((steps_n @ OF_BINS.T)[order], starts)
        return np.asarray(total / self.n_repeats[:, None])

    def contrast(self, steps_n: np.ndarray) -> np.ndarray:
        """Compute contrasts of repeats over their bins (r x d) of step means of grasps (n x 120)."""
        return np.asarray(self.mix @ (steps_n @ OF_CONTRASTS.T))

    @cached_property
    def _by_cell(self) -> tuple[np.ndarray, np.ndarray]:
        """Grasps (n) cell by cell, and where each cell's begin (c)."""
        return np.argsort(self.cell, kind="stable"), np.cumsum(self.n_repeats) - self.n_repeats
