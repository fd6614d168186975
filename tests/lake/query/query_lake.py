"""A made-up lake that contains what docs/how-to/ask-the-lake.md asks for, and the same facts as pandas frames.

Campaign `quick`, three batches of four tools. Built in: B01T1 slips off the turned cube, B02T1 was never measured on
the hourglass, some attempts failed and were repeated, readings drift, B03 pushes objects down, simulation is off by a
constant per object class.
"""

from dataclasses import dataclass
from datetime import UTC, datetime, timedelta

import numpy as np
import pandas as pd

from fast.lake.provenance import Provenance
from fast.lake.store import Lake
from fast.lake.tables.campaign import (
    BatchRow,
    CampaignRow,
    DesignRow,
    GraspRow,
    ObjectRow,
    Row,
    SimulationRow,
    SimulatorVersionRow,
    ToolRow,
    TraceRow,
)
from fast.lake.tables.requests import setup_columns
from fast.models import traces as features
from fast.models.design.space import random_designs
from fast.models.ids import canonical_json
from fast.models.objects.catalogue import OBJECTS
from fast.models.records import Design, GraspSetup, Trace
from fast.models.simulation.version import SimulatorVersion

OBJECT_IDS = (2, 6, 18, 20, 24, 28, 30, 32)
N_BATCHES, N_SLOTS, N_REPEATS = 3, 4, 2
INCOMPLETE, MISSING = "quick/B02T1", 28
FAILED = {("quick/B01T0", 2, 0): "gripper", ("quick/B01T0", 24, 1): "overload", ("quick/B03T1", 30, 0): "overload"}
DRIFT_N_PER_GRASP = 0.25
PAUSE_S = 24.0
VERSIONS = (SimulatorVersion(), SimulatorVersion(tier="screening"))
_START = datetime(2026, 3, 2, 8, tzinfo=UTC)
_SETUP = GraspSetup()
_CAMPAIGN = "quick"


@dataclass(frozen=True)
class Facts:
    """The rows of the lake as frames; `grasps` are the valid ones with their `trace`, `attempts` are all."""

    grasps: pd.DataFrame
    attempts: pd.DataFrame
    simulations: pd.DataFrame
    designs: pd.DataFrame


def build(lake: Lake) -> Facts:
    """Append the campaign to the lake."""
    designs = random_designs(N_BATCHES * N_SLOTS, np.random.default_rng(5))
    rows: list[Row] = [CampaignRow(campaign_id=_CAMPAIGN, name="Quick", config_toml="")]
    rows += [_object_row(object_id) for object_id in OBJECT_IDS]
    rows += [DesignRow.of(design) for design in designs] + [SimulatorVersionRow.of(version) for version in VERSIONS]
    attempts: list[GraspRow] = []
    traces: list[TraceRow] = []
    for batch in range(1, N_BATCHES + 1):
        kind = "random" if batch == 1 else "guided"
        batch_id = BatchRow.make_id(_CAMPAIGN, batch)
        rows.append(BatchRow(batch_id=batch_id, campaign_id=_CAMPAIGN, batch=batch, kind=kind, n_tools=N_SLOTS))
        for slot in range(N_SLOTS):
            _measure(batch, slot, designs[(batch - 1) * N_SLOTS + slot], attempts, traces)
    simulations = [
        _simulation(design, object_id, version)
        for design in designs
        for object_id in OBJECT_IDS
        for version in VERSIONS
    ]
    provenance = Provenance(code_version="0.1.0", code_dirty=False)
    lake.append([*rows, *attempts, *traces, *simulations], provenance)
    return _facts(attempts, traces, simulations, designs)


def _object_row(object_id: int) -> ObjectRow:
    shape = OBJECTS[object_id]
    return ObjectRow(
        object_id=object_id,
        name=shape.name,
        object_class=shape.object_class,
        orientation=shape.orientation,
        parameters_json=canonical_json(shape.parameters),
    )


def _measure(batch: int, slot: int, design: Design, attempts: list[GraspRow], traces: list[TraceRow]) -> None:
    """Append the grasps of one tool; an attempt that fails is repeated at once."""
    tool_id = ToolRow.make_id(_CAMPAIGN, batch, slot)
    for object_id in OBJECT_IDS:
        for repeat in range(N_REPEATS):
            if (tool_id, object_id) == (INCOMPLETE, MISSING):
                continue
            reason = FAILED.get((tool_id, object_id, repeat))
            if reason:
                attempts.append(_grasp(batch, slot, design, object_id, repeat, 0, len(attempts), None, reason))
            trace = _trace(design, batch, object_id, len(attempts))
            row = _grasp(batch, slot, design, object_id, repeat, 1 if reason else 0, len(attempts), trace, "")
            attempts.append(row)
            traces.append(TraceRow.of(row.grasp_id, trace))


def _grasp(
    batch: int,
    slot: int,
    design: Design,
    object_id: int,
    repeat: int,
    attempt: int,
    order: int,
    trace: Trace | None,
    reason: str,
) -> GraspRow:
    tool_id = ToolRow.make_id(_CAMPAIGN, batch, slot)
    return GraspRow(
        grasp_id=GraspRow.make_id(tool_id, object_id, repeat, attempt),
        campaign_id=_CAMPAIGN,
        tool_id=tool_id,
        batch=batch,
        slot=slot,
        design_id=design.design_id,
        object_id=object_id,
        repeat=repeat,
        attempt=attempt,
        order=order,
        status="failed" if trace is None else "ok",
        reason=reason,
        started_at=_START + timedelta(seconds=PAUSE_S * order),
        peak_force_n=None if trace is None else features.peak_force_n(trace),
        work_j=None if trace is None else features.work_j(trace),
        initial_force_n=None if trace is None else features.initial_force_n(trace),
        bench="virtual",
        **setup_columns(_SETUP),
    )


def _trace(design: Design, batch: int, object_id: int, order: int) -> Trace:
    """A push while closing (40 samples), then rise, plateau and decline over 50 mm of lift, with noise."""
    rng = np.random.default_rng([7, order])
    lift_mm = np.concatenate([np.zeros(40), np.arange(1, 201) * 0.25])
    let_go_mm = 12.0 + 3.5 * OBJECT_IDS.index(object_id) + 0.1 * design.rib_count
    peak_n = 3.0 * batch + 2.0 * design.rib_thickness_mm + 0.1 * design.rib_angle_deg + 0.5 * (object_id % 7) + 5.0
    hold = 1 / (1 + np.exp((lift_mm - let_go_mm) / 2.2))
    push_n = -0.5
    closing = np.clip(np.arange(lift_mm.size) / 39, 0, 1)
    force_n = (peak_n + push_n) * (1 - np.exp(-lift_mm / 1.5)) * hold - push_n * closing * hold
    force_n = force_n * rng.normal(1, 0.01) + rng.normal(0, 0.05, lift_mm.size) + DRIFT_N_PER_GRASP * order * hold
    force_n[:40] -= DRIFT_N_PER_GRASP * order * hold[:40]
    return Trace(time_s=np.arange(lift_mm.size) * 0.05, lift_mm=lift_mm, force_n=force_n)


def _simulation(design: Design, object_id: int, version: SimulatorVersion) -> SimulationRow:
    is_coarse = version.tier == "screening"
    has_failed = is_coarse and object_id == 24
    return SimulationRow(
        simulation_id=SimulationRow.make_id(design.design_id, object_id, version.version_id, _SETUP.setup_id),
        design_id=design.design_id,
        object_id=object_id,
        version_id=version.version_id,
        status="failed" if has_failed else "ok",
        reason="not_converged" if has_failed else "",
        peak_force_n=None if has_failed else 2.0 * design.rib_thickness_mm + 8.0 + object_id / 10,
        contact_force_n=None if has_failed else 4.0,
        work_j=None if has_failed else 0.1,
        n_dof=300 if is_coarse else 1800,
        cpu_s=(0.1 if is_coarse else 1.0) + 0.01 * object_id,
        **setup_columns(_SETUP),
    )


def _facts(
    attempts: list[GraspRow], traces: list[TraceRow], simulations: list[SimulationRow], designs: list[Design]
) -> Facts:
    trace_of = {row.grasp_id: row.trace for row in traces}
    frame = pd.DataFrame([row.model_dump() for row in attempts])
    frame["object_name"] = [OBJECTS[i].name for i in frame["object_id"]]
    frame["object_class"] = [OBJECTS[i].object_class for i in frame["object_id"]]
    valid = frame[frame["status"] == "ok"].copy()
    valid["trace"] = [trace_of[grasp_id] for grasp_id in valid["grasp_id"]]
    simulated = pd.DataFrame([row.model_dump() for row in simulations])
    tier_of = {version.version_id: version.tier for version in VERSIONS}
    simulated["tier"] = [tier_of[version_id] for version_id in simulated["version_id"]]
    designed = pd.DataFrame([DesignRow.of(design).model_dump() for design in designs])
    return Facts(valid, frame, simulated, designed)
