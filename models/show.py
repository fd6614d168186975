"""How results show themselves: as a table of pandas, as a plot, as HTML in a notebook."""

import html
import io
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from fast.models.errors import MissingDependencyError

if TYPE_CHECKING:
    import numpy as np
    from matplotlib.axes import Axes


def load_pandas() -> Any:
    """Return the module pandas.

    Raises:
        MissingDependencyError: it is not installed.
    """
    try:
        import pandas
    except ImportError as error:
        raise MissingDependencyError("pandas is not installed; `pip install pandas`.") from error
    return pandas


def draw_force(axes: "Axes", lift_mm: "np.ndarray", force_n: "np.ndarray") -> None:
    """Draw force over lift, n samples each, in mm and N."""
    axes.plot(lift_mm, force_n)
    axes.axhline(0.0, color="0.8", linewidth=0.8, zorder=0)
    axes.set_xlabel("lift (mm)")
    axes.set_ylabel("pull-off force (N)")


def force_svg(lift_mm: "np.ndarray", force_n: "np.ndarray") -> str:
    """Return a picture of force over lift, as the text of an SVG that stands in a page."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(4.6, 2.6), layout="constrained")
    draw_force(figure.subplots(), lift_mm, force_n)
    written = io.StringIO()
    figure.savefig(written, format="svg", metadata={"Date": None})
    text = written.getvalue()
    return text[text.index("<svg") :]


def html_table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a table as HTML; the first cell of a row is its name."""

    def make_row(fields: Sequence[str], tag: str) -> str:
        first, *others = map(html.escape, fields)
        return f"<tr><th>{first}</th>" + "".join(f"<{tag}>{cell}</{tag}>" for cell in others) + "</tr>"

    return "<table>" + make_row(head, "th") + "".join(make_row(row, "td") for row in rows) + "</table>"
