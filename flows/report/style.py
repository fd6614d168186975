"""One look for every figure: colour-blind safe colours (Okabe and Ito 2008), sizes, and how a figure is saved.

Figures are `matplotlib.figure.Figure` objects (no pyplot), so nothing global is created and nothing leaks. They
are drawn narrow (`WIDTH_IN`) because the same SVG is shown on a phone at 390 px and in a page of 1,080 px.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from io import StringIO
from pathlib import Path
from typing import Any

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure

INK = "#1a1a1a"
MUTED = "#5f6670"
FAINT = "#c9ced6"
FIRST = "#d55e00"  # Okabe-Ito vermilion: the first random batch
BEST = "#0072b2"  # Okabe-Ito blue: the best tool, the last batch
SIMULATED = "#009e73"  # Okabe-Ito bluish green: anything simulated
SOFTEST = "#cc79a7"  # Okabe-Ito reddish purple: the softest tool
COMPLIANT = "#7fb2d6"
RIGID = "#6b7078"
OBJECT = "#d9c9a3"


WIDTH_IN = 4.6

_RC: dict[Any, Any] = {
    "font.family": "sans-serif",
    "font.sans-serif": ["DejaVu Sans"],
    "font.size": 9,
    "axes.titlesize": 9,
    "axes.labelsize": 9,
    "axes.edgecolor": MUTED,
    "axes.labelcolor": INK,
    "axes.linewidth": 0.8,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.axisbelow": True,
    "grid.color": "#e6e9ed",
    "grid.linewidth": 0.8,
    "legend.frameon": False,
    "legend.fontsize": 8.5,
    "lines.linewidth": 1.6,
    "text.color": INK,
    "xtick.color": MUTED,
    "ytick.color": MUTED,
    "xtick.labelcolor": INK,
    "ytick.labelcolor": INK,
    "xtick.labelsize": 8.5,
    "ytick.labelsize": 8.5,
    "svg.fonttype": "none",
    "svg.hashsalt": "fast",
    "path.simplify": True,
}


@contextmanager
def figure_style() -> Iterator[None]:
    """Draw and save inside this context; matplotlib's settings are restored afterwards.

    A person's `matplotlibrc` is left aside: with `text.usetex` a figure would need a TeX installation.
    """
    with mpl.rc_context():
        mpl.rcdefaults()
        mpl.rcParams.update(_RC)
        yield


def new_figure(width_in: float = WIDTH_IN, height_in: float = 3.2) -> Figure:
    """Make an empty figure of the given size, laid out by constrained layout."""
    return Figure(figsize=(width_in, height_in), layout="constrained")


def new_axes(width_in: float = WIDTH_IN, height_in: float = 3.2, grid: str = "y") -> tuple[Figure, Axes]:
    """Make a figure with one pair of axes; `grid` is `x`, `y`, `both` or empty for none."""
    figure = new_figure(width_in, height_in)
    axes = figure.subplots()
    if grid:
        axes.grid(True, axis=grid)  # type: ignore[arg-type]  # stubs want a literal
    return figure, axes


def save_svg(figure: Figure, path: Path) -> None:
    """Write an SVG with selectable text and no date, so that the same data gives the same file."""
    path.parent.mkdir(parents=True, exist_ok=True)
    text = StringIO()
    figure.savefig(text, format="svg", metadata=dict.fromkeys(("Date", "Creator", "Format", "Type")), transparent=True)
    drawing = text.getvalue()
    path.write_text(drawing[drawing.index("<svg") :], encoding="utf-8")  # the prologue names a DTD on the network
