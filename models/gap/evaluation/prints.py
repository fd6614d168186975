"""How stiff held-out prints are: as their grasps on other objects say, since no simulator can know it before.

Moduli of prints scatter by a few per cent. On a new tool that is often more than what an effect changes, and it says
nothing of the simulator. So naming judges a left-out tool by one half of its objects once the other half has told its
modulus (`rank_effects`), and the evaluation does the like: a tool's grasps on its other held-out objects count.
"""

from dataclasses import dataclass

import numpy as np

from fast.models.gap.evaluation.held_out import HeldOut
from fast.models.gap.fit.recalibrate import TOOL_SD

_FARTHEST = 3.0  # standard deviations of a print that one cell may ask for
_LEAST_CELL_SD = 0.01  # of the logarithm of a cell's forces over the simulated ones


@dataclass(frozen=True, eq=False)
class PrintFactors:
    """Factor on the simulated forces of m held-out grasps, from the same tool on other objects, and its relative sd."""

    factor: np.ndarray
    sd: np.ndarray

    @staticmethod
    def of(held_out: HeldOut, simulated_n: np.ndarray) -> "PrintFactors":
        """Factors of held-out grasps as a simulator has them (m x 120); 1 for a tool on one object.

        The logarithm of a factor has the prior N(0, `TOOL_SD`^2). Cells scatter about their tool by the standard
        deviation that they show.
        """
        pairs = np.stack([held_out.tool, held_out.obj])
        cells, cell = np.unique(pairs, axis=1, return_inverse=True)
        along, size = (
            np.bincount(cell, (other * simulated_n).sum(axis=1)) for other in (held_out.measured_n, simulated_n)
        )
        log = np.log(np.maximum(along, 1e-9) / np.maximum(size, 1e-9))
        log = np.clip(log, -_FARTHEST * TOOL_SD, _FARTHEST * TOOL_SD)
        _, own = np.unique(cells[0], return_inverse=True)
        n_cells, total = np.bincount(own)[own], np.bincount(own, log)[own]
        n_spare = len(log) - own.max() - 1
        left = float(((log - total / n_cells) ** 2).sum()) / max(n_spare, 1)
        share = max(left, _LEAST_CELL_SD**2) / TOOL_SD**2 if n_spare else np.inf
        n_others = n_cells - 1
        shift = (total - log) / (n_others + share)
        sd = TOOL_SD / np.sqrt(1.0 + n_others / share)
        return PrintFactors(np.exp(shift)[cell], sd[cell])
