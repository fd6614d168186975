"""The picture of slopes: its numbers stay clear of the names, and its words say only what it shows."""

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from fast.flows.report.slopes import draw_peak_changes
from fast.models.records import GraspSimulation, Slope, Slopes


def draw(step: float | None) -> Any:
    none = np.zeros(2)
    by = {"height_mm": Slope("N/mm", none, 33.8, 3.0), "length_mm": Slope("N/mm", none, -14.7, 1.6, step)}
    result = SimpleNamespace(slopes=Slopes(20.0, by, {}), peak_force_n=94.58)
    figure = draw_peak_changes(cast(GraspSimulation, result), "a grasp")
    figure.draw_without_rendering()
    return figure


def test_numbers_stay_clear_of_the_names() -> None:
    figure = draw(None)
    axes = figure.axes[0]
    for text in axes.texts:
        extent = text.get_window_extent()
        assert axes.get_window_extent().x0 < extent.x0, text.get_text()
        assert extent.x1 < figure.bbox.x1, text.get_text()


@pytest.mark.parametrize(("step", "is_said"), [(None, False), (0.5, True)])
def test_hollow_bars_are_explained_where_there_are_some(step: float | None, is_said: bool) -> None:
    assert ("hollow" in draw(step).axes[0].get_xlabel()) == is_said
