"""The pictures of docs/reference/verification.md.

    python -m tests.models.simulation.verification.figures

solves every problem again and writes docs/verification/*.png, in about one CPU minute.
"""

from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from tests.models.simulation.verification import cook, elastica, energy, hertz, manufactured, slope, sofa
from tests.models.simulation.verification.bricks import KINDS

FOLDER = Path(__file__).parents[4] / "docs" / "verification"
COLOURS = {"C3D4": "#999999", "C3D10": "#e69f00", "C3D15": "#0072b2", "C3D20R": "#009e73"}
EXACT, FIRST, SECOND = "black", "#0072b2", "#d55e00"
STYLE = {"axes.spines.top": False, "axes.spines.right": False, "legend.frameon": False, "font.size": 9}


def draw_manufactured(left: Axes, right: Axes) -> None:
    """Errors over the number of cells, with the slopes of theory."""
    for kind in KINDS:
        cells = (4, 8, 12) if kind == "C3D4" else (2, 4, 6)
        errors = [manufactured.solve_cube(kind, n) for n in cells]
        for axes, norms in ((left, [e.l2 for e in errors]), (right, [e.h1 for e in errors])):
            axes.loglog(cells, norms, "o-", color=COLOURS[kind], label=kind)
    for axes, title, gain in ((left, "position, L2 (mm)", 1), (right, "gradient, L2", 0)):
        for line, degree in ((axes.lines[0], 1), (axes.lines[-1], 2)):
            sides, norms = np.array(line.get_data())
            ends = sides[[1, -1]]
            axes.loglog(ends, 0.6 * norms[-1] * (ends / ends[-1]) ** -(degree + gain), "--", color=EXACT, lw=0.8)
            place = (ends[0], 0.6 * norms[-1] * (ends[0] / ends[-1]) ** -(degree + gain))
            axes.annotate(f"rate {degree + gain} ", place, fontsize=8, ha="right", va="center")
        axes.set(xlabel="cells per side", title=f"Error of the {title}")
        axes.set_xticks([2, 4, 6, 8, 12], ["2", "4", "6", "8", "12"])
        axes.minorticks_off()
    left.legend()


def draw_elastica(axes: Axes) -> None:
    """Centre lines of the beam and of the solid."""
    loads = [1.0, 2.0, 5.0]
    for load, solid in zip(loads, elastica.solid_shapes("C3D20R", loads), strict=True):
        along, across = elastica.elastica_shape(load)
        axes.plot(along, -across, color=EXACT, lw=1, label="elastica" if load == loads[0] else None)
        axes.plot(*(solid * [[1], [-1]]), ".", color=COLOURS["C3D20R"], label="C3D20R" if load == loads[0] else None)
        axes.annotate(f"{load:g}", (along[-1], -across[-1]), xytext=(4, -4), textcoords="offset points")
    axes.set(xlabel="along / length", ylabel="across / length", title="Cantilever at F L$^2$ / (E I) = 1, 2, 5")
    axes.set_aspect("equal")
    axes.legend()


def draw_cook(axes: Axes) -> None:
    """Deflection of Cook's membrane over the mesh at two Poisson ratios."""
    cells = [2, 4, 8, 16, 32]
    for poisson, line in ((0.49, "-"), (0.499, "--")):
        for kind in KINDS:
            deflections = [cook.tip_deflection(kind, n, poisson) for n in cells]
            axes.semilogx(cells, deflections, "o" + line, ms=3, color=COLOURS[kind], label=f"{kind}, nu {poisson}")
    axes.set(xlabel="cells per side", ylabel="deflection (mm per MPa)", title="Cook's membrane", ylim=(0, None))
    axes.set_xticks(cells, [str(n) for n in cells])
    axes.minorticks_off()
    axes.legend(fontsize=7, ncols=2)


def draw_cylinder(axes: Axes) -> None:
    """Pressure under the cylinder."""
    contact = hertz.press(hertz.cylinder_block(), 0.1, is_sphere=False)
    half_width, highest = hertz.line_contact(contact.force_n)
    x = np.linspace(0.0, half_width, 200)
    axes.plot(contact.distance_mm, contact.pressure_mpa, ".", ms=3, color=FIRST, label="contact points")
    axes.plot(x, hertz.profile(x, half_width, highest), color=EXACT, label="Hertz at the same force")
    axes.set(xlabel="distance from the middle (mm)", ylabel="pressure (MPa)", title="Cylinder, R 20 mm", xlim=(0, 1.4))
    axes.legend()


def draw_sphere(axes: Axes) -> None:
    """Force over indentation of the sphere."""
    mesh, depths = hertz.sphere_block(), np.array([0.0125, 0.025, 0.0375, 0.05])
    forces = [hertz.press(mesh, depth, is_sphere=True).force_n for depth in depths]
    fine = np.linspace(0.0, depths[-1], 100)
    axes.plot(depths, forces, "o", color=FIRST, label="C3D20R, elements of 0.4 mm")
    axes.plot(fine, [hertz.point_contact(depth)[0] if depth else 0.0 for depth in fine], color=EXACT, label="Hertz")
    axes.set(xlabel="indentation (mm)", ylabel="force (N)", title="Sphere, R 20 mm")
    axes.legend()


def draw_slope(axes: Axes) -> None:
    """Speed of the block on slopes around the friction angle."""
    critical = np.arctan(0.56)
    for extra_deg, colour in ((-0.5, FIRST), (0.5, "#56b4e9"), (2.0, "#e69f00"), (5.0, SECOND)):
        angle = critical + np.radians(extra_deg)
        motion = slope.slide(angle, 0.56)
        rate = max(slope.GRAVITY_MM_PER_S2 * (np.sin(angle) - 0.56 * np.cos(angle)), 0.0)
        axes.plot(motion.time_s, rate * motion.time_s, color=EXACT, lw=0.8)
        label = f"{np.degrees(angle):.2f} deg"
        axes.plot(motion.time_s[::4], motion.speed_mm_per_s[::4], "o", ms=4, color=colour, label=label)
    axes.set(xlabel="time (s)", ylabel="speed (mm/s)", title="Block on a slope, friction angle 29.25 deg")
    axes.legend()


def draw_sofa(left: Axes, right: Axes) -> None:
    """Forces of the press and of the pull."""
    cases = (
        ("our C3D4, coarse mesh", sofa.linear_mesh(3.0), True, COLOURS["C3D4"]),
        ("our production elements, divided in four", sofa.quadratic_mesh(6.0, 1), False, COLOURS["C3D20R"]),
    )
    for label, mesh, at_nodes, colour in cases:
        press, pull = sofa.press_and_pull(mesh, at_nodes=at_nodes)
        for axes, curve in ((left, press), (right, pull)):
            axes.plot(curve.travel_mm, curve.force_x_n, color=colour, label=f"{label}: Fx")
            axes.plot(curve.travel_mm, curve.force_z_n, "--", color=colour, label="Fz")
    for axes, points, title in ((left, sofa.SOFA_PRESS, "Press"), (right, sofa.SOFA_PULL, "Pull")):
        axes.plot(points[:, 0], points[:, 1], "o", ms=4, color=SECOND, label="SOFA, coarse mesh: Fx")
        axes.plot(points[:, 0], points[:, 2], "s", ms=4, mfc="none", color=SECOND, label="Fz")
        axes.set(xlabel=f"{title.lower()} (mm)", ylabel="force of one finger (N)", title=title)
    left.plot(12.0, sofa.SOFA_PRESS_N["medium"], "^", color=SECOND, label="SOFA, medium mesh: Fx")
    left.plot(12.0, sofa.SOFA_PRESS_N["fine"], "v", color=SECOND, label="SOFA, fine mesh: Fx")
    handles, labels = left.get_legend_handles_labels()
    right.legend(handles, labels, fontsize=7)


def draw_energy(axes: Axes, object_id: int, title: str) -> None:
    """Where the work of the base goes."""
    balance, n_closing = energy.grasp(object_id, 0.5)
    step = 0.5 * (np.arange(len(balance.work)) + 1)
    stored = balance.elastic + balance.contact
    axes.stackplot(
        step,
        [stored, balance.friction, np.maximum(balance.rest, 0.0)],
        labels=["stored", "friction", "rest: snaps, time steps"],
        colors=["#56b4e9", "#e69f00", "#bbbbbb"],
    )
    axes.plot(step, balance.work, color=EXACT, label="work of the base")
    axes.axvline(step[n_closing - 1], color=EXACT, lw=0.5, ls=":")
    axes.set(xlabel="travel of the base: closing, then lift (mm)", ylabel="energy of one finger (mJ)", title=title)
    axes.set_ylim(0.0, 1.5 * balance.work.max())
    axes.legend(loc="upper left", ncols=2, fontsize=8)


def _pair(width: float = 9.0, height: float = 3.4) -> tuple[Figure, Axes, Axes]:
    figure = Figure(figsize=(width, height), layout="constrained")
    left, right = figure.subplots(1, 2)
    return figure, left, right


def main() -> None:
    """Write every picture."""
    FOLDER.mkdir(parents=True, exist_ok=True)
    with mpl.rc_context(STYLE):
        figures = {name: _pair() for name in ("manufactured", "bending", "hertz", "sofa", "energy")}
        draw_manufactured(*figures["manufactured"][1:])
        draw_elastica(figures["bending"][1])
        draw_cook(figures["bending"][2])
        draw_cylinder(figures["hertz"][1])
        draw_sphere(figures["hertz"][2])
        draw_sofa(*figures["sofa"][1:])
        draw_energy(figures["energy"][1], 1, "Sphere")
        draw_energy(figures["energy"][2], 30, "Cube")
        single = Figure(figsize=(4.5, 3.2), layout="constrained")
        draw_slope(single.subplots())
        single.savefig(FOLDER / "slope.png", dpi=110)
        for name, (figure, _, _) in figures.items():
            figure.savefig(FOLDER / f"{name}.png", dpi=110)


if __name__ == "__main__":
    main()
