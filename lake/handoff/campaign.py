"""The campaign that imported data become: its row, batches and tools, so that status and report can show it.

Its config has no schedule. It says `kind = "imported"` and names every folder that was imported into it.
"""

import hashlib
import json
import logging
import re
import tomllib
from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from fast.lake.handoff.files import HandoffGrasp
from fast.lake.handoff.format import FILE_NAMES
from fast.lake.store import Lake
from fast.lake.tables.campaign import BatchRow, CampaignRow, ObjectRow, Row, ToolRow
from fast.lake.tables.catalogue_rows import object_rows
from fast.lake.tables.imported import IMPORTED, is_imported
from fast.models.errors import UsageError

_LOG = logging.getLogger(__name__)
Place = tuple[int, int]  # (batch, slot)
_SLOTS = 10
_TOOL_LABEL = re.compile(r"B(\d{1,6})T(\d)$")


def source_hash(directory: Path) -> str:
    """Hash the hand-off files in a folder: their names and bytes."""
    digest = hashlib.sha256()
    for name in sorted(FILE_NAMES):
        path = directory / name
        if path.exists():
            digest.update(f"{name} {path.stat().st_size}\n".encode())
            with path.open("rb") as file:
                digest.update(hashlib.file_digest(file, "sha256").digest())
    return digest.hexdigest()[:16]


def campaign_row(lake: Lake, campaign_id: str, source: str, content_hash: str) -> CampaignRow:
    """Return the campaign with one more source, unless it has this one.

    Raises:
        UsageError: the lake has a campaign of this name that was not imported.
    """
    sources = []
    for row in lake.rows(CampaignRow, campaign_id=campaign_id):
        if not is_imported(row["config_toml"]):
            raise UsageError(
                f"campaign `{campaign_id}` of this lake was not imported, so nothing can be imported into it; "
                "nothing was written: give another --campaign."
            )
        sources = tomllib.loads(row["config_toml"])["sources"]
    new = {"folder": source, "content_hash": content_hash}
    lines = ["# Imported data: there is no schedule to run.", f'kind = "{IMPORTED}"']
    for known in [*sources, *([] if new in sources else [new])]:
        lines += ["", "[[sources]]", *(f"{key} = {json.dumps(value)}" for key, value in known.items())]
    return CampaignRow(campaign_id=campaign_id, name=campaign_id, config_toml="\n".join(lines) + "\n")


def tool_places(lake: Lake, campaign_id: str, tool_ids: Sequence[str]) -> dict[str, Place]:
    """Return batch and slot of each tool: as the lake has it, else as its name says (`B02T4`), else the next free."""
    places = {row["tool_id"]: (row["batch"], row["slot"]) for row in lake.rows(ToolRow, campaign_id=campaign_id)}
    new = [tool_id for tool_id in dict.fromkeys(tool_ids) if tool_id not in places]
    taken = set(places.values())
    for tool_id in new:
        label = _TOOL_LABEL.search(tool_id)
        place = (int(label[1]), int(label[2])) if label else None
        if place and place not in taken:
            places[tool_id] = place
            taken.add(place)
    first = max((batch for batch, _ in taken), default=0) + 1
    for number, tool_id in enumerate(tool_id for tool_id in new if tool_id not in places):
        places[tool_id] = first + number // _SLOTS, number % _SLOTS
    return places


def bench_rows(
    lake: Lake,
    campaign_id: str,
    source: str,
    grasps: Sequence[HandoffGrasp],
    places: dict[str, Place],
    tools: Sequence[dict[str, Any]] = (),
) -> list[Row]:
    """Return objects the lake lacks, batches and tools of measured grasps; `tools`: what the folder says of them."""
    told = {row["tool_id"]: row for row in tools}
    usual: dict[str, Any] = {"status": "printed", "operator": f"import of {source}"}
    known = lake.ids(ObjectRow)
    rows: list[Row] = [row for row in object_rows() if row.object_id not in known]
    n_tools: dict[int, int] = defaultdict(int)
    for batch, _ in places.values():
        n_tools[batch] += 1
    rows += [
        BatchRow(
            batch_id=BatchRow.make_id(campaign_id, batch),
            campaign_id=campaign_id,
            batch=batch,
            kind=IMPORTED,
            n_tools=n,
        )
        for batch, n in sorted(n_tools.items())
    ]
    return rows + [
        ToolRow(
            **usual
            | {name: value for name, value in told.get(tool_id, {}).items() if value != ""}
            | {"tool_id": tool_id, "design_id": design_id},
            campaign_id=campaign_id,
            batch=places[tool_id][0],
            slot=places[tool_id][1],
            confirmed_by="auto",
        )
        for tool_id, design_id in _tool_designs(lake, campaign_id, grasps).items()
    ]


def _tool_designs(lake: Lake, campaign_id: str, grasps: Sequence[HandoffGrasp]) -> dict[str, str]:
    """Return the design of each tool that is one: of a single design, and no other campaign's."""
    designs: dict[str, set[str]] = defaultdict(set)
    for grasp in grasps:
        if grasp.fidelity == "real":
            designs[grasp.tool_id].add(grasp.design_id)
    others = {}
    for row in lake.rows(ToolRow, tool_id=list(designs)):
        if row["campaign_id"] == campaign_id:
            designs[row["tool_id"]].add(row["design_id"])
        else:
            others[row["tool_id"]] = row["campaign_id"]
    found = {}
    for tool_id, design_ids in designs.items():
        if tool_id in others:
            why = f"is a tool of campaign {others[tool_id]}"
        elif len(design_ids) > 1:
            why = f"has {len(design_ids)} designs"
        else:
            (found[tool_id],) = design_ids
            continue
        _LOG.warning("tool %s %s: its grasps are imported, but the report cannot rank it", tool_id, why)
    return found
