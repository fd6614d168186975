"""Worlds of the hidden-effect study as folders that `fast lake import` takes, without a word of what they hide."""

import csv
from collections.abc import Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from flows.benchmarks.gap_worlds import WorldKey, Worlds
from hardware.hidden.lab import TOOLS_PER_BATCH
from models.design.space import numbered_design
from models.ids import tool_label
from models.records import Design
from models.traces.step_features import is_usable

_START = datetime(2024, 3, 4, 8, 0, tzinfo=UTC)
_BATCH_APART = timedelta(days=2)


def write_handoff(worlds: Worlds, key: WorldKey, folder: Path) -> int:
    """Write designs, grasps and traces of a world; returns how many grasps. What it hides is nowhere in the files."""
    folder.mkdir(parents=True, exist_ok=True)
    designs = {f"design-{number:02d}": numbered_design(number) for number in worlds.panels.designs}
    names = list(designs)
    rows, samples = [], []
    for order, (site, trace) in enumerate(worlds.measure(key)):
        if not is_usable(trace):
            continue
        batch, slot = divmod(site.tool, TOOLS_PER_BATCH)
        grasp_id = f"{worlds_name(key)}-{order:04d}"
        started = _START + batch * _BATCH_APART + timedelta(seconds=site.context.clock_s)
        rows.append(
            [
                grasp_id,
                names[site.tool],
                worlds.panels.objects[site.obj],
                site.context.repeat,
                "real",
                tool_label(batch + 1, slot),
                started.isoformat(),
                order,
            ]
        )
        channels = {name: np.round(getattr(trace, name), 4) for name in ("time_s", "lift_mm", "force_n")}
        samples.append(pa.table({"grasp_id": [grasp_id] * len(trace.time_s), **channels}))
    head = ["grasp_id", "design_id", "object_id", "repeat", "fidelity", "tool_id", "started_at", "order"]
    _write_csv(folder / "grasps.csv", head, rows)
    parameters = list(Design.model_fields)
    values = [[name, *(getattr(design, field) for field in parameters)] for name, design in designs.items()]
    _write_csv(folder / "designs.csv", ["design_id", *parameters], values)
    pq.write_table(pa.concat_tables(samples), folder / "traces.parquet", compression="zstd")
    return len(rows)


def worlds_name(key: WorldKey) -> str:
    """A name that says nothing of what is hidden."""
    return f"world-{key.world_id[1:7]}"


def _write_csv(path: Path, head: Sequence[str], rows: Sequence[Sequence[object]]) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(head)
        writer.writerows(rows)
