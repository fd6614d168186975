"""Single cells (a tool on an object): those with most of the gap, and those whose simulated force is unsure."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from fast.models.gap.bank.bank import Bank
from fast.models.gap.where.residuals import Residuals, peaks
from fast.models.objects.catalogue import get_object

UNSURE_SHARE = 0.1  # of the peak: meshes of an independent solver differ by that in one cell of ten
N_HEAVIEST = 5


@dataclass(frozen=True)
class HeavyCell:
    """A tool on an object by name, its share of all squares of the gap, its gap (rms) and its measured peak in N."""

    tool: str
    object_name: str
    share: float
    gap_n: float
    peak_n: float


@dataclass(frozen=True)
class UnsureCell:
    """A cell in which numerical variants or another height change the force by `spread_n` (rms over the lift).

    `peak_n`: simulated, at the centre of the bank.
    """

    tool: str
    object_name: str
    cause: Literal["mesh", "height"]
    spread_n: float
    peak_n: float


def find_heaviest_cells(residuals: Residuals) -> tuple[HeavyCell, ...]:
    """Find the cells that most of the gap lies in, the largest first."""
    squares = ((residuals.measured_n - residuals.predicted_n) ** 2).mean(axis=1)
    cell = residuals.tool * len(residuals.objects) + residuals.obj
    names, place = np.unique(cell, return_inverse=True)
    total, counts = np.bincount(place, squares), np.bincount(place)
    peak_n = np.bincount(place, residuals.peak_n) / counts
    found = []
    for row in np.argsort(-total)[:N_HEAVIEST]:
        tool, obj = divmod(int(names[row]), len(residuals.objects))
        found.append(
            HeavyCell(
                tool=residuals.tools[tool],
                object_name=get_object(residuals.objects[obj]).name,
                share=float(total[row] / max(float(total.sum()), 1e-12)),
                gap_n=float(np.sqrt(total[row] / counts[row])),
                peak_n=float(peak_n[row]),
            )
        )
    return tuple(found)


def find_unsure_cells(bank: Bank, tools: tuple[str, ...]) -> tuple[UnsureCell, ...]:
    """Find cells of the bank whose force changes by more than a tenth of the peak, the most unsure first.

    tools: names (t), as in the bank.
    """
    peak_n = peaks(np.nan_to_num(bank.centre_steps_n).reshape(-1, bank.centre_steps_n.shape[-1]))
    peak_n = peak_n.reshape(bank.centre_steps_n.shape[:2])
    spreads = {"mesh": _spread(bank, bank.numerical_steps_n), "height": _spread(bank, bank.placed_steps_n)}
    found = []
    for tool, target in zip(*np.nonzero(peak_n > 0), strict=True):
        cause: Literal["mesh", "height"] = "mesh"
        if spreads["height"][tool, target] > spreads["mesh"][tool, target]:
            cause = "height"
        spread_n = float(spreads[cause][tool, target])
        if spread_n > UNSURE_SHARE * peak_n[tool, target]:
            name = get_object(bank.targets[target].object_id).name
            found.append(UnsureCell(tools[tool], name, cause, spread_n, float(peak_n[tool, target])))
    return tuple(sorted(found, key=lambda cell: -cell.spread_n / cell.peak_n))


def _spread(bank: Bank, steps_n: np.ndarray) -> np.ndarray:
    """Find the largest change by any variant (t x k x v x steps), root mean square over steps with force, t x k."""
    centre_n = bank.centre_steps_n[:, :, None]
    is_held = np.abs(centre_n) > 0.05 * np.nanmax(np.abs(centre_n), axis=-1, keepdims=True)
    is_held = is_held | (np.abs(steps_n) > 0.05 * np.nanmax(np.abs(centre_n), axis=-1, keepdims=True))
    squares = np.where(is_held, np.nan_to_num(steps_n - centre_n) ** 2, 0.0).sum(axis=-1)
    return np.asarray(np.sqrt(squares / np.maximum(is_held.sum(axis=-1), 1)).max(axis=2, initial=0.0))
