"""What hangs in the rack of a virtual arm: what the campaign of its lake opened it with last."""

from pathlib import Path

from fast.tasks.bench.arm_rack import read_rack
from fast.tasks.campaign.requests import BENCH_OPENED, append_event
from tests.tasks.campaign.small_campaign import begun, small_campaign


def test_the_rack_holds_the_tools_that_the_bench_was_opened_with_last(tmp_path: Path) -> None:
    address = str(tmp_path / "lake")
    assert read_rack(address) == {}
    campaign = begun(small_campaign(tmp_path))
    assert read_rack(address) == {}
    first, second = campaign.state().tools
    for hanging in ({0: first.tool_id, 1: second.tool_id}, {0: second.tool_id, 9: first.tool_id}):
        append_event(campaign.lake, campaign.campaign_id, BENCH_OPENED, "connected", hanging=hanging)
    append_event(campaign.lake, campaign.campaign_id, BENCH_OPENED, "a gantry", wire_log="W1")
    rack = read_rack(address)
    assert {slot: tool.tool_id for slot, tool in rack.items()} == {0: second.tool_id, 9: first.tool_id}
    assert rack[9].design == first.design
