"""A bench plan as a hand-off folder without its samples: whoever makes the grasps adds them, and gives it back."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from fast.lake.handoff.export_folder import list_design_columns, write_csv, write_files
from fast.lake.handoff.format import FILE_NAMES, GRASP_COLUMNS, HOW_COLUMNS
from fast.lake.store import Lake
from fast.lake.tables.campaign import DesignRow, GraspRow, ProposalRow, ToolRow
from fast.models.errors import UsageError
from fast.models.objects.catalogue import get_object
from fast.models.records import GraspRequest

SHEET, RESULTS = "sheet.html", "results.csv"
RESULT_COLUMNS = ("tool_id", "object_id", "object", "repeat", "peak_force_n", "reason")


def write_plan(
    lake: Lake, requests: Sequence[GraspRequest], sheet_html: str, directory: Path, *, is_told: bool = False
) -> None:
    """Write `designs.csv`, `grasps.csv` in the order of the requests, and the sheet for whoever makes them.

    is_told: a bench of one's own answers, which may know peaks alone; they are written into `results.csv`. Its tools
    may be not printed yet.

    Raises:
        UsageError: the folder holds files of these names, or cannot be written, or a tool is no longer there.
    """
    there = [name for name in (*FILE_NAMES, RESULTS, SHEET) if (directory / name).exists()]
    if there:
        raise UsageError(f"{directory} already holds {', '.join(there)}; nothing was written: give a new folder.")
    tools = find_tools(lake, requests, are_printed=not is_told)
    designs = lake.rows(DesignRow, design_id=[row.design_id for row in tools.values()])
    rows = [_row(request, tools[request.tool_id], place) for place, request in enumerate(requests)]
    results = [_result_row(request) for request in requests]
    write_files(
        directory,
        [
            ("designs.csv", lambda path: write_csv(path, list_design_columns(designs), designs)),
            ("grasps.csv", lambda path: write_csv(path, (*GRASP_COLUMNS, *HOW_COLUMNS), rows)),
            *([(RESULTS, lambda path: write_csv(path, RESULT_COLUMNS, results))] if is_told else []),
            (SHEET, lambda path: _write_text(path, sheet_html)),
        ],
    )


def find_tools(lake: Lake, requests: Sequence[GraspRequest], *, are_printed: bool = True) -> dict[str, ToolRow]:
    """Find rows of the tools that requests need, by id; those that will be printed, if they need not be yet.

    Raises:
        UsageError: one is not in the lake, or was rejected.
    """
    wanted = list(dict.fromkeys(request.tool_id for request in requests))
    rows = {} if are_printed else _find_proposed(lake, wanted)
    rows |= {row.tool_id: row for row in lake.records(ToolRow, tool_id=wanted)}
    for tool_id in wanted:
        row = rows.get(tool_id)
        if row is None or row.status == "rejected":
            why = "is not in the table of tools" if row is None else f"was rejected ({row.reason or 'no reason given'})"
            n = sum(request.tool_id == tool_id for request in requests)
            raise UsageError(
                f"{n} of {len(requests)} grasps are asked of tool {tool_id}, which {why}; mount it again and confirm "
                "it with `fast print confirm`, or run `fast gap` again to ask for grasps of the tools that are there."
            )
    return rows


def _find_proposed(lake: Lake, tool_ids: Sequence[str]) -> dict[str, ToolRow]:
    """Find tools as they will be, by id."""
    campaigns = sorted({tool_id.rpartition("/")[0] for tool_id in tool_ids})
    return {
        tool_id: ToolRow(
            tool_id=tool_id,
            campaign_id=row.campaign_id,
            batch=row.batch,
            slot=row.slot,
            design_id=row.design_id,
            status="printed",
            confirmed_by="auto",
        )
        for row in lake.records(ProposalRow, campaign_id=campaigns, fidelity="real")
        if row.batch is not None
        and row.slot is not None
        and (tool_id := ToolRow.make_id(row.campaign_id, row.batch, row.slot)) in tool_ids
    }


def _result_row(request: GraspRequest) -> dict[str, Any]:
    name = get_object(request.object_id).name
    return {**dict.fromkeys(RESULT_COLUMNS, ""), **request.model_dump(include=set(RESULT_COLUMNS)), "object": name}


def _row(request: GraspRequest, tool: ToolRow, place: int) -> dict[str, Any]:
    return {
        "grasp_id": GraspRow.make_id(request.tool_id, request.object_id, request.repeat, 0, request.request_id),
        "design_id": tool.design_id,
        "object_id": request.object_id,
        "repeat": request.repeat,
        "fidelity": "real",
        "tool_id": request.tool_id,
        "started_at": "",
        "order": place,
        **request.setup.model_dump(),
        **request.placement.model_dump(),
        "request_id": request.request_id,
    }


def _write_text(path: Path, text: str) -> None:
    path.write_text(text, encoding="utf-8")
