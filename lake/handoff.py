"""The hand-off format, both directions: designs, grasps and traces of another lab or simulator.

A folder with `designs.csv`, `grasps.csv`, `traces.parquet` (or `traces.csv`) and, for simulated grasps,
optionally `simulations.csv`. Import writes everything or nothing and keeps every id and number; peak,
work and initial force are computed from the traces, in the frame of `GraspSetup`.
"""

import csv
import json
import os
import re
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, Literal, NamedTuple

import pyarrow as pa
import pyarrow.parquet as pq

from lake.files import TEMPORARY_PREFIX, discard, make_folder, publish, writing_failed
from lake.handoff_files import (
    DESIGN_COLUMNS,
    GRASP_COLUMNS,
    SIMULATION_COLUMNS,
    THETA_COLUMNS,
    TRACE_COLUMNS,
    Fault,
    Handoff,
    HandoffError,
    HandoffGrasp,
    read_handoff,
)
from lake.provenance import Provenance
from lake.store import Lake
from lake.tables import (
    DesignRow,
    GraspRow,
    Row,
    SimTraceRow,
    SimulationRow,
    SimulatorVersionRow,
    TraceRow,
    setup_columns,
)
from models import features
from models.errors import LakeError, UsageError
from models.ids import canonical_json, content_id
from models.records import GraspSetup

_TOOL_LABEL = re.compile(r"B(\d+)T(\d)$")
_TRACE_SCHEMA = pa.schema([(TRACE_COLUMNS[0], pa.string()), *((name, pa.float64()) for name in TRACE_COLUMNS[1:])])
_TRACES_AT_ONCE = 512  # traces held in memory while exporting


class HandoffCounts(NamedTuple):
    """How much was imported or exported."""

    n_designs: int
    n_real: int
    n_sim: int
    n_samples: int


def import_handoff(
    lake: Lake,
    directory: Path,
    provenance: Provenance,
    *,
    campaign_id: str | None = None,
    setup: GraspSetup | None = None,
) -> HandoffCounts:
    """Import a hand-off folder; importing it again changes nothing.

    Measured grasps become `grasps` and `traces` of the campaign `campaign_id` (default
    `import-<folder name>`), simulated ones `simulations` and `sim_traces`. `setup` is how the grasps were
    made, by default the one of the format (open gap 70, closed gap 16, tips 5 mm below the object).

    Raises:
        HandoffError: something is wrong; every fault is named and nothing was written.
    """
    directory = Path(directory)
    handoff = read_handoff(directory, lake.ids(DesignRow))
    _check_against_lake(lake, directory, handoff)
    campaign = campaign_id or f"import-{directory.resolve().name}"
    columns = setup_columns(setup or GraspSetup())
    rows: list[Row] = [DesignRow.of(design, design_id) for design_id, design in handoff.designs.items()]
    for grasp in handoff.grasps:
        rows += (
            _real_rows(grasp, campaign, columns) if grasp.fidelity == "real" else _sim_rows(grasp, campaign, columns)
        )
    lake.append(_unique(rows), provenance)
    return _counts(len(handoff.designs), handoff.grasps)


def export_handoff(
    lake: Lake,
    directory: Path,
    *,
    campaign_id: str | None = None,
    traces: Literal["parquet", "csv"] = "parquet",
) -> HandoffCounts:
    """Export the successful grasps and simulations that have traces, all or those of one campaign.

    Of a campaign, the simulations of its designs are exported. `directory` is made if missing and must
    hold no hand-off files yet.

    Raises:
        UsageError: the folder already holds files of this name, or cannot be written.
    """
    directory = Path(directory)
    names = ("designs.csv", "grasps.csv", "simulations.csv", "traces.csv", "traces.parquet")
    there = [name for name in names if (directory / name).exists()]
    if there:
        raise UsageError(f"{directory} already holds {', '.join(there)}; nothing was written: give a new folder.")
    real, sim = _exported_real(lake, campaign_id), _exported_sim(lake, campaign_id)
    wanted = {row["design_id"] for row in real} | {row["design_id"] for row in sim}
    designs = [row for row in lake.rows(DesignRow) if row["design_id"] in wanted]
    write_traces = _write_traces_parquet if traces == "parquet" else _write_traces_csv
    n_samples = [0]
    blocks = _counted(_sample_blocks(lake, real, sim), n_samples)
    files: list[tuple[str, Callable[[Path], None]]] = [
        ("designs.csv", lambda path: _write_csv(path, DESIGN_COLUMNS, designs)),
        ("grasps.csv", lambda path: _write_csv(path, GRASP_COLUMNS, real + sim)),
        (f"traces.{traces}", lambda path: write_traces(path, blocks)),
    ]
    if sim:
        files.append(("simulations.csv", lambda path: _write_csv(path, SIMULATION_COLUMNS, sim)))
    _write_all(directory, files)
    return HandoffCounts(len(designs), len(real), len(sim), n_samples[0])


def _check_against_lake(lake: Lake, directory: Path, handoff: Handoff) -> None:
    """Refuse ids that the lake already uses for something else."""
    faults = []
    known = {row.design_id: row.design for row in lake.records(DesignRow, design_id=list(handoff.designs))}
    for design_id, design in handoff.designs.items():
        if known.get(design_id, design) != design:
            limit = "is a design of the lake with other parameters; give it another id."
            faults.append(Fault("designs.csv", None, "design_id", design_id, limit))
    used = _used_ids(lake)
    for grasp in handoff.grasps:
        identity = (grasp.fidelity, grasp.design_id, grasp.object_id)
        if used.get(grasp.grasp_id, identity) != identity:
            limit = "is in the lake for another design, object or fidelity; give it another id."
            faults.append(Fault("grasps.csv", None, "grasp_id", grasp.grasp_id, limit))
    if faults:
        raise HandoffError(directory, faults)


def _used_ids(lake: Lake) -> dict[str, tuple[str, str, int]]:
    table = lake.query(
        "SELECT grasp_id AS id, 'real' AS fidelity, design_id, object_id FROM grasps UNION ALL "
        "SELECT simulation_id, 'sim', design_id, object_id FROM simulations"
    )
    return {row["id"]: (row["fidelity"], row["design_id"], row["object_id"]) for row in table.to_pylist()}


def _real_rows(grasp: HandoffGrasp, campaign_id: str, setup: dict[str, Any]) -> list[Row]:
    label = _TOOL_LABEL.search(grasp.tool_id)
    row = GraspRow(
        grasp_id=grasp.grasp_id,
        campaign_id=campaign_id,
        tool_id=grasp.tool_id,
        batch=int(label[1]) if label else None,
        slot=int(label[2]) if label else None,
        design_id=grasp.design_id,
        object_id=grasp.object_id,
        repeat=grasp.repeat,
        order=grasp.order,
        status="ok",
        started_at=grasp.started_at,
        peak_force_n=features.peak_force_n(grasp.trace),
        work_j=features.work_j(grasp.trace),
        initial_force_n=features.initial_force_n(grasp.trace),
        bench="real",
        **setup,
    )
    return [row, TraceRow.of(grasp.grasp_id, grasp.trace)]


def _sim_rows(grasp: HandoffGrasp, campaign_id: str, setup: dict[str, Any]) -> list[Row]:
    simulation = grasp.simulation or {}
    version = _version_row(campaign_id, {name: simulation.get(name) for name in THETA_COLUMNS})
    started_at = grasp.started_at.isoformat() if grasp.started_at else ""
    details = {"repeat": grasp.repeat, "tool_id": grasp.tool_id, "started_at": started_at, "order": grasp.order}
    row = SimulationRow(
        simulation_id=grasp.grasp_id,
        design_id=grasp.design_id,
        object_id=grasp.object_id,
        version_id=version.version_id,
        status="ok",
        peak_force_n=features.peak_force_n(grasp.trace),
        contact_force_n=simulation.get("contact_force_n"),
        work_j=features.work_j(grasp.trace),
        details_json=canonical_json(details),
        **setup,
    )
    return [version, row, SimTraceRow.of(grasp.grasp_id, grasp.trace)]


def _version_row(campaign_id: str, theta: dict[str, float | None]) -> SimulatorVersionRow:
    """The other lab's simulator, as far as it told."""
    content = {"imported": campaign_id, "theta": theta}
    return SimulatorVersionRow(
        version_id=content_id("V", content),
        version_json=canonical_json(content),
        tier="imported",
        effects_json="[]",
        **theta,
    )


def _unique(rows: Sequence[Row]) -> list[Row]:
    return list({(row.table, row.__dict__[row.id_column()]): row for row in rows}.values())


def _counts(n_designs: int, grasps: Sequence[HandoffGrasp]) -> HandoffCounts:
    n_real = sum(grasp.fidelity == "real" for grasp in grasps)
    n_samples = sum(len(grasp.trace.time_s) for grasp in grasps)
    return HandoffCounts(n_designs, n_real, len(grasps) - n_real, n_samples)


def _exported_real(lake: Lake, campaign_id: str | None) -> list[dict[str, Any]]:
    filters = {"campaign_id": campaign_id} if campaign_id else {}
    traced = lake.ids(TraceRow)
    rows = lake.rows(GraspRow, status="ok", **filters)
    return [_as_text(row) for row in rows if row["grasp_id"] in traced]


def _exported_sim(lake: Lake, campaign_id: str | None) -> list[dict[str, Any]]:
    filters = {}
    if campaign_id:
        of_campaign = "SELECT design_id FROM {} WHERE campaign_id = $id"
        sql = f"{of_campaign.format('grasps')} UNION {of_campaign.format('proposals')}"
        filters["design_id"] = lake.query(sql, {"id": campaign_id}).column(0).to_pylist()
    traced = lake.ids(SimTraceRow)
    theta = {row["version_id"]: {k: row[k] for k in THETA_COLUMNS} for row in lake.rows(SimulatorVersionRow)}
    nothing = {"repeat": 0, "tool_id": "", "started_at": "", "order": None}
    rows = [row for row in lake.rows(SimulationRow, status="ok", **filters) if row["simulation_id"] in traced]
    return [
        _as_text(
            row
            | nothing
            | {"grasp_id": row["simulation_id"], "fidelity": "sim"}
            | theta.get(row["version_id"], {})
            | {k: v for k, v in json.loads(row["details_json"]).items() if k in nothing}
        )
        for row in rows
    ]


def _as_text(row: dict[str, Any]) -> dict[str, Any]:
    started_at = row["started_at"]
    return row | {
        "started_at": started_at.isoformat() if started_at and not isinstance(started_at, str) else started_at
    }


def _sample_blocks(lake: Lake, real: list[dict[str, Any]], sim: list[dict[str, Any]]) -> Iterable[pa.Table]:
    """Samples as long tables in the order of the grasps, some hundred traces at a time."""
    for rows, table in ((real, TraceRow), (sim, SimTraceRow)):
        key = table.id_column()
        for start in range(0, len(rows), _TRACES_AT_ONCE):
            ids = [row["grasp_id"] for row in rows[start : start + _TRACES_AT_ONCE]]
            yield lake.query(
                f"SELECT {key} AS grasp_id, unnest(time_s) AS time_s, unnest(lift_mm) AS lift_mm, "
                f"unnest(force_n) AS force_n FROM (SELECT * FROM {table.table} WHERE {key} IN (SELECT unnest($ids)) "
                f"ORDER BY list_position($ids, {key}))",
                {"ids": ids},
            )


def _counted(blocks: Iterable[pa.Table], n_rows: list[int]) -> Iterable[pa.Table]:
    for block in blocks:
        n_rows[0] += block.num_rows
        yield block


def _write_all(directory: Path, files: Sequence[tuple[str, Callable[[Path], None]]]) -> None:
    """Write all files under temporary names, then name them all; after an error none is there."""
    staged: list[tuple[Path, Path]] = []
    try:
        make_folder(directory)
        for name, write in files:
            temporary = directory / f"{TEMPORARY_PREFIX}{os.getpid()}-{name}"
            staged.append((temporary, directory / name))
            write(temporary)
            _sync_file(temporary)
        for temporary, final in staged:
            publish(temporary, final)
    except (OSError, LakeError) as error:
        discard([path for pair in staged for path in pair])
        raise error if isinstance(error, LakeError) else writing_failed(directory, error) from error


def _sync_file(path: Path) -> None:
    with path.open("rb") as file:
        os.fsync(file.fileno())


def _write_csv(path: Path, columns: Sequence[str], rows: Sequence[dict[str, Any]]) -> None:
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(columns)
        writer.writerows([row[column] for column in columns] for row in rows)


def _write_traces_csv(path: Path, blocks: Iterable[pa.Table]) -> None:
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(TRACE_COLUMNS)
        for block in blocks:
            writer.writerows(zip(*(block[name].to_pylist() for name in TRACE_COLUMNS), strict=True))


def _write_traces_parquet(path: Path, blocks: Iterable[pa.Table]) -> None:
    with pq.ParquetWriter(path, _TRACE_SCHEMA, compression="zstd") as writer:
        for block in blocks:
            writer.write_table(block.select(list(TRACE_COLUMNS)).cast(_TRACE_SCHEMA))
