"""Cells whose repeats all look wrong are measured once more before the batch ends, also after a kill."""

import json

import pytest

from fast.hardware.virtual.world.file import World
from fast.lake.tables.campaign import EventRow, GraspRow
from fast.models.traces.flags import Anomaly
from fast.tasks.bench import again
from fast.tasks.campaign.campaign import Campaign
from fast.tasks.scientist.observe import closed_batches
from tests.studies.benchmarks.made_up_batch import CAMPAIGN_ID, Batch, measure_missing

BATCH = Batch(2, (3, 8), 2)
WRONG = ("study/B01T1", 8)


class Killed(BaseException):
    """The process died here."""


@pytest.fixture
def campaign(tmp_path):
    return BATCH.make(tmp_path / "lake")


@pytest.fixture(autouse=True)
def looks_wrong(monkeypatch):
    """The repeats of one cell look wrong, and one of the two of another; four cells are too few for real flags."""
    kinds = {}

    def look(campaign):
        rows = sorted(campaign.lake.rows(GraspRow, status="ok"), key=lambda row: row["grasp_id"])
        bad = [r for r in rows if (r["tool_id"], r["object_id"]) == WRONG and r["repeat"] < 2 + kinds.get("stays", 0)]
        single = [r for r in rows if (r["tool_id"], r["object_id"], r["repeat"]) == ("study/B01T0", 3, 0)]
        flag = Anomaly(0, "stuck_valve", 1e-6, "expected", 1.0, "no force shows")._asdict()
        return [{**flag, **{k: row[k] for k in ("grasp_id", "tool_id", "object_id")}} for row in [*bad, *single]]

    monkeypatch.setattr(again, "_look", look)
    return kinds


def measure(campaign, dies_after=None):
    made = []

    def on_grasp(tool, grasp):
        made.append((tool.tool_id, grasp.object_id, grasp.repeat))
        if len(made) == dies_after:
            raise Killed

    measure_missing(campaign, World(), on_grasp)
    return made


def decisions(campaign):
    rows = campaign.lake.rows(EventRow, campaign_id=CAMPAIGN_ID, kind=again.MEASURED_AGAIN)
    return [json.loads(row["payload_json"]) for row in rows]


@pytest.mark.parametrize(("stays", "decided"), [(0, again.FAULT), (1, again.SO)])
def test_the_cell_is_measured_once_more_and_old_and_new_are_kept(campaign, looks_wrong, stays, decided):
    looks_wrong["stays"] = stays
    assert measure(campaign)[8:] == [(*WRONG, 2)]
    (event,) = decisions(campaign)
    (cell,) = event["cells"]
    assert (event["batch"], cell["tool_id"], cell["object_id"], cell["decided"]) == (1, *WRONG, decided)
    kept = [row for row in campaign.lake.rows(GraspRow) if (row["tool_id"], row["object_id"]) == WRONG]
    assert sorted((row["repeat"], bool(row["request_id"])) for row in kept) == [(0, False), (1, False), (2, True)]
    assert measure(campaign) == []  # once per cell
    assert closed_batches(campaign, campaign.state()) == [1]


@pytest.mark.parametrize("dies_after", [8, 9])
def test_a_kill_around_the_second_look_loses_nothing(campaign, dies_after):
    with pytest.raises(Killed):
        measure(campaign, dies_after)
    assert closed_batches(campaign, campaign.state()) == []
    assert measure(campaign) == ([(*WRONG, 2)] if dies_after == 8 else [])
    assert [cell["decided"] for cell in decisions(campaign)[0]["cells"]] == [again.FAULT]
    assert closed_batches(campaign, campaign.state()) == [1]


def test_no_more_than_the_budget(campaign):
    execution = campaign.config.execution.model_copy(update={"again_grasps": 0})
    none = Campaign(campaign.lake, campaign.config.model_copy(update={"execution": execution}))
    assert len(measure(none)) == 8
    assert decisions(none) == []
