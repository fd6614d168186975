"""How much better the best tool is than the reference finger: the scale that numbers of several labs have in common."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fast.flows.report.campaign.facts import Tool
from fast.models.traces.quality import Interval, ratio_of_means
from fast.tasks.templates import number


@dataclass(frozen=True)
class TimesReference:
    """Tool quality of `best` over that of the reference fingers that were measured on the same objects, all prints."""

    best: Tool
    references: tuple[Tool, ...]
    ratio: Interval

    @property
    def reference_n(self) -> float:
        """Mean tool quality of the reference fingers."""
        return float(np.mean([tool.quality_n for tool in self.references]))

    @property
    def times(self) -> str:
        """`1.80 times the reference finger [1.72, 1.89]`; without the interval where it is not known."""
        known = math.isfinite(self.ratio.lower) and math.isfinite(self.ratio.upper)
        interval = f" [{self.ratio.lower:.2f}, {self.ratio.upper:.2f}]" if known else ""
        return f"{self.ratio.mean:.2f} times the reference finger{interval}"

    @property
    def sentence(self) -> str:
        """The ratio, and what it is of."""
        labels = ", ".join(tool.label for tool in self.references)
        finger = f"{self.references[0].reference} ({labels}, {number(self.reference_n, 1, 'N')})"
        if math.isfinite(self.ratio.lower):
            return f"{self.best.label} holds {self.times}; brackets: 95 % interval. The reference finger is {finger}."
        why = "it needs repeats of both tools" if math.isnan(self.ratio.lower) else "the reference is too near to 0 N"
        words = f"{self.best.label} holds {self.times}; its interval is not known: {why}."
        return f"{words} The reference finger is {finger}."


def compare_with_reference(tools: Sequence[Tool], best: Tool | None) -> TimesReference | None:
    """Compare the best tool with the reference finger; None where one of them is not measured on every object.

    Of several prints of the reference finger the mean counts, with the interval of a mean of independent tools.
    """
    references = tuple(t for t in tools if t.reference is not None and t.is_complete)
    if best is None or best.reference is not None or best.quality_n is None or not references:
        return None
    references = tuple(t for t in references if t.reference == references[0].reference)
    quality_n = float(np.mean([t.quality_n for t in references]))
    widths = [math.nan if t.half_width_n is None else t.half_width_n for t in references]
    half_width_n = math.sqrt(sum(width**2 for width in widths)) / len(widths)
    of_best = math.nan if best.half_width_n is None else best.half_width_n
    return TimesReference(best, references, ratio_of_means(best.quality_n, of_best, quality_n, half_width_n))
