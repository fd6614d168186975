"""Figures look the same whatever a person's own settings of Matplotlib are, and are legible on screen and paper."""

import re

import matplotlib as mpl
import numpy as np

from fast.flows.report.campaign.work import draw_work
from fast.flows.report.slopes import describe_change
from fast.flows.report.style import figure_style, new_axes, save_svg
from fast.models.records import Slope
from fast.tasks.templates import find_environment


def test_a_matplotlibrc_of_a_paper_is_left_aside(tmp_path):
    def draw(name):
        with figure_style():
            figure, axes = new_axes()
            axes.plot([0, 1], label="pull_off")  # TeX would stumble over the underscore
            axes.legend()
            save_svg(figure, tmp_path / name)
        return (tmp_path / name).read_text()

    ours = draw("ours.svg")
    strange = {"text.usetex": True, "font.family": "serif", "figure.dpi": 300, "lines.linestyle": ":"}
    with mpl.rc_context(strange):
        assert draw("strange.svg") == ours
        assert mpl.rcParams["text.usetex"], "a person's own settings are there again"


def test_the_rules_of_a_phone_are_of_the_screen():
    """A printed page is as narrow as a phone: it lost its columns."""
    narrow = re.findall(r"@media (.*?)\(max-width", find_environment().globals["stylesheet"])
    assert narrow
    assert set(narrow) == {"screen and "}


def test_a_legend_stands_beside_what_is_drawn():
    rows = [{"object_id": 2, "object_name": "sphere", "batch": batch, "work_j": 0.1 * batch} for batch in (1, 3)]
    figure = draw_work(rows, 1, 3)
    assert figure.axes[0].get_legend() is None
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["batch B01", "batch B03"]


def test_constants_are_spelled_as_people_do():
    slope = Slope(unit="N", force_n=np.zeros(2), peak_n=1.0, usual=0.02)
    assert describe_change("nu", slope) == "Poisson's ratio + 0.02"
    assert describe_change("young_modulus_mpa", slope) == "Young's modulus + 0.02 MPa"
