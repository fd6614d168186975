"""A batch whose proposing was cut off is proposed again as it would have been."""

from fast.lake.tables.campaign import BatchRow, ProposalRow
from fast.tasks.scientist.propose import propose_initial_tools


def test_the_row_of_a_batch_is_there_whenever_its_proposals_are(campaign, monkeypatch):
    published = []
    publish = campaign.lake.storage.publish
    monkeypatch.setattr(
        campaign.lake.storage,
        "publish",
        lambda staged, final: (published.append(final.parent.name), publish(staged, final)),
    )
    propose_initial_tools(campaign)
    assert published[:3] == ["designs", "batches", "proposals"]
    assert len(campaign.lake.ids(BatchRow)) == len({row.batch for row in campaign.lake.records(ProposalRow)})
