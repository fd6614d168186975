"""The page of a round robin: bias of each lab, scatter between labs by object and finger, and their fits."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from fast.flows.report.folder import Folder, write_page
from fast.flows.report.style import BEST, FIRST, INK, MUTED, OBJECT, SIMULATED, SOFTEST, WIDTH_IN, new_axes
from fast.lake.store import Lake
from fast.models.objects.catalogue import find_object
from fast.models.traces.round_robin import LabBias
from fast.models.units import spell_share
from fast.tasks.traces.labs import LabsSideBySide, read_labs

_COLOURS = (BEST, FIRST, SIMULATED, SOFTEST, OBJECT)
_UNKNOWN = "not known"


def write_labs_report(lake: Lake, out: Path) -> tuple[Path, LabsSideBySide]:
    """Write the page into the folder `out`; returns the path of `index.html`, and what it shows.

    Raises:
        UsageError: labs cannot be compared, or the folder cannot be written.
    """
    found = read_labs(lake)

    def prepare(folder: Folder) -> dict[str, object]:
        objects = [vars(one) | {"name": _object_name(one.key)} for one in found.compared.by_object]
        fingers = [vars(one) | {"name": one.key} for one in found.compared.by_finger]
        return {
            "address": lake.address,
            "found": found,
            "labs": [vars(lab) | {"bias": format_bias(lab)} for lab in found.compared.labs],
            "bias": folder.draw("bias", _draw_bias(found)),
            "agreement": folder.draw("agreement", _draw_agreement(found)),
            "spreads": {"object": _save_spreads("objects", objects, folder),
                        "finger": _save_spreads("fingers", fingers, folder)},
            "thetas": [_describe_theta(row) for row in found.thetas],
            "named": [_describe_named(row) for row in found.named],
        }  # fmt: skip

    return write_page(Folder(Path(out)), "flows/report/labs.html.j2", prepare), found


def format_bias(lab: LabBias) -> str:
    """Return `+3.1 % [-0.2, 6.0]`, or the mean alone where the interval is not known."""
    bias = lab.bias
    if not np.isfinite(bias.mean):
        return _UNKNOWN
    if not np.isfinite(bias.lower):
        return f"{bias.mean:+.1%}, interval {_UNKNOWN}"
    return f"{bias.mean:+.1%} [{bias.lower:+.1%}, {bias.upper:+.1%}]"


def _save_spreads(name: str, rows: Sequence[dict[str, Any]], folder: Folder) -> dict[str, object]:
    """Save the scatter by object or by finger: rows, also as CSV, and their picture."""
    told = ("mean_n", "repeat_sd_n", "lab_sd_n", "reproducibility_sd_n")
    folder.numbers(name, [{"key": r["key"], "n_pairs": r["n_cells"], **{n: r[n] for n in told}} for r in rows])
    return {"rows": rows, "picture": folder.draw(name, _draw_spreads(rows))}


def _describe_theta(row: dict[str, Any]) -> dict[str, str]:
    return {
        "of": row["campaign_id"] or "all, jointly",
        "labs": row["labs"] or "all",
        "young_modulus": _interval(row, "young_modulus", "_mpa", 1),
        "friction": _interval(row, "friction", "", 2),
        "calibration_id": row["calibration_id"],
    }


def _describe_named(row: dict[str, Any]) -> dict[str, Any]:
    closed = "-" if row["closed_fraction"] is None else spell_share(row["closed_fraction"])
    return {"of": row["campaign_id"] or "all, jointly", "closed": closed, **row}


def _interval(row: dict[str, float], name: str, unit: str, digits: int) -> str:
    median, low, high = (row[f"{name}_{part}{unit}"] for part in ("median", "q05", "q95"))
    if median is None:
        return _UNKNOWN
    return f"{median:.{digits}f} [{low:.{digits}f}, {high:.{digits}f}]"


def _object_name(key: str) -> str:
    obj = find_object(int(key))
    return key if obj is None else f"{key} {obj.name}"


def _draw_bias(found: LabsSideBySide) -> Figure:
    labs = found.compared.labs
    figure, axes = new_axes(WIDTH_IN, 0.9 + 0.45 * len(labs), grid="x")
    for place, lab in enumerate(labs):
        colour = _COLOURS[place % len(_COLOURS)]
        if np.isfinite(lab.bias.lower):
            axes.hlines(place, 100 * lab.bias.lower, 100 * lab.bias.upper, color=colour, linewidth=2.2)
        axes.plot(100 * lab.bias.mean, place, "o", color=colour, markersize=6)
    axes.axvline(0.0, color=MUTED, linewidth=0.8)
    axes.set_yticks(range(len(labs)), [lab.lab for lab in labs])
    axes.set_ylim(len(labs) - 0.5, -0.5)
    axes.margins(x=0.15)
    axes.set_xlabel("bias against the mean of labs (%)")
    return figure


def _draw_agreement(found: LabsSideBySide) -> Figure:
    figure, axes = new_axes(WIDTH_IN, 3.8, grid="both")
    means = found.compared.means_n.values()
    for place, lab in enumerate(found.compared.labs):
        points = [(float(np.mean(list(forces.values()))), forces[lab.lab]) for forces in means if lab.lab in forces]
        x, y = zip(*points, strict=True)
        axes.plot(x, y, "o", color=_COLOURS[place % len(_COLOURS)], markersize=4, alpha=0.75, label=lab.lab)
    top = 1.05 * max(max(forces.values()) for forces in means)
    axes.plot([0.0, top], [0.0, top], color=INK, linewidth=0.8)
    axes.set_xlim(0.0, top)
    axes.set_ylim(0.0, top)
    axes.set_xlabel("mean of the labs (N)")
    axes.set_ylabel("peak force in one lab (N)")
    figure.legend(loc="outside upper left", ncols=4, handletextpad=0.2)
    return figure


def _draw_spreads(spreads: Sequence[dict[str, Any]]) -> Figure:
    figure, axes = new_axes(WIDTH_IN, 0.9 + 0.3 * len(spreads), grid="x")
    for place, one in enumerate(spreads):
        for offset, value_n, colour in ((-0.18, one["repeat_sd_n"], MUTED), (0.18, one["lab_sd_n"], BEST)):
            if value_n is not None:
                axes.barh(place + offset, value_n, height=0.34, color=colour)
    axes.barh([np.nan], [np.nan], color=MUTED, label="repeats in one lab")
    axes.barh([np.nan], [np.nan], color=BEST, label="between labs")
    axes.set_yticks(range(len(spreads)), [one["name"] for one in spreads])
    axes.set_ylim(len(spreads) - 0.5, -0.5)
    axes.set_xlabel("standard deviation (N)")
    figure.legend(loc="outside upper left", ncols=2)
    return figure
