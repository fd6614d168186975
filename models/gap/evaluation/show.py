"""SHOW: before, after, floor and peers on the held-out grasps, in one go."""

from dataclasses import dataclass

import numpy as np

from models.gap.evaluation.baselines import baselines
from models.gap.evaluation.closed import gap_closed
from models.gap.evaluation.held_out import BLOCKS, HeldOut, Metrics, Prediction, class_errors, metrics
from models.gap.findings import Gap
from models.gap.where.residuals import Residuals
from models.objects.catalogue import get_object

BEFORE, AFTER = "theta recalibrated", "with the named effect"
WORSE = 1.05  # an effect that makes a class of objects worse by more than this is said


@dataclass(frozen=True, eq=False)
class Shown:
    """The last word on a gap. `predictions`: before, after, and peers; `metrics`: of each, over every block."""

    held_out: HeldOut
    gap: Gap
    predictions: tuple[Prediction, ...]
    metrics: tuple[Metrics, ...]
    by_class: dict[str, dict[str, float]]
    warnings: tuple[str, ...]

    def of(self, label: str, block: str = BLOCKS[0]) -> Metrics:
        """Metrics of one prediction."""
        return next(m for m in self.metrics if m.label == label and m.block == block)


def show(
    held_out: HeldOut, before: Prediction, after: Prediction, residuals: Residuals | None = None, seed: int = 0
) -> Shown:
    """Compare `after` with `before`, the floor and, if the residuals to learn from are given, the peers."""
    peers = () if residuals is None else baselines(residuals, held_out, before.steps_n, seed)
    predictions = (before, after, *peers)
    names = {number: get_object(number).object_class for number in held_out.objects}
    by_class = {p.label: class_errors(held_out, p, names) for p in predictions}
    return Shown(
        held_out=held_out,
        gap=gap_closed(held_out, before, after, seed),
        predictions=predictions,
        metrics=tuple(metrics(held_out, p, block) for p in predictions for block in held_out.blocks),
        by_class=by_class,
        warnings=_warnings(held_out, by_class[before.label], by_class[after.label]),
    )


def _warnings(held_out: HeldOut, before: dict[str, float], after: dict[str, float]) -> tuple[str, ...]:
    worse = [name for name in before if after[name] > WORSE * before[name]]
    found = [f"Held-out grasps of class {name} got worse, {before[name]:.2f} to {after[name]:.2f} N." for name in worse]
    n_tools, n_objects = (
        len(np.unique(x)) for x in (held_out.tool[held_out.is_new_tool], held_out.obj[held_out.is_new_object])
    )
    if min(n_tools, n_objects) < 3:
        found.append(
            f"{n_tools} designs and {n_objects} objects were held out; intervals of fewer than 3 of either are too "
            "narrow, hold out more."
        )
    return tuple(found)
