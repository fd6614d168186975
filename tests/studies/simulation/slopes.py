"""Slopes of a grasp and the ripple of its force: what slopes cost and how true they are, on one machine, in minutes."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from matplotlib.figure import Figure

from fast.flows.report.slopes import describe_change
from fast.flows.report.style import BEST, FIRST, MUTED, SIMULATED, figure_style, new_figure
from fast.models.design.space import numbered_design
from fast.models.objects.catalogue import get_object
from fast.models.records import GraspSetup, GraspSimulation, Placement, Slopes
from fast.models.simulation.contact.points import PointSpacing
from fast.models.simulation.grasp import simulate_grasp
from fast.models.simulation.inputs import GraspInputs
from fast.models.simulation.problem import TIER_NUMERICS, Numerics
from fast.models.simulation.scatter import find_scatter
from fast.models.simulation.slopes.parameters import find_parameters
from fast.models.simulation.tolerances import Tolerances
from fast.models.simulation.version import TIERS, SimulatorVersion
from fast.models.traces.step_features import step_means
from tests.studies.benchmarks.base import Options, Rows, Tables

OBJECTS = (1, 14, 5, 20, 8, 24, 11, 30, 17, 2, 27, 33)
N_REFERENCE = 3  # of the cells: a grasp of the reference tier costs twenty of production
RIPPLE_DESIGNS, RIPPLE_OBJECTS = (3, 11), (1, 14, 30, 17, 24)
RIPPLE_Z_MM = np.linspace(0.0, 0.25, 6)
SIX = ("friction", "nu", "wall_offset_mm", "closed_gap_mm", "length_mm", "rib_angle_deg")
TWELVE = (
    *SIX,
    *("width_mm", "height_mm", "tip_length_mm", "front_thickness_mm"),
    *("back_thickness_mm", "rib_thickness_mm"),
)
KINDS = {
    "friction": ("friction",),
    "nu": ("nu",),
    "walls, lengths": (
        *("wall_offset_mm", "length_mm", "width_mm", "height_mm", "tip_length_mm"),
        *("front_thickness_mm", "back_thickness_mm", "rib_thickness_mm"),
    ),
    "closing": ("closed_gap_mm",),
    "rib angle": ("rib_angle_deg",),
}
CLOSE = 0.2  # relative error of a slope over the lift, root mean square, that counts as right
FINER = 4.0
N_COPIES = 100
SHOWN = 3  # the cell that is drawn


@dataclass(frozen=True)
class _Cell:
    design: int
    object_id: int

    def simulate(
        self,
        along: Sequence[str] = (),
        version: SimulatorVersion = TIERS["production"],
        numerics: Numerics | None = None,
        z_mm: float = 0.0,
    ) -> GraspSimulation:
        """The grasp of this cell."""
        return simulate_grasp(
            numbered_design(self.design),
            get_object(self.object_id),
            version,
            GraspSetup(),
            placement=Placement(offset_z_mm=z_mm),
            numerics=numerics,
            along=along,
        )


def measure_slopes(options: Options) -> Tables:
    """Cost and truth of slopes, ripple and scatter of the peak, errors by contact points and tier, CPU time."""
    objects = options.objects or OBJECTS
    cells = [_Cell(design, object_id) for design, object_id in enumerate(objects)]
    cells[0].simulate(SIX)  # compiled, and all code loaded
    tell = options.tell
    tell(f"{len(cells)} cells: grasps, and slopes by 6 and 12 parameters")
    plain = [_cheapest(cell.simulate) for cell in cells]
    six = [cell.simulate(SIX) for cell in cells]
    twelve = [cell.simulate(TWELVE) for cell in cells]
    tell("slopes on the steps of the reference tier")
    fine_steps = [cell.simulate(TWELVE, numerics=TIER_NUMERICS["reference"]) for cell in cells]
    if options.figure is not None:
        shown = min(SHOWN, len(cells) - 1)
        title = f"Design random-{cells[shown].design} on object {cells[shown].object_id}"
        with figure_style():
            draw_trace_slopes(twelve[shown], SIX[:4], title).savefig(options.figure, dpi=150)
    tell("finer contact points")
    points = PointSpacing(PointSpacing().along_mm / FINER, PointSpacing().across_mm / FINER)
    fine_points = [cell.simulate(numerics=replace(Numerics(), spacing=points)) for cell in cells]
    tell("the reference tier")
    reference = [cell.simulate(version=TIERS["reference"]) for cell in cells[:N_REFERENCE]]
    tell("ripple")
    return {
        "cost of slopes, in grasps": [
            _cost_row("6 parameters", plain, six),
            _cost_row("12 parameters", plain, twelve),
        ],
        "slopes against those on the steps of the reference tier, before the first jump": [
            _truth_row(kind, names, twelve, fine_steps) for kind, names in KINDS.items()
        ],
        "ripple: scatter of the peak over placements of 0 to 0.25 mm in z about a line, %": _ripple_rows(),
        "against four times finer contact points, %": [
            _error_row("trace", [_trace_error(a, b) for a, b in zip(plain, fine_points, strict=True)]),
            _error_row("peak", [_peak_error(a, b) for a, b in zip(plain, fine_points, strict=True)]),
        ],
        "against the reference tier, %": [
            _error_row("peak", [_peak_error(a, b) for a, b in zip(plain, reference, strict=False)])
        ],
        "scatter of the peak by tolerances, against simulated copies": _tolerance_rows(cells, tell),
        "CPU of a grasp, s": [
            {
                "grasps": len(plain),
                "median": float(np.median([one.cpu_s for one in plain])),
                "mean": float(np.mean([one.cpu_s for one in plain])),
                "steps": float(np.mean([one.n_steps for one in plain])),
                "iterations": float(np.mean([one.n_newton for one in plain])),
                "factorisations": float(np.mean([one.n_factorisations for one in plain])),
            }
        ],
        "cells": [
            {
                "design": cell.design,
                "object_id": cell.object_id,
                "peak_force_n": own.peak_force_n,
                "trace_error": _trace_error(own, fine),
                "peak_error": _peak_error(own, fine),
                "cpu_s": own.cpu_s,
                "trusted_mm": sloped.slopes.trusted_mm if sloped.slopes else 0.0,
                "lost": len(sloped.slopes.lost) if sloped.slopes else 0,
            }
            for cell, own, fine, sloped in zip(cells, plain, fine_points, twelve, strict=True)
        ],
    }


def _cheapest(simulate: Callable[[], GraspSimulation]) -> GraspSimulation:
    """The cheaper of two runs of a grasp: the first of a design also builds its model."""
    return min((simulate(), simulate()), key=lambda result: result.cpu_s)


def _cost_row(what: str, plain: Sequence[GraspSimulation], sloped: Sequence[GraspSimulation]) -> dict[str, object]:
    extra = np.array([b.cpu_s - a.cpu_s for a, b in zip(plain, sloped, strict=True)])
    own = np.array([a.cpu_s for a in plain])
    lost = sum(len(one.slopes.lost) for one in sloped if one.slopes)
    each = {"median": float(np.median(extra / own)), "largest": float((extra / own).max())}
    return {"slopes": what, "cells": len(own), "of_all": float(extra.sum() / own.sum()), **each, "lost": lost}


def _truth_row(
    kind: str, names: Sequence[str], own: Sequence[GraspSimulation], true: Sequence[GraspSimulation]
) -> dict[str, object]:
    """Relative errors of slopes over the lift, root mean square, and of the peak's."""
    errors, peaks = [], []
    for a, b in zip(own, true, strict=True):
        if a.slopes is None or b.slopes is None:
            continue
        until_mm = min(a.slopes.trusted_mm, b.slopes.trusted_mm)
        lift_mm = np.arange(0.5, max(until_mm, 1.0), 0.5)
        for name in names:
            if name in a.slopes.by and name in b.slopes.by:
                first, second = (
                    np.interp(lift_mm, one.trace.lift_mm[one.trace.is_lift], slopes.by[name].force_n[one.trace.is_lift])
                    for one, slopes in ((a, a.slopes), (b, b.slopes))
                )
                errors.append(float(np.sqrt(np.mean((first - second) ** 2) / np.mean(second**2))))
                peaks.append(abs(a.slopes.by[name].peak_n / b.slopes.by[name].peak_n - 1.0))
    return {
        "kind": kind,
        "slopes": len(errors),
        "median_error": float(np.median(errors)),
        "within_20_percent": 100.0 * float(np.mean(np.array(errors) < CLOSE)),
        "peak_median_error": float(np.median(peaks)),
        "peak_within_20_percent": 100.0 * float(np.mean(np.array(peaks) < CLOSE)),
    }


def _ripple_rows() -> Rows:
    scatters = {}
    for design in RIPPLE_DESIGNS:
        for object_id in RIPPLE_OBJECTS:
            peaks = [_Cell(design, object_id).simulate(z_mm=float(z_mm)).peak_force_n for z_mm in RIPPLE_Z_MM]
            rest = peaks - np.polyval(np.polyfit(RIPPLE_Z_MM, peaks, 1), RIPPLE_Z_MM)
            scatters[design, object_id] = 100.0 * float(np.sqrt((rest**2).sum() / (len(peaks) - 2)) / np.mean(peaks))
    rows: Rows = [{"design": d, "object_id": o, "sd": sd} for (d, o), sd in scatters.items()]
    values = list(scatters.values())
    return [{"design": "median", "sd": float(np.median(values))}, {"design": "largest", "sd": max(values)}, *rows]


def _tolerance_rows(cells: Sequence[_Cell], tell: Callable[[str], None]) -> Rows:
    """Scatter that is said of every cell's peak, and that of copies with walls, height and closing drawn.

    Drawn evenly, with the standard deviations that are said: walls may differ by 0.3 mm at most, two of these.
    """
    tolerances = Tolerances()
    rows: Rows = []
    for cell in cells:
        tell(f"{N_COPIES} copies of design {cell.design} on object {cell.object_id}")
        inputs = GraspInputs(
            numbered_design(cell.design), get_object(cell.object_id), TIERS["production"], GraspSetup()
        )
        rng, sds = np.random.default_rng(cell.object_id), tolerances.stated
        drawn = rng.uniform(-np.sqrt(3.0), np.sqrt(3.0), (N_COPIES, len(sds))) * list(sds.values())
        peaks = np.array([_simulate_moved(inputs, dict(zip(sds, moves, strict=True))) for moves in drawn])
        said_n = find_scatter(inputs, tolerances).sd_n or np.nan
        simulated_n = float(peaks.std(ddof=1))
        numbers = {"sd_said_n": said_n, "sd_simulated_n": simulated_n, "ratio": said_n / simulated_n}
        rows.append({"design": cell.design, "object_id": cell.object_id, "mean_peak_n": float(peaks.mean()), **numbers})
    ratios = [float(str(row["ratio"])) for row in rows]
    ends = [{"design": word, "ratio": value} for word, value in (("least", min(ratios)), ("largest", max(ratios)))]
    return [{"design": "median", "ratio": float(np.median(ratios))}, *ends, *rows]


def _simulate_moved(inputs: GraspInputs, moves: Mapping[str, float]) -> float:
    for name, move in moves.items():
        parameter = find_parameters(inputs, (name,))[name]
        inputs = parameter.put(parameter.value + move)
    return simulate_grasp(
        inputs.design, inputs.obj, inputs.version, inputs.setup, placement=inputs.placement
    ).peak_force_n


def _trace_error(own: GraspSimulation, fine: GraspSimulation) -> float:
    """Error of the step means in % of the largest, root mean square while the object is held."""
    a, b = step_means(own.trace), step_means(fine.trace)
    held = np.abs(b) > 0.05 * np.abs(b).max()
    return 100.0 * float(np.sqrt(np.mean((a - b)[held] ** 2)) / np.abs(b).max())


def _peak_error(own: GraspSimulation, fine: GraspSimulation) -> float:
    return 100.0 * (own.peak_force_n / fine.peak_force_n - 1.0)


def _error_row(what: str, errors: Sequence[float]) -> dict[str, object]:
    sizes = np.abs(errors)
    return {
        "of": what,
        "cells": len(sizes),
        "median": float(np.median(sizes)),
        "rms": float(np.sqrt(np.mean(sizes**2))),
        "p95": float(np.percentile(sizes, 95)),
        "largest": float(sizes.max()),
    }


def draw_trace_slopes(result: GraspSimulation, names: Sequence[str], title: str) -> Figure:
    """The force over the lift, and below it what the usual change of each parameter adds to it; shaded: not trusted."""
    slopes = result.slopes or Slopes(0.0, {}, {})
    figure = new_figure(6.8, 4.6)
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=(1, 1.5))
    is_lift = result.trace.is_lift
    lift_mm = result.trace.lift_mm[is_lift]
    above.plot(lift_mm, result.trace.force_n[is_lift], color=SIMULATED)
    colors = (BEST, FIRST, SIMULATED, "#cc79a7", "#e69f00", MUTED)
    kept = lift_mm <= slopes.trusted_mm
    for name, color in zip(names, colors, strict=False):
        slope = slopes.by[name]
        change_n = slope.usual * slope.force_n[is_lift]
        below.plot(lift_mm[kept], change_n[kept], color=color, label=describe_change(name, slope))
    for axes in (above, below):
        axes.axhline(0.0, color=MUTED, linewidth=0.8)
        axes.grid(True, axis="y")
        axes.axvspan(
            slopes.trusted_mm, max(float(lift_mm[-1]), slopes.trusted_mm), color=MUTED, alpha=0.12, linewidth=0
        )
    above.set_ylabel("force (N)")
    below.set(xlabel="lift (mm)", ylabel="change of the force (N)")
    below.legend(ncols=2, loc="best")
    figure.suptitle(title, x=0.01, ha="left", fontsize=10)
    return figure
