"""Grasps that a search asks for, made on the virtual bench over its drivers, and what studies of the lake see."""

import pytest

from fast.hardware.bench import open_virtual_bench
from fast.hardware.tools.mounted import MountedTool
from fast.hardware.virtual.world.file import Sensor, World
from fast.lake.provenance import current_provenance
from fast.lake.tables.campaign import GraspRow
from fast.models.records import GraspRequest, GraspSetup, Placement
from fast.tasks.bench.asked import read_open_requests, write_requests
from fast.tasks.bench.measure import BenchUse, measure_tool
from fast.tasks.bench.plan import ToolWork, plan_asked, plan_tool
from fast.tasks.bench.print import PrintConfirmation, confirm_print
from fast.tasks.campaign.campaign import Campaign
from fast.tasks.campaign.state import ProposedTool, rank_tools
from fast.tasks.gap.data import read_grasps
from fast.tasks.scientist.propose import propose_initial
from tests.hardware.station.grasp_stub import holds_to_the_top

FASTER, WAITING = GraspSetup(lift_speed_mm_per_s=20.0), GraspSetup(dwell_s=2.0)
WORLD = World(seed=7, sensor=Sensor(noise_sd_n=0.12))
ASIDE = Placement(offset_x_mm=2.0)


@pytest.fixture
def tool(campaign: Campaign) -> ProposedTool:
    propose_initial(campaign)
    confirm_print(campaign.lake, "small", 1, PrintConfirmation(operator="ada"))
    return campaign.state().tools_of(1)[0]


def make(campaign: Campaign, tool: ProposedTool, work: ToolWork, most: int = 99) -> int:
    """Make what is to be done with a tool; `most` grasps, then the process is stopped."""
    made: list[object] = []
    tools = {tool.rack_slot: MountedTool(tool.tool_id, tool.design)}
    with open_virtual_bench(WORLD, tools, holds_to_the_top, wires="memory") as bench:
        use = BenchUse(None, "w", lambda: len(made) >= most, lambda tool, grasp: made.append(grasp))
        measure_tool(campaign, bench, work, use)
    return len(made)


def test_asked_grasps_are_made_once_and_every_study_knows_how(campaign: Campaign, tool: ProposedTool) -> None:
    lake = campaign.lake
    make(campaign, tool, plan_tool(campaign, campaign.state(), tool))
    before = rank_tools(lake, "small")
    object_id = campaign.object_ids[0]
    asked = [
        GraspRequest(tool_id=tool.tool_id, object_id=object_id, setup=FASTER),
        GraspRequest(tool_id=tool.tool_id, object_id=object_id),
        GraspRequest(tool_id=tool.tool_id, object_id=object_id, setup=WAITING, placement=ASIDE),
    ]
    write_requests(lake, "A1", asked, "small", current_provenance())
    assert make(campaign, tool, plan_asked(lake, tool), most=1) == 1  # killed: it goes on with the second
    assert [one.setup for one, _ in read_open_requests(lake)] == [GraspSetup(), WAITING]
    assert make(campaign, tool, plan_asked(lake, tool)) == 2
    assert make(campaign, tool, plan_asked(lake, tool)) == 0
    assert make(campaign, tool, plan_tool(campaign, campaign.state(), tool)) == 0, "ordinary grasps are all there"
    after = rank_tools(lake, "small")
    assert [(row["tool_id"], row["n_grasps"]) for row in after] == [(row["tool_id"], row["n_grasps"]) for row in before]
    assert after[0]["tool_quality_n"] == pytest.approx(before[0]["tool_quality_n"])
    rows = [row for row in lake.records(GraspRow) if row.request_id is not None]
    assert sorted(row.repeat for row in rows) == [2, 3, 4]
    assert {row.placement for row in rows} == {Placement(), ASIDE}

    measured = read_grasps(lake, "small")
    assert measured.answers is not None
    assert set(measured.grasps.lift_speed_mm_per_s) == {5.0}  # ordinary grasps alone
    grasps = measured.answers.grasps
    assert set(grasps.setups) == {GraspSetup(), FASTER, WAITING}
    assert grasps.base_setup == GraspSetup()
    assert grasps.placements == (Placement(), ASIDE)
    assert sorted(grasps.lift_speed_mm_per_s)[-1] == 20.0
    cells = grasps.cells
    assert [target.placement for target in cells.targets[len(grasps.objects) :]] == [ASIDE]  # speeds cost no simulation
