"""The study of traces: its figure of small multiples."""

import numpy as np

from fast.models.records import Trace
from tests.studies.traces.figure import traces_figure


def test_traces_are_drawn_in_panels() -> None:
    trace = Trace(np.arange(4.0), np.array([0.0, 0.0, 5.0, 10.0]), np.array([0.0, -3.0, 10.0, 0.0]))
    tools = {"softest": trace, "best": trace}
    figure = traces_figure([("1 sphere", tools), ("24 cone", tools)], {"softest": "soft", "best": "best"})
    assert [axes.get_title(loc="left") for axes in figure.axes[:2]] == ["1 sphere", "24 cone"]
