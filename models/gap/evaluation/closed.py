"""How much of the gap was closed: of what is above the noise floor, with an interval over designs and objects."""

import numpy as np

from models.gap.evaluation.held_out import HeldOut, Prediction
from models.gap.findings import Gap

N_BOOTSTRAP = 2000
_LEAST_GAP = 1.02  # before over floor: less than that above it is no gap to close


def gap_closed(held_out: HeldOut, before: Prediction, after: Prediction, seed: int = 0) -> Gap:
    """Root mean square errors before and after, the floor, and the closed share of what is above it.

    The floor is the scatter of repeats or what other meshes change, whichever is larger. Designs and objects are drawn
    with replacement, both at once, for the 95 % interval: too wide rather than too narrow.
    """
    parts = _Cells.of(held_out, before, after)
    rng = np.random.default_rng(seed)
    weights = np.stack([parts.weights(rng) for _ in range(N_BOOTSTRAP)])
    value, drawn = parts.closed(np.ones((1, len(parts.n))))[0], parts.closed(weights)
    low, high = np.nanquantile(drawn, (0.025, 0.975)) if np.isfinite(drawn).any() else (-1.0, 1.0)
    rmse_before, rmse_after, floor = parts.rmse(np.ones((1, len(parts.n))))
    return Gap(
        rmse_before_n=float(rmse_before[0]),
        rmse_after_n=float(rmse_after[0]),
        rmse_floor_n=float(floor[0]),
        closed_fraction=float(np.nan_to_num(value)),
        ci95=(float(low), float(high)),
    )


class _Cells:
    """Sums of squares by tool and object: n, before, after, repeats with their number, other meshes (c each)."""

    def __init__(self, tool: np.ndarray, obj: np.ndarray, columns: np.ndarray) -> None:
        self.tool, self.obj = tool, obj
        self.n, self.before, self.after, self.repeat, self.n_repeat, self.mesh = columns

    @staticmethod
    def of(held_out: HeldOut, before: Prediction, after: Prediction) -> "_Cells":
        names, cell = np.unique(held_out.cell, return_inverse=True)
        squares = [((held_out.measured_n - p.steps_n) ** 2).mean(axis=1) for p in (before, after)]
        repeat = held_out.repeat_squares
        columns = (np.ones(len(cell)), *squares, np.nan_to_num(repeat), np.isfinite(repeat), held_out.numerical_n**2)
        n_objects = len(held_out.objects)
        tool = np.unique(names // n_objects, return_inverse=True)[1]
        obj = np.unique(names % n_objects, return_inverse=True)[1]
        return _Cells(tool, obj, np.array([np.bincount(cell, weights=column) for column in columns]))

    def weights(self, rng: np.random.Generator) -> np.ndarray:
        """How often each cell is drawn: its tool's times its object's number, c."""
        tool, obj = (rng.multinomial(k, np.full(k, 1.0 / k)) for k in (self.tool.max() + 1, self.obj.max() + 1))
        return np.asarray(tool[self.tool] * obj[self.obj], dtype=float)

    def rmse(self, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Before, after and floor of draws (b x c), b each; NaN where nothing was drawn."""
        with np.errstate(invalid="ignore", divide="ignore"):
            before, after, mesh = (
                np.sqrt(weights @ x / (weights @ self.n)) for x in (self.before, self.after, self.mesh)
            )
            repeat = np.sqrt(weights @ self.repeat / (weights @ self.n_repeat))
        return before, after, np.fmax(repeat, mesh)

    def closed(self, weights: np.ndarray) -> np.ndarray:
        """Closed share, b, within -1 and 1; 0 where there is no gap above the floor."""
        before, after, floor = self.rmse(weights)
        with np.errstate(invalid="ignore", divide="ignore"):
            share = np.clip((before - after) / (before - floor), -1.0, 1.0)
        return np.where(before > _LEAST_GAP * floor, share, np.where(np.isfinite(before), 0.0, np.nan))
