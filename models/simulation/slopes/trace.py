"""From copies of fingers to slopes of a trace: what is moved for each parameter, and what the load cell sees of it."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from fast.models.errors import MeshingFailed, SimulationFailed
from fast.models.records import GraspSimulation, Slope, Slopes, Trace
from fast.models.simulation.effects.base import Effect
from fast.models.simulation.inputs import GraspInputs
from fast.models.simulation.mesh.build import build_moved_mesh, printed_profile
from fast.models.simulation.output.fingers import FingerResult, sum_of_fingers
from fast.models.simulation.problem import FingerProblem
from fast.models.simulation.slopes.march import Copies
from fast.models.simulation.slopes.parameters import Parameter
from fast.models.simulation.solver.stepping import LOCATED

JUMP_SHARE = 0.05  # of the largest pull: what is lost of it in one place of the lift, at least, is a jump
MARGIN_MM = 1.0  # from the first jump: a parameter may move it

Moved = Mapping[str, tuple[float, FingerProblem]]


@dataclass(frozen=True)
class SlopesPlan:
    """What is done for the slopes by each parameter.

    `moved`: the change of a parameter and the problem with it; those in `carried` need a copy that walks along, the
    others act on the closing, on the modulus of the whole or on the finished trace. `finite`: those for which grasps of
    their own are simulated. `lost`: why one has none.
    """

    parameters: Mapping[str, Parameter]
    moved: Moved
    carried: Moved
    finite: tuple[str, ...]
    lost: Mapping[str, str]
    closes_further: bool

    @property
    def has_copies(self) -> bool:
        """Whether copies of the fingers go their way."""
        return bool(self.carried) or self.closes_further

    def walk_copies(
        self, finger: FingerResult, problem: FingerProblem, until_mm: float, deadline: float
    ) -> tuple[dict[str, np.ndarray], dict[str, str]]:
        """Walk copies of one finger: slopes (n, 3) of its force by name, up to a lift, and why copies were given up."""
        if finger.walk is None:
            return {}, {}
        rolled = {
            name: (change, replace(own, roll_deg=problem.roll_deg)) for name, (change, own) in self.carried.items()
        }
        copies = Copies(finger.walk.finger, problem, rolled, closes_further=self.closes_further, deadline=deadline)
        slopes_n = copies.walk(finger.walk, len(finger.time_s), until_mm)
        share = 2.0 if problem.mesh.is_half else 1.0
        return {name: share * values for name, values in slopes_n.items()}, copies.failures


def plan_slopes(
    parameters: Mapping[str, Parameter], problem: FingerProblem, inputs: GraspInputs, *, has_own_mesh: bool
) -> SlopesPlan:
    """Plan what to do for the slopes by these parameters; `problem` is the grasp's, whose mesh may be its own."""
    moved: dict[str, tuple[float, FingerProblem]] = {}
    finite, lost = [name for name, parameter in parameters.items() if parameter.is_finite], {}
    for name, parameter in parameters.items():
        if parameter.is_finite:
            continue
        own = _moved_problem(parameter, problem, inputs, has_own_mesh)
        if own is not None:
            moved[name] = parameter.small, own
        elif has_own_mesh:
            lost[name] = "the mesh that was given cannot be moved with it"
        else:
            finite.append(name)
    carried = {name: moved[name] for name in moved if parameters[name].is_carried}
    closes_further = any(_moves_closing(problem, own) for _, own in moved.values())
    return SlopesPlan(parameters, moved, carried, tuple(finite), lost, closes_further)


def _moved_problem(
    parameter: Parameter, problem: FingerProblem, inputs: GraspInputs, has_own_mesh: bool
) -> FingerProblem | None:
    """Return the problem with a parameter moved a little, on the same elements; None if they cannot be had."""
    asked = parameter.put(parameter.value + parameter.small)
    actual = asked.with_effects()
    mesh = problem.mesh
    if asked.design != inputs.design or _shapes(actual.effects) != _shapes(problem.effects):
        if has_own_mesh:
            return None
        settings = inputs.version.mesh
        before = printed_profile(inputs.design, settings, problem.effects)
        found = build_moved_mesh(mesh, before, asked.design, settings, actual.effects)
        if found is None:
            return None
        mesh = found
    return replace(
        problem, mesh=mesh, design=asked.design, theta=actual.theta, setup=actual.setup, effects=actual.effects
    )


def _moves_closing(problem: FingerProblem, moved: FingerProblem) -> bool:
    """Return whether closing may end elsewhere with a parameter moved: its jaw differs, or gives way to any force."""
    return moved.jaw != problem.jaw or moved.stroke_mm != problem.stroke_mm or not problem.jaw.is_rigid


def _shapes(effects: Sequence[Effect]) -> list[Effect]:
    """Return those that change what is meshed."""
    return [effect for effect in effects if effect.overrides("modify_profile", "modify_section")]


def find_slopes(
    plan: SlopesPlan,
    problems: Sequence[FingerProblem],
    fingers: Sequence[FingerResult],
    trace: Trace,
    again: Callable[[GraspInputs], GraspSimulation],
    deadline: float = np.inf,
) -> Slopes:
    """Find the slopes of a grasp's trace, from copies of its fingers, and from grasps simulated `again`.

    Copies go as far as their slopes are good or the force has its peak. `deadline` is a time of `time.monotonic`.
    """
    problem, lift_mm = problems[0], trace.lift_mm
    raw = sum_of_fingers(fingers, [f.force_n[:, 2] for f in fingers], problem.force_scale)
    event_mm = problem.numerics.limits.event_mm
    jump_mm = min((first_jump_mm(f, event_mm) for f in fingers), default=np.inf)
    trusted_mm = min(max(jump_mm - MARGIN_MM, 0.0), float(lift_mm[-1]))
    until_mm = max(trusted_mm, float(lift_mm[_at_peak(trace)]))
    walked = [plan.walk_copies(f, own, until_mm, deadline) for f, own in zip(fingers, problems, strict=True)]
    lost = dict(plan.lost)
    by = {}
    for name, parameter in plan.parameters.items():
        needed = [name]
        if name in plan.moved and _moves_closing(problem, plan.moved[name][1]):
            needed.append(Copies.CLOSER)
        failure = next((why[own] for _, why in walked for own in needed if own in why), lost.get(name))
        if failure is not None:
            lost[name] = failure
        elif name in plan.finite:
            try:
                by[name] = _finite_slope(parameter, trace, again)
            except (SimulationFailed, MeshingFailed) as error:
                lost[name] = f"its finite step cannot be simulated: {error}"
        else:
            change, own = plan.moved[name]
            pulls_n = [
                _pull_slope(f, slopes_n, problem, change, own, name)
                for f, (slopes_n, _) in zip(fingers, walked, strict=True)
            ]
            per_unit = sum_of_fingers(fingers, pulls_n, problem.force_scale).force_n
            per_unit = per_unit + raw.force_n * (own.force_scale / problem.force_scale - 1.0) / change
            by[name] = _slope_of(parameter, *_see(raw, trace, per_unit, change, own.effects))
    return Slopes(trusted_mm, by, lost)


def _pull_slope(
    finger: FingerResult,
    slopes_n: Mapping[str, np.ndarray],
    problem: FingerProblem,
    change: float,
    moved: FingerProblem,
    name: str,
) -> np.ndarray:
    """Compute slope (n) of one finger's pull at the reference modulus: its copy's, and that of where closing ends.

    `slopes_n` (n, 3) are those of the copies; one of the `problem` moved by `change` of the parameter `name`.

    A jaw of stroke S and compliance C stops after a way s with s + C N = S, or where the closing force N is the largest
    that it has: the derivatives of these two say how s moves with the parameter.
    """
    own_n, closer = slopes_n.get(name, np.zeros(finger.force_n.shape)), slopes_n.get(Copies.CLOSER)
    if closer is None or not _moves_closing(problem, moved):
        return own_n[:, 2]
    share = 2.0 if problem.mesh.is_half else 1.0
    last = finger.n_closing - 1
    force_n, by_own, by_way = (-values[last, 0] / share for values in (finger.force_n, own_n, closer))
    jaw, other = problem.jaw, moved.jaw
    if finger.has_stalled and np.isfinite(jaw.max_force_n) and force_n > 0.99 * jaw.max_force_n:
        further_mm = ((other.max_force_n - jaw.max_force_n) / change - by_own) / by_way
    else:
        given = (moved.stroke_mm - problem.stroke_mm) / change
        given -= force_n * (other.compliance_mm_per_n - jaw.compliance_mm_per_n) / change
        compliance = jaw.compliance_mm_per_n
        further_mm = (given - compliance * by_own) / (1.0 + compliance * by_way)
    return np.asarray(own_n[:, 2] + further_mm * closer[:, 2])


def _see(
    raw: Trace, trace: Trace, per_unit: np.ndarray, change: float, effects: Sequence[Effect]
) -> tuple[np.ndarray, float]:
    """Return slopes of the trace (n) as the effects make it, and of its peak, from that (m) of the force before them.

    The peak of a trace that comes later is the same peak, at another sample.
    """
    if not any(effect.acts_on_traces() for effect in effects):
        return per_unit, float(per_unit[_at_peak(trace)])
    moved = Trace(raw.time_s, raw.lift_mm, raw.force_n + change * np.nan_to_num(per_unit))
    for effect in effects:
        moved = effect.modify_trace(moved)
    slope = (np.interp(trace.time_s, moved.time_s, moved.force_n) - trace.force_n) / change
    known_s = raw.time_s[np.isfinite(per_unit)][-1]
    peak_n = float(moved.force_n[_at_peak(moved)] - trace.force_n[_at_peak(trace)]) / change
    return np.where(trace.time_s <= known_s, slope, np.nan), peak_n


def _finite_slope(parameter: Parameter, trace: Trace, again: Callable[[GraspInputs], GraspSimulation]) -> Slope:
    """Take the central difference of two own grasps; to one side where the other is out of the parameter's range."""
    step = parameter.finite
    below = parameter.value if parameter.is_at_limit else parameter.value - step
    low, high = again(parameter.put(below)), again(parameter.put(parameter.value + step))
    width = parameter.value + step - below
    forces = [np.interp(trace.time_s, one.trace.time_s, one.trace.force_n, right=0.0) for one in (low, high)]
    peak_n = (high.peak_force_n - low.peak_force_n) / width
    return _slope_of(parameter, (forces[1] - forces[0]) / width, peak_n, abs(step))


def _slope_of(parameter: Parameter, force_n: np.ndarray, peak_n: float, step: float | None = None) -> Slope:
    """Return the slope by a parameter; 0 without a sign."""
    return Slope(parameter.unit, force_n + 0.0, float(peak_n) + 0.0, parameter.usual, step)


def _at_peak(trace: Trace) -> int:
    return int(np.argmax(np.where(trace.is_lift, trace.force_n, -np.inf)))


def first_jump_mm(finger: FingerResult, event_mm: float) -> float:
    """Find the lift of the first jump of a finger's pull; infinite where there is none."""
    lift_mm, pull_n = finger.lift_mm[finger.n_closing - 1 :], finger.force_n[finger.n_closing - 1 :, 2]
    if len(pull_n) < 2:
        return np.inf
    is_short = np.diff(lift_mm) < (LOCATED + 0.01) * event_mm
    is_jump = is_short & (np.abs(np.diff(pull_n)) > JUMP_SHARE * pull_n.max())
    return float(lift_mm[1:][is_jump].min(initial=np.inf))
