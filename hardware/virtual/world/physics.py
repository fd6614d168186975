"""What a grasp in a world would really measure: the request to the solver, its scatter, and the sensor chain.

The solver is injected (`Physics`), so a caller may run it in a process pool or replace it in tests. Every random number
is drawn from (world seed, tool, object, repeat), so a resumed bench measures what an uninterrupted one would.
"""

import math
import threading
from bisect import bisect_right
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Protocol

import numpy as np
from pydantic import SerializeAsAny

from fast.hardware.virtual.world.file import World
from fast.hardware.virtual.world.hidden import TIMED, build_hidden
from fast.models.errors import MeshingFailed, SimulationFailed
from fast.models.ids import content_id, seed_from
from fast.models.records import Design, EffectValue, GraspSetup, GraspSimulation, Placement, Record, Theta
from fast.models.simulation.version import MeshSettings, SimulatorVersion

if TYPE_CHECKING:
    from fast.models.objects.rigid import RigidObject

# Below these a grasp is taken as symmetric: one finger is solved instead of two, or half of it instead of all. At the
# limit the peak of two designs changes by at most 1.5 % on a turned cube, 0.4 % on sphere, tube and hourglass.
NEGLIGIBLE_OFFSET_X_MM = 0.75
NEGLIGIBLE_OFFSET_Y_MM = 0.5
NEGLIGIBLE_TURN_DEG = 1.0
SOLVER_DEADLINE_S = 900.0
NOISE_BLOCK = 256


class PhysicsRequest(Record):
    """One grasp for the solver: picklable, and the same for every repeat of a tool on an object."""

    tool_id: str
    """Whose print it is: prints of one design differ."""
    design: SerializeAsAny[Design]
    """With the parameters of its family, which the base class does not know."""
    object_id: int
    """What is grasped."""
    setup: GraspSetup
    """How it is made."""
    placement: Placement
    """Where the object sits between the fingers."""
    theta: Theta
    """Of the world's material and contact."""
    mesh_edge_mm: float
    """Of the finger's section."""
    mesh_layers: int
    """Over its width."""
    hidden: tuple[EffectValue, ...]
    """Effects of the world that the scientist's simulator does not know."""
    tool_seed: int
    """Of what differs from print to print."""

    @property
    def request_id(self) -> str:
        """Id derived from the whole content, `B` and 12 hex digits."""
        return content_id("B", self.model_dump(mode="json"))


Physics = Callable[[PhysicsRequest], GraspSimulation]


def build_request(
    world: World,
    tool_id: str,
    design: Design,
    object_id: int,
    setup: GraspSetup,
    offset_mm: tuple[float, float] = (0.0, 0.0),
    yaw_deg: float = 0.0,
) -> PhysicsRequest:
    """Build a world's request for one tool on one object, with the object's placement drawn.

    `offset_mm`, `yaw_deg`: how far in x and y the bench put the object off the middle of the fingers, and turned it, on
    top of what is drawn. No law of a world's grasps knows a speed: the bench plays the same answer at the speed at
    which it moves.
    """
    return PhysicsRequest(
        tool_id=tool_id,
        design=design,
        object_id=object_id,
        setup=setup.timed_as(GraspSetup()),
        placement=_placement(world, tool_id, object_id, offset_mm, yaw_deg),
        theta=_tool_theta(world, tool_id),
        mesh_edge_mm=world.mesh.edge_mm,
        mesh_layers=world.mesh.layers,
        hidden=(*(value for value in world.hidden if value.effect != TIMED), *_print_error(world, tool_id)),
        tool_seed=seed_from(world.seed, "tool", tool_id),
    )


def simulate_request(request: PhysicsRequest) -> GraspSimulation:
    """Simulate as the default `Physics`: the finite-element grasp with the world's theta, mesh and hidden laws.

    Raises:
        SimulationFailed: the solver found no solution, or no mesh (reason `mesh_...`).
    """
    from fast.models.objects.catalogue import get_object
    from fast.models.simulation.contact.law import ContactLaw
    from fast.models.simulation.grasp import Numerics, simulate_grasp  # heavy: compiles on first use

    # The truth must share neither the simulator's mesh nor its regularisation of contact. Softer than 4 N/mm3 it would
    # differ by an artefact: rims sink in and hook (`models.simulation.contact.law.ContactLaw`).
    mesh = MeshSettings(edge_mm=request.mesh_edge_mm, layers=request.mesh_layers)
    version = SimulatorVersion(theta=request.theta, mesh=mesh)
    contact = ContactLaw(normal_n_per_mm3=6.0, tangential_n_per_mm3=3.0, smoothing_mm=0.04)
    try:
        return simulate_grasp(
            request.design,
            get_object(request.object_id),
            version,
            request.setup,
            placement=request.placement,
            effects=build_hidden(request.hidden, request.tool_seed),
            numerics=Numerics(contact=contact),
            deadline_s=SOLVER_DEADLINE_S,
        )
    except MeshingFailed as failure:
        raise SimulationFailed(str(failure), f"mesh_{failure.reason}") from failure


def solve_elsewhere(physics: Physics, obj: "RigidObject", request: PhysicsRequest) -> GraspSimulation:
    """Run a physics in another process, which may not know the own object of the request.

    Raises:
        SimulationFailed: as the physics.
    """
    from fast.models.objects.catalogue import register

    register(obj)
    return physics(request)


class PhysicsStore(Protocol):
    """Where results outlive the process, such as `hardware.virtual.world.physics_cache`."""

    def get(self, request: PhysicsRequest) -> GraspSimulation | None:
        """Get the kept result of a request, or None."""

    def put(self, request: PhysicsRequest, result: GraspSimulation) -> None:
        """Keep the result of a request."""


class PhysicsCache:
    """A `Physics` that solves each request once; thread-safe. Failures are remembered too, but only here.

    `put` takes results that were computed ahead; `store` keeps results for the next process.
    """

    def __init__(self, physics: Physics, store: PhysicsStore | None = None) -> None:
        self._physics = physics
        self._store = store
        self._results: dict[str, GraspSimulation | SimulationFailed] = {}
        self._lock = threading.Lock()

    def __call__(self, request: PhysicsRequest) -> GraspSimulation:
        """Return the result of the request, solved now unless known.

        Raises:
            SimulationFailed: as the physics behind the cache.
        """
        key = request.request_id
        with self._lock:
            result = self._results.get(key)
        if result is None:
            result = self._solve(request)
            self.put(request, result)
        if isinstance(result, SimulationFailed):
            raise SimulationFailed(str(result), result.reason) from result
        return result

    def put(self, request: PhysicsRequest, result: GraspSimulation | SimulationFailed) -> None:
        """Store a result that was computed elsewhere."""
        with self._lock:
            self._results[request.request_id] = result

    def missing(self, requests: Iterable[PhysicsRequest]) -> list[PhysicsRequest]:
        """List those requests that are not known yet, in order and without duplicates."""
        unique = {request.request_id: request for request in requests}
        with self._lock:
            return [request for key, request in unique.items() if key not in self._results]

    def _solve(self, request: PhysicsRequest) -> GraspSimulation | SimulationFailed:
        kept = self._store.get(request) if self._store is not None else None
        if kept is not None:
            return kept
        try:
            result = self._physics(request)
        except SimulationFailed as failure:
            return failure
        if self._store is not None:
            self._store.put(request, result)
        return result


@dataclass(frozen=True)
class GraspCurve:
    """Force on the load cell by closing progress and by lift, as the world answers the bench.

    `closing_share` (n, 0 to 1) with `closing_force_n` (n); `lift_mm` (m, increasing) with `lift_force_n` (m).
    """

    closing_share: np.ndarray
    closing_force_n: np.ndarray
    lift_mm: np.ndarray
    lift_force_n: np.ndarray
    release_lift_mm: float
    """From here on the fingers have left the object; infinite if they never do."""

    def closing_force_at(self, share: float) -> float:
        """Return the force in N when the jaws have made this share of their stroke."""
        return float(np.interp(share, self.closing_share, self.closing_force_n))

    def lift_force_at(self, lift_mm: float) -> float:
        """Return the force in N at a lift; the end values hold outside the curve."""
        lifts_mm, forces_n = self._lift_points
        after = bisect_right(lifts_mm, lift_mm)
        if after == 0 or after == len(lifts_mm):
            return forces_n[max(after - 1, 0)]
        slope = (forces_n[after] - forces_n[after - 1]) / (lifts_mm[after] - lifts_mm[after - 1])
        return slope * (lift_mm - lifts_mm[after - 1]) + forces_n[after - 1]

    @cached_property
    def _lift_points(self) -> tuple[list[float], list[float]]:
        """The lift as lists: `np.interp` takes ten times as long for one point, and every reading asks for one."""
        return self.lift_mm.tolist(), self.lift_force_n.tolist()


def grasp_curve(simulation: GraspSimulation, world: World, request: PhysicsRequest, repeat: int) -> GraspCurve:
    """Make the curve of one grasp: the solver's trace times the scatter from grasp to grasp."""
    trace = simulation.trace
    force_n = trace.force_n * _repeat_factor(world, request, repeat)
    lift = trace.is_lift
    closing_s, closing_n = trace.time_s[~lift], force_n[~lift]
    lift_mm, lift_n = trace.lift_mm[lift], force_n[lift]
    if lift_mm.size == 0:
        lift_mm, lift_n = np.zeros(1), force_n[-1:] if force_n.size else np.zeros(1)
    closing_end_s = float(trace.time_s[lift][0]) if lift.any() else float(trace.time_s[-1])
    elapsed_s = closing_s - trace.time_s[0]
    return GraspCurve(
        closing_share=np.append(elapsed_s / max(closing_end_s - float(trace.time_s[0]), 1e-9), 1.0),
        closing_force_n=np.append(closing_n, lift_n[0]),
        lift_mm=lift_mm,
        lift_force_n=lift_n,
        release_lift_mm=_release_lift_mm(lift_mm, lift_n, request.setup.max_lift_mm),
    )


def _release_lift_mm(lift_mm: np.ndarray, force_n: np.ndarray, max_lift_mm: float) -> float:
    """Lift after which the force stays zero. A solver that stops before the longest lift saw the fingers come free."""
    if lift_mm[-1] < max_lift_mm - 1e-6:
        return float(lift_mm[-1])
    touching = np.flatnonzero(np.abs(force_n) > 1e-6)
    if touching.size == 0:
        return float(lift_mm[0])
    return float(lift_mm[touching[-1] + 1]) if touching[-1] + 1 < len(lift_mm) else float("inf")


def _placement(world: World, tool_id: str, object_id: int, offset_mm: tuple[float, float], yaw_deg: float) -> Placement:
    """Return where the object sits in this mounting, and how the tool's fingers are turned."""
    scatter = world.scatter
    x, z = _draws(world, 2, "placement", tool_id, object_id)
    y, yaw = _draws(world, 2, "pose", tool_id, object_id)
    (roll,) = _draws(world, 1, "roll", tool_id)
    return Placement(
        offset_x_mm=offset_mm[0] + _unless_negligible(scatter.placement_sd_mm * x, NEGLIGIBLE_OFFSET_X_MM),
        offset_y_mm=offset_mm[1] + _unless_negligible(scatter.offset_y_sd_mm * y, NEGLIGIBLE_OFFSET_Y_MM),
        offset_z_mm=scatter.placement_sd_mm * z + 0.0,
        yaw_deg=yaw_deg + _unless_negligible(scatter.yaw_sd_deg * yaw, NEGLIGIBLE_TURN_DEG),
        roll_deg=_unless_negligible(scatter.roll_sd_deg * roll, NEGLIGIBLE_TURN_DEG),
    )


def _unless_negligible(value: float, limit: float) -> float:
    """Return the value, or 0 below the limit; never -0.0, which would be another request."""
    return value if abs(value) >= limit and value != 0.0 else 0.0


def _print_error(world: World, tool_id: str) -> tuple[EffectValue, ...]:
    """Return how much thicker than drawn a printed tool's walls are, by the law of `wall_thickness_offset`."""
    if world.scatter.thickness_sd_mm == 0.0:
        return ()
    (draw,) = _draws(world, 1, "thickness", tool_id)
    offset_mm = world.scatter.thickness_sd_mm * draw
    return (EffectValue(effect="wall_thickness_offset", parameters={"offset_mm": offset_mm}),)


def _draws(world: World, n: int, purpose: str, *parts: str | int) -> list[float]:
    """Draw standard normal numbers, at most 3."""
    return np.clip(_rng(world, purpose, *parts).standard_normal(n), -3, 3).tolist()


def _tool_theta(world: World, tool_id: str) -> Theta:
    """Return one printed tool's theta. Solved with its own modulus: some hidden laws break force's scaling with E."""
    modulus_mpa = world.theta.young_modulus_mpa * tool_modulus_factor(world, tool_id)
    return world.theta.model_copy(update={"young_modulus_mpa": modulus_mpa})


def tool_modulus_factor(world: World, tool_id: str) -> float:
    """Return the true modulus of a printed tool over the world's theta."""
    draw = float(_rng(world, "tool", tool_id).standard_normal())
    return float(np.exp(world.scatter.tool_modulus_sd * np.clip(draw, -3, 3)))


def _repeat_factor(world: World, request: PhysicsRequest, repeat: int) -> float:
    draw = float(_rng(world, "repeat", request.tool_id, request.object_id, repeat).standard_normal())
    return float(np.exp(world.scatter.repeat_sd * np.clip(draw, -3, 3)))


class SensorNoise:
    """AR(1) noise of the transmitter's readings, drawn for one grasp.

    x(k) = rho x(k-1) + sqrt(1 - rho^2) sd e(k), rho = exp(-1 / (rate * correlation time)); skipped readings are
    drawn in one step, so the statistics do not depend on how often somebody looks.
    """

    def __init__(self, world: World, tool_id: str, object_id: int, repeat: int) -> None:
        self._sd_n = world.sensor.noise_sd_n
        correlation_s = world.sensor.noise_correlation_s
        self._rho = float(np.exp(-1.0 / (world.sensor.rate_hz * correlation_s))) if correlation_s > 0 else 0.0
        self._draws = _normal_draws(_rng(world, "noise", tool_id, object_id, repeat))
        self._value_n = self._sd_n * next(self._draws)

    def advance(self, n_readings: int) -> float:
        """Return the noise in N, `n_readings` after the last call."""
        if self._sd_n == 0.0:
            return 0.0
        rho = self._rho**n_readings
        step = math.sqrt(1.0 - rho * rho) * self._sd_n
        self._value_n = rho * self._value_n + step * next(self._draws)
        return self._value_n


def _normal_draws(rng: np.random.Generator) -> Iterator[float]:
    """Yield standard normal numbers without end, the same as one by one; in blocks, as a call costs what 100 do."""
    while True:
        yield from rng.standard_normal(NOISE_BLOCK).tolist()


def _rng(world: World, purpose: str, *parts: str | int) -> np.random.Generator:
    return np.random.default_rng(seed_from(world.seed, purpose, *parts))
