"""What happened in a lake, as events of the Prefect server: deployments may be triggered by them (prefect.yaml).

Events are a convenience: a server keeps them for days and may be down when one is sent. The lake is the truth, and
what an event starts looks there for what is new.
"""

from collections.abc import Sequence

from prefect.events import emit_event

from flows.prefect_server import address_for_others
from tasks.campaign import Campaign

MEASURED = "fast.batches.measured"


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
