"""What it costs to derive where a campaign stands, at the size of the paper's: a lake of its rows, with no content."""

import statistics
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from lake.store import Lake
from lake.tables.campaign import DesignRow, GraspRow, ProposalRow, SimulationRow, TraceRow, setup_columns
from lake.tables.row import Row
from models.design.space import numbered_design
from models.ids import canonical_json
from models.records import Design
from tasks.campaign.campaign import Campaign
from tasks.campaign.config import CampaignConfig

NAME = "state"
N_STATES = 7
_TOOLS_OF_TRAY = 10


def state_cpu_s(root: Path, n_simulated: int, n_tools: int) -> dict[str, float]:
    """CPU ms of `Campaign.state` with so many designs simulated, and tools measured and simulated, on all objects.

    `first`: in a new process, from all rows. `with_news`: after the rows of one more design, which is how it is mostly
    asked for; `growth`: how much more that is than in an empty lake. `unchanged`: when nothing came.
    """
    campaign = _campaign(root / "large")
    rows = [row for number in range(n_simulated + n_tools) for row in _rows(campaign, number, number < n_tools)]
    campaign.lake.append(rows, campaign.provenance())
    first_ms = _cpu_ms(campaign.state)
    known = n_simulated + n_tools
    news_ms = _news_ms(campaign, known)
    return {
        "rows": len(campaign.lake.ids(SimulationRow)) + len(campaign.lake.ids(GraspRow)),
        "first_cpu_ms": first_ms,
        "with_news_cpu_ms": news_ms,
        "growth_cpu_ms": max(0.0, news_ms - _news_ms(_campaign(root / "small"), 0)),
        "unchanged_cpu_ms": statistics.median(_cpu_ms(campaign.state) for _ in range(N_STATES)),
    }


def _campaign(root: Path) -> Campaign:
    config = CampaignConfig.model_validate({"name": NAME, "bench": {"world": ""}})
    return Campaign(Lake.open(root, create=True), config)


def _news_ms(campaign: Campaign, n_known: int) -> float:
    """CPU ms of a state after the rows of one more simulated design."""
    campaign.state()
    spent = []
    for number in range(n_known, n_known + N_STATES):
        campaign.lake.append(_rows(campaign, number, is_tool=False), campaign.provenance())
        spent.append(_cpu_ms(campaign.state))
    return statistics.median(spent)


def _cpu_ms(work: Callable[[], object]) -> float:
    before = time.process_time()
    work()
    return 1e3 * (time.process_time() - before)


def _rows(campaign: Campaign, number: int, is_tool: bool) -> list[Row]:
    """A design, proposed and simulated; as a tool, measured too."""
    design = numbered_design(number)
    rows: list[Row] = [DesignRow.of(design), _proposal(design, number, is_tool)]
    rows += [_simulation(campaign, design, object_id) for object_id in campaign.object_ids]
    return rows + _grasps(campaign, design, number) if is_tool else rows


def _proposal(design: Design, number: int, is_tool: bool) -> ProposalRow:
    batch, slot = divmod(number, _TOOLS_OF_TRAY)
    return ProposalRow(
        proposal_id=f"{NAME}/{number}", campaign_id=NAME, batch=batch + 1, slot=slot if is_tool else None, index=number,
        fidelity="real" if is_tool else "sim", design_id=design.design_id, acquisition="random", n_real=0, n_sim=0,
        n_pending=0,
    )  # fmt: skip


def _simulation(campaign: Campaign, design: Design, object_id: int) -> SimulationRow:
    version_id, setup = campaign.version.version_id, campaign.config.grasp
    return SimulationRow(
        simulation_id=SimulationRow.make_id(design.design_id, object_id, version_id, setup.setup_id),
        design_id=design.design_id, object_id=object_id, version_id=version_id, status="ok", peak_force_n=1.0,
        **setup_columns(setup),
    )  # fmt: skip


def _grasps(campaign: Campaign, design: Design, number: int) -> list[Row]:
    batch, slot = divmod(number, _TOOLS_OF_TRAY)
    tool_id, setup = f"{NAME}/B{batch + 1:02d}T{slot}", campaign.config.grasp
    rows: list[Row] = []
    for object_id, repeat in campaign.config.objects.cells(0):
        grasp_id = GraspRow.make_id(tool_id, object_id, repeat, 0)
        rows += [
            TraceRow(grasp_id=grasp_id, time_s=np.zeros(1), lift_mm=np.zeros(1), force_n=np.ones(1)),
            GraspRow(
                grasp_id=grasp_id, campaign_id=NAME, tool_id=tool_id, batch=batch + 1, slot=slot,
                design_id=design.design_id, object_id=object_id, repeat=repeat, status="ok", peak_force_n=1.0,
                setup_id=setup.setup_id, setup_json=canonical_json(setup.model_dump()), bench="virtual",
            ),
        ]  # fmt: skip
    return rows
