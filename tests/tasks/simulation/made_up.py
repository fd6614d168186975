"""Rows as bench and simulator would write them."""

from fast.lake.tables.campaign import GraspRow, SimulationRow, TraceRow
from fast.models.ids import canonical_json


def append_grasp(campaign, tool, object_id, repeat, peak_force_n, attempt=0, status="ok", bench="virtual"):
    setup = campaign.config.grasp
    row = GraspRow(
        grasp_id=GraspRow.make_id(tool.tool_id, object_id, repeat, attempt),
        campaign_id=campaign.campaign_id,
        tool_id=tool.tool_id,
        batch=tool.batch,
        slot=tool.slot,
        design_id=tool.design.design_id,
        object_id=object_id,
        repeat=repeat,
        attempt=attempt,
        status=status,
        peak_force_n=peak_force_n if status == "ok" else None,
        setup_id=setup.setup_id,
        setup_json=canonical_json(setup.model_dump()),
        bench=bench,
    )
    trace = TraceRow(grasp_id=row.grasp_id, time_s=[0.0], lift_mm=[0.0], force_n=[peak_force_n])
    campaign.lake.append([trace, row], campaign.provenance())


def append_simulation(campaign, design, object_id, peak_force_n, version=None, pressure_kpa=None):
    setup, version_id = campaign.config.grasp, (version or campaign.version).version_id
    row = SimulationRow(
        simulation_id=SimulationRow.make_id(design.design_id, object_id, version_id, setup.setup_id),
        design_id=design.design_id,
        object_id=object_id,
        version_id=version_id,
        setup_id=setup.setup_id,
        setup_json=canonical_json(setup.model_dump()),
        status="failed" if peak_force_n is None else "ok",
        peak_force_n=peak_force_n,
        pressure_kpa=pressure_kpa,
    )
    campaign.lake.append([row], campaign.provenance())
