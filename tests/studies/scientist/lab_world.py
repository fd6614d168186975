"""How far the simulator is from the lab world, and where the best finger of that world lies.

Two questions. Agreement: random designs on an object of each class, in the simulator that `campaigns/paper.toml`
believes in and in `worlds/lab.toml`. Best design: a direct search for the largest mean peak, without scatter, in both.
"""

import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np
from scipy.stats import spearmanr

from fast.flows.progress import RateEstimate, describe_time_left
from fast.hardware.virtual.world.file import Scatter, World, load_world
from fast.hardware.virtual.world.physics import PhysicsRequest, build_request, simulate_request
from fast.hardware.virtual.world.physics_cache import physics_id
from fast.models.design.space import BEST_PUBLISHED, N_RIB_LEVELS, PARAMETERS, from_unit, numbered_design, snap, to_unit
from fast.models.errors import MeshingFailed, SimulationFailed
from fast.models.ids import content_id
from fast.models.objects.catalogue import OBJECTS, get_object
from fast.models.records import Design, GraspSetup, GraspSimulation, Record
from fast.models.simulation.version import SimulatorVersion
from fast.tasks.campaign.config import load_config
from fast.tasks.simulation.pool import WorkerPool
from tests.studies.benchmarks.base import Options, Rows, Tables
from tests.studies.benchmarks.outcomes import RecordFile, read_records

ROOT = Path(__file__).parents[3]
N_DESIGNS = 12
CLASS_OBJECTS = (2, 6, 10, 14, 17, 19, 22, 24, 27, 28, 31, 32)  # of each class that has a mirror plane
SEARCH_OBJECTS = (2, 14, 28, 32)  # those of campaigns/compare.toml
N_RANDOM, COMPASS_STEPS = 30, (0.3, 0.15)  # of the range of each parameter
STIFFEST = {"length_mm": 35.0, "width_mm": 35.0, "height_mm": 90.0, "front_thickness_mm": 3.0,
            "back_thickness_mm": 3.0, "rib_thickness_mm": 3.0}  # fmt: skip
AT_BOUND = 0.01  # share of the range within which a parameter counts as lying on its bound
DEADLINE_S = 900.0
Bench = Literal["simulator", "lab", "lab without scatter"]
SEARCHED: tuple[Bench, ...] = ("simulator", "lab without scatter")


class LabGrasp(Record):
    """One grasp; `key` is all that decides it. No peak: it failed, and `reason` says why."""

    key: str
    bench: Bench
    design: Design
    object_id: int
    peak_force_n: float | None = None
    cpu_s: float = 0.0
    reason: str = ""


@dataclass
class Grasps:
    """Grasps that are known, and the worker that makes the others."""

    world: World
    version: SimulatorVersion
    setup: GraspSetup
    options: Options
    file: RecordFile
    pool: WorkerPool
    known: dict[str, LabGrasp]
    rate: RateEstimate = field(default_factory=RateEstimate)

    def mean_peak_n(self, bench: Bench, design: Design, objects: Sequence[int]) -> float:
        """Mean peak of a design in N; NaN if a grasp failed."""
        peaks = [self.grasp(bench, design, object_id).peak_force_n for object_id in objects]
        return float(np.mean([np.nan if peak is None else peak for peak in peaks]))

    def grasp(self, bench: Bench, design: Design, object_id: int) -> LabGrasp:
        """The grasp, known or made now."""
        key = self._key(bench, design, object_id)
        if key not in self.known:
            self.known[key] = self._make(key, bench, design, object_id)
            self.file.append(self.known[key])
        return self.known[key]

    def _key(self, bench: Bench, design: Design, object_id: int) -> str:
        believed = self.version.version_id if bench == "simulator" else self._world(bench).model_dump(mode="json")
        return content_id("B", [physics_id(), bench, believed, self.setup.setup_id, design.model_dump(), object_id])

    def _world(self, bench: Bench) -> World:
        return self.world if bench == "lab" else self.world.model_copy(update={"scatter": Scatter()})

    def _make(self, key: str, bench: Bench, design: Design, object_id: int) -> LabGrasp:
        asked = LabGrasp(key=key, bench=bench, design=design, object_id=object_id)
        try:
            if bench == "simulator":
                result = self.pool.call(simulate, design, object_id, self.version, self.setup)
            else:
                result = self.pool.call(simulate_request, self._request(bench, design, object_id))
        except SimulationFailed as failure:
            return asked.model_copy(update={"reason": failure.reason})
        return asked.model_copy(update={"peak_force_n": result.peak_force_n, "cpu_s": round(result.cpu_s, 3)})

    def _request(self, bench: Bench, design: Design, object_id: int) -> PhysicsRequest:
        return build_request(self._world(bench), f"lab/{design.design_id}", design, object_id, self.setup)


def simulate(design: Design, object_id: int, version: SimulatorVersion, setup: GraspSetup) -> GraspSimulation:
    """The grasp as the simulator sees it.

    Raises:
        SimulationFailed: the solver found no solution, or no mesh.
    """
    from fast.models.simulation.grasp import simulate_grasp  # heavy: compiles on first use

    try:
        return simulate_grasp(design, get_object(object_id), version, setup, deadline_s=DEADLINE_S)
    except MeshingFailed as failure:
        raise SimulationFailed(str(failure), f"mesh_{failure.reason}") from failure


def measure_lab_world(options: Options) -> Tables:
    """Simulated against measured peaks in the lab world by class, and the best design of a direct search."""
    world_path = ROOT / "worlds" / "lab.toml"
    world = load_world(world_path.read_text(encoding="utf-8"), world_path.name)
    config = load_config(ROOT / "campaigns" / "paper.toml")
    known = {grasp.key: grasp for grasp in read_records(options.results, LabGrasp, "grasp of the lab world")}
    pool = WorkerPool(1)
    try:
        with RecordFile(options.results) as file:
            grasps = Grasps(world, config.simulator.version, config.grasp, options, file, pool, known)
            pairs = measure_pairs(grasps, options.designs or N_DESIGNS, options.objects or CLASS_OBJECTS)
            found = {bench: search(grasps, bench, options.n or N_RANDOM) for bench in SEARCHED}
    finally:
        pool.close()
    return {
        "classes": class_rows(pairs),
        "designs": [design_row(pairs)],
        "best": [best_row(bench, searched) for bench, searched in found.items()],
        "searched in both": [transfer_row(found)],
        "cost": [cost_row(pairs)],
    }


Pair = tuple[LabGrasp, LabGrasp]


def measure_pairs(grasps: Grasps, n_designs: int, objects: Sequence[int]) -> list[Pair]:
    """Each random design on each object, simulated and in the lab world; pairs with a failure are kept."""
    pairs = []
    for number in range(n_designs):
        design = numbered_design(number)
        pairs += [(grasps.grasp("simulator", design, o), grasps.grasp("lab", design, o)) for o in objects]
        grasps.rate.update(number + 1, time.monotonic())
        left = describe_time_left(grasps.rate.seconds_left(n_designs - number - 1))
        grasps.options.tell(f"agreement: design {number + 1} of {n_designs}, {left}")
    return pairs


def search(grasps: Grasps, bench: Bench, n_random: int) -> dict[Design, float]:
    """Mean peaks in N of random and known designs, of corners, and of a compass search from the best of them.

    A compass step tries each parameter up and down, cut at its bounds, and then all steps together that were better.
    """
    designs = [*corners(), BEST_PUBLISHED, *(numbered_design(number) for number in range(n_random))]
    found: dict[Design, float] = {}

    def try_all(some: Sequence[Design], what: str) -> None:
        for design in some:
            if design not in found:
                found[design] = grasps.mean_peak_n(bench, design, SEARCH_OBJECTS)
        grasps.options.tell(f"search, {bench}: {what}, best {found[best_of(found)]:.2f} N of {len(found)} designs")

    try_all(designs, "start")
    for step in COMPASS_STEPS:
        centre = best_of(found)
        moves = compass(centre, step)
        try_all(list(moves), f"steps of {step}")
        better = [move for design, move in moves.items() if found[design] > found[centre]]
        together = np.clip(to_unit([centre])[0] + np.sum(better, axis=0) if better else to_unit([centre])[0], 0.0, 1.0)
        try_all(from_unit(snap(together[None])), "together")
    return found


def corners() -> list[Design]:
    """The stiffest fingers of the design box: short and thick, with few and with many ribs."""
    base = BEST_PUBLISHED.model_copy(update={**STIFFEST, "rib_angle_deg": 0.0})
    cases = [(ribs, tip_mm) for ribs in (1, 5, 10) for tip_mm in (20.0, 30.0)]
    return [base.model_copy(update={"rib_count": ribs, "tip_length_mm": tip_mm}) for ribs, tip_mm in cases]


def compass(centre: Design, step: float) -> dict[Design, np.ndarray]:
    """Designs one step away along each parameter, with the step (9) in the unit cube that leads there."""
    middle = to_unit([centre])[0]
    moves = {}
    for column, name in enumerate(PARAMETERS):
        least = max(step, 1.0 / (N_RIB_LEVELS - 1)) if name == "rib_count" else step
        for sign in (-1.0, 1.0):
            point = middle.copy()
            point[column] = np.clip(point[column] + sign * least, 0.0, 1.0)
            point = snap(point[None])[0]
            if point[column] != middle[column]:
                moves[from_unit(point[None])[0]] = point - middle
    return moves


def best_of(found: dict[Design, float]) -> Design:
    """The design with the largest mean peak; failures do not count."""
    return max(found, key=lambda design: -np.inf if np.isnan(found[design]) else found[design])


def on_bounds(design: Design) -> list[str]:
    """Parameters that lie on a bound of the design box."""
    unit = to_unit([design])[0]
    return [name for name, value in zip(PARAMETERS, unit, strict=True) if min(value, 1.0 - value) < AT_BOUND]


def class_rows(pairs: Sequence[Pair]) -> Rows:
    """Correlation of simulated and measured peaks over the designs, per object, and the median ratio."""
    rows: Rows = []
    for object_id in dict.fromkeys(simulated.object_id for simulated, _ in pairs):
        simulated_n, measured_n = _peaks([pair for pair in pairs if pair[0].object_id == object_id])
        obj = OBJECTS[object_id]
        rows.append({"object_class": obj.object_class, "object_id": object_id, **_agreement(simulated_n, measured_n)})
    return rows


def design_row(pairs: Sequence[Pair]) -> dict[str, object]:
    """The same for the means of designs over the objects; a design with a failed grasp is left out."""
    by_design: dict[Design, list[Pair]] = {}
    for pair in pairs:
        by_design.setdefault(pair[0].design, []).append(pair)
    whole = [own for own in by_design.values() if len(_peaks(own)[0]) == len(own)]
    means = np.array([[peaks.mean() for peaks in _peaks(own)] for own in whole])
    return {"designs_left_out": len(by_design) - len(whole), **_agreement(means[:, 0], means[:, 1])}


def best_row(bench: Bench, found: dict[Design, float]) -> dict[str, object]:
    """The best design of a search, what lies on a bound, and how far behind the best with at most two bounds is."""
    best = best_of(found)
    inside = {design: n for design, n in found.items() if len(on_bounds(design)) <= 2}
    return {
        "bench": bench,
        "designs": len(found),
        "best_n": found[best],
        "bounds": len(on_bounds(best)),
        "on_bounds": " ".join(on_bounds(best)) or "none",
        "best_inside_n": found[best_of(inside)],
        "published_n": found[BEST_PUBLISHED],
        **best.model_dump(),
    }


def transfer_row(found: dict[Bench, dict[Design, float]]) -> dict[str, object]:
    """What the ranking of one search is worth in the other, over the designs of both."""
    simulated, measured = found["simulator"], found["lab without scatter"]
    both = [d for d in simulated if d in measured and np.isfinite([simulated[d], measured[d]]).all()]
    best_simulated = max(both, key=lambda design: simulated[design])
    ten = sorted(both, key=lambda design: -simulated[design])[:10]
    return {
        **_agreement(np.array([simulated[d] for d in both]), np.array([measured[d] for d in both])),
        "measured_of_best_simulated_n": measured[best_simulated],
        "measured_of_ten_best_simulated_n": float(np.mean([measured[d] for d in ten])),
        "best_measured_n": max(measured[d] for d in both),
    }


def cost_row(pairs: Sequence[Pair]) -> dict[str, object]:
    """CPU seconds of a grasp in the simulator and in the lab world; failures."""
    simulated, measured = ([pair[side] for pair in pairs] for side in (0, 1))
    return {
        "grasps": len(pairs),
        "simulator_median_cpu_s": float(np.median([grasp.cpu_s for grasp in simulated])),
        "lab_median_cpu_s": float(np.median([grasp.cpu_s for grasp in measured])),
        "lab_mean_cpu_s": float(np.mean([grasp.cpu_s for grasp in measured])),
        "failed_simulator": sum(grasp.peak_force_n is None for grasp in simulated),
        "failed_lab": sum(grasp.peak_force_n is None for grasp in measured),
    }


def _peaks(pairs: Sequence[Pair]) -> tuple[np.ndarray, np.ndarray]:
    peaks = np.array([(s.peak_force_n, m.peak_force_n) for s, m in pairs], dtype=float).reshape(-1, 2)
    done = peaks[np.isfinite(peaks).all(axis=1)]
    return done[:, 0], done[:, 1]


def _agreement(simulated_n: np.ndarray, measured_n: np.ndarray) -> dict[str, object]:
    return {
        "n": len(simulated_n),
        "correlation": float(np.corrcoef(simulated_n, measured_n)[0, 1]),
        "rank_correlation": float(spearmanr(simulated_n, measured_n).statistic),
        "median_ratio": float(np.median(measured_n / np.maximum(simulated_n, 0.1))),
        "simulated_mean_n": float(simulated_n.mean()),
        "measured_mean_n": float(measured_n.mean()),
    }
