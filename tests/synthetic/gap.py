"""A made-up gap problem with a known answer: closed-form grasps whose effects have made-up but sensible physics.

A part that friction holds from the start of the lift and a normal part that pushes or draws late, so that traces tell
friction from modulus and their peaks hardly do: the structure of the simulator's own traces. Tools and objects make the
shape of a grasp through their designs and numbers, so that what is learnt of some speaks of others. Effects of cost P
and those with a memory are the catalogue's own.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np

from fast.models.design.space import numbered_design, to_unit
from fast.models.gap.ask.answers import Answers
from fast.models.gap.ask.predict import Pair, make_grasps
from fast.models.gap.bank.bank import (
    DEEPER_MM,
    NUMERICAL,
    WIDE,
    WIDER_MM,
    Bank,
    BankPlan,
    EffectRuns,
)
from fast.models.gap.bank.sensor_effects import read_lead
from fast.models.gap.data import GapData
from fast.models.gap.grasps import Cells, Grasps, of_one_setup
from fast.models.records import Design, EffectValue, GraspContext, GraspSetup, Theta, Trace
from fast.models.simulation.effects.catalogue import CATALOGUE, build_effects
from fast.models.traces.step_features import N_STEPS, step_means
from fast.models.traces.step_noise import SensorNoise
from tests.synthetic.simulation import replayed

OBJECTS = (1, 3, 6, 10, 14, 21, 22, 25, 28, 30, 32, 34)
SETUP = GraspSetup()
_LIFT_MM = np.linspace(0.0, 60.0, 241)
_GRASP_S = 40.0  # from one grasp to the next
_REFERENCE_MPA = 0.05

Parameters = Mapping[str, float]
Hidden = Mapping[str, Parameters]
# Of a trace, a design, an object's number, what came before the grasp, and how it is made.
Sense = Callable[[Trace, Design, int, GraspContext, GraspSetup], Trace]


@dataclass(frozen=True)
class GapTruth:
    """What made-up measurements hide; scatters are relative.

    mesh: how far the truth is from the simulator's mesh, in units of the bank's other meshes. unlisted: made-up laws
    that no catalogue has, as `made_up_trace` takes them. sense: what the load cell reports of a trace, by another law.
    """

    theta: Theta = Theta(young_modulus_mpa=9.2, friction=0.66, poisson_ratio=0.43)
    effects: tuple[EffectValue, ...] = ()
    tool_sd: float = 0.04
    cell_sd: float = 0.015
    repeat_sd: float = 0.01
    mesh: float = 0.7
    noise: SensorNoise = SensorNoise(sd_n=0.12, correlation_s=0.05, rate_hz=80.0)
    unlisted: Hidden = field(default_factory=dict)
    sense: Sense | None = None


def made_up_gap(
    n_tools: int,
    n_objects: int,
    seed: int,
    truth: GapTruth = GapTruth(),
    *,
    n_repeats: int = 3,
    held_out: tuple[int, int] = (0, 0),
) -> GapData:
    """A problem of numbered designs on the first of `OBJECTS`; the last `held_out` tools and objects are held out."""
    rng = np.random.default_rng(seed)
    designs = tuple(numbered_design(number) for number in range(n_tools))
    objects = OBJECTS[:n_objects]
    shapes = _shapes(designs, objects)
    tool, obj, contexts = _order(rng, n_tools, n_objects, n_repeats)
    scatter = _draw_scatter(rng, (n_tools, n_objects), truth)
    made = [(*one, SETUP) for one in zip(tool, obj, contexts, strict=True)]
    steps_n = _measured(rng, shapes, designs, truth, scatter, made)
    grasps = Grasps(
        tools=tuple(f"T{number}" for number in range(n_tools)),
        designs=designs,
        objects=objects,
        tool=tool,
        obj=obj,
        contexts=contexts,
        steps_n=steps_n,
        grasp_ids=tuple(f"g{number}" for number in range(len(tool))),
        noise=truth.noise,
        **of_one_setup(len(tool)),
    )
    tools, objs = (np.arange(n) >= n - left for n, left in zip((n_tools, n_objects), held_out, strict=True))
    return GapData(grasps, _bank_of(designs, objects), tools, objs)


def made_up_answers(data: GapData, seed: int, truth: GapTruth, experiments: Mapping[Pair, int]) -> Answers:
    """What pairs of grasps, so many of each, give on the bench on which `made_up_gap` measured with this seed.

    Of settings, speeds, dwell, gap and tip height count.
    """
    grasps, rng = data.grasps, np.random.default_rng(seed)
    n_repeats = max(context.repeat for context in grasps.contexts) + 1
    shape = (len(grasps.tools), len(grasps.objects))
    _order(rng, *shape, n_repeats)
    scatter = _draw_scatter(rng, shape, truth)
    pairs = [pair for pair, n in experiments.items() for _ in range(n)]
    asked = make_grasps(grasps, pairs)
    setups = [asked.setups[number] for number in asked.setup]
    made = list(zip(asked.tool, asked.obj, asked.contexts, setups, strict=True))
    rng = np.random.default_rng([seed, 22])
    steps_n = _measured(rng, _shapes(grasps.designs, grasps.objects), grasps.designs, truth, scatter, made)
    rows = np.arange(len(pairs))
    return Answers(replace(asked, steps_n=steps_n), np.stack([rows, rows + len(pairs)], axis=1))


@lru_cache(maxsize=8)
def _bank_of(designs: tuple[Design, ...], objects: tuple[int, ...]) -> Bank:
    """The same for every truth, so made once; nobody may write into it."""
    return made_up_bank(objects, _shapes(designs, objects))


def made_up_bank(objects: Sequence[int], shapes: np.ndarray, plan: BankPlan = WIDE) -> Bank:
    """A bank of grasps of these shapes (t x o x 4), as `models.gap.bank.bank` asks for it."""
    centre, grid = plan.centre, plan.grid_thetas
    effects = {
        name: EffectRuns(
            name,
            plan.list_amplitudes(name),
            np.stack([_steps(shapes, centre, {name: _whole(name, row)}) for row in plan.list_amplitudes(name)], axis=2),
        )
        for name in plan.effects
        if CATALOGUE[name].bank_runs and name in _MADE_UP
    }
    return Bank(
        targets=Cells.full([], objects, GraspSetup()).targets,
        centre=centre,
        grid=np.array(plan.grid.points),
        grid_steps_n=np.stack([_steps(shapes, theta) for theta in grid], axis=2),
        grid_lead_n=np.stack([_leads(shapes, theta) for theta in grid], axis=2),
        centre_steps_n=_steps(shapes, centre),
        numerical_steps_n=np.stack([_steps(shapes, centre, mesh=row) for row in np.eye(len(NUMERICAL))], axis=2),
        placed_steps_n=np.stack([_steps(shapes, centre, late_mm=deeper) for deeper in DEEPER_MM], axis=2),
        wider_steps_n=np.stack([_steps(shapes, centre, wider_mm=wider) for wider in WIDER_MM], axis=2),
        effects=effects,
    )


def made_up_steps(data: GapData, theta: Theta, hidden: Hidden) -> np.ndarray:
    """What the made-up simulator says of every grasp at theta and with effects of cost C and F, n x 120."""
    whole = {name: _whole(name, parameters) for name, parameters in hidden.items()}
    shapes = _shapes(data.grasps.designs, data.grasps.objects)
    return np.asarray(_steps(shapes, theta, whole)[data.grasps.tool, data.grasps.obj])


def with_bank(data: GapData, plan: BankPlan) -> GapData:
    """The same grasps with another bank."""
    return replace(
        data, bank=made_up_bank(data.grasps.objects, _shapes(data.grasps.designs, data.grasps.objects), plan)
    )


def made_up_trace(
    shape: np.ndarray,
    theta: Theta,
    hidden: Hidden | None = None,
    *,
    wider_mm: float = 0.0,
    late_mm: float = 0.0,
    mesh: np.ndarray | None = None,
) -> Trace:
    """Lift of a made-up grasp: `shape` (4) in the unit cube is what tool and object make of it.

    hidden: effects of cost C and F with all their parameters. late_mm: how much deeper the tips stand, by which all
    forces come later. mesh: shares of the numerical errors, one for each variant of a bank; the last is a ripple.
    """
    known = hidden or {}
    errors = np.zeros(len(NUMERICAL)) if mesh is None else mesh
    ratio, z, length = theta.poisson_ratio, _LIFT_MM, 30.0 + 20.0 * shape[1]
    stiffness = theta.young_modulus_mpa / 10.0 * (4.0 + 16.0 * shape[0]) * (1.0 + 0.5 * (ratio - 0.35))
    stiffness *= (1.0 - 0.08 * (0.5 + shape[3]) * wider_mm) * (1.0 + 0.04 * errors[0] * (shape[2] - 0.3))
    stiffness /= 1.0 - ratio**2
    stiffness *= _closed_share(stiffness, shape, known)
    friction = theta.friction * _friction_factor(stiffness, shape, known)
    hold = np.clip(1.0 - z / length, 0.0, None) ** (0.3 + shape[2] + 0.03 * errors[1])
    late = (z - 0.7 * length - 0.5 * errors[2]) / 6.0
    push = np.exp(-(late**2)) * (0.5 + ratio) - 0.3 * (1.0 - 2 * shape[3]) * np.exp(-z / 5.0)
    force = stiffness * hold * friction / (0.6 + friction) - 0.3 * stiffness * push * (z < length)
    force = force * (1.0 + 0.01 * errors[3] * np.sin(3.0 * z + 6.0 * shape[2]))
    if "shear_adhesion" in known:
        area_mm2 = 500.0 * (0.3 + shape[1]) * np.sqrt(np.clip(1.0 - z / length, 0.0, None))
        force = force + known["shear_adhesion"]["shear_strength_mpa"] * area_mm2
    if "object_edge_radius" in known:
        worn = 0.5 * known["object_edge_radius"]["extra_radius_mm"] * (0.2 + shape[3])
        force = force * (1.0 - np.clip(worn, -0.5, 0.9) * np.exp(-(((z - length) / 6.0) ** 2)))
    return Trace(z / 5.0, z, np.interp(z - late_mm, z, force) if late_mm else force)


_MADE_UP = frozenset(
    {
        "wall_thickness_offset",
        "static_kinetic_friction",
        "pressure_dependent_friction",
        "shear_adhesion",
        "object_edge_radius",
        "base_compliance",
        "force_limited_closing",
    }
)


def _closed_share(stiffness: float, shape: np.ndarray, hidden: Hidden) -> float:
    """What is left of the stiffness by thicker walls, a base that gives way and jaws that stall."""
    share = 1.0
    if "wall_thickness_offset" in hidden:
        share *= (1.0 + hidden["wall_thickness_offset"]["offset_mm"] / (2.0 + shape[0])) ** (2.0 + shape[2])
    closing_n = 0.4 * stiffness * share * (0.5 + shape[2])
    if "base_compliance" in hidden:
        share /= 1.0 + hidden["base_compliance"]["compliance_mm_per_n"] * closing_n / 1.5
    if "force_limited_closing" in hidden:
        share *= min(1.0, hidden["force_limited_closing"]["max_force_n"] / closing_n)
    return share


def _friction_factor(stiffness: float, shape: np.ndarray, hidden: Hidden) -> np.ndarray | float:
    """Factor on friction over the lift, from slip (a third of the lift) and pressure."""
    factor: np.ndarray | float = 1.0
    if "static_kinetic_friction" in hidden:
        law = hidden["static_kinetic_friction"]
        slip_mm = _LIFT_MM / 3.0 * (0.5 + shape[1])
        factor = law["kinetic_ratio"] + (1.0 - law["kinetic_ratio"]) * np.exp(-slip_mm / law["slip_scale_mm"])
    if "rational_friction" in hidden:
        law = hidden["rational_friction"]
        slip_mm = _LIFT_MM / 3.0 * (0.5 + shape[1])
        factor = law["kinetic_ratio"] + (1.0 - law["kinetic_ratio"]) / (1.0 + slip_mm / law["slip_scale_mm"])
    if "pressure_dependent_friction" in hidden:
        law = hidden["pressure_dependent_friction"]
        pressure_mpa = stiffness * (0.5 + shape[2]) / 300.0
        factor = factor * (pressure_mpa / law["reference_mpa"]) ** -law["exponent"]
    return factor


def _whole(effect: str, parameters: Parameters) -> Parameters:
    return CATALOGUE[effect].neutral.parameters | dict(parameters)


def _shapes(designs: Sequence[Design], objects: Sequence[int]) -> np.ndarray:
    """Shapes of grasps, t x o x 4 in the unit cube: what designs do, what objects do, and a little of both."""
    unit = to_unit(designs) - 0.5
    weights = np.random.default_rng(1).standard_normal((4, unit.shape[1])) * 1.2
    weights[0, 4:7] = 2.0  # thick walls are stiff
    own = np.array([np.random.default_rng([2, number]).standard_normal(4) for number in objects])
    by_tool = unit @ weights.T
    both = by_tool[:, None] + own[None] + 0.4 * by_tool[:, None] * own[None]
    return np.asarray(1.0 / (1.0 + np.exp(-both)))


def _steps(
    shapes: np.ndarray,
    theta: Theta,
    hidden: Hidden | None = None,
    *,
    wider_mm: float = 0.0,
    late_mm: float = 0.0,
    mesh: np.ndarray | None = None,
) -> np.ndarray:
    """Step means (t x o x 120) of grasps of shapes (t x o x 4)."""
    traces = (
        made_up_trace(shape, theta, hidden, wider_mm=wider_mm, late_mm=late_mm, mesh=mesh)
        for shape in shapes.reshape(-1, shapes.shape[-1])
    )
    steps = [step_means(trace) for trace in traces]
    return np.array(steps).reshape(*shapes.shape[:-1], N_STEPS)


def _leads(shapes: np.ndarray, theta: Theta) -> np.ndarray:
    """What is before the lift, t x o x 12: made-up grasps hold."""
    leads = [read_lead(made_up_trace(shape, theta), GraspSetup()) for shape in shapes.reshape(-1, shapes.shape[-1])]
    return np.array(leads).reshape(*shapes.shape[:-1], -1)


def _order(
    rng: np.random.Generator, n_tools: int, n_objects: int, n_repeats: int
) -> tuple[np.ndarray, np.ndarray, tuple[GraspContext, ...]]:
    """Tools one after the other, objects in random order, repeats in a row."""
    tool: list[int] = []
    obj: list[int] = []
    contexts: list[GraspContext] = []
    for t in range(n_tools):
        for place, o in enumerate(rng.permutation(n_objects)):
            for repeat in range(n_repeats):
                in_tool, in_batch = place * n_repeats + repeat, len(tool)
                tool.append(t)
                obj.append(o)
                context = GraspContext(
                    repeat=repeat, tool_grasps=in_tool, batch_grasps=in_batch, clock_s=_GRASP_S * in_batch
                )
                contexts.append(context)
    return np.array(tool), np.array(obj), tuple(contexts)


def _draw_scatter(rng: np.random.Generator, shape: tuple[int, int], truth: GapTruth) -> tuple[np.ndarray, np.ndarray]:
    """What tools and cells differ by: factors on moduli (t), and offsets relative to the peak, t x o x 120."""
    tool_factor = np.exp(truth.tool_sd * rng.standard_normal(shape[0]))
    draws = rng.standard_normal((*shape, 5))
    phase = np.linspace(0.0, np.pi, N_STEPS) * np.arange(5)[:, None]
    return tool_factor, truth.cell_sd * draws @ np.cos(phase) / np.sqrt(3.0)


def _measured(
    rng: np.random.Generator,
    shapes: np.ndarray,
    designs: Sequence[Design],
    truth: GapTruth,
    scatter: tuple[np.ndarray, np.ndarray],
    made: Sequence[tuple[int, int, GraspContext, GraspSetup]],
) -> np.ndarray:
    """Noisy step means of the truth, n x 120."""
    tool_factor, offsets = scatter
    mesh = truth.mesh * np.array([0.8, -0.6, 0.7, 0.5])
    rows = []
    for at_tool, at_obj, context, setup in made:
        covariance = truth.noise.step_covariance(N_STEPS, setup.lift_speed_mm_per_s)
        root = _find_root(covariance.tobytes())
        own = (float(tool_factor[at_tool]), mesh)
        trace = _true_trace(shapes[at_tool, at_obj], designs[at_tool], truth, context, setup, own)
        if truth.sense is not None:
            trace = truth.sense(trace, designs[at_tool], OBJECTS[at_obj], context, setup)
        steps = step_means(trace)
        steps = steps + np.abs(steps).max() * offsets[at_tool, at_obj]
        steps = steps * np.exp(truth.repeat_sd * rng.standard_normal())
        rows.append(steps + root @ rng.standard_normal(N_STEPS))
    return np.array(rows)


@lru_cache(maxsize=16)
def _find_root(covariance: bytes) -> np.ndarray:
    matrix = np.frombuffer(covariance).reshape(N_STEPS, N_STEPS)
    return np.linalg.cholesky(matrix + 1e-12 * np.eye(N_STEPS))


def _true_trace(
    shape: np.ndarray,
    design: Design,
    truth: GapTruth,
    context: GraspContext,
    setup: GraspSetup,
    scatter: tuple[float, np.ndarray],
) -> Trace:
    """The trace of one grasp with all that is hidden, free of noise; scatter: factor on the modulus, and mesh."""
    theta = truth.theta
    listed = {row.effect: _whole(row.effect, row.parameters) for row in truth.effects if row.effect in _MADE_UP}
    made_up = {**listed, **truth.unlisted}
    built = build_effects([value for value in truth.effects if value.effect not in _MADE_UP])
    effects = [effect.in_grasp(design, setup, context) for effect in built]
    wider_mm, worn = setup.closed_gap_mm - SETUP.closed_gap_mm, 1.0
    for effect in effects:
        wider_mm += effect.modify_setup(setup, design).closed_gap_mm - setup.closed_gap_mm
        worn *= float(effect.friction_factor(np.zeros(1), np.full(1, _REFERENCE_MPA)))
    factor, mesh = scatter
    real = theta.model_copy(
        update={"friction": theta.friction * worn, "young_modulus_mpa": theta.young_modulus_mpa * factor}
    )
    late_mm = setup.tip_below_mm - SETUP.tip_below_mm
    trace = _timed(made_up_trace(shape, real, made_up, wider_mm=wider_mm, late_mm=late_mm, mesh=mesh), setup)
    return replayed(trace, effects, design, real)


def _timed(trace: Trace, setup: GraspSetup) -> Trace:
    """A lift at the setup's speed; a dwell is a hold before it."""
    time_s = setup.dwell_s + trace.lift_mm / setup.lift_speed_mm_per_s
    if setup.dwell_s == 0.0:
        return Trace(time_s, trace.lift_mm, trace.force_n)
    held = np.zeros(1)
    return Trace(
        np.concatenate([held, time_s]),
        np.concatenate([held, trace.lift_mm]),
        np.append(trace.force_n[0], trace.force_n),
    )
