"""The page of a round robin: bias of each lab, scatter between labs by object and finger, and their fits."""

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from fast.flows.report.folder import Folder, write_page
from fast.flows.report.html import Markup, Page, columns, count, number, paragraph, section, table, tiles
from fast.flows.report.style import BEST, FIRST, INK, MUTED, OBJECT, SIMULATED, SOFTEST, WIDTH_IN, new_axes
from fast.lake.store import Lake
from fast.models.objects.catalogue import find_object
from fast.models.traces.round_robin import LabBias, Spread
from fast.tasks.traces.labs import LabsSideBySide, read_labs

_COLOURS = (BEST, FIRST, SIMULATED, SOFTEST, OBJECT)
_NAV = {"labs": "Labs", "objects": "By object", "fingers": "By finger", "fits": "Theta and effects"}
_UNKNOWN = "not known"


def write_labs_report(lake: Lake, out: Path) -> tuple[Path, LabsSideBySide]:
    """Write the page into the folder `out`; returns the path of `index.html`, and what it shows.

    Raises:
        UsageError: labs cannot be compared, or the folder cannot be written.
    """
    found = read_labs(lake)
    page = Page(
        title="Labs side by side",
        kicker=f"FAST round robin, {lake.address}",
        footer="Terms of ISO 5725-2. Units: N; shares of the force in per cent.",
        nav=_NAV,
    )
    sections = (_write_labs, _write_objects, _write_fingers, _write_fits)
    return write_page(Folder(Path(out)), found, page, _headline, sections), found


def _headline(found: LabsSideBySide) -> Markup:
    overall = found.compared.overall
    fingers = [(found.n_travelled, "finger", "that travelled"), (found.n_printed, "design", "that each lab printed")]
    told = " and ".join(f"{count(n, noun)} {rest}" for n, noun, rest in fingers if n)
    lead = (
        f"{count(len(found.compared.labs), 'lab')} measured {told}: {count(overall.n_cells, 'pair')} of finger and "
        "object."
    )
    shown = [
        (_sd(overall.repeat_sd_n), "repeatability: SD of repeats in one lab"),
        (_sd(overall.lab_sd_n), "SD between labs, beyond that of repeats"),
        (_sd(overall.reproducibility_sd_n), "reproducibility: SD of one grasp in any lab"),
        (number(overall.mean_n, 1, "N"), "mean peak force over labs"),
    ]
    return Markup(paragraph(lead, "lead") + tiles(shown))


def _sd(value_n: float | None) -> str:
    return _UNKNOWN if value_n is None else number(value_n, 2, "N")


def format_bias(lab: LabBias) -> str:
    """`+3.1 % [-0.2, 6.0]`, or the mean alone where the interval is not known."""
    bias = lab.bias
    if not np.isfinite(bias.mean):
        return _UNKNOWN
    if not np.isfinite(bias.lower):
        return f"{bias.mean:+.1%}, interval {_UNKNOWN}"
    return f"{bias.mean:+.1%} [{bias.lower:+.1%}, {bias.upper:+.1%}]"


def _write_labs(found: LabsSideBySide, folder: Folder) -> Markup:
    compared = found.compared
    rows = [(lab.lab, lab.n_grasps, lab.n_cells, format_bias(lab)) for lab in compared.labs]
    pairs = [
        (pair.first, pair.second, pair.n_fingers, _UNKNOWN if pair.rank_correlation is None
         else number(pair.rank_correlation, 2))
        for pair in compared.pairs
    ]  # fmt: skip
    left_out = ""
    if found.n_left_out:
        left_out = paragraph(f"{found.n_left_out} grasps were made at another grasp setup and are left out.", "note")
    return section(
        "labs",
        "Labs",
        columns(
            folder.figure("bias", _draw_bias(found), "Bias of each lab"),
            folder.figure("agreement", _draw_agreement(found), "Force in each lab against the mean of all labs"),
        ),
        table(["lab", "grasps", "pairs", "bias"], rows, numeric=(1, 2)),
        paragraph(
            "Bias: how far a lab lies from the mean of all labs, in shares of the force, averaged over objects and "
            "then over fingers; brackets: 95 % interval, fingers drawn again. A bias that is the same for all fingers "
            "changes no ranking.",
            "note",
        ),
        table(["lab", "and", "fingers", "rank correlation"], pairs, numeric=(2, 3)),
        paragraph(
            "Rank correlation (Spearman): whether both labs put the fingers in the same order; 1: the same. It needs "
            "four fingers.",
            "note",
        ),
        left_out,
    )


def _write_objects(found: LabsSideBySide, folder: Folder) -> Markup:
    words = (
        "The last three columns are standard deviations in N. An object with a large bar between labs is placed, "
        "mounted or made differently in them; look at its traces first (fast view)."
    )
    return _write_spreads("object", found.compared.by_object, _object_name, words, folder)


def _write_fingers(found: LabsSideBySide, folder: Folder) -> Markup:
    words = (
        "A design that each lab printed brings the scatter of printers and materials with it; a tool that travelled "
        "does not. A name with B01T0 is a tool, one that begins with D a design."
    )
    return _write_spreads("finger", found.compared.by_finger, str, words, folder)


def _write_spreads(
    what: str, spreads: Sequence[Spread], spell: Callable[[str], str], words: str, folder: Folder
) -> Markup:
    """Scatter by object or by finger: picture, table, how to read them, numbers."""
    name = f"{what}s"
    figure = folder.figure(name, _draw_spreads(spreads, spell), f"Scatter by {what}")
    return section(
        name,
        f"By {what}",
        columns(figure, _spread_table(what, spreads, spell)),
        paragraph(words, "note"),
        folder.numbers(name, [_record(one) for one in spreads]),
    )


def _write_fits(found: LabsSideBySide, _folder: Folder) -> Markup:
    thetas = [
        (
            row["campaign_id"] or "all, jointly",
            row["labs"] or "all",
            _interval(row, "young_modulus", "_mpa", 1),
            _interval(row, "friction", "", 2),
            row["calibration_id"],
        )
        for row in found.thetas
    ]
    named = [
        (row["campaign_id"] or "all, jointly", row["round"], row["named"], number(row["probability"], 2),
         "-" if row["closed_fraction"] is None else f"{row['closed_fraction']:.0%}")
        for row in found.named
    ]  # fmt: skip
    return section(
        "fits",
        "Theta and effects",
        paragraph(
            "Each lab fitted apart: fast calibrate --campaign LAB.NAME and fast gap --campaign LAB.NAME. All labs "
            "fitted jointly, with one theta and one set of effects: the same commands without --campaign. Intervals "
            "apart that do not overlap say that the labs do not share one material or one bench."
        ),
        table(
            ["measurements of", "labs", "Young's modulus (MPa)", "friction", "calibration"],
            thetas,
            empty="Nothing is calibrated yet.",
        ),
        table(
            ["measurements of", "round", "named", "probability", "gap closed"],
            named,
            numeric=(1, 3, 4),
            empty="No gap search has been made yet.",
        ),
    )


def _interval(row: dict[str, float], name: str, unit: str, digits: int) -> str:
    median, low, high = (row[f"{name}_{part}{unit}"] for part in ("median", "q05", "q95"))
    if median is None:
        return _UNKNOWN
    return f"{median:.{digits}f} [{low:.{digits}f}, {high:.{digits}f}]"


def _spread_table(heading: str, spreads: Sequence[Spread], spell: Callable[[str], str]) -> Markup:
    """Mean force, and standard deviations of repeats, between labs and of both, N."""
    rows = []
    for one in spreads:
        sds = (one.repeat_sd_n, one.lab_sd_n, one.reproducibility_sd_n)
        told = [_UNKNOWN if sd is None else number(sd, 2) for sd in sds]
        rows.append((spell(one.key), one.n_cells, number(one.mean_n, 2), *told))
    return table([heading, "pairs", "mean (N)", "repeats", "between labs", "both"], rows, numeric=(1, 2, 3, 4, 5))


def _record(one: Spread) -> dict[str, object]:
    return {
        "key": one.key,
        "n_pairs": one.n_cells,
        "mean_n": one.mean_n,
        "repeat_sd_n": one.repeat_sd_n,
        "lab_sd_n": one.lab_sd_n,
        "reproducibility_sd_n": one.reproducibility_sd_n,
    }


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
    axes.legend(loc="upper left", handletextpad=0.2)
    return figure


def _draw_spreads(spreads: Sequence[Spread], spell: Callable[[str], str]) -> Figure:
    figure, axes = new_axes(WIDTH_IN, 0.9 + 0.3 * len(spreads), grid="x")
    for place, one in enumerate(spreads):
        for offset, value_n, colour in ((-0.18, one.repeat_sd_n, MUTED), (0.18, one.lab_sd_n, BEST)):
            if value_n is not None:
                axes.barh(place + offset, value_n, height=0.34, color=colour)
    axes.barh([np.nan], [np.nan], color=MUTED, label="repeats in one lab")
    axes.barh([np.nan], [np.nan], color=BEST, label="between labs")
    axes.set_yticks(range(len(spreads)), [spell(one.key) for one in spreads])
    axes.set_ylim(len(spreads) - 0.5, -0.5)
    axes.set_xlabel("standard deviation (N)")
    figure.legend(loc="outside upper left", ncols=2)
    return figure
