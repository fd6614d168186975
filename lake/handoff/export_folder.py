"""Export in the hand-off format: designs, grasps and traces for another lab or simulator."""

import csv
import json
import os
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, Literal

import pyarrow as pa
import pyarrow.parquet as pq

from fast.lake.handoff.format import (
    DESIGN_COLUMNS,
    END_COLUMNS,
    FAMILY_COLUMNS,
    FILE_NAMES,
    GRASP_COLUMNS,
    HOW_COLUMNS,
    MATERIAL_COLUMNS,
    OBJECTS_FILE,
    RECIPE_COLUMNS,
    SIMULATION_COLUMNS,
    TELLING_COLUMNS,
    THETA_COLUMNS,
    TOOL_COLUMNS,
    TRACE_COLUMNS,
)
from fast.lake.handoff.import_folder import HandoffCounts
from fast.lake.provenance import PACKAGE
from fast.lake.storage.files import TEMPORARY_PREFIX, discard, make_folder, publish
from fast.lake.store import Lake
from fast.lake.tables.campaign import (
    DesignRow,
    GraspRow,
    ObjectRow,
    SimTraceRow,
    SimulationRow,
    SimulatorVersionRow,
    ToolRow,
    TraceRow,
)
from fast.lake.tables.catalogue_rows import read_lot_rows
from fast.lake.tables.imported import importing_campaign
from fast.models.errors import LakeError, UsageError, describe_cause
from fast.models.records import GraspSetup

_TRACE_SCHEMA = pa.schema([(TRACE_COLUMNS[0], pa.string()), *((name, pa.float64()) for name in TRACE_COLUMNS[1:])])
_TRACES_AT_ONCE = 512  # traces held in memory while exporting


def export_handoff(
    lake: Lake,
    directory: Path,
    *,
    campaign_id: str | None = None,
    traces: Literal["parquet", "csv"] = "parquet",
) -> HandoffCounts:
    """Export the measured grasps, the simulations that have traces, and all designs; or those of one campaign.

    Of a campaign, the simulations of its designs and those imported with it are exported, and the designs of
    what is exported. `directory` is made if missing and must hold no hand-off files yet.

    Raises:
        UsageError: the folder already holds files of this name, or cannot be written.
    """
    directory = Path(directory)
    there = [name for name in FILE_NAMES if (directory / name).exists()]
    if there:
        raise UsageError(f"{directory} already holds {', '.join(there)}; nothing was written: give a new folder.")
    real, sim = _exported_real(lake, campaign_id), _exported_sim(lake, campaign_id)
    wanted = {row["design_id"] for row in real} | {row["design_id"] for row in sim}
    designs = [row for row in lake.rows(DesignRow) if campaign_id is None or row["design_id"] in wanted]
    write_traces = _write_traces_parquet if traces == "parquet" else _write_traces_csv
    n_samples = [0]
    blocks = _counted(_sample_blocks(lake, real, sim), n_samples)
    columns = (*GRASP_COLUMNS, *_list_told(real + sim), *_list_ends(real))
    files: list[tuple[str, Callable[[Path], None]]] = [
        ("designs.csv", lambda path: write_csv(path, list_design_columns(designs), designs)),
        (
            "grasps.csv",
            lambda path: write_csv(path, columns, real + sim),
        ),
    ]
    if sim or lake.ids(TraceRow, grasp_id=[row["grasp_id"] for row in real]):
        files.append((f"traces.{traces}", lambda path: write_traces(path, blocks)))
    own = _find_own_objects(lake, {row["object_id"] for row in real + sim})
    if tools := _find_tools(lake, real):
        of_tools = (*TOOL_COLUMNS, *RECIPE_COLUMNS) if any(row["recipe"] for row in tools) else TOOL_COLUMNS
        files.append(("tools.csv", lambda path: write_csv(path, of_tools, tools)))
        lots = sorted({row["material_lot"] for row in tools if row["material_lot"]})
        if materials := [row.model_dump() for row in read_lot_rows(lake, lots)]:
            files.append(("materials.csv", lambda path: write_csv(path, MATERIAL_COLUMNS, materials)))
    if own:
        files.append((OBJECTS_FILE, lambda path: _write_objects(path, own)))
    if sim:
        files.append(("simulations.csv", lambda path: write_csv(path, SIMULATION_COLUMNS, sim)))
    write_files(directory, files)
    return HandoffCounts(len(designs), len(real), len(sim), n_samples[0])


def list_design_columns(rows: Sequence[dict[str, Any]]) -> tuple[str, ...]:
    """List columns of designs.csv; the family only where one is no fin ray."""
    return (*DESIGN_COLUMNS, *FAMILY_COLUMNS) if any(row["family"] for row in rows) else DESIGN_COLUMNS


def _list_ends(rows: Sequence[dict[str, Any]]) -> list[str]:
    """List columns of where grasps were made and how they ended that say more than an unnamed bench and success."""
    usual = {"bench": "real", "status": "ok", "attempt": 0}
    return [name for name in END_COLUMNS if any((row[name] or None) != (usual.get(name) or None) for row in rows)]


def _find_tools(lake: Lake, real: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Find tools of the grasps of which a person said or measured something."""
    rows = lake.rows(ToolRow, tool_id=sorted({row["tool_id"] for row in real}))
    usual = ("tool_id", "design_id", "status", "operator")
    said = [name for name in (*TOOL_COLUMNS, *RECIPE_COLUMNS) if name not in usual]
    return [row for row in rows if any(row[name] not in (None, "") for name in said)]


def _find_own_objects(lake: Lake, object_ids: set[int]) -> list[ObjectRow]:
    """Find own objects among those of the grasps, in the order of their numbers."""
    rows = lake.records(ObjectRow, object_id=sorted(object_ids))
    return sorted((row for row in rows if row.shape is not None), key=lambda row: row.object_id)


def _write_objects(path: Path, rows: Sequence[ObjectRow]) -> None:
    entries = [{"object_id": row.object_id, "name": row.name, "shape": row.shape} for row in rows]
    path.write_text(json.dumps(entries, indent=1) + "\n", encoding="utf-8")


def _list_told(rows: Sequence[dict[str, Any]]) -> list[str]:
    """List columns of how a grasp was made: those that matter most, and others that differ from the usual."""
    usual: dict[str, Any] = GraspSetup().model_dump()
    differing = {name for name in HOW_COLUMNS if any((row[name] or None) != (usual.get(name) or None) for row in rows)}
    return [name for name in HOW_COLUMNS if name in differing or name in TELLING_COLUMNS]


def _exported_real(lake: Lake, campaign_id: str | None) -> list[dict[str, Any]]:
    filters = {"campaign_id": campaign_id} if campaign_id else {}
    traced = lake.ids(TraceRow)
    rows = [_as_text(row) for row in lake.rows(GraspRow, **filters)]
    untold = {"peak_force_n": None}  # of a grasp with samples: it follows from them
    return [
        row
        | ({"software": f"{PACKAGE} {row['code_version']}"} if row["software"] is None else {})  # our own
        | (untold if row["grasp_id"] in traced else {})
        for row in rows
    ]


def _exported_sim(lake: Lake, campaign_id: str | None) -> list[dict[str, Any]]:
    traced = lake.ids(SimTraceRow)
    versions = {row["version_id"]: row for row in lake.rows(SimulatorVersionRow)}
    nothing = dict.fromkeys(END_COLUMNS) | {
        "repeat": 0,
        "tool_id": "",
        "started_at": "",
        "order": None,
        "request_id": None,
    }
    rows = [row for row in lake.rows(SimulationRow, status="ok") if row["simulation_id"] in traced]
    if campaign_id:
        of_campaign = "SELECT design_id FROM {} WHERE campaign_id = $id"
        sql = f"{of_campaign.format('grasps')} UNION {of_campaign.format('proposals')}"
        designs = set(lake.query(sql, {"id": campaign_id}).column(0).to_pylist())
        imported = {name for name, row in versions.items() if importing_campaign(row["version_json"]) == campaign_id}
        rows = [row for row in rows if row["design_id"] in designs or row["version_id"] in imported]
    return [
        _as_text(
            row
            | nothing
            | {"grasp_id": row["simulation_id"], "fidelity": "sim"}
            | {name: versions.get(row["version_id"], {}).get(name) for name in THETA_COLUMNS}
            | {k: v for k, v in json.loads(row["details_json"]).items() if k in nothing}
        )
        for row in rows
    ]


def _as_text(row: dict[str, Any]) -> dict[str, Any]:
    started_at = row["started_at"]
    setup = GraspSetup.model_validate_json(row["setup_json"])
    return (
        setup.model_dump()
        | row
        | {"started_at": started_at.isoformat() if started_at and not isinstance(started_at, str) else started_at}
    )


def _sample_blocks(lake: Lake, real: list[dict[str, Any]], sim: list[dict[str, Any]]) -> Iterable[pa.Table]:
    """Yield samples as long tables in the order of the grasps, some hundred traces at a time."""
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


def write_files(directory: Path, files: Sequence[tuple[str, Callable[[Path], None]]]) -> None:
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
        if isinstance(error, LakeError):
            raise
        why = f"{directory} cannot be written ({describe_cause(error)}); nothing was written: give another folder"
        raise UsageError(f"{why}, or free disk space.") from error


def _sync_file(path: Path) -> None:
    with path.open("rb") as file:
        os.fsync(file.fileno())


def write_csv(path: Path, columns: Sequence[str], rows: Sequence[dict[str, Any]]) -> None:
    """Write these columns of rows, with a header."""
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
