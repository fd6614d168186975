"""Files in which grasps are told: a table of peaks, or a hand-off folder with traces."""

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from typing import Any

from fast.lake.handoff.answers import find_settings
from fast.lake.handoff.fields import time as read_time
from fast.lake.handoff.files import read_handoff
from fast.lake.tables.campaign import DesignRow
from fast.models.errors import UsageError
from fast.models.objects.catalogue import list_known
from fast.models.records import Trace, find_setup_id
from fast.models.validation import closest, plain
from fast.tasks.bench.machine_files.words import scale_of
from fast.tasks.bench.told import ToldGrasp
from fast.tasks.campaign.campaign import Campaign
from fast.tasks.campaign.csv_file import CsvRow, read_rows

NEEDED = ("tool_id", "object_id", "repeat", "peak_force_n")
OPTIONAL = ("object", "reason", "started_at")
_MISSING = ("nan", "NaT", "<NA>")  # how data frames write it

_FORCE_LIMIT = "it must be a finite number, in N, or empty with a reason beside it"
_WITH_UNIT = re.compile(r"(?P<number>[^A-Za-z]+?)\s*(?P<unit>[A-Za-z]+)")


def read_peaks(path: Path, notes: list[str] | None = None) -> list[ToldGrasp]:
    """Read the grasps of a table of peaks (`results.csv`); rows with neither peak nor reason are still to be made.

    notes: a list that takes a sentence about columns that were left out.

    Raises:
        UsageError: the file cannot be read, or a cell cannot be used.
    """
    ignored: list[str] = []
    rows = read_rows(path, NEEDED, OPTIONAL, ignored)
    if ignored and notes is not None:
        notes.append(f"{path.name}: columns that nobody knows were left out: {', '.join(ignored)}")
    told = [_read_row(row) for row in rows if row["peak_force_n"] or row.get("reason")]
    if not told:
        raise UsageError(f"{path} has no peak_force_n and no reason; fill in the rows of the grasps that were made.")
    return told


def _read_row(row: CsvRow) -> ToldGrasp:
    return ToldGrasp(
        place=row.place,
        tool_id=row["tool_id"],
        object_id=_read_object_once(row),
        repeat=row.integer("repeat"),
        peak_force_n=_read_force_n(row) if row["peak_force_n"] else None,
        reason=row.get("reason", ""),
        started_at=_read_time(row),
    )


def read_object(row: CsvRow, column: str) -> int:
    """Read the number of an object, which may be given by its name.

    Raises:
        UsageError: it is neither.
    """
    text = row[column].strip().casefold()
    names = {obj.name.casefold(): obj.object_id for obj in list_known()}
    if text in names:
        return names[text]
    if text.isdecimal():  # numbers of own objects have ten digits
        return int(text)
    if any(letter.isalpha() for letter in text):
        raise row.wrong(column, f"it must be a number or a name; {closest(text, list(names))}".rstrip("."))
    return row.integer(column)


def _read_object_once(row: CsvRow) -> int:
    """Read the object of a row; column `object` may not name another, and words there that name none are a remark."""
    object_id, name = read_object(row, "object_id"), row.get("object", "").strip().casefold()
    namesakes = {obj.object_id for obj in list_known() if obj.name.casefold() == name}
    if namesakes and object_id not in namesakes:
        raise row.wrong("object", f"but object_id is `{row['object_id']}`, another object; which was it")
    return object_id


def _read_force_n(row: CsvRow) -> float:
    """Read a force in N, or with its unit in the cell."""
    match = _WITH_UNIT.fullmatch(row["peak_force_n"].strip())
    scale = scale_of("force", match["unit"]) if match else None
    if match is None or scale is None:
        return row.number("peak_force_n", _FORCE_LIMIT)
    bare = CsvRow(row.place, row.decimal, {"peak_force_n": match["number"].strip()})
    return scale * bare.number("peak_force_n", _FORCE_LIMIT)


def _read_time(row: CsvRow) -> datetime | None:
    try:
        return read_time(row.get("started_at", ""))
    except ValueError as error:
        raise row.wrong("started_at", str(error).rstrip(".")) from error


def read_rows_of(grasps: Iterable[Mapping[str, Any]]) -> list[ToldGrasp]:
    """Read grasps told from Python: mappings with the columns of a table of peaks, or `trace` in place of the peak.

    Raises:
        UsageError: a key is missing or unknown, or a value is of the wrong kind.
    """
    known = {*NEEDED, *OPTIONAL, "trace"}
    told = []
    for number, grasp in enumerate(grasps, start=1):
        place = f"grasp {number}"
        if missing := [name for name in NEEDED[:3] if name not in grasp]:
            raise UsageError(f"{place}: `{missing[0]}` is missing; nothing was written: add it.")
        if unknown := [name for name in grasp if name not in known]:
            raise UsageError(f"{place}: unknown key `{unknown[0]}`; the keys are {', '.join(sorted(known))}.")
        cells = {name: _text_of(grasp.get(name)) for name in (*NEEDED, *OPTIONAL)}
        trace = grasp.get("trace")
        if not isinstance(trace, Trace) and _text_of(trace):
            raise UsageError(f"{place}: trace is of type {type(trace).__name__}, it must be a fast.Trace; change it.")
        one = _read_row(CsvRow(place, ".", cells))
        told.append(replace(one, trace=trace if isinstance(trace, Trace) else None))
    return told


def _text_of(value: Any) -> str:
    """Return the text of a value; empty for None, and for what a data frame has where nothing is known."""
    text = "" if value is None else str(plain(value))
    return "" if text in _MISSING else text


def read_folder(campaign: Campaign, folder: Path) -> list[ToldGrasp]:
    """Read the grasps of a hand-off folder: the plan with traces beside it, or with peaks and reasons in its rows.

    Raises:
        UsageError: it is no such folder, or something in it is wrong; all faults are named.
    """
    handoff = read_handoff(folder, campaign.lake.ids(DesignRow))
    if simulated := [grasp.grasp_id for grasp in handoff.grasps if grasp.fidelity != "real"]:
        raise UsageError(f"{folder}: grasp {simulated[0]} is simulated; tell measured grasps alone.")
    usual = campaign.config.grasp
    return [
        ToldGrasp(
            place=f"{folder} grasp {grasp.grasp_id}",
            tool_id=grasp.tool_id,
            object_id=grasp.object_id,
            repeat=grasp.repeat,
            peak_force_n=grasp.peak_force_n if grasp.status == "ok" else None,
            trace=grasp.trace if grasp.status == "ok" else None,
            reason=grasp.reason,
            started_at=grasp.started_at,
            setup_id=find_setup_id(*find_settings(grasp, usual)),
        )
        for grasp in handoff.grasps
    ]


def read_told(campaign: Campaign, paths: Sequence[Path], notes: list[str] | None = None) -> list[ToldGrasp]:
    """Read the grasps of tables of peaks and of hand-off folders.

    Raises:
        UsageError: something in them cannot be used.
    """
    told: list[ToldGrasp] = []
    for path in paths:
        told += read_folder(campaign, path) if path.is_dir() else read_peaks(path, notes)
    return told
