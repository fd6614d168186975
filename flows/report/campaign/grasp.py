"""Pictures of one simulated grasp: its trace with peak and work, and the deformed fingers at five instants."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from fast.flows.report.grasp_frames import Frame, Instant, largest_force_n
from fast.flows.report.style import COMPLIANT, FAINT, INK, MUTED, OBJECT, RIGID, SIMULATED, new_figure
from fast.models.objects.distance import distance
from fast.models.objects.primitives import bounds
from fast.models.records import GraspSimulation
from fast.models.units import typeset

FORCE_COLOURS = "plasma_r"
ARROW_MM = 22.0  # length of the largest arrow
BASE_MM = 4.0  # drawn height of the rigid base
PLOT_IN = 2.3
MARGIN_MM = 4.0
GRID_MM = 0.5
N_SLICES = 41  # of the object along y


def draw_trace(result: GraspSimulation, instants: Sequence[Instant], title: str) -> Figure:
    """Draw the load cell's force over closing time and over lift; peak, work and the numbered instants marked."""
    figure = new_figure(8.6, 3.7)
    closing, lift = figure.subplots(1, 2, sharey=True, width_ratios=(1, 2.4))
    trace, is_lift = result.trace, result.trace.is_lift
    start = np.flatnonzero(is_lift)[:1]
    until = int(start[0]) + 1 if start.size else len(trace.time_s)
    closing.plot(trace.time_s[:until], trace.force_n[:until], color=SIMULATED)
    lift.plot(trace.lift_mm[is_lift], trace.force_n[is_lift], color=SIMULATED)
    lift.fill_between(trace.lift_mm[is_lift], trace.force_n[is_lift], color=SIMULATED, alpha=0.12, linewidth=0)
    for axes in (closing, lift):
        axes.axhline(0, color=MUTED, linewidth=0.8)
        axes.grid(True, axis="y")
        axes.margins(y=0.16)
    _mark_peak(lift, result)
    for number, instant in enumerate(instants, start=1):
        snapshot = instant.right
        axes, at = (closing, snapshot.time_s) if snapshot.phase == "closing" else (lift, snapshot.lift_mm)
        _numbered(axes, at, instant.force_n, number)
    closing.set(xlabel="time from the start of closing (s)", ylabel="force on the load cell (N)")
    lift.set(xlabel="lift (mm)")
    closing.set_title("closing", loc="left", color=MUTED)
    lift.set_title("lift", loc="left", color=MUTED)
    figure.suptitle(title, x=0.01, ha="left", fontsize=10)
    return figure


def _mark_peak(axes: Axes, result: GraspSimulation) -> None:
    trace, is_lift = result.trace, result.trace.is_lift
    lift, force = trace.lift_mm[is_lift], trace.force_n[is_lift]
    at = float(lift[np.argmax(force)])
    span = max(float(lift[-1]), 1e-9)
    axes.annotate(
        f"peak {result.peak_force_n:.2f} N at {at:.1f} mm",
        (at, result.peak_force_n),
        (at + 0.12 * span, 1.02 * result.peak_force_n),
        va="bottom",
        arrowprops={"arrowstyle": "-", "color": MUTED, "linewidth": 0.8, "shrinkB": 5},
    )
    total = float(np.trapezoid(np.clip(force, 0.0, None), lift))
    centre = float(np.trapezoid(np.clip(force, 0.0, None) * lift, lift)) / total if total > 0.0 else 0.5 * span
    axes.text(centre, 0.22 * result.peak_force_n, f"work {1e3 * result.work_j:.0f} mJ", ha="center", color=SIMULATED)


def _numbered(axes: Axes, x: float, y: float, number: int) -> None:
    axes.plot(x, y, "o", markersize=11, color="white", markeredgecolor=INK, markeredgewidth=0.8, zorder=5)
    axes.text(x, y, str(number), ha="center", va="center_baseline", fontsize=7.5, zorder=6)


@dataclass(frozen=True)
class Stage:
    """What all instants of a grasp are drawn with: one view, one scale of pressure and of forces.

    Attributes:
        low, high: corners (x, z) of the view, mm.
        silhouette: of the object, as `_silhouette` gives it.
        top_kpa: pressure of the darkest dots; a few points on edges carry ten times that of all others.
        longest_n: force of the arrow of `ARROW_MM`.
    """

    low: np.ndarray
    high: np.ndarray
    silhouette: tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]
    top_kpa: float
    longest_n: float

    @classmethod
    def of(cls, solid: np.ndarray, instants: Sequence[Instant]) -> "Stage":
        """Make the stage that holds all of these instants; `solid` (n_rows, N_COLUMNS): the object where it stands."""
        frames = [frame for instant in instants for frame in instant.frames.values()]
        pressed = [frame.pressure_kpa for frame in frames if frame.pressure_kpa.size]
        top_kpa = float(np.percentile(np.concatenate(pressed), 98.0)) if pressed else 1.0
        return cls(*_limits(frames, solid), _silhouette(solid), top_kpa, largest_force_n(frames))

    @property
    def height_over_width(self) -> float:
        """Of the view."""
        width, height = self.high - self.low
        return float(height / width)

    @property
    def colours(self) -> ScalarMappable:
        """From contact pressure (kPa) to colour."""
        return ScalarMappable(Normalize(0.0, self.top_kpa), colormaps[FORCE_COLOURS])

    def draw(self, axes: Axes, number: int, instant: Instant) -> None:
        """Draw fingers and object at one instant.

        Drawn are the middle section y = 0 of each finger, the silhouette of the object (dark: its middle section),
        dots where the finger is pressed, coloured by pressure, and arrows for the object's force on the finger.
        """
        _draw_object(axes, *self.silhouette)
        for frame in instant.frames.values():
            _draw_finger(axes, frame)
            _draw_pressure(axes, frame, self.colours, ARROW_MM / self.longest_n)
        axes.set_xlim(self.low[0], self.high[0])
        axes.set_ylim(self.low[1], self.high[1])
        axes.set_aspect("equal")
        axes.set_title(_caption(number, instant), loc="left", fontsize=9, linespacing=1.35)
        axes.tick_params(length=2)


def draw_instants(solid: np.ndarray, instants: Sequence[Instant], title: str) -> Figure:
    """Draw the deformed fingers from the side at every instant, in one row, with the contact pressure on them.

    `solid` (n_rows, N_COLUMNS): the object where it stands.
    """
    stage = Stage.of(solid, instants)
    figure = new_figure(12.0, 12.0 / len(instants) * stage.height_over_width * 0.93 + 0.95)
    panels = np.atleast_1d(figure.subplots(1, len(instants), sharex=True, sharey=True))
    for number, (axes, instant) in enumerate(zip(panels, instants, strict=True), start=1):
        stage.draw(axes, number, instant)
        axes.set_xlabel("x (mm)")
    panels[0].set_ylabel("z (mm)")
    bar = figure.colorbar(stage.colours, ax=list(panels), fraction=0.02, pad=0.01, shrink=0.75, extend="max")
    bar.set_label("contact pressure (kPa)")
    figure.suptitle(f"{title}; longest arrow {stage.longest_n:.2f} N", x=0.005, ha="left", fontsize=10)
    return figure


def draw_instant(stage: Stage, number: int, instant: Instant) -> Figure:
    """Draw one instant on its own, for a page that sets several side by side."""
    figure = new_figure(PLOT_IN, PLOT_IN * stage.height_over_width + 0.6)
    axes = figure.subplots()
    stage.draw(axes, number, instant)
    axes.set(xlabel="x (mm)", ylabel="z (mm)")
    return figure


def _caption(number: int, instant: Instant) -> str:
    snapshot = instant.right
    where = f"lift {snapshot.lift_mm:.1f} mm" if snapshot.phase == "lift" else f"closing, {snapshot.time_s:.2f} s"
    force = round(instant.force_n, 2) + 0.0  # no minus before a zero
    return f"{number}  {instant.name}\n{where}\n{typeset(force, '.2f')} N on the load cell"


def _limits(frames: Sequence[Frame], solid: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the corners (x, z) of a view that holds both fingers at every instant, and the object."""
    low, high = (np.array([bound[0], bound[2]]) for bound in bounds(solid))
    for points in (frame.nodes[:, [0, 2]] for frame in frames):
        low, high = np.minimum(low, points.min(axis=0)), np.maximum(high, points.max(axis=0))
    return low - MARGIN_MM, high + np.array([MARGIN_MM, MARGIN_MM + BASE_MM])


def _silhouette(solid: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return the side view: grid x (a), z (b), and the object's distance (b, a) at y = 0 and its least value over y."""
    low, high = bounds(solid)
    x, z = (np.arange(low[i] - 2 * GRID_MM, high[i] + 3 * GRID_MM, GRID_MM) for i in (0, 2))
    least = np.full((len(z), len(x)), np.inf)
    middle = least
    for y in [*np.linspace(low[1], high[1], N_SLICES), 0.0]:
        grid_x, grid_z = np.meshgrid(x, z)
        points = np.column_stack([grid_x.ravel(), np.full(grid_x.size, y), grid_z.ravel()])
        middle = distance(solid, points).reshape(grid_x.shape)
        least = np.minimum(least, middle)
    return x, z, middle, least


def _draw_object(axes: Axes, x: np.ndarray, z: np.ndarray, middle: np.ndarray, least: np.ndarray) -> None:
    axes.axhline(0.0, color=FAINT, linewidth=0.8)
    for values, alpha in ((least, 0.45), (middle, 1.0)):
        if values.min() < 0.0:
            axes.contourf(x, z, values, levels=[-1e9, 0.0], colors=[OBJECT], alpha=alpha)
    axes.contour(x, z, least, levels=[0.0], colors=[MUTED], linewidths=0.8)


def _draw_finger(axes: Axes, frame: Frame) -> None:
    points, shape = frame.nodes[:, [0, 2]], frame.shape
    axes.add_collection(
        PolyCollection([points[rim] for rim in shape.section], facecolor=COMPLIANT, edgecolor=COMPLIANT, lw=0.3)
    )
    axes.add_collection(LineCollection(list(points[shape.outline]), colors=INK, linewidths=0.6))
    base = points[shape.base_nodes]
    left, width, bottom = base[:, 0].min(), np.ptp(base[:, 0]), base[:, 1].min()
    axes.bar(left, BASE_MM, width, bottom=bottom, align="edge", facecolor=RIGID, edgecolor=INK, linewidth=0.6)


def _draw_pressure(axes: Axes, frame: Frame, colours: ScalarMappable, mm_per_n: float) -> None:
    """Draw dots where the finger is pressed, and arrows for the force on it."""
    pressure_kpa = frame.pressure_kpa
    if not pressure_kpa.size:
        return
    order = np.argsort(pressure_kpa)  # the highest on top
    x, z = frame.pressed_at[order][:, [0, 2]].T
    axes.scatter(x, z, c=colours.to_rgba(pressure_kpa[order]), s=7, linewidths=0, zorder=4)
    places, forces = (values[:, [0, 2]].T for values in frame.forces)
    arrows: dict[str, Any] = {
        "angles": "xy",
        "scale_units": "xy",
        "scale": 1.0,
        "width": 0.006,
        "color": INK,
        "zorder": 5,
    }
    axes.quiver(*places, *(mm_per_n * forces), **arrows)
