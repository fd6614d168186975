"""What happened in a lake, as events of the Prefect server: deployments may be triggered by them (prefect.yaml).

Events are a convenience: a server keeps them for days and may be down when one is sent. The lake is the truth, and
what an event starts looks there for what is new.
"""

from collections.abc import Sequence

from prefect.events import emit_event

from fast.flows.server.server import address_for_others
from fast.lake.store import Lake
from fast.tasks.campaign.campaign import Campaign

MEASURED = "fast.batches.measured"
CALIBRATED = "fast.calibration.made"
FOUND = "fast.gap.found"


def announce_measured(campaign: Campaign, batches: Sequence[int]) -> None:
    """Tell the server that these batches of a campaign are completely measured."""
    emit_event(
        MEASURED,
        resource={
            "prefect.resource.id": f"fast.campaign.{campaign.campaign_id}",
            "prefect.resource.name": campaign.campaign_id,
        },
        payload={"lake": address_for_others(campaign.lake), "campaign": campaign.campaign_id, "batches": list(batches)},
    )


def announce_gap(lake: Lake, gap_id: str, sentence: str, is_alarm: bool) -> None:
    """Tell the server that a gap search of a lake has ended with something new to say."""
    emit_event(
        FOUND,
        resource={"prefect.resource.id": f"fast.gap.{gap_id}", "prefect.resource.name": gap_id},
        payload={"lake": address_for_others(lake), "gap": gap_id, "alarm": is_alarm, "sentence": sentence},
    )


def announce_calibrated(lake: Lake, calibration_id: str, sentence: str) -> None:
    """Tell the server that a lake has a new calibration."""
    emit_event(
        CALIBRATED,
        resource={"prefect.resource.id": f"fast.calibration.{calibration_id}", "prefect.resource.name": calibration_id},
        payload={"lake": address_for_others(lake), "calibration": calibration_id, "sentence": sentence},
    )
