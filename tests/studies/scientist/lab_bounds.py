"""Why the best finger of the lab world lies on bounds: slopes of its mean peak, and what another jaw leaves of them.

At the best design of `python -m tests.studies lab-world` each parameter is moved alone, and the mean peak of the
objects of that search is taken again, without scatter. Every grasp also tells how hard the fingers push their jaws open
during the lift. The jaws of the world stall at a force when they close, and stay where they are from then on, whatever
the force. Air would push with the stall force all the time: a jaw that is pushed harder yields, one that is pushed less
closes further. What the pull would be is estimated from the same grasp, N being the force of one finger on its jaw:

    F' = F limit / N        while N is at least `FOLLOWED` of the limit, F after that

as if the pull of a contact were in proportion to the force that presses it. In two more benches the jaws are weaker, or
the friction falls with the pressure, as rubber's does.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from fast.hardware.virtual.world.file import Scatter, World, load_world
from fast.hardware.virtual.world.physics import build_request, simulate_watched
from fast.models.design.fin_ray import FinRay
from fast.models.design.space import PARAMETERS, from_unit, snap, to_unit
from fast.models.objects.catalogue import OBJECTS
from fast.models.records import Design, EffectValue, GraspSetup
from fast.models.simulation.effects.catalogue import build_effects
from fast.models.simulation.output.recording import Snapshot
from fast.tasks.campaign.config import load_config
from tests.studies.benchmarks.base import Options, Rows, Tables
from tests.studies.scientist.lab_world import ROOT, SEARCH_OBJECTS, on_bounds

STALL = "force_limited_closing"
STEP = 0.15  # of the range of a parameter, as the last steps of that search
FOLLOWED = 0.5  # of the limit: a jaw that is pushed less has reached the end of its stroke
TIE_N = 0.1  # a parameter that changes the mean peak by less decides nothing
WEAKER = 0.5  # of the jaws' force, in the second bench
# Of a smooth elastic contact: Hertz; of rubber: Schallamach 1952. The reference is near the pressure of flat contacts.
PRESSED = EffectValue(effect="pressure_dependent_friction", parameters={"exponent": 0.33, "reference_mpa": 0.2})
# The best of 41 designs in the lab world without scatter (docs/benchmarks/lab-world.json).
BEST_IN_LAB = FinRay(
    length_mm=35.0,
    width_mm=35.0,
    height_mm=90.0,
    tip_length_mm=30.0,
    front_thickness_mm=3.0,
    back_thickness_mm=3.0,
    rib_thickness_mm=2.85,
    rib_count=4,
    rib_angle_deg=0.0,
)


@dataclass(frozen=True)
class LiftPull:
    """The lift of one grasp: force on the load cell (n) and of one finger on its jaw (n), in N."""

    pull_n: np.ndarray
    jaw_n: np.ndarray

    @property
    def peak_n(self) -> float:
        """Largest pull."""
        return float(self.pull_n.max())

    def steady_peak_n(self, limit_n: float) -> float:
        """Largest pull if a jaw pushes with its limit all the time."""
        is_followed = self.jaw_n >= FOLLOWED * limit_n
        return float((self.pull_n * np.where(is_followed, limit_n / np.maximum(self.jaw_n, 1e-9), 1.0)).max())


@dataclass(frozen=True)
class Bench:
    """A world without scatter, the setup, the force at which a jaw stalls, and effects beside the hidden ones."""

    name: str
    world: World
    setup: GraspSetup
    limit_n: float
    extra: tuple[EffectValue, ...] = ()

    def lift(self, design: Design, object_id: int) -> LiftPull:
        """The lift of a design on an object.

        Raises:
            SimulationFailed: the solver found no solution, or no mesh.
        """
        forces: list[tuple[float, float]] = []

        def add(snapshot: Snapshot) -> None:
            if snapshot.phase == "lift":
                inward, _, upward = snapshot.scale * snapshot.clamp_force
                forces.append((2.0 * upward, -inward))

        # Without scatter the object stands in the middle: one finger is solved, and counts twice.
        simulate_watched(
            build_request(self.world, "lab", design, object_id, self.setup), add, build_effects(self.extra)
        )
        return LiftPull(*np.array(forces).T)

    def means_n(self, design: Design) -> tuple[float, float]:
        """Mean peak of a design over the objects of the search: as it is, and with a steady force of the jaws."""
        lifts = [self.lift(design, object_id) for object_id in SEARCH_OBJECTS]
        return _mean([lift.peak_n for lift in lifts]), _mean([lift.steady_peak_n(self.limit_n) for lift in lifts])


def measure_lab_bounds(options: Options) -> Tables:
    """Slopes of the mean peak at the best design of the lab world, with jaws that stay and jaws that push on."""
    world = load_world((ROOT / "worlds" / "lab.toml").read_text(encoding="utf-8"), "lab.toml")
    setup = load_config(ROOT / "campaigns" / "paper.toml").grasp
    lab = _bench(world, setup, 1.0)
    benches = [lab, _bench(world, setup, WEAKER), replace(lab, name=PRESSED.effect, extra=(PRESSED,))]
    moves = moves_from(BEST_IN_LAB)
    slopes: Rows = [{"parameter": m.name, "from": m.before, "to": getattr(m.design, m.name)} for m in moves]
    for bench in benches:
        staying_n, steady_n = bench.means_n(BEST_IN_LAB)
        for row, (name, _, design) in zip(slopes, moves, strict=True):
            staying, steady = bench.means_n(design)
            row |= {bench.name: staying - staying_n, f"{bench.name}, steady": steady - steady_n}
            options.tell(f"{bench.name}: {name} {staying:.2f} N for {staying_n:.2f} N")
    return {
        "designs": [
            _design_row(lab, design) for design in (BEST_IN_LAB, moved_inside(moves, [row[lab.name] for row in slopes]))
        ],
        "change of the mean peak, N": slopes,
        "jaws": [_jaw_row(lab, object_id) for object_id in SEARCH_OBJECTS],
    }


def _bench(world: World, setup: GraspSetup, share: float) -> Bench:
    """The world without scatter, its jaws at a share of their force."""
    (stall,) = (value for value in world.hidden if value.effect == STALL)
    limit_n = share * stall.parameters["max_force_n"]
    weaker = EffectValue(effect=STALL, parameters={"max_force_n": limit_n})
    hidden = tuple(weaker if value is stall else value for value in world.hidden)
    return Bench(f"{limit_n:g} N", world.model_copy(update={"scatter": Scatter(), "hidden": hidden}), setup, limit_n)


class Move(NamedTuple):
    """A design in which one parameter is moved: its name, its value before, the design."""

    name: str
    before: float
    design: Design


def moves_from(centre: Design) -> list[Move]:
    """Every parameter moved alone, up and down where there is room."""
    middle, found = to_unit([centre])[0], []
    for column, name in enumerate(PARAMETERS):
        for step in (-STEP, STEP):
            point = middle.copy()
            point[column] += step
            if 0.0 <= point[column] <= 1.0:
                found.append(Move(name, getattr(centre, name), from_unit(snap(point[None]))[0]))
    return found


def moved_inside(moves: Sequence[Move], changes_n: Sequence[float]) -> Design:
    """The design with every parameter moved the better way, all at once, where that loses less than `TIE_N`."""
    best: dict[str, tuple[float, Move]] = {}
    for move, change in zip(moves, changes_n, strict=True):
        if change > max(-TIE_N, best[move.name][0] if move.name in best else -np.inf):
            best[move.name] = change, move
    changed = {name: getattr(move.design, name) for name, (_, move) in best.items()}
    return BEST_IN_LAB.model_copy(update=changed)


def _design_row(bench: Bench, design: Design) -> dict[str, object]:
    """Mean peak of a design, and what lies on a bound."""
    staying, steady = bench.means_n(design)
    found = on_bounds(design)
    return {"mean_n": staying, "steady_n": steady, "bounds": len(found), "on_bounds": " ".join(found)} | (
        design.model_dump()
    )


def _jaw_row(bench: Bench, object_id: int) -> dict[str, object]:
    """How hard a finger of the best design pushes its jaw open on an object."""
    lift = bench.lift(BEST_IN_LAB, object_id)
    at_peak = int(lift.pull_n.argmax())
    return {
        "object_id": object_id,
        "name": OBJECTS[object_id].name,
        "peak_n": lift.peak_n,
        "steady_peak_n": lift.steady_peak_n(bench.limit_n),
        "jaw_first_n": float(lift.jaw_n[0]),
        "jaw_at_peak_n": float(lift.jaw_n[at_peak]),
        "jaw_largest_n": float(lift.jaw_n.max()),
    }


def _mean(values: list[float]) -> float:
    return float(np.mean(values))
