"""The evaluation: before, after and floor on the held-out grasps, in one go, and how much of the gap is closed.

Closed is counted of what is above the noise floor, with an interval over designs and objects.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from fast.models.gap.evaluation.held_out import (
    BLOCKS,
    HeldOut,
    Metrics,
    Prediction,
    PrintFactors,
    compute_class_errors,
    compute_metrics,
)
from fast.models.gap.findings import Confound, Gap
from fast.models.objects.catalogue import get_object
from fast.models.simulation.effects.catalogue import CATALOGUE
from fast.models.units import spell_count, spell_share, typeset

BEFORE, AFTER = "theta recalibrated", "after the search"
WORSE, WORSE_N = 1.05, 0.01  # an effect that makes a class of objects worse by more than both is reported
N_BOOTSTRAP = 2000
FEWEST_HELD_OUT = 3  # designs, and objects: an interval over fewer is too narrow
_LEAST_GAP = 1.02  # before over floor: less than that above it is no gap to close
HARDLY_VISIBLE = 0.1  # of a signature left once theta and tools are fitted again
_OF = {
    "young_modulus_mpa": "Young's modulus",
    "friction": "friction, as long as all lifts have one speed",
    "tool_modulus": "the modulus of each tool",
}
_ANYWHERE = "a second lift speed, a second closed gap and a dead weight on the load cell"


@dataclass(frozen=True, eq=False)
class Evaluation:
    """The last word on a gap. `predictions`: before and after; `metrics`: of each, over every block."""

    held_out: HeldOut
    gap: Gap
    predictions: tuple[Prediction, ...]
    metrics: tuple[Metrics, ...]
    by_class: dict[str, dict[str, float]]
    warnings: tuple[str, ...]

    def of(self, label: str, block: str = BLOCKS[0]) -> Metrics:
        """Return the metrics of one prediction."""
        return next(m for m in self.metrics if m.label == label and m.block == block)


def evaluate(
    held_out: HeldOut, before: Prediction, after: Prediction, seed: int = 0, patternless_n: float = 0.0
) -> Evaluation:
    """Compare `after` with `before` and the floor; patternless_n: see `measure_gap_closed`."""
    predictions = (before, after)
    names = {number: get_object(number).object_class for number in held_out.objects}
    by_class = {p.label: compute_class_errors(held_out, p, names) for p in predictions}
    return Evaluation(
        held_out=held_out,
        gap=measure_gap_closed(held_out, before, after, seed, patternless_n),
        predictions=predictions,
        metrics=tuple(compute_metrics(held_out, p, block) for p in predictions for block in held_out.blocks),
        by_class=by_class,
        warnings=_warnings(held_out, by_class[before.label], by_class[after.label]),
    )


def measure_gap_closed(
    held_out: HeldOut, before: Prediction, after: Prediction, seed: int = 0, patternless_n: float = 0.0
) -> Gap:
    """Compute root mean square errors before and after, the floor, and the closed share of what is above it.

    The floor is the scatter of repeats, what numerical variants change, or `patternless_n`, the differences in which
    designs, objects and repeats show no pattern (N), whichever is largest. Designs and objects are
    drawn with replacement, both at once, for the 95 % interval: too wide rather than too narrow. Fewer than three of
    either have none.
    """
    parts = _Cells.of(held_out, before, after, patternless_n)
    rng = np.random.default_rng(seed)
    weights = np.stack([parts.weights(rng) for _ in range(N_BOOTSTRAP)])
    value, drawn = parts.closed(np.ones((1, len(parts.n))))[0], parts.closed(weights)
    low, high = np.nanquantile(drawn, (0.025, 0.975)) if np.isfinite(drawn).any() else (-1.0, 1.0)
    has_interval = min(_count_held_out(held_out)) >= FEWEST_HELD_OUT
    rmse_before, rmse_after, floor = parts.rmse(np.ones((1, len(parts.n))))
    return Gap(
        rmse_before_n=float(rmse_before[0]),
        rmse_after_n=float(rmse_after[0]),
        rmse_floor_n=float(floor[0]),
        closed_fraction=float(np.nan_to_num(value)),
        ci95=(float(low), float(high)) if has_interval else None,
    )


LEAST_CHANGE = 0.02  # of the held-out error: less is neither a gain nor a harm


@dataclass(frozen=True)
class Change:
    """Root mean square errors of two simulators on held-out grasps, and the 90 % interval of their difference, in N."""

    before_n: float
    after_n: float
    ci90_n: tuple[float, float]

    @property
    def is_gain(self) -> bool:
        """Whether the second simulator is better, and no worse whichever designs and objects had been held out.

        Where few are held out, some draws have only grasps in which the effect does nothing: no change is no harm.
        """
        least_n = LEAST_CHANGE * self.before_n
        return self.after_n - self.before_n < -least_n and self.ci90_n[1] < least_n

    @property
    def sentence(self) -> str:
        """Both errors, and how sure their difference is."""
        change, low, high = (typeset(n, "+.2g") for n in (self.after_n - self.before_n, *self.ci90_n))
        return (
            f"the held-out error goes from {self.before_n:.3g} to {self.after_n:.3g} N, a change of "
            f"{change} N [{low}, {high}]"
        )


def measure_change(held_out: HeldOut, before_n: np.ndarray, after_n: np.ndarray, seed: int = 0) -> Change:
    """Compare two simulators by their step means of the held-out grasps (m x 120 each).

    Each gets the prints as stiff as its own errors on other objects say. Designs and objects are drawn with
    replacement, both at once, as in `measure_gap_closed`; both simulators are judged on the same draws.
    """
    before_n, after_n = (
        PrintFactors.of(held_out, steps_n).factor[:, None] * steps_n for steps_n in (before_n, after_n)
    )
    parts = _Cells.of(held_out, Prediction(BEFORE, before_n), Prediction(AFTER, after_n))
    rng = np.random.default_rng(seed)
    before, after, _ = parts.rmse(np.stack([parts.weights(rng) for _ in range(N_BOOTSTRAP)]))
    low, high = np.nanquantile(after - before, (0.05, 0.95))
    whole = parts.rmse(np.ones((1, len(parts.n))))
    return Change(float(whole[0][0]), float(whole[1][0]), (float(low), float(high)))


def _warnings(held_out: HeldOut, before: dict[str, float], after: dict[str, float]) -> tuple[str, ...]:
    worse = [n for n in before if after[n] > max(WORSE * before[n], before[n] + WORSE_N)]
    found = [f"Held-out grasps of class {name} got worse, {before[name]:.2f} to {after[name]:.2f} N." for name in worse]
    n_tools, n_objects = _count_held_out(held_out)
    if min(n_tools, n_objects) < FEWEST_HELD_OUT:
        found.append(
            f"{spell_count(n_tools, 'design')} and {spell_count(n_objects, 'object')} were held out, too few for an "
            f"interval, which takes {FEWEST_HELD_OUT} of either; measure more designs or objects."
        )
    return tuple(found)


def _count_held_out(held_out: HeldOut) -> tuple[int, int]:
    """Count the designs and the objects that are new."""
    return len(np.unique(held_out.tool[held_out.is_new_tool])), len(np.unique(held_out.obj[held_out.is_new_object]))


class _Cells:
    """Sums of squares by tool and object: n, before, after, repeats with their number, variants (c each)."""

    def __init__(self, tool: np.ndarray, obj: np.ndarray, columns: np.ndarray, least_floor_n: float) -> None:
        self.tool, self.obj, self.least_floor_n = tool, obj, least_floor_n
        self.n, self.before, self.after, self.repeat, self.n_repeat, self.mesh = columns

    @staticmethod
    def of(held_out: HeldOut, before: Prediction, after: Prediction, least_floor_n: float = 0.0) -> "_Cells":
        names, cell = np.unique(held_out.cell, return_inverse=True)
        squares = [((held_out.measured_n - p.steps_n) ** 2).mean(axis=1) for p in (before, after)]
        repeat = held_out.repeat_squares
        columns = (np.ones(len(cell)), *squares, np.nan_to_num(repeat), np.isfinite(repeat), held_out.numerical_n**2)
        n_objects = len(held_out.objects)
        tool = np.unique(names // n_objects, return_inverse=True)[1]
        obj = np.unique(names % n_objects, return_inverse=True)[1]
        sums = np.array([np.bincount(cell, weights=column) for column in columns])
        return _Cells(tool, obj, sums, least_floor_n)

    def weights(self, rng: np.random.Generator) -> np.ndarray:
        """Tell how often each cell is drawn: its tool's times its object's number, c."""
        tool, obj = (rng.multinomial(k, np.full(k, 1.0 / k)) for k in (self.tool.max() + 1, self.obj.max() + 1))
        return np.asarray(tool[self.tool] * obj[self.obj], dtype=float)

    def rmse(self, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Compute before, after and floor of draws (b x c), b each; NaN where nothing was drawn."""
        with np.errstate(invalid="ignore", divide="ignore"):
            before, after, mesh = (
                np.sqrt(weights @ x / (weights @ self.n)) for x in (self.before, self.after, self.mesh)
            )
            repeat = np.sqrt(weights @ self.repeat / (weights @ self.n_repeat))
        return before, after, np.fmax(np.fmax(repeat, mesh), self.least_floor_n)

    def closed(self, weights: np.ndarray) -> np.ndarray:
        """Compute the closed share, b, within -1 and 1; 0 where there is no gap above the floor."""
        before, after, floor = self.rmse(weights)
        with np.errstate(invalid="ignore", divide="ignore"):
            share = np.clip((before - after) / (before - floor), -1.0, 1.0)
        return np.where(before > _LEAST_GAP * floor, share, np.where(np.isfinite(before), 0.0, np.nan))


def find_confounds(visible: Mapping[str, float] | None = None) -> tuple[Confound, ...]:
    """Find the catalogue's declared aliases, and effects of which theta and tools take all but a tenth in these data.

    visible: by effect, the share of its signature that is left once theta and tools are fitted again.
    """
    declared = [
        Confound(effect=name, of=_OF[spec.alias_of], experiment=spec.experiment or _ANYWHERE)
        for name, spec in CATALOGUE.items()
        if spec.alias_of is not None
    ]
    names = {confound.effect for confound in declared}
    hidden = [
        Confound(
            effect=name,
            of=f"theta and tools, which take up {spell_share(1 - share)} of it in these data",
            experiment=CATALOGUE[name].experiment or _ANYWHERE,
        )
        for name, share in (visible or {}).items()
        if share < HARDLY_VISIBLE and name in CATALOGUE and name not in names
    ]
    return (*declared, *hidden)
