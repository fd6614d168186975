"""Figures look the same whatever a person's own settings of Matplotlib are."""

import matplotlib as mpl

from fast.flows.report.style import figure_style, new_axes, save_svg


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
