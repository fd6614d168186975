"""A small lake to find a gap in: closed forms for tools at a hidden theta and for the whole bank, no physics run."""

from collections.abc import Collection, Sequence
from pathlib import Path

import numpy as np

from lake.row import Row
from lake.store import Lake
from lake.tables import DesignRow, SimTraceRow, SimulationRow, SimulatorVersionRow, TraceRow, setup_columns
from models.calibration.traces.synthetic import made_up_trace
from models.design_space import numbered_design
from models.records import Design, GraspSetup, SimulatorVersion, Trace
from tasks.gap_bank import bank_plans
from tests.tasks import trace_lake
from tests.tasks.trace_lake import BASE, PROVENANCE, SETUP, shape

__all__ = ["BASE", "DESIGNS", "OBJECTS", "SETUP", "bank_rows", "gap_lake", "measured_rows"]

DESIGNS = [numbered_design(number) for number in range(8)]
OBJECTS = (4, 7, 18, 24, 30)
N_REPEATS = 2
measured_rows = trace_lake.measured_rows


def simulated_trace(design: Design, version: SimulatorVersion, setup: GraspSetup, object_id: int) -> Trace:
    """A closed form in which an effect, another mesh and a wider gap each change the trace a little."""
    theta = version.theta
    trace = made_up_trace(
        shape(design, object_id), np.array([theta.young_modulus_mpa, theta.friction, theta.poisson_ratio])
    )
    share = 0.002 * (version.mesh.layers + version.mesh.refine - 1) - 0.02 * (setup.closed_gap_mm - SETUP.closed_gap_mm)
    wave = np.zeros(len(trace.lift_mm))
    for value in version.effects:
        length_mm = 10.0 + float(len(value.effect) % 7)
        wave += 0.05 * sum(value.parameters.values()) * np.sin(trace.lift_mm / length_mm)
    return Trace(trace.time_s, trace.lift_mm, trace.force_n * (1.0 + share) + wave * (trace.force_n > 0))


def bank_rows(designs: Sequence[Design], objects: Sequence[int], fail: Collection[tuple[int, str]] = ()) -> list[Row]:
    """The bank of designs on objects; `fail`: object and version of grasps that failed."""
    rows: dict[str, Row] = {}
    for plan in bank_plans(BASE, designs, objects, SETUP):
        for design, version in plan.points:
            rows[version.version_id] = SimulatorVersionRow.of(version)
            for object_id in objects:
                for row in _simulated(design, version, plan.setup, object_id, (object_id, version.version_id) in fail):
                    rows[f"{row.table} {getattr(row, row.id_column())}"] = row
    return list(rows.values())


def gap_lake(root: Path, force_factor: float = 1.0) -> Lake:
    """A lake with eight tools measured twice on four objects, and their whole bank."""
    lake = Lake.open(root, create=True)
    rows: list[Row] = [DesignRow.of(design) for design in DESIGNS]
    rows += bank_rows(DESIGNS, OBJECTS)
    for number, design in enumerate(DESIGNS):
        for object_id in OBJECTS:
            for repeat in range(N_REPEATS):
                for row in measured_rows(design, f"demo/B01T{number}", object_id, repeat):
                    is_trace = isinstance(row, TraceRow)
                    rows.append(row.model_copy(update={"force_n": force_factor * row.force_n}) if is_trace else row)
    lake.append(rows, PROVENANCE)
    return lake


def _simulated(
    design: Design, version: SimulatorVersion, setup: GraspSetup, object_id: int, is_failed: bool
) -> list[Row]:
    simulation_id = SimulationRow.make_id(design.design_id, object_id, version.version_id, setup.setup_id)
    row = SimulationRow(
        simulation_id=simulation_id,
        design_id=design.design_id,
        object_id=object_id,
        version_id=version.version_id,
        status="failed" if is_failed else "ok",
        **setup_columns(setup),
    )
    trace = SimTraceRow.of(simulation_id, simulated_trace(design, version, setup, object_id))
    return [row] if is_failed else [trace, row]
