"""Supplementary figures 1-4 of the paper: noise, discrepancy, and which inputs matter to simulator and discrepancy."""

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure
from scipy.stats import rv_continuous

from flows.report.style import BEST, FAINT, MUTED, SIMULATED, WIDTH_IN, new_axes, new_figure
from models.calibration.inference.result import CalibrationResult
from models.calibration.inference.summary import density_of

_SHOWN = 0.995  # quantile of the draws at the end of an axis


def density_figure(draws: np.ndarray, x_label: str, prior: rv_continuous | None = None) -> Figure:
    """Posterior density of one positive parameter, its mode marked, the prior behind it."""
    figure, axes = new_axes(WIDTH_IN, 2.7, grid="")
    grid, density = curve = density_of(draws)
    axes.fill_between(grid, density, color=BEST, alpha=0.25, linewidth=0)
    axes.plot(grid, density, color=BEST, label="posterior")
    top = 1.08 * float(np.quantile(draws, _SHOWN))
    if prior is not None:
        points = np.linspace(0.0, top, 400)[1:]
        axes.plot(points, prior.pdf(points), color=MUTED, linewidth=1.1, linestyle=(0, (4, 2)), label="prior")
    axes.axvline(curve.mode, color=BEST, linewidth=1.0, linestyle=":", label=f"mode {curve.mode:.3g}")
    axes.set_xlim(0.0, top)
    axes.set_ylim(0.0, 1.1 * float(density.max()))
    axes.set_yticks([])
    axes.spines["left"].set_visible(False)
    axes.set_xlabel(x_label)
    axes.legend(loc="upper right")
    return figure


def sensitivity_figure(inputs: Sequence[str], relevance: np.ndarray, lengthscales: np.ndarray, colour: str) -> Figure:
    """Permutation relevance of each input beside its inverse lengthscale; bars are medians, lines 90 % intervals.

    relevance, lengthscales: draws x inputs; they need not be of the same draws.
    """
    figure = new_figure(5.6, 0.7 + 0.24 * len(inputs))
    left, right = figure.subplots(1, 2, sharey=True)
    places = np.arange(len(inputs))
    for axes, values, label in (
        (left, relevance, "share of the variance lost\nwhen the input is permuted"),
        (right, 1.0 / lengthscales, "1 / lengthscale,\nper range of the input"),
    ):
        low, middle, high = np.quantile(values, (0.05, 0.5, 0.95), axis=0)
        axes.grid(True, axis="x")
        axes.barh(places, middle, height=0.6, color=colour if axes is left else FAINT)
        axes.hlines(places, low, high, color=MUTED, linewidth=1.2)
        axes.set_xlim(left=0.0)
        axes.set_xlabel(label)
        axes.tick_params(axis="y", length=0)
    left.set_yticks(places, [input_label(name) for name in inputs])
    left.invert_yaxis()
    return figure


def emulator_inputs(result: CalibrationResult) -> list[str]:
    """Names of the simulator's inputs, in the order of the emulator."""
    return [name.partition(".")[2] for name in result.names if name.startswith("lengthscale_h.")]


def lengthscales_of(result: CalibrationResult, kernel: str) -> np.ndarray:
    """Draws of the lengthscales of kernel `h` or `e`, n x inputs."""
    return result.flat(*(name for name in result.names if name.startswith(f"lengthscale_{kernel}.")))


def input_label(name: str) -> str:
    """An input in words, without its unit."""
    return name.removesuffix("_mpa").removesuffix("_mm").removesuffix("_deg").replace("_", " ")


SIMULATOR_COLOUR, DISCREPANCY_COLOUR = SIMULATED, BEST
