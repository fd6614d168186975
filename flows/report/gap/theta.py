"""The section of theta on the page of a gap search."""

import numpy as np

from flows.report.folder import Folder
from flows.report.gap.evidence import OLD, GapEvidence
from flows.report.html import Markup, paragraph, section, table

_THETA = {"young_modulus_mpa": "Young's modulus (MPa)", "friction": "friction", "poisson_ratio": "Poisson ratio"}


def theta_section(evidence: GapEvidence, folder: Folder) -> Markup:
    """Whether the constants moved towards what other instruments say."""
    is_known = any(row.independent is not None for row in evidence.theta)
    headings = ("constant", "before", "with what was named", "tensile bars of the paper", "")[: 5 if is_known else 3]
    rows = [
        (
            _THETA.get(r.parameter, r.parameter),
            _median(r.before),
            _median(r.after),
            None if r.independent is None else f"{r.independent[0]:.3g} \u00b1 {r.independent[1]:.2g}",
            _moved(r.before[0], r.after[0], r.independent),
        )[: len(headings)]
        for r in evidence.theta
    ]
    words_ = paragraph(
        "Median and 90 % interval. A missing effect bends theta; with the right effect it moves back to what other "
        "instruments say.", "note",
    )  # fmt: skip
    return section("theta", "Theta before and after", table(headings, rows, empty=OLD), words_ if rows else "")


def _median(of: tuple[float, float, float]) -> str:
    median, low, high = of
    return f"{median:.3g} [{low:.3g}, {high:.3g}]" if high > low else f"{median:.3g}"


def _moved(before: float, after: float, independent: tuple[float, float] | None) -> str:
    """Whether a constant came nearer to its independent measurement."""
    if independent is None or np.isclose(before, after, rtol=0.01):
        return ""
    return "nearer" if abs(after - independent[0]) < abs(before - independent[0]) else "further away"
