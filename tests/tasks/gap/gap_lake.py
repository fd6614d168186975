"""A small lake to find a gap in: closed forms for tools at a hidden theta and for the whole bank, no physics run."""

from collections.abc import Collection, Sequence
from functools import cache
from pathlib import Path

import numpy as np

from fast.lake.store import Lake
from fast.lake.tables.campaign import (
    DesignRow,
    GraspRow,
    SimTraceRow,
    SimulationRow,
    SimulatorVersionRow,
)
from fast.lake.tables.requests import setup_columns
from fast.lake.tables.row import Row
from fast.models.design.space import numbered_design, to_unit
from fast.models.gap.bank.bank import NUMERICAL
from fast.models.gap.grasps import Cells
from fast.models.records import Design, EffectValue, GraspContext, GraspRequest, GraspSetup, Theta, Trace
from fast.models.simulation.effects.catalogue import CATALOGUE, build_effects
from fast.models.simulation.version import SimulatorVersion
from fast.tasks.gap.bank import plan_bank
from fast.tasks.simulation.plan import SimulationPlan
from tests.synthetic.gap import made_up_trace
from tests.tasks.calibration.trace_lake import PROVENANCE, grasp_rows

BASE, SETUP = SimulatorVersion(), GraspSetup()
DESIGNS = [numbered_design(number) for number in range(8)]
OBJECTS = (4, 7, 14, 18, 24, 30)
N_REPEATS = 2
TRUTH = Theta(young_modulus_mpa=9.2, friction=0.66, poisson_ratio=0.43)
_SIMPLE = ("rib_imperfection", "hyperelastic_stiffening", "print_anisotropy", "finger_finger_contact")


def shape(design: Design, object_id: int) -> np.ndarray:
    """Shape of a made-up grasp (4, in the unit cube): something of the design, something of the object."""
    weights = np.random.default_rng(1).standard_normal((4, 9)) * 1.2
    own = np.random.default_rng([2, object_id]).standard_normal(4)
    return np.asarray(1.0 / (1.0 + np.exp(-(weights @ (to_unit([design])[0] - 0.5) + own))))


def simulated_trace(design: Design, version: SimulatorVersion, setup: GraspSetup, object_id: int) -> Trace:
    """What the made-up simulator answers; effects that it has no law for are a wave on the force."""
    neutral = {value.effect: CATALOGUE[value.effect].neutral.parameters | value.parameters for value in version.effects}
    mesh = np.array([float(version == version.model_copy(update=dict(choice))) for choice in NUMERICAL])
    wider_mm = setup.closed_gap_mm - SETUP.closed_gap_mm
    late_mm = setup.tip_below_mm - SETUP.tip_below_mm
    trace = made_up_trace(
        shape(design, object_id), version.theta, neutral, wider_mm=wider_mm, late_mm=late_mm, mesh=mesh
    )
    force_n = trace.force_n
    for place, effect in enumerate(_SIMPLE):
        if effect in neutral:
            size = sum(neutral[effect].values()) * (0.3 + to_unit([design])[0][5 + place % 3])
            force_n = force_n * (1.0 + 0.02 * size * np.cos(trace.lift_mm / (8.0 + 6.0 * place)))
    return Trace(trace.time_s, trace.lift_mm, force_n)


def measured_rows(
    design: Design,
    tool_id: str,
    object_id: int,
    repeat: int,
    attempt: int = 0,
    hidden: Sequence[EffectValue] = (),
    setup: GraspSetup = SETUP,
) -> list[Row]:
    """A measured grasp: three seconds of closing and holding, then the lift; 80 readings a second, noise of 0.05 N."""
    wider_mm, late_mm = setup.closed_gap_mm - SETUP.closed_gap_mm, setup.tip_below_mm - SETUP.tip_below_mm
    lift = made_up_trace(shape(design, object_id), TRUTH, wider_mm=wider_mm, late_mm=late_mm)
    closed_s = 3.0 + setup.dwell_s
    time_s = np.arange(0.0, closed_s + 60.0 / setup.lift_speed_mm_per_s, 1 / 80.0)
    lift_mm = setup.lift_speed_mm_per_s * np.clip(time_s - closed_s, 0.0, None)
    force_n = np.where(time_s > 0.35, np.interp(lift_mm, lift.lift_mm, lift.force_n), 0.0)
    trace = Trace(time_s, lift_mm, force_n * (1.0 + 0.02 * np.sin(7.0 * design.length_mm)))
    for effect in build_effects(hidden):
        trace = effect.in_grasp(design, setup, GraspContext()).modify_trace(trace)
    rng = np.random.default_rng([int(1000 * design.length_mm), object_id, repeat])
    reported_n = np.interp(time_s, trace.time_s, trace.force_n)
    trace = Trace(time_s, lift_mm, reported_n + 0.05 * rng.standard_normal(len(time_s)))
    return grasp_rows(design, tool_id, object_id, repeat, attempt, trace)


def answer_rows(requests: Sequence[GraspRequest], hidden: Sequence[EffectValue] = ()) -> list[Row]:
    """The grasps that a search asks for, as the bench of `gap_lake` makes them."""
    rows: list[Row] = []
    for request in requests:
        design = DESIGNS[int(request.tool_id[-1])]
        for row in measured_rows(
            design, request.tool_id, request.object_id, request.repeat, hidden=hidden, setup=request.setup
        ):
            grasp_id = GraspRow.make_id(request.tool_id, request.object_id, request.repeat, 0, request.request_id)
            own = {"grasp_id": grasp_id}
            if isinstance(row, GraspRow):
                how = setup_columns(request.setup, request.placement)
                own |= {"bench": "virtual", "peak_force_n": 5.0, "request_id": request.request_id, **how}
            rows.append(row.model_copy(update=own))
    return rows


def bank_rows(designs: Sequence[Design], objects: Sequence[int], fail: Collection[tuple[int, str]] = ()) -> list[Row]:
    """The bank of designs on objects; `fail`: object and version of grasps that failed."""
    return plan_rows(plan_bank(BASE, Cells.full(designs, objects, SETUP)), fail)


def plan_rows(plans: Sequence[SimulationPlan], fail: Collection[tuple[int, str]] = ()) -> list[Row]:
    """What simulating plans would leave in the lake."""
    rows: dict[str, Row] = {}
    for plan in plans:
        for design, version in plan.points:
            rows[version.version_id] = SimulatorVersionRow.of(version)
            for object_id in plan.object_ids:
                is_failed = (object_id, version.version_id) in fail
                for row in _simulated(design, version, plan, object_id, is_failed):
                    rows[f"{row.table} {getattr(row, row.id_column())}"] = row
    return list(rows.values())


def gap_lake(
    root: Path,
    hidden: Sequence[EffectValue] = (),
    bench: str = "virtual",
    has_bank: bool = True,
) -> Lake:
    """A lake with eight tools measured twice on six objects, and their whole bank."""
    lake = Lake.open(root, create=True)
    rows: list[Row] = [DesignRow.of(design) for design in DESIGNS]
    rows += _make_whole_bank() if has_bank else []
    for number, design in enumerate(DESIGNS):
        for object_id in OBJECTS:
            for repeat in range(N_REPEATS):
                for row in measured_rows(design, f"demo/B01T{number}", object_id, repeat, hidden=hidden):
                    if isinstance(row, GraspRow):
                        row = row.model_copy(update={"bench": bench, "peak_force_n": 5.0})
                    rows.append(row)
    lake.append(rows, PROVENANCE)
    return lake


@cache
def _make_whole_bank() -> tuple[Row, ...]:
    """The bank of every such lake: two seconds of work."""
    return tuple(bank_rows(DESIGNS, OBJECTS))


def _simulated(
    design: Design, version: SimulatorVersion, plan: SimulationPlan, object_id: int, is_failed: bool
) -> list[Row]:
    """A simulation; another placement of the object changes nothing."""
    simulation_id = SimulationRow.make_id(design.design_id, object_id, version.version_id, plan.setup_id)
    row = SimulationRow(
        simulation_id=simulation_id,
        design_id=design.design_id,
        object_id=object_id,
        version_id=version.version_id,
        status="failed" if is_failed else "ok",
        **setup_columns(plan.setup, plan.placement),
    )
    trace = SimTraceRow.of(simulation_id, simulated_trace(design, version, plan.setup, object_id))
    return [row] if is_failed else [trace, row]
