"""How the campaign's simulator changed: what each night added, and what that did to error and ranking."""

from typing import Any

from fast.flows.report.campaign.content import Content
from fast.flows.report.folder import Folder
from fast.tasks.campaign.night_story import Night, read_nights, read_verdicts
from fast.tasks.templates import number


def prepare_nights(content: Content, folder: Folder) -> dict[str, Any] | None:
    """A row for each night with a new simulator; None where there was none and no search has judged one."""
    lake, campaign_id = content.lake, content.campaign.campaign_id
    nights = read_nights(lake, campaign_id)
    refused = [f"{verdict.sentence}." for verdict in read_verdicts(lake, campaign_id) if not verdict.is_accepted]
    if nights:
        folder.numbers("nights", [night.model_dump(mode="json") for night in nights])
    return {"nights": [_describe(night) for night in nights], "refused": refused} if nights or refused else None


def _describe(night: Night) -> dict[str, Any]:
    return {
        "batch": f"B{night.batch:02d}",
        "change": night.change,
        "error": f"{number(night.error_before_n, 2)} → {number(night.error_after_n, 2)}",
        "rank": f"{number(night.rank_before, 2)} → {number(night.rank_after, 2)}",
        "n_tools": night.n_tools,
        "designs": f"{night.n_done} of {night.n_planned}",
        "worker_hours": night.worker_hours,
    }
