"""A world as an entrant gets it: a hand-off folder, and `asked.csv`, the grasps whose forces are to be foretold.

`designs.csv`, `grasps.csv` and `traces.parquet` are of the hand-off format, so `fast lake import` reads them, too.
Nothing here knows what is hidden.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from fast.flows.challenge.bank_table import read_bank
from fast.flows.challenge.manifest import BANK, TOOLS_PER_BATCH, Manifest, read_table
from fast.lake.handoff.export_folder import write_csv
from fast.lake.handoff.format import DESIGN_COLUMNS, GRASP_COLUMNS, TELLING_COLUMNS, TRACE_COLUMNS
from fast.models.design.fin_ray import FinRay
from fast.models.errors import UsageError
from fast.models.gap.data import GapData
from fast.models.gap.grasps import Grasps, of_one_setup
from fast.models.records import Design, GraspContext, GraspSetup, Trace
from fast.models.traces.step_features import N_STEPS, step_means

ASKED = "asked.csv"
_BEGAN = datetime(2026, 1, 5, 8, tzinfo=UTC)  # of the first batch; each batch has its own day
_SETUP = GraspSetup()
_FORCE_DIGITS, _TIME_DIGITS, _LIFT_DIGITS = 2, 4, 2  # of readings with a noise of 0.1 N, an encoder of 0.01 mm


@dataclass(frozen=True)
class Made:
    """A grasp that a lab made: numbers of its tool and object, what came before it, and its trace unless it got lost.

    is_asked: whether its trace is withheld.
    """

    tool: int
    obj: int
    context: GraspContext
    trace: Trace | None
    is_asked: bool


@dataclass(frozen=True, eq=False)
class GivenWorld:
    """What an entrant knows of a world: measured grasps with their bank, and grasps without forces to be foretold."""

    name: str
    data: GapData
    asked: Grasps


def write_world(folder: Path, made: Sequence[Made], designs: Mapping[str, Design], objects: Sequence[int]) -> None:
    """Write the files of a world. designs: by id, in the order of the tools."""
    folder.mkdir(parents=True)
    write_csv(folder / "designs.csv", DESIGN_COLUMNS, [{"design_id": n} | d.model_dump() for n, d in designs.items()])
    rows = [_describe(one, place, list(designs), objects) for place, one in enumerate(made)]
    told = (*GRASP_COLUMNS, *TELLING_COLUMNS, "status", "reason")
    write_csv(folder / "grasps.csv", told, [row for row, one in zip(rows, made, strict=True) if not one.is_asked])
    write_csv(folder / ASKED, GRASP_COLUMNS, [row for row, one in zip(rows, made, strict=True) if one.is_asked])
    shown = [
        (row["grasp_id"], one.trace) for row, one in zip(rows, made, strict=True) if one.trace and not one.is_asked
    ]
    lengths = [len(trace.time_s) for _, trace in shown]
    columns: list[Any] = [pa.array(np.repeat([name for name, _ in shown], lengths))]
    for name, digits in (("time_s", _TIME_DIGITS), ("lift_mm", _LIFT_DIGITS), ("force_n", _FORCE_DIGITS)):
        columns.append(np.round(np.concatenate([getattr(trace, name) for _, trace in shown]), digits))
    table = pa.table(dict(zip(TRACE_COLUMNS, columns, strict=True)))
    pq.write_table(
        table,
        folder / "traces.parquet",
        compression="zstd",
        compression_level=19,
        use_dictionary=["grasp_id", "force_n"],
        column_encoding={"time_s": "BYTE_STREAM_SPLIT", "lift_mm": "BYTE_STREAM_SPLIT"},
    )


def read_world(challenge: Path, name: str) -> GivenWorld:
    """Read a world of a challenge's folder, as FAST's own methods take it.

    Raises:
        UsageError: the folder lacks it.
    """
    folder, manifest = challenge / name, Manifest.read(challenge)
    if name not in manifest.worlds:
        raise UsageError(f"{challenge} has no world `{name}`; its worlds are {manifest.name_worlds()}.")
    rows = read_table(folder / "designs.csv")
    designs = {row.pop("design_id"): FinRay.model_validate(row) for row in rows if row["design_id"]}
    told = [*read_table(folder / "grasps.csv"), *read_table(folder / ASKED)]
    told.sort(key=lambda row: int(row["order"]))
    contexts = _list_contexts(told)
    objects = sorted({int(row["object_id"]) for row in told})
    steps_n = {key: step_means(trace) for key, trace in read_traces(folder / "traces.parquet").items()}
    names, tools = list(designs), {row["design_id"]: row["tool_id"] for row in told}
    nothing = np.full(N_STEPS, np.nan)
    grasps = Grasps(
        tools=tuple(tools[name] for name in names),
        designs=tuple(designs.values()),
        objects=tuple(objects),
        tool=np.array([names.index(row["design_id"]) for row in told]),
        obj=np.array([objects.index(int(row["object_id"])) for row in told]),
        contexts=tuple(contexts),
        steps_n=np.array([steps_n.get(row["grasp_id"], nothing) for row in told]),
        grasp_ids=tuple(row["grasp_id"] for row in told),
        noise=manifest.load_cell,
        **of_one_setup(len(told)),
    )
    is_asked = np.array(["status" not in row for row in told])
    is_measured = ~is_asked & np.isfinite(grasps.steps_n).all(axis=1)
    bank = read_bank(challenge / BANK, names, objects)
    data = GapData.of_all(grasps.select(np.flatnonzero(is_measured)), bank)
    return GivenWorld(name, data, grasps.select(np.flatnonzero(is_asked)))


def read_traces(path: Path) -> dict[str, Trace]:
    """Read the traces of a file of the hand-off format by grasp."""
    table = pq.read_table(path)
    names, first, counts = np.unique(np.array(table["grasp_id"]), return_index=True, return_counts=True)
    channels = [np.array(table[name]) for name in TRACE_COLUMNS[1:]]
    return {
        str(name): Trace(*(channel[start : start + n] for channel in channels))
        for name, start, n in zip(names, first, counts, strict=True)
    }


def name_grasp(tool: int, object_id: int, repeat: int) -> str:
    """Return the id of a grasp within its world."""
    return f"{_name_tool(tool)}-O{object_id:02d}-{repeat}"


def _name_tool(tool: int) -> str:
    batch, slot = divmod(tool, TOOLS_PER_BATCH)
    return f"B{batch + 1:02d}T{slot}"


def _describe(one: Made, place: int, design_ids: Sequence[str], objects: Sequence[int]) -> dict[str, Any]:
    began = _BEGAN + timedelta(days=one.tool // TOOLS_PER_BATCH, seconds=one.context.clock_s)
    return {
        "grasp_id": name_grasp(one.tool, objects[one.obj], one.context.repeat),
        "design_id": design_ids[one.tool],
        "object_id": objects[one.obj],
        "repeat": one.context.repeat,
        "fidelity": "real",
        "tool_id": _name_tool(one.tool),
        "started_at": began.isoformat(timespec="milliseconds"),
        "order": place,
        **{name: getattr(_SETUP, name) for name in TELLING_COLUMNS},
        "status": "ok" if one.trace is not None else "failed",
        "reason": "" if one.trace is not None else "the trace got lost",
    }


def _list_contexts(told: Sequence[Mapping[str, str]]) -> list[GraspContext]:
    """List what came before each grasp; told: all of a world, in order."""
    in_tool: dict[str, int] = {}
    in_batch: dict[str, int] = {}
    found = []
    for row in told:
        tool, batch = row["tool_id"], row["tool_id"].partition("T")[0]
        began = datetime.fromisoformat(row["started_at"])
        clock_s = (began - began.replace(hour=_BEGAN.hour, minute=0, second=0, microsecond=0)).total_seconds()
        repeat, of_tool, of_batch = int(row["repeat"]), in_tool.get(tool, 0), in_batch.get(batch, 0)
        found.append(GraspContext(repeat=repeat, tool_grasps=of_tool, batch_grasps=of_batch, clock_s=clock_s))
        in_tool[tool], in_batch[batch] = of_tool + 1, of_batch + 1
    return found
