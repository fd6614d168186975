"""Report and recording of a campaign that ended: what a process of its own writes, which never sees Prefect."""

from pathlib import Path
from typing import TYPE_CHECKING

from fast.lake.store import Lake

if TYPE_CHECKING:
    from fast.flows.report.campaign.reference import TimesReference


def write_files(lake: Lake, campaign_id: str, output: Path) -> "tuple[Path, Path, TimesReference | None]":
    """Report and recording of a campaign in `output`, and its best tool against the reference finger."""
    from fast.flows.report.campaign.content import Content
    from fast.flows.report.campaign.page import add_features, write_report
    from fast.flows.viewer.campaign import write_recording

    add_features(lake, campaign_id)
    report = write_report(lake, campaign_id, output / "report")
    recording = write_recording(lake, campaign_id, output / f"{campaign_id}.rrd")
    return report, recording, Content.load(lake, campaign_id).times_reference
