"""Rows that studies of traces begin with: the measured grasps that count, their designs, and samples by id."""

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence

import numpy as np

from fast.lake.store import Lake
from fast.lake.tables.campaign import DesignRow, GraspRow, SimTraceRow, TraceRow
from fast.models.errors import UsageError
from fast.models.records import Design, GraspSetup, Placement, Trace


def measured_grasps(lake: Lake, campaign_id: str | None) -> list[GraspRow]:
    """List grasps that ended well, the last attempt of each repeat, by tool, object, repeat and setup.

    Raises:
        UsageError: nothing was measured, or on several benches, or a repeat was imported twice.
    """
    where = {"campaign_id": campaign_id} if campaign_id else {}
    rows = sorted(lake.records(GraspRow, status="ok", **where), key=lambda row: row.attempt)
    last = {_key(row): row for row in rows}
    place = f"campaign {campaign_id}" if campaign_id else f"the lake {lake.address}"
    if not last:
        raise UsageError(f"{place} has no measured grasps; measure tools, or import data with `fast lake import`.")
    _refuse_duplicates(place, rows)
    require_one_bench(((row.lab or "", f"{row.bench} {row.world_hash or ''}") for row in last.values()), place)
    return [last[key] for key in sorted(last)]


def require_one_bench(pairs: Iterable[tuple[str, str]], place: str) -> None:
    """Raise UsageError where a lab measured on several benches; those of several labs are fitted jointly.

    pairs: (lab, bench) of each grasp, lab empty where it has no name.
    """
    benches: dict[str, set[str]] = {}
    for lab, bench in pairs:
        benches.setdefault(lab, set()).add(bench.strip())
    for lab, found in benches.items():
        if len(found) > 1:
            of_lab = f" of the lab {lab}" if lab else ""
            raise UsageError(
                f"{place} has grasps of {len(found)} benches{of_lab} ({', '.join(sorted(found))}), which one "
                "calibration cannot compare; give one --campaign that has a single one."
            )


def find_base_setup(rows: Sequence[GraspRow]) -> GraspSetup:
    """Find the setup of ordinary grasps: that of most which nobody asked for, the object at its nominal place."""
    usual = [row for row in rows if row.request_id is None and row.placement == Placement()]
    counts = Counter(row.setup_json for row in sorted(usual or rows, key=lambda row: row.setup_id))
    return GraspSetup.model_validate_json(counts.most_common(1)[0][0])


def designs_of(lake: Lake, design_ids: Sequence[str]) -> dict[str, Design]:
    """Return designs by the id that rows of grasps have, which may be another lab's.

    Raises:
        UsageError: the lake lacks one.
    """
    wanted = sorted(set(design_ids))
    known = {row.design_id: row.design for row in lake.records(DesignRow, design_id=wanted)}
    unknown = [design_id for design_id in wanted if design_id not in known]
    if unknown:
        raise UsageError(f"measured design {unknown[0]} is not in the table of designs; import it with its parameters.")
    return {design_id: known[design_id] for design_id in wanted}


def read_traces(
    lake: Lake, table: type[TraceRow] | type[SimTraceRow], ids: Sequence[str]
) -> Iterator[tuple[str, Trace]]:
    """Read traces by id, as far as there are any, in one query.

    Raises:
        UsageError: the channels of a trace differ in length.
    """
    key = table.id_column()
    sql = f"SELECT {key}, time_s, lift_mm, force_n FROM {table.table} WHERE {key} IN (SELECT unnest(?))"
    columns = [column.combine_chunks() for column in lake.query(sql, [list(ids)]).columns]
    for row_id, *channels in zip(*columns, strict=True):
        try:
            trace = Trace(*(np.asarray(channel.values, dtype=float) for channel in channels))
        except ValueError as error:
            raise UsageError(f"trace {row_id.as_py()} cannot be used: {error}; leave that grasp out.") from error
        yield row_id.as_py(), trace


def _key(row: GraspRow) -> tuple[str, int, int, str, str, str]:
    """Tell which grasp a row is an attempt of."""
    return row.tool_id, row.object_id, row.repeat, row.setup_id, row.request_id or "", row.lab or ""


def _refuse_duplicates(place: str, rows: Sequence[GraspRow]) -> None:
    counts = Counter((*_key(row), row.attempt) for row in rows)
    twice = sorted(key for key, n in counts.items() if n > 1)
    if twice:
        tool_id, object_id, repeat, *_ = twice[0]
        raise UsageError(
            f"{place} has {len(twice)} repeats twice, first repeat {repeat} of tool {tool_id} on object {object_id}; "
            "number the repeats of a tool on an object 0, 1, 2 and import again."
        )
