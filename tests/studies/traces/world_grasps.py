"""Grasps of a virtual world, all objects with many tools: solved once, kept in a file, then measured as a bench would.

The physics, its scatter and the noise are those of `hardware.virtual.world`; only the devices between world and lake
are left out, since identification and anomalies of hundreds of tools' grasps need their readings and not the wires.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fast.hardware.station.separation import WINDOW_MM
from fast.hardware.station.station import CLOSED_SETTLE_S, closing_s
from fast.hardware.virtual.world.file import World, load_world
from fast.hardware.virtual.world.physics import (
    PhysicsRequest,
    SensorNoise,
    build_request,
    grasp_curve,
    simulate_request,
)
from fast.hardware.virtual.world.physics_cache import physics_id
from fast.models.design.space import numbered_design
from fast.models.errors import ConfigError, SimulationFailed
from fast.models.objects.catalogue import OBJECTS
from fast.models.records import GraspSetup, GraspSimulation, Record, Trace
from fast.models.simulation.grasp import simulate_grasp
from fast.models.simulation.version import SimulatorVersion
from fast.models.traces import peak_force_n, work_j
from fast.models.traces.batch import TraceFeatures, features_of_samples
from tests.studies.benchmarks.base import Options
from tests.studies.benchmarks.outcomes import RecordFile, read_records

SETUP = GraspSetup()
N_TOOLS = 24
N_REPEATS = 3
_DIGITS = 4  # of kept times, lifts and forces
WORLDS = Path(__file__).resolve().parents[3] / "worlds"
SIMULATED = "simulator"  # in place of the hash of a world: what the simulator expects


class WorldGrasp(Record):
    """The solved grasp of a tool on an object, without repeats and noise; no samples where the solver failed.

    `tool` is the number of a `models.design.space.numbered_design`, `code` the id of the physics behind it.
    """

    tool: int
    object_id: int
    world_hash: str
    code: str
    time_s: tuple[float, ...] = ()
    lift_mm: tuple[float, ...] = ()
    force_n: tuple[float, ...] = ()
    cpu_s: float = 0.0

    @property
    def trace(self) -> Trace:
        """The samples as arrays."""
        return Trace(*(np.array(values) for values in (self.time_s, self.lift_mm, self.force_n)))


@dataclass(frozen=True, eq=False)
class WorldTraces:
    """Measured traces of m grasps: labels (m each) and the samples."""

    tool: np.ndarray
    object_id: np.ndarray
    repeat: np.ndarray
    traces: tuple[Trace, ...]

    @property
    def features(self) -> TraceFeatures:
        """Features of all of them, in order."""
        offsets = np.cumsum([0, *(len(trace.lift_mm) for trace in self.traces)])
        lifts, forces = ([getattr(trace, name) for trace in self.traces] for name in ("lift_mm", "force_n"))
        return features_of_samples(np.concatenate(lifts), np.concatenate(forces), offsets)


Spoil = Callable[[tuple[int, int, int], Trace], np.ndarray]
"""From (tool, object, repeat) and its true trace to the force on the load cell."""


def leave_alone(grasp: tuple[int, int, int], true: Trace) -> np.ndarray:
    """Nothing is wrong."""
    return true.force_n


def bench_world(name: str = "quick") -> World:
    """A world of the folder `worlds`; the default is that of the quick campaign.

    Raises:
        ConfigError: its file is not beside the code.
    """
    path = WORLDS / f"{name}.toml"
    try:
        return load_world(path.read_text(encoding="utf-8"), str(path))
    except OSError as error:
        raise ConfigError(f"{path} cannot be read ({error.strerror}); run from a complete checkout.") from error


def solve_world(world: World, tools: Sequence[int], objects: Sequence[int], options: Options) -> list[WorldGrasp]:
    """Grasps of these tools on these objects that are solved: from the results file, else now, up to the time limit."""
    code = physics_id()
    return _solve_missing(world.world_hash, code, lambda t, o: _solve(world, t, o, code), tools, objects, options)


def simulate_cells(tools: Sequence[int], objects: Sequence[int], options: Options) -> list[WorldGrasp]:
    """The same grasps by the simulator as it is delivered, which knows none of the worlds."""
    version = SimulatorVersion()

    def solve(tool: int, object_id: int) -> WorldGrasp:
        labels: dict[str, Any] = {"tool": tool, "object_id": object_id, "world_hash": SIMULATED, "code": code}
        started = time.process_time()
        try:
            trace = simulate_grasp(numbered_design(tool), OBJECTS[object_id], version, SETUP).trace
        except SimulationFailed:
            return WorldGrasp(**labels, cpu_s=round(time.process_time() - started, 3))
        return WorldGrasp(**labels, cpu_s=round(time.process_time() - started, 3), **_channels(trace))

    code = version.version_id
    return _solve_missing(SIMULATED, code, solve, tools, objects, options)


def _solve_missing(
    world_hash: str,
    code: str,
    solve: Callable[[int, int], WorldGrasp],
    tools: Sequence[int],
    objects: Sequence[int],
    options: Options,
) -> list[WorldGrasp]:
    kept = read_records(options.results, WorldGrasp, "grasp of a world")
    known = {(g.tool, g.object_id): g for g in kept if (g.code, g.world_hash) == (code, world_hash)}
    cases = [(tool, object_id) for tool in tools for object_id in objects]
    missing = [case for case in cases if case not in known]
    options.tell(f"{len(cases) - len(missing)} grasps known, {len(missing)} to solve")
    started = time.monotonic()
    with RecordFile(options.results) as file:
        for n_done, case in enumerate(missing, start=1):
            if time.monotonic() - started > 60.0 * options.limit_minutes:
                break
            known[case] = solve(*case)
            file.append(known[case])
            if n_done % len(objects) == 0:
                options.tell(f"{n_done} of {len(missing)} grasps solved")
    return [known[case] for case in cases if case in known]


def _request(world: World, tool: int, object_id: int) -> PhysicsRequest:
    return build_request(world, f"study/B01T{tool}", numbered_design(tool), object_id, SETUP)


def _solve(world: World, tool: int, object_id: int, code: str) -> WorldGrasp:
    started = time.process_time()
    try:
        trace = simulate_request(_request(world, tool, object_id)).trace
    except SimulationFailed:
        cpu_s = round(time.process_time() - started, 3)
        return WorldGrasp(tool=tool, object_id=object_id, world_hash=world.world_hash, code=code, cpu_s=cpu_s)
    cpu_s = round(time.process_time() - started, 3)
    labels: dict[str, Any] = {"tool": tool, "object_id": object_id, "world_hash": world.world_hash, "code": code}
    return WorldGrasp(**labels, cpu_s=cpu_s, **_channels(trace))


def _channels(trace: Trace) -> dict[str, Any]:
    return {name: np.round(getattr(trace, name), _DIGITS).tolist() for name in ("time_s", "lift_mm", "force_n")}


def simulated_features(measured: WorldTraces, simulated: Sequence[WorldGrasp]) -> TraceFeatures:
    """Features of the simulated trace of each measured grasp, in order; NaN where the simulator has none."""
    solved = [grasp for grasp in simulated if grasp.time_s]
    offsets = np.cumsum([0, *(len(grasp.time_s) for grasp in solved)])
    lifts, forces = (np.concatenate([getattr(g, name) for g in solved]) for name in ("lift_mm", "force_n"))
    found = features_of_samples(lifts, forces, offsets)
    place = {(grasp.tool, grasp.object_id): number for number, grasp in enumerate(solved)}
    rows = [place.get(cell, -1) for cell in zip(measured.tool.tolist(), measured.object_id.tolist(), strict=True)]
    nothing = np.full((1, found.values.shape[1]), np.nan), np.zeros((1, found.profile_n.shape[1]))
    return TraceFeatures(np.vstack([found.values, nothing[0]])[rows], np.vstack([found.profile_n, nothing[1]])[rows])


def measure_world(
    world: World, grasps: Sequence[WorldGrasp], n_repeats: int = N_REPEATS, spoil: Spoil = leave_alone
) -> WorldTraces:
    """Traces that the bench of a world reads of its solved grasps: every one `n_repeats` times, noise and all.

    `spoil` may change the true force of a grasp, before the noise.
    """
    solved = [grasp for grasp in grasps if grasp.time_s]
    cases = [(grasp, repeat) for grasp in solved for repeat in range(n_repeats)]
    return WorldTraces(
        np.array([grasp.tool for grasp, _ in cases]),
        np.array([grasp.object_id for grasp, _ in cases]),
        np.array([repeat for _, repeat in cases]),
        tuple(_readings(world, grasp, repeat, spoil) for grasp, repeat in cases),
    )


def _readings(world: World, grasp: WorldGrasp, repeat: int, spoil: Spoil) -> Trace:
    """One repeat at the transmitter's rate: closing, a moment at rest, the lift and a tail."""
    request = _request(world, grasp.tool, grasp.object_id)
    curve = grasp_curve(_simulation(grasp.trace), world, request, repeat)
    stroke_s = closing_s(SETUP)
    rest_s = stroke_s + CLOSED_SETTLE_S
    top_mm = OBJECTS[grasp.object_id].height_mm + SETUP.tip_below_mm
    end_mm = min(max(curve.release_lift_mm, top_mm) + WINDOW_MM, SETUP.max_lift_mm)
    n_readings = int((rest_s + end_mm / SETUP.lift_speed_mm_per_s) * world.sensor.rate_hz)
    time_s = np.arange(1, n_readings + 1) / world.sensor.rate_hz
    lift_mm = np.maximum(time_s - rest_s, 0.0) * SETUP.lift_speed_mm_per_s
    closing_n = np.interp(time_s / stroke_s, curve.closing_share, curve.closing_force_n)
    lift_n = np.interp(lift_mm, curve.lift_mm, curve.lift_force_n)
    lift_n[lift_mm >= curve.release_lift_mm] = 0.0
    noise = SensorNoise(world, request.tool_id, grasp.object_id, repeat)
    noise_n = np.array([noise.advance(1) for _ in time_s])
    true = Trace(time_s, lift_mm, np.where(time_s < stroke_s, closing_n, lift_n))
    return Trace(time_s, lift_mm, spoil((grasp.tool, grasp.object_id, repeat), true) + noise_n)


def _simulation(trace: Trace) -> GraspSimulation:
    """What a curve needs of a result: the trace."""
    return GraspSimulation(trace, peak_force_n(trace), 0.0, work_j(trace), 0, 0, 0, 0.0)
