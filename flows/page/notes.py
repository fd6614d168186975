"""Notes and photos that people leave on a tool: events of the lake, and files of its outputs."""

import hashlib
from collections.abc import Mapping

from fast.lake.store import Lake
from fast.lake.tables.campaign import ToolRow
from fast.models.errors import UsageError
from fast.tasks.campaign.requests import append_event

NOTE = "note"  # kind of the events
MOST_PHOTO_BYTES = 15_000_000
_LONGEST = 1000
_PICTURES = {b"\xff\xd8\xff": ".jpg", b"\x89PNG\r\n\x1a\n": ".png", b"RIFF": ".webp"}


def keep_note(lake: Lake, form: Mapping[str, str], operator: str) -> str:
    """Keep what a person wrote about a tool.

    Raises:
        UsageError: nothing was written, or there is no such tool.
    """
    about, text = form.get("about", ""), form.get("text", "")[:_LONGEST]
    if not text:
        raise UsageError("The note is empty; nothing was kept.")
    append_event(lake, _find_campaign(lake, about), NOTE, text, about=about, operator=operator)
    return "The note is kept."


def keep_photo(lake: Lake, about: str, content: bytes, operator: str) -> str:
    """Keep a photo of a tool.

    Raises:
        UsageError: it is no picture, or there is no such tool.
    """
    campaign_id = _find_campaign(lake, about)
    suffix = next((suffix for start, suffix in _PICTURES.items() if content.startswith(start)), None)
    if suffix is None or (suffix == ".webp" and content[8:12] != b"WEBP"):
        raise UsageError("This is no JPEG, PNG or WebP picture; nothing was kept.")
    name = f"{hashlib.sha256(content).hexdigest()[:20]}{suffix}"
    folder = lake.root / "outputs" / campaign_id / "photos"
    folder.mkdir(parents=True, exist_ok=True)
    (folder / name).write_bytes(content)
    words = {"about": about, "operator": operator, "photo": f"/outputs/{campaign_id}/photos/{name}"}
    append_event(lake, campaign_id, NOTE, "photo", **words)
    return "The photo is kept."


def _find_campaign(lake: Lake, tool_id: str) -> str:
    rows = lake.rows(ToolRow, tool_id=tool_id)
    if not rows:
        raise UsageError(f"There is no tool `{tool_id}` in this lake.")
    return str(rows[-1]["campaign_id"])
