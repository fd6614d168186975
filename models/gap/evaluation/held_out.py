"""Grasps that were kept for the end, what was predicted for them, and how well."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import scipy
from scipy.special import ndtri

from fast.models.errors import UsageError
from fast.models.gap.data import GapData
from fast.models.gap.fit.recalibrate import TOOL_SD
from fast.models.gap.where.residuals import peaks
from fast.models.records import Record, Theta
from fast.models.traces.step_features import STEP_MM

BLOCKS = ("all held out", "new designs", "new objects", "both new")
_N_MM_PER_J = 1e3
_Z90 = float(ndtri(0.95))
_FARTHEST = 3.0  # standard deviations of a print that one cell may ask for
_LEAST_CELL_SD = 0.01  # of the logarithm of a cell's forces over the simulated ones


@dataclass(frozen=True, eq=False)
class HeldOut:
    """m grasps that touch a design or an object kept for the end."""

    tools: tuple[str, ...]
    """Names."""
    objects: tuple[int, ...]
    """Ids."""
    tool: np.ndarray
    """m, numbers into `tools`."""
    obj: np.ndarray
    """m, numbers into `objects`."""
    measured_n: np.ndarray
    """m x steps."""
    is_new_tool: np.ndarray
    """m, whether no training grasp has its tool."""
    is_new_object: np.ndarray
    """m, whether no training grasp has its object."""
    numerical_n: np.ndarray
    """m, root mean square of what numerical variants change in each."""
    way: np.ndarray
    """m, number of the setup and placement."""

    @staticmethod
    def of(data: GapData, theta: Theta, rows: np.ndarray | None = None) -> "HeldOut":
        """Take the held-out grasps of a search; rows: those that could be simulated, as of `data.held_out`.

        Raises:
            UsageError: nothing is held out.
        """
        held_out = data.held_out if rows is None else data.held_out.select(rows)
        grasps, bank = held_out.grasps, data.bank
        if not len(grasps.tool):
            raise UsageError("no grasp is held out, so nothing can be shown; hold out two designs and two objects.")
        scale = theta.young_modulus_mpa / bank.centre.young_modulus_mpa
        change = scale * (bank.numerical_steps_n - bank.centre_steps_n[:, :, None])[grasps.tool, held_out.column]
        return HeldOut(
            tools=grasps.tools,
            objects=grasps.objects,
            tool=grasps.tool,
            obj=grasps.obj,
            measured_n=grasps.steps_n,
            is_new_tool=np.asarray(data.held_out_tools[grasps.tool]),
            is_new_object=np.asarray(data.held_out_objects[grasps.obj]),
            numerical_n=np.sqrt(np.nan_to_num(change**2).mean(axis=(1, 2))),
            way=grasps.setup * len(grasps.placements) + grasps.placement,
        )

    @property
    def cell(self) -> np.ndarray:
        """Number of the tool, object, setup and placement of each grasp, m."""
        return np.asarray((self.tool * len(self.objects) + self.obj) * (self.way.max() + 1) + self.way)

    @property
    def blocks(self) -> Mapping[str, np.ndarray]:
        """Which grasps are of a new design, of a new object, of both (masks of m)."""
        masks = (np.ones(len(self.tool), dtype=bool), self.is_new_tool & ~self.is_new_object,
                 self.is_new_object & ~self.is_new_tool, self.is_new_tool & self.is_new_object)  # fmt: skip
        return {name: mask for name, mask in zip(BLOCKS, masks, strict=True) if mask.any()}

    @property
    def repeat_squares(self) -> np.ndarray:
        """Mean square by which each grasp differs from its cell, without bias, m; NaN without a second repeat."""
        _, cell = np.unique(self.cell, return_inverse=True)
        counts = np.bincount(cell)
        means = np.zeros((len(counts), self.measured_n.shape[1]))
        np.add.at(means, cell, self.measured_n)
        left = self.measured_n - (means / counts[:, None])[cell]
        n = counts[cell]
        return np.where(n > 1, (left**2).mean(axis=1) * n / np.maximum(n - 1, 1), np.nan)


@dataclass(frozen=True, eq=False)
class PrintFactors:
    """Factor on the simulated forces of m held-out grasps, from the same tool on other objects, and its relative sd.

    Moduli of prints scatter by more than an effect often changes, and no simulator can know them before.
    """

    factor: np.ndarray
    sd: np.ndarray

    @staticmethod
    def of(held_out: HeldOut, simulated_n: np.ndarray) -> "PrintFactors":
        """Compute factors of held-out grasps as a simulator has them (m x 120); 1 for a tool on one object.

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


@dataclass(frozen=True, eq=False)
class Prediction:
    """What a model says of the held-out grasps: means, and standard deviations if it knows them (m x steps, N)."""

    label: str
    steps_n: np.ndarray
    sd_n: np.ndarray | None = None


class Metrics(Record):
    """How well held-out grasps were predicted; None where the data cannot say."""

    label: str
    """Of the prediction."""
    block: str
    """One of `BLOCKS`: which of the held-out grasps."""
    n_grasps: int
    """Of the block."""
    rmse_n: float
    """Root mean square error of step means."""
    peak_bias_n: float
    """Mean of measured minus predicted peaks."""
    peak_bias_share: float
    """The same as a share of the mean measured peak."""
    peak_mae_n: float
    """Mean absolute error of peaks."""
    rank_by_design: float | None
    """Spearman correlation of mean peaks over designs; None below three, or where all are alike."""
    rank_by_object: float | None
    """The same over designs within an object, mean over objects."""
    work_error_j: float
    """Mean absolute error of the area under force over lift."""
    coverage_90: float | None
    """Share of steps inside 90 % intervals, where there is force; None for a prediction without intervals."""
    width_90_n: float | None
    """Mean width of these intervals; None likewise."""


def compute_metrics(held_out: HeldOut, prediction: Prediction, block: str = BLOCKS[0]) -> Metrics:
    """Compute the metrics of a prediction over a block of the held-out grasps."""
    rows = held_out.blocks[block]
    measured, predicted = held_out.measured_n[rows], prediction.steps_n[rows]
    tool, obj = held_out.tool[rows], held_out.obj[rows]
    peak, of_model = peaks(measured), peaks(predicted)
    work = STEP_MM * (measured - predicted).sum(axis=1) / _N_MM_PER_J
    coverage, width = _intervals(measured, predicted, None if prediction.sd_n is None else prediction.sd_n[rows])
    return Metrics(
        label=prediction.label,
        block=block,
        n_grasps=int(rows.sum()),
        rmse_n=float(np.sqrt(np.mean((measured - predicted) ** 2))),
        peak_bias_n=float(np.mean(peak - of_model)),
        peak_bias_share=float(np.mean(peak - of_model) / max(abs(float(np.mean(peak))), 1e-9)),
        peak_mae_n=float(np.mean(np.abs(peak - of_model))),
        rank_by_design=_rank(_means(peak, tool), _means(of_model, tool)),
        rank_by_object=_rank_within(peak, of_model, tool, obj),
        work_error_j=float(np.mean(np.abs(work))),
        coverage_90=coverage,
        width_90_n=width,
    )


def compute_class_errors(held_out: HeldOut, prediction: Prediction, names: Mapping[int, str]) -> dict[str, float]:
    """Compute the root mean square error (N) by the class of the object; names: class of every object id."""
    of_grasp = np.array([names[held_out.objects[o]] for o in held_out.obj])
    squares = ((held_out.measured_n - prediction.steps_n) ** 2).mean(axis=1)
    return {str(name): float(np.sqrt(squares[of_grasp == name].mean())) for name in np.unique(of_grasp)}


def add_scatter(
    label: str, draws_n: np.ndarray, held_out: HeldOut, relative_sd: np.ndarray, noise_sd_n: float
) -> Prediction:
    """Predict with intervals from posterior draws (d x m x steps) and what no simulator knows of a single grasp.

    relative_sd: m, scatter of the force by print, placement and repeat. noise_sd_n: of a step's mean.
    """
    mean = draws_n.mean(axis=0)
    variance = draws_n.var(axis=0) + relative_sd[:, None] ** 2 * mean**2
    variance = variance + (noise_sd_n**2 + held_out.numerical_n**2)[:, None]
    return Prediction(label, mean, np.sqrt(variance))


def _intervals(measured: np.ndarray, predicted: np.ndarray, sd: np.ndarray | None) -> tuple[float | None, float | None]:
    """Compute the share of steps inside 90 % intervals and their mean width, where there is force."""
    if sd is None:
        return None, None
    holds = np.abs(predicted) > 0.05 * np.abs(predicted).max(axis=1, keepdims=True)
    inside = np.abs(measured - predicted) <= _Z90 * sd
    return float(inside[holds].mean()), float(2.0 * _Z90 * sd[holds].mean())


def _means(values: np.ndarray, group: np.ndarray) -> np.ndarray:
    names = np.unique(group)
    return np.array([values[group == name].mean() for name in names])


def _rank(a: np.ndarray, b: np.ndarray) -> float | None:
    if len(a) < 3 or np.ptp(a) == 0 or np.ptp(b) == 0:
        return None
    return float(scipy.stats.spearmanr(a, b).statistic)


def _rank_within(a: np.ndarray, b: np.ndarray, tool: np.ndarray, obj: np.ndarray) -> float | None:
    found = [_rank(_means(a[obj == o], tool[obj == o]), _means(b[obj == o], tool[obj == o])) for o in np.unique(obj)]
    known = [r for r in found if r is not None]
    return float(np.mean(known)) if known else None
