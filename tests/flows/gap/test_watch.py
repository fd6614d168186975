"""Who is told of a gap."""

from pathlib import Path

import pytest

from fast.flows.campaign.notify import KINDS
from fast.flows.gap.scheduled import FLOW, _notifier
from fast.flows.server.crashed_runs import OURS
from fast.lake.store import Lake
from fast.lake.tables.campaign import CampaignRow, GraspRow
from fast.lake.tables.row import Row
from tests.tasks.calibration.calibration_lake import CONFIG
from tests.tasks.calibration.trace_lake import DESIGNS, PROVENANCE, measured_rows

ALOUD = "[execution]\nnotify_virtual = true\n"


def lake_of(root: Path, config: str | None, bench: str) -> Lake:
    """A lake with one grasp of campaign `demo`."""
    lake = Lake.open(root, create=True)
    rows: list[Row] = [
        row.model_copy(update={"bench": bench}) if isinstance(row, GraspRow) else row
        for row in measured_rows(DESIGNS[0], "T0", 4, 0)
    ]
    if config is not None:
        rows.append(CampaignRow(campaign_id="demo", name="demo", config_toml=config))
    lake.append(rows, PROVENANCE)
    return lake


@pytest.mark.parametrize(
    ("config", "bench", "kinds"),
    [
        (None, "virtual", ()),
        (None, "real", KINDS),
        ('kind = "imported"\n', "real", KINDS),
        (CONFIG.format(name="demo", tier="production"), "virtual", ()),
        (CONFIG.format(name="demo", tier="production") + ALOUD, "virtual", KINDS),
        (CONFIG.format(name="demo", tier="production") + '[execution]\nnotify = ["done"]\n', "real", ()),
    ],
)
def test_people_are_told_as_the_campaigns_say(
    tmp_path: Path, config: str | None, bench: str, kinds: tuple[str, ...]
) -> None:
    lake = lake_of(tmp_path / "lake", config, bench)
    assert _notifier(lake, None).kinds == kinds
    assert _notifier(lake, "demo").kinds == kinds
    assert _notifier(lake, "another").kinds == ()


def test_a_search_whose_process_is_gone_is_swept() -> None:
    assert FLOW in OURS
