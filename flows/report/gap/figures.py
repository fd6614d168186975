"""Figures of a gap search: where, by what name, and what it changed."""

from collections.abc import Sequence
from textwrap import wrap
from typing import Any

import numpy as np
import scipy
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from fast.flows.report.gap.sentences import describe_effect, shorten_tool
from fast.flows.report.style import BEST, FAINT, FIRST, INK, MUTED, WIDTH_IN, new_axes
from fast.models.gap.evaluation.evaluate import AFTER, BEFORE, Evaluation
from fast.models.gap.findings import Candidate, Decision, LawCurve, Rest
from fast.models.gap.where.residuals import AT, PHASES, Residuals
from fast.models.objects.catalogue import get_object
from fast.models.traces.step_features import STEP_MM

MEASURED, SIM_BEFORE, SIM_AFTER = INK, FIRST, BEST
_MOST_NAMES = 6
_LEAST_AXIS = 5.0  # per cent: bars of nothing should look like it
_LEAST_SHARE = 2.0  # per cent that the colours of a map always span


def draw_errors(evaluation: Evaluation) -> Figure:
    """Draw bars of the held-out error, before and after, and the floor as a line."""
    labels = [p.label for p in evaluation.predictions]
    values = [evaluation.of(label).rmse_n for label in labels]
    figure, axes = new_axes(WIDTH_IN, 0.9 + 0.42 * len(labels), grid="x")
    colours = [SIM_BEFORE if label == BEFORE else SIM_AFTER for label in labels]
    places = np.arange(len(labels))
    axes.barh(places, values, height=0.62, color=colours)
    for place, value in enumerate(values):
        _label(axes, (value, place), f"{value:.2f} N")
    floor = evaluation.gap.rmse_floor_n
    axes.axvline(floor, color=MUTED, linewidth=1.2, linestyle=(0, (4, 2)))
    _label(axes, (floor, -0.72), f"floor {floor:.2f} N", MUTED)
    axes.set_yticks(places, ["before, recalibrated" if label == BEFORE else label for label in labels])
    axes.set_ylim(len(labels) - 0.5, -0.95)
    axes.set_xlim(0.0, 1.22 * max(values))
    axes.tick_params(axis="y", length=0)
    axes.set_xlabel("root mean square error on held-out grasps (N)")
    return figure


def _label(axes: Axes, at: tuple[float, float], words: str, color: str = INK) -> None:
    """Write words to the right of the end of a bar or line; blanks before them would be lost in the picture's file."""
    axes.annotate(words, at, xytext=(4, 0), textcoords="offset points", va="center", fontsize=8.5, color=color)


def draw_map(residuals: Residuals, phase: str) -> Figure:
    """Draw tools by objects: how much force is missing in a phase, in per cent of the predicted peak."""
    table, tools, objects = _table(residuals, PHASES.index(phase))
    rows, columns = _by_mean(table)
    shown = 100.0 * table[np.ix_(rows, columns)]
    figure, axes = new_axes(WIDTH_IN, 1.6 + 0.19 * len(objects), grid="")
    top = max(float(np.nanquantile(np.abs(shown), 0.98)), _LEAST_SHARE)
    # Objects go down, where their names can be read; tools across.
    image = axes.imshow(shown.T, cmap="PuOr", vmin=-top, vmax=top, aspect="auto")
    axes.set_yticks(range(len(objects)), [get_object(objects[c]).name for c in columns], fontsize=7.8)
    axes.set_xticks(range(len(tools)), [shorten_tool(tools[r]) for r in rows], rotation=90, fontsize=7.2)
    axes.tick_params(length=0)
    for side in ("left", "bottom"):
        axes.spines[side].set_visible(False)
    bar = figure.colorbar(image, ax=axes, location="top", shrink=0.7, aspect=28, pad=0.02)
    bar.set_label(f"measured less simulated force {AT[phase]},\n% of the peak", fontsize=8.5)
    bar.outline.set_visible(False)
    return figure


def _table(residuals: Residuals, place: int) -> tuple[np.ndarray, list[str], list[int]]:
    """Compute the mean relative residual by tool and object, with those that have any; NaN where there is none."""
    t, o = len(residuals.tools), len(residuals.objects)
    u = residuals.relative[:, place]
    is_there = np.isfinite(u)
    places, bins = (residuals.tool[is_there], residuals.obj[is_there]), (np.arange(t + 1), np.arange(o + 1))
    table = scipy.stats.binned_statistic_2d(*places, u[is_there], "mean", bins).statistic
    rows, columns = (np.flatnonzero(np.isfinite(table).any(axis=axis)) for axis in (1, 0))
    names = [residuals.tools[r] for r in rows], [residuals.objects[c] for c in columns]
    return table[np.ix_(rows, columns)], *names


def _by_mean(table: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return rows and columns in the order of their means, so that what belongs together lies together."""
    return np.argsort(np.nanmean(table, axis=1)), np.argsort(np.nanmean(table, axis=0))


def draw_law(law: LawCurve) -> Figure:
    """Draw the law of what was named, as the data have it, with its 90 % band."""
    figure, axes = new_axes(WIDTH_IN, 2.9, grid="both")
    axes.fill_between(law.at, law.low, law.high, color=BEST, alpha=0.18, linewidth=0)
    axes.plot(law.at, law.median, color=BEST, linewidth=2.0)
    axes.set_xlim(min(law.at), max(law.at))
    axes.set_xlabel(law.state)
    axes.set_ylabel("\n".join(wrap(law.quantity, 32)))
    return figure


def draw_rest(rest: Rest) -> Figure:
    """Draw the force over lift that nothing in the simulator explains, with its 90 % band over tools and objects."""
    figure, axes = new_axes(WIDTH_IN, 2.9, grid="both")
    axes.axhline(0.0, color=MUTED, linewidth=0.8)
    axes.fill_between(rest.lift_mm, rest.low_n, rest.high_n, color=FIRST, alpha=0.18, linewidth=0)
    axes.plot(rest.lift_mm, rest.force_n, color=FIRST, linewidth=1.8)
    axes.set_xlim(0.0, max(rest.lift_mm))
    axes.set_xlabel("lift (mm)")
    axes.set_ylabel("measured less simulated force (N)")
    return figure


def draw_names(candidates: Sequence[Candidate], named: Decision) -> Figure:
    """Draw the evidence for each candidate, the answer's in blue."""
    known = [c for c in candidates if c.nats is not None]
    by_name = sorted((c for c in known if c.effect != "unknown"), key=lambda c: -(c.nats or 0.0))
    chosen = by_name[:_MOST_NAMES]
    chosen += [c for c in by_name[_MOST_NAMES:] if c.effect in named.effects]
    chosen += [c for c in known if c.effect == "unknown"]
    values = [max(c.nats or 0.0, 0.0) for c in chosen]
    figure, axes = new_axes(WIDTH_IN, 0.8 + 0.32 * len(chosen), grid="x")
    answer = set(named.effects) or {named.kind}
    places = np.arange(len(chosen))
    axes.barh(places, values, height=0.62, color=[BEST if c.effect in answer else FAINT for c in chosen])
    for place, value in enumerate(values):
        _label(axes, (value, place), f"{value:.0f}")
    labels = ["a pattern without a name" if c.effect == "unknown" else describe_effect(c.effect) for c in chosen]
    axes.set_yticks(places, labels)
    axes.invert_yaxis()
    axes.tick_params(axis="y", length=0)
    axes.set_xlim(0.0, max(1.18 * max(values, default=0.0), _LEAST_AXIS))
    axes.set_xlabel("evidence (logarithm)")
    return figure


def draw_trace(evaluation: Evaluation, rows: Sequence[int], title: str) -> Figure:
    """Draw a held-out tool on an object: measured repeats, and the simulator before and after, with 90 % interval."""
    figure, axes = new_axes(WIDTH_IN, 2.5, grid="both")
    by_label = {p.label: p for p in evaluation.predictions}
    lift_mm = STEP_MM * (np.arange(evaluation.held_out.measured_n.shape[1]) + 0.5)
    axes.axhline(0.0, color=MUTED, linewidth=0.8)
    after = by_label[AFTER]
    first = rows[0]
    if after.sd_n is not None:
        half = 1.645 * after.sd_n[first]
        low, high = after.steps_n[first] - half, after.steps_n[first] + half
        axes.fill_between(lift_mm, low, high, color=SIM_AFTER, alpha=0.15, linewidth=0)
    for row in rows:
        axes.plot(lift_mm, evaluation.held_out.measured_n[row], color=MEASURED, linewidth=1.0, alpha=0.75)
    axes.plot(lift_mm, by_label[BEFORE].steps_n[first], color=SIM_BEFORE, linewidth=1.7, linestyle=(0, (4, 1.5)))
    axes.plot(lift_mm, after.steps_n[first], color=SIM_AFTER, linewidth=1.7)
    held = np.abs(evaluation.held_out.measured_n[list(rows)]).max(axis=0)
    still = np.flatnonzero(held > 0.05 * held.max())
    axes.set_xlim(0.0, min(lift_mm[still[-1]] + 5.0, lift_mm[-1]) if still.size else lift_mm[-1])
    axes.set_title(title, loc="left")
    axes.set_xlabel("lift (mm)")
    axes.set_ylabel("force (N)")
    return figure


def draw_classes(evaluation: Evaluation) -> Figure:
    """Draw the held-out error by class of the object, before and after."""
    before, after = evaluation.by_class[BEFORE], evaluation.by_class[AFTER]
    names = sorted(before, key=lambda name: before[name])
    figure, axes = new_axes(WIDTH_IN, 0.9 + 0.24 * len(names), grid="x")
    places = np.arange(len(names))
    axes.hlines(places, [after[n] for n in names], [before[n] for n in names], color=FAINT, linewidth=2.0)
    axes.plot([before[n] for n in names], places, "o", color=SIM_BEFORE, markersize=5, label="before")
    axes.plot([after[n] for n in names], places, "D", color=SIM_AFTER, markersize=5, label="after")
    axes.set_yticks(places, names)
    axes.tick_params(axis="y", length=0)
    axes.set_xlim(left=0.0)
    axes.set_xlabel("root mean square error (N)")
    axes.legend(loc="lower right")
    return figure


def name_cell(evaluation: Evaluation, row: int) -> str:
    """Return the tool and object of a held-out grasp."""
    held_out = evaluation.held_out
    tool, obj = held_out.tools[held_out.tool[row]], held_out.objects[held_out.obj[row]]
    return f"{shorten_tool(tool)} on the {get_object(obj).name}"


def choose_cells(evaluation: Evaluation, n: int = 6) -> list[list[int]]:
    """Choose n held-out cells to show (rows): other objects and tools in turn, from the middle of the errors before."""
    held_out = evaluation.held_out
    before = next(p for p in evaluation.predictions if p.label == BEFORE)
    squares = ((held_out.measured_n - before.steps_n) ** 2).mean(axis=1)
    cells = np.unique(held_out.cell)
    rows = {int(c): np.flatnonzero(held_out.cell == c).tolist() for c in cells}
    error = {c: float(squares[r].mean()) for c, r in rows.items()}
    middle = float(np.median(list(error.values())))
    is_new = {c: bool(held_out.is_new_tool[r[0]] and held_out.is_new_object[r[0]]) for c, r in rows.items()}
    order = sorted(rows, key=lambda c: (not is_new[c], abs(np.log(max(error[c], 1e-12) / max(middle, 1e-12)))))
    found: list[list[int]] = []
    seen: dict[str, set[Any]] = {"tool": set(), "obj": set()}
    for is_strict in (True, False):
        for c in order:
            tool, obj = held_out.tool[rows[c][0]], held_out.obj[rows[c][0]]
            is_fresh = obj not in seen["obj"] or (not is_strict and tool not in seen["tool"])
            if len(found) < n and is_fresh and rows[c] not in found:
                found.append(rows[c])
                seen["tool"].add(tool)
                seen["obj"].add(obj)
    return found
