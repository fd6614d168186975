"""One simulated grasp: close, lift, separate; the sum of both fingers as the load cell sees it."""

import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Self

import numpy as np

from fast.models.design.space import BEST_PUBLISHED
from fast.models.errors import UsageError
from fast.models.kernels import compile_once
from fast.models.objects.catalogue import get_object
from fast.models.objects.primitives import bounds
from fast.models.objects.rigid import RigidObject
from fast.models.records import Design, GraspContext, GraspSetup, GraspSimulation, Placement
from fast.models.simulation.actuation import ClosingStall
from fast.models.simulation.body.elasticity import REFERENCE_MODULUS_MPA
from fast.models.simulation.contact.law import Obstacle
from fast.models.simulation.effects.base import Effect
from fast.models.simulation.finger import FingerState, FingerStep
from fast.models.simulation.inputs import GraspInputs
from fast.models.simulation.mesh.build import build_mesh
from fast.models.simulation.mesh.solid import SolidMesh
from fast.models.simulation.output.fingers import FingerResult, sum_of_fingers
from fast.models.simulation.output.pressure import PressureGauge
from fast.models.simulation.output.recording import Camera, Phase, Recorder
from fast.models.simulation.output.twist import TwistGauge
from fast.models.simulation.placement import Side, check_overlap, check_reach, find_symmetry
from fast.models.simulation.problem import FingerProblem, Numerics, find_numerics
from fast.models.simulation.slopes.parameters import find_parameters
from fast.models.simulation.slopes.trace import find_slopes, plan_slopes
from fast.models.simulation.solver.newton import NewtonSolver
from fast.models.simulation.solver.stepping import (
    FingerRecord,
    Path,
    Step,
    Stepper,
    Walk,
    deadline_after,
    lift_step_mm,
    travel_to_touch,
)
from fast.models.simulation.version import SimulatorVersion, check_tier
from fast.models.traces import peak_force_n, work_j
from fast.models.traces.step_features import LIFT_MM
from fast.models.validation import check_type

__all__ = ["FingerProblem", "FingerResult", "Numerics", "compile_simulator", "simulate_finger", "simulate_grasp"]

SNAP = "snap"  # the flag of a grasp whose finger snapped in the lift and held on
RIM = "rim"  # the flag of a grasp whose pull hangs on edges that sink into the finger deeper than the mesh resolves
# Error of a trace per unresolved energy, both root mean square over the lift: 0.11 to 0.15 per mm where it is large.
ERROR_PER_MM = 0.14
RIM_ERROR_N = 0.5 * REFERENCE_MODULUS_MPA / 9.2  # expected error that is flagged: 0.5 N at 9.2 MPa
INWARD, UPWARD = np.array([-1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0])
FREE_STEPS = 2  # steps without contact before the end of the lift is considered
RESIDUAL_FORCE_N = 0.05  # at the reference modulus: what may be left of the force when the lift ends


def simulate_grasp(
    design: Design,
    obj: RigidObject,
    version: SimulatorVersion = SimulatorVersion(),  # noqa: B008 - frozen record
    setup: GraspSetup = GraspSetup(),  # noqa: B008 - frozen record
    *,
    placement: Placement = Placement(),  # noqa: B008 - frozen record
    context: GraspContext = GraspContext(),  # noqa: B008 - frozen record
    effects: Sequence[Effect] | None = None,
    mesh: SolidMesh | None = None,
    numerics: Numerics | None = None,
    deadline_s: float | None = None,
    recorder: Recorder | None = None,
    along: Sequence[str] | str = (),
) -> GraspSimulation:
    """Simulate one displacement-controlled grasp of a fixed rigid object.

    Each finger is solved alone: the object is fixed, so the fingers meet only through the mirror plane x = 0. What
    object and `placement` leave of the symmetry decides how much is solved (see `models.simulation.placement`): half a
    finger or its full width, one finger that counts twice or both. Forces are exactly proportional to E (see
    `models.simulation.body.elasticity`).

    `context` is what came before, for effects with a memory. `effects` default to those of the version. `mesh`
    replaces the mesh of the design (half width unless `needs_full_width`). `numerics` is for convergence studies
    and for worlds that must not share the simulator's regularisation; by default it is that of the version's tier.
    `deadline_s` is a wall-clock limit. `recorder` is called with every converged step (see
    `models.simulation.output.recording`). `along` names parameters by which the trace gets slopes (see
    `models.simulation.slopes.parameters`); a parameter whose slope cannot be had is told in `slopes.lost`.

    Raises:
        UsageError: an argument is of another type, the version's tier was removed, `mesh` is half a finger where that
            is not enough, or a parameter in `along` is unknown or has no slope.
        SimulationFailed: reason `object_outside`, `overlap_at_start`, `time_out`, `no_convergence`, `inverted_element`,
            `indefinite`, `deep_penetration` or `max_steps`.
        MeshingFailed: the mesh could not be made.
    """
    kinds = (
        (Design, design),
        (RigidObject, obj),
        (SimulatorVersion, version),
        (GraspSetup, setup),
        (Placement, placement),
    )
    for kind, given in kinds:
        check_type(given, kind, f"the {kind.__name__}")
    check_tier(version.tier)
    inputs = GraspInputs(design, obj, version, setup, placement, context, effects)
    wanted = find_parameters(inputs, along)
    compile_simulator()
    started = time.process_time()
    deadline = deadline_after(deadline_s)
    actual = inputs.with_effects()
    check_reach(actual.obj, placement, design, actual.setup)
    symmetry = find_symmetry(actual.obj, placement)
    has_own_mesh = mesh is not None
    if mesh is None:
        mesh = build_mesh(design, version.mesh, full_width=not symmetry.mirror_y, effects=actual.effects)
    if mesh.is_half and not symmetry.mirror_y:
        raise UsageError(
            f"half a finger is not enough for object {obj.object_id} at this placement; mesh it with full_width=True."
        )
    numerics = numerics or find_numerics(version)
    problem = FingerProblem(mesh, design, actual.theta, actual.setup, actual.effects, numerics)
    plan = plan_slopes(wanted, problem, inputs, has_own_mesh=has_own_mesh)
    solved = [_Finger.of(problem, actual.obj, placement, side) for side in symmetry.sides]
    check_overlap(actual.obj, placement, actual.setup, [finger.first_gap_mm() for finger in solved])
    ready = time.process_time()
    watch = _as_half_turned(recorder) if symmetry.is_only_half_turn else recorder
    keeps_steps = plan.has_copies
    fingers = [simulate_finger(f.problem, f.obstacle, deadline, watch, f.side, keeps_steps) for f in solved]
    result = replace(_result_of(fingers, problem), setup_cpu_s=ready - started + sum(f.setup_cpu_s for f in fingers))
    if wanted:

        def again(moved: GraspInputs) -> GraspSimulation:
            rest_s = None if deadline_s is None else max(deadline - time.monotonic(), 0.0)
            return simulate_grasp(
                moved.design,
                moved.obj,
                moved.version,
                moved.setup,
                placement=moved.placement,
                context=context,
                effects=effects,
                mesh=mesh if has_own_mesh else None,
                numerics=numerics,
                deadline_s=rest_s,
            )

        problems = [finger.problem for finger in solved]
        result = replace(result, slopes=find_slopes(plan, problems, fingers, result.trace, again, deadline))
    return replace(result, cpu_s=time.process_time() - started)


def simulate_inputs(inputs: GraspInputs, along: Sequence[str] | str = ()) -> GraspSimulation:
    """Simulate the grasp of these inputs; see `simulate_grasp`."""
    return simulate_grasp(
        inputs.design,
        inputs.obj,
        inputs.version,
        inputs.setup,
        placement=inputs.placement,
        context=inputs.context,
        effects=inputs.effects,
        along=along,
    )


def compile_simulator() -> None:
    """Have the simulator compiled on this computer; every simulation does."""
    compile_once(_compile_elsewhere)


def _compile_elsewhere() -> None:
    """Compile in a process of its own.

    A process that compiles has every kernel twice, alone and within those that call it, and may use either, which
    differ in the last bit. One that loads them uses the same as all others.
    """
    code = "from fast.models import kernels; kernels.is_compiler(); "
    code += f"from {__name__} import call_kernels; call_kernels()"
    if subprocess.run([sys.executable, "-c", code], check=False).returncode != 0:
        call_kernels()  # what is wrong is wrong here too, and is told


def call_kernels() -> None:
    """Call every kernel: one grasp with slopes does."""
    simulate_grasp(BEST_PUBLISHED, get_object(30), along=("friction", "closed_gap_mm"))


def _result_of(fingers: Sequence[FingerResult], problem: FingerProblem) -> GraspSimulation:
    """Return what the load cell sees of the solved fingers, and the work it took; without the time."""
    scale = problem.force_scale
    trace = sum_of_fingers(fingers, [f.force_n[:, 2] for f in fingers], scale)
    for effect in problem.effects:
        trace = effect.modify_trace(trace)
    contact = np.mean([-f.force_n[f.n_closing - 1, 0] for f in fingers])
    return GraspSimulation(
        trace=trace,
        peak_force_n=peak_force_n(trace),
        contact_force_n=float(contact) * scale,
        work_j=work_j(trace),
        n_steps=sum(f.n_steps for f in fingers),
        n_newton=sum(f.n_newton for f in fingers),
        n_dof=fingers[0].n_dof,
        cpu_s=0.0,
        n_factorisations=sum(f.n_factorisations for f in fingers),
        mesh_id=problem.mesh.mesh_id,
        flag=_flag_of(fingers),
        twist_deg=max(f.twist_deg for f in fingers),
        pressure_kpa=1e3 * scale * max(f.pressure_mpa for f in fingers),
        ribs_touch=any(f.ribs_touch for f in fingers),
    )


def _flag_of(fingers: Sequence[FingerResult]) -> str:
    """Tell why the force is not converged as others are, in one word; empty if it is."""
    if any(f.has_snapped for f in fingers):
        return SNAP
    # One finger that is solved counts twice.
    both_n = 2.0 * float(np.mean([f.mesh_error_n for f in fingers]))
    return RIM if both_n > RIM_ERROR_N else ""


def _as_half_turned(recorder: Recorder | None) -> Recorder | None:
    return None if recorder is None else lambda snapshot: recorder(replace(snapshot, is_half_turned=True))


@dataclass(frozen=True)
class _Finger:
    """One finger to solve, as it stands on the +x side: for the left one everything is seen in the mirror x = 0."""

    problem: FingerProblem
    obstacle: Obstacle
    side: Side

    @classmethod
    def of(cls, problem: FingerProblem, obj: RigidObject, placement: Placement, side: Side) -> Self:
        """Make the finger on a side at a placement; seen in the mirror, a roll is one the other way."""
        is_mirrored = side == "left"
        rolled = replace(problem, roll_deg=-placement.roll_deg if is_mirrored else placement.roll_deg)
        return cls(rolled, Obstacle.of(obj, placement, is_mirrored=is_mirrored), side)

    def first_gap_mm(self) -> float:
        """Return the least distance of the open finger from the object, < 0 inside; inf where their boxes are apart."""
        model = self.problem.model()
        nodes = model.nodes - 0.5 * self.problem.setup.open_gap_mm * INWARD
        if bounds(self.obstacle.primitives)[1][0] <= nodes[:, 0].min():
            return np.inf
        return model.surface.gap_mm(nodes, self.obstacle)


def simulate_finger(
    problem: FingerProblem,
    obstacle: Obstacle,
    deadline: float = np.inf,
    recorder: Recorder | None = None,
    side: Side = "right",
    keeps_steps: bool = False,
) -> FingerResult:
    """Close and lift one finger against an obstacle; `deadline` is a time of `time.monotonic`.

    `recorder` is called with every converged step; `side` names the finger in its snapshots. `keeps_steps`: for
    copies that go the same way.
    """
    started = time.process_time()
    model = problem.model()
    finger = model.against(obstacle, problem.finger_stop_mm)
    newton = NewtonSolver(model.workspace, problem.numerics.newton, deadline)
    stepper = Stepper(finger, newton, problem.numerics.limits, problem.friction)
    setup_cpu_s = time.process_time() - started
    camera = None
    if recorder is not None:
        scale = problem.force_scale
        camera = Camera(recorder, side, finger.body.mesh, finger.nodes, finger.surface, obstacle, scale)
    gauge = TwistGauge(problem.mesh, finger.nodes, problem.design.tip_height_mm)
    seen = _Observed(gauge, PressureGauge(finger.surface.areas, problem.mesh.is_half), camera, keeps_steps)
    _close_and_lift(finger, stepper, problem, seen)
    share = 2.0 if problem.mesh.is_half else 1.0
    return FingerResult(
        time_s=np.array(seen.record.time_s),
        lift_mm=np.array(seen.record.lift_mm),
        force_n=share * np.array(seen.record.force_n),
        n_closing=seen.n_closing,
        n_steps=stepper.n_steps,
        n_newton=newton.n_iterations,
        n_factorisations=newton.n_factorisations,
        n_dof=model.body.n_dof,
        setup_cpu_s=setup_cpu_s,
        has_snapped=seen.has_snapped,
        ribs_touch=stepper.finger.ribs_touch,
        twist_deg=gauge.largest_deg,
        pressure_mpa=seen.pressure.largest,
        mesh_error_n=share * seen.mesh_error_n,
        has_stalled=seen.has_stalled,
        walk=seen.walk,
    )


@dataclass
class _Observed:
    """What is noted of the converged steps of one finger."""

    gauge: TwistGauge
    """How far the tip has turned."""
    pressure: PressureGauge
    """Largest contact pressure so far, MPa."""
    camera: Camera | None
    """Keeps pictures of the finger; None where nobody asked for them."""
    keeps_steps: bool = False
    """Whether the steps are kept, for copies of the finger."""
    walk: Walk | None = None
    """The steps, if they are kept."""
    record: FingerRecord = field(default_factory=FingerRecord)
    """Samples of the closing, then of the lift."""
    n_closing: int = 0
    """Samples that belong to the closing."""
    has_snapped: bool = False
    """A step let the finger jump to another equilibrium."""
    has_stalled: bool = False
    """The jaws stopped before they had closed."""
    unresolved_n_mm: list[float] = field(default_factory=list)
    """What the mesh does not resolve of the contact, step by step."""

    @property
    def mesh_error_n(self) -> float:
        """Expected error of the force on the meshed body by its mesh, root mean square over the lift."""
        lift_mm = self.record.lift_mm[self.n_closing :]
        squares = np.trapezoid(np.square(self.unresolved_n_mm), lift_mm)
        return ERROR_PER_MM * float(np.sqrt(squares / LIFT_MM))

    def look(self, phase: Phase, time_s: float, travel_mm: float, state: FingerState, clamp_n: np.ndarray) -> None:
        """Note twist and picture of an instant."""
        self.gauge.add(state.x)
        if self.camera is not None:
            self.camera.take(phase, time_s, travel_mm, state, clamp_n)

    def add(self, phase: Phase, time_s: float, travel_mm: float, step: Step) -> None:
        """Add a converged step: its force and pressure too."""
        if self.walk is not None:
            steps = self.walk.lift if phase == "lift" else self.walk.closing
            steps.append((len(self.record.time_s), step))
        self.pressure.add(step.state.contact)
        self.record.add(time_s, travel_mm if phase == "lift" else 0.0, step.clamp_n)
        if phase == "lift":
            self.unresolved_n_mm.append(step.state.contact.unresolved_n_mm)
        self.look(phase, time_s, travel_mm, step.state, step.clamp_n)


def _close_and_lift(finger: FingerStep, stepper: Stepper, problem: FingerProblem, seen: _Observed) -> None:
    """Walk the finger through the whole grasp, and note every step."""
    state = _close(finger, stepper, problem, seen)
    seen.n_closing = len(seen.record.time_s)
    setup, limits = problem.setup, problem.numerics.limits
    start_s = problem.stroke_mm / setup.close_speed_mm_per_s + setup.dwell_s
    lift = Path(
        state.base,
        UPWARD,
        setup.max_lift_mm,
        setup.lift_speed_mm_per_s,
        lift_step_mm(limits),
        limits.first_lift_mm,
        limits.event_mm,
    )
    n_free = 0
    for step in stepper.walk(state, lift):
        seen.has_snapped |= step.is_snap
        seen.add("lift", start_s + step.travel_mm / setup.lift_speed_mm_per_s, step.travel_mm, step)
        n_free = 0 if finger.is_touching(step.state) else n_free + 1
        is_slack = abs(step.clamp_n[2]) < RESIDUAL_FORCE_N
        if n_free >= FREE_STEPS and is_slack and _is_clear(finger, lift, step.travel_mm):
            break


def _close(finger: FingerStep, stepper: Stepper, problem: FingerProblem, seen: _Observed) -> FingerState:
    """Walk the finger through the closing, and note every step; return the state at its end, at rest."""
    setup, record, no_force = problem.setup, seen.record, np.zeros(3)
    record.add(0.0, 0.0, no_force)
    start, stroke = 0.5 * setup.open_gap_mm * -INWARD, problem.stroke_mm
    free = travel_to_touch(finger.distance_to_anything, start, INWARD, stroke)
    state = finger.undeformed(start + free * INWARD, setup.close_speed_mm_per_s * INWARD)
    touch_s, end_s = free / setup.close_speed_mm_per_s, stroke / setup.close_speed_mm_per_s
    if free > 0.0:
        record.add(touch_s, 0.0, no_force)
    if seen.keeps_steps:
        seen.walk = Walk(finger, state)
    seen.look("closing", touch_s, free, state, no_force)
    stall = ClosingStall(problem.jaw, stroke - free, problem.numerics.limits.closing_mm)
    closing = Path(state.base, INWARD, stroke - free, setup.close_speed_mm_per_s, stall.longest_step_mm)
    for step in stepper.walk(state, closing):
        state = step.state
        seen.add("closing", touch_s + step.travel_mm / setup.close_speed_mm_per_s, free + step.travel_mm, step)
        if stall.has_stalled(step):
            seen.has_stalled = True
            break
    state.v[:] = 0.0
    if seen.walk is not None:
        seen.walk.rest = len(record.time_s) - 1, stepper.finger, state, record.force_n[-1]
    if record.time_s[-1] < end_s - 1e-9:
        record.repeat_until(end_s)
    if setup.dwell_s > 0.0:  # quasi-static: nothing happens
        record.repeat_until(end_s + setup.dwell_s)
    return state


def _is_clear(finger: FingerStep, lift: Path, travel: float) -> bool:
    """Return whether the undeformed finger meets nothing during the rest of the lift."""
    rest = lift.length_mm - travel
    free = travel_to_touch(finger.distance_to_object, lift.at(travel), UPWARD, rest)
    return free >= rest
