"""Reference grasps with a tool of their own: when, under which name, and after a kill."""

import pytest

from fast.hardware.cell.diagnostics import DiagnosticPlan, ReferenceTool
from fast.hardware.virtual.world.file import World
from fast.lake.maintenance import check
from fast.lake.tables.campaign import DiagnosticRow
from fast.models.design.space import BEST_PUBLISHED
from fast.models.errors import ConfigError
from fast.tasks.bench.reference_grasps import ReferenceGrasps
from fast.tasks.campaign.campaign import Campaign
from fast.tasks.campaign.config import CampaignConfig
from fast.tasks.campaign.state import ProposedTool
from tests.studies.benchmarks.made_up_batch import Batch, measure_missing

BATCH = Batch(3, (3, 8), 1)
REFERENCE = ReferenceTool(slot=9, design=BEST_PUBLISHED)


class Killed(BaseException):
    """The process died here."""


@pytest.fixture
def campaign(tmp_path):
    made = BATCH.make(tmp_path / "lake")
    plan = DiagnosticPlan(reference_every=4, reference_object=3, reference_tool=REFERENCE, repeats=1)
    return Campaign(made.lake, made.config.model_copy(update={"diagnostics": plan}))


def measure(campaign, dies_after=None):
    made = []

    def on_grasp(tool, _grasp):
        made.append(tool.tool_id.removeprefix("study/"))
        if len(made) == dies_after:
            raise Killed

    measure_missing(campaign, World(), on_grasp)
    return made


def test_the_reference_tool_frames_the_batch_and_comes_back_after_so_many_grasps(campaign):
    assert measure(campaign) == ["R9", "B01T0", "B01T0", "B01T1", "B01T1", "R9", "B01T2", "B01T2", "R9"]
    rows = campaign.lake.rows(DiagnosticRow)
    assert [(row["tool_id"], row["repeat"], row["n_grasps_before"], row["object_id"]) for row in rows] == [
        ("study/R9", 0, 0, 3),
        ("study/R9", 1, 4, 3),
        ("study/R9", 2, 6, 3),
    ]
    assert {row["design_id"] for row in rows} == {BEST_PUBLISHED.design_id}
    assert check(campaign.lake) == []


def test_after_a_kill_no_reference_grasp_is_made_twice(campaign):
    for n in (1, 4):
        with pytest.raises(Killed):
            measure(campaign, dies_after=n)
    assert measure(campaign) == ["R9", "B01T2", "B01T2", "R9"]


def test_without_a_reference_tool_nothing_changes(tmp_path):
    campaign = BATCH.make(tmp_path / "lake")
    references = ReferenceGrasps(campaign, 1)
    tools = campaign.state().tools_of(1)
    assert references.add_to(tools) == tools
    assert references.plan_due() == references.plan_due(is_last=True) == []


def test_a_slot_for_two_tools_is_refused(campaign):
    here = ProposedTool("study/B01T2", 1, 2, BEST_PUBLISHED, hangs_in=9)
    with pytest.raises(ConfigError, match="Tool B01T2 hangs in slot 9, which is the reference tool's"):
        ReferenceGrasps(campaign, 1).add_to([here])
    config = campaign.config.model_dump()
    config["diagnostics"]["reference_tool"]["slot"] = 2
    with pytest.raises(ValueError, match="slot 2 is one of the 3 that a batch uses"):
        CampaignConfig.model_validate(config)
    with pytest.raises(ValueError, match="makes no grasp while reference_every is 0"):
        DiagnosticPlan(reference_tool=REFERENCE)
