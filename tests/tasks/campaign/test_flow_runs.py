import pytest

from fast.lake.tables.campaign import FlowRunRow
from fast.models.errors import LakeError
from fast.tasks.campaign.flow_runs import record_run


def run(campaign, flow_run_id, work):
    return record_run(campaign.lake, "campaign", "small", flow_run_id, work, campaign.provenance())


def rows(campaign):
    return {row["flow_run_id"]: row for row in campaign.lake.rows(FlowRunRow)}


@pytest.mark.parametrize(("answer", "status"), [(True, "completed"), (False, "interrupted")])
def test_a_run_is_a_row_from_its_start_to_its_end(campaign, answer, status):
    seen = []

    def work():
        seen.append(rows(campaign)["R1"])
        return answer

    assert run(campaign, "R1", work) is answer
    assert (seen[0]["status"], seen[0]["ended_at"]) == ("running", None)
    row = rows(campaign)["R1"]
    assert (row["status"], row["name"], row["campaign_id"]) == (status, "campaign small", "small")
    assert row["ended_at"] >= row["started_at"] == seen[0]["started_at"]
    assert row["process_id"] > 0


def test_a_failure_is_recorded_and_raised(campaign):
    def work():
        raise LakeError("The disk is full.")

    with pytest.raises(LakeError, match="The disk is full"):
        run(campaign, "R1", work)
    assert (rows(campaign)["R1"]["status"], rows(campaign)["R1"]["reason"]) == ("failed", "The disk is full.")


def test_a_killed_run_is_called_died_by_the_next_one(campaign, monkeypatch):
    monkeypatch.setattr("fast.tasks.campaign.flow_runs._append_end", lambda *_: None)  # as if it were killed before
    run(campaign, "R1", lambda: True)
    monkeypatch.undo()
    run(campaign, "R2", lambda: True)
    assert {key: row["status"] for key, row in rows(campaign).items()} == {"R1": "died", "R2": "completed"}


def test_a_lake_that_cannot_be_written_does_not_hide_why_the_run_ended(campaign, monkeypatch, caplog):
    def work():
        monkeypatch.setattr("fast.lake.storage.folder.publish", fail)
        raise ValueError("the real reason")

    def fail(*_):
        raise LakeError("No space left.")

    with pytest.raises(ValueError, match="the real reason"):
        run(campaign, "R1", work)
    assert "No space left" in caplog.text
