"""Checks of the gantry for lost steps, and what they mean for the grasps made since the last one."""

from hardware.bench import Bench
from hardware.safety.lost_steps import SLIP_LIMIT_MM, LostStepsError
from tasks.campaign.campaign import Campaign
from tasks.campaign.requests import append_event

CHECKED, LOST_STEPS = "position_checked", "lost_steps"  # kinds of events

# Ordinary grasps and diagnostic runs that came after the last check; after lost steps the gantry was homed.
_SINCE_LAST_CHECK = f"""
    WITH made AS (
        SELECT grasp_id AS id, created_at FROM raw_grasps WHERE campaign_id = $campaign
        UNION SELECT diagnostic_id, created_at FROM diagnostics WHERE campaign_id = $campaign
    ), last AS (
        SELECT max(created_at) AS checked_at FROM events
        WHERE campaign_id = $campaign AND kind IN ('{CHECKED}', '{LOST_STEPS}')
    )
    SELECT id FROM made, last WHERE checked_at IS NULL OR created_at > checked_at ORDER BY created_at, id
"""


def check_position(campaign: Campaign, bench: Bench, batch: int) -> None:
    """Check that the gantry is where it is counted, and keep the outcome as an event.

    Raises:
        LostStepsError: it is not; the event `lost_steps` names every grasp and diagnostic run since the last check.
        DeviceError: a device failed on the way.
    """
    lake, name = campaign.lake, campaign.campaign_id
    since = lake.query(_SINCE_LAST_CHECK, {"campaign": name})["id"].to_pylist()
    try:
        slip_mm = bench.position.run()
    except LostStepsError as error:
        what = {"batch": batch, "slip_mm": error.slip_mm, "limit_mm": SLIP_LIMIT_MM, "grasp_ids": since}
        append_event(lake, name, LOST_STEPS, f"{error} Suspect grasps: {len(since)}.", **what)
        raise
    what = {"batch": batch, "slip_mm": slip_mm, "limit_mm": SLIP_LIMIT_MM, "n_grasps": len(since)}
    append_event(lake, name, CHECKED, f"no lost steps over {len(since)} grasps", **what)
