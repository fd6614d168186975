"""What the lake costs: appending grasps one by one, reading them back, compacting."""

import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from flows.benchmarks.base import Rows, Tables, timed


def measure_lake() -> Tables:
    """Append grasps one by one as the bench does, read them back, compact, read again."""
    from lake.maintenance import compact
    from lake.provenance import current_provenance
    from lake.store import Lake
    from lake.tables import GraspRow, TraceRow
    from models.records import Trace

    lift = np.linspace(0, 60, 1200)
    trace = Trace(time_s=lift / 5, lift_mm=lift, force_n=10 * np.exp(-lift / 20))
    rows: Rows = []
    with tempfile.TemporaryDirectory() as folder:
        found = Lake.open(Path(folder) / "lake", create=True)
        provenance = current_provenance()
        for n_grasps in (108, 1080):
            start = time.process_time()
            n_before = len(found.ids(GraspRow))
            for number in range(n_before, n_grasps):
                found.append([TraceRow.of(f"K{number}", trace), _grasp_row(number)], provenance)
            append_s = (time.process_time() - start) / (n_grasps - n_before)
            _, read_s = timed(lambda: found.query("SELECT tool_id, avg(peak_force_n) FROM grasps GROUP BY tool_id"))
            rows.append({"n_grasps": n_grasps, "append_cpu_ms": 1e3 * append_s, "first_query_cpu_s": read_s})
        _, compact_s = timed(lambda: [compact(found, table) for table in ("grasps", "traces")])
        fresh = Lake.open(found.root)
        _, read_s = timed(lambda: fresh.query("SELECT tool_id, avg(peak_force_n) FROM grasps GROUP BY tool_id"))
        rows.append({"n_grasps": n_grasps, "compact_cpu_s": compact_s, "first_query_cpu_s": read_s})
    return {"lake": rows}


def _grasp_row(number: int) -> Any:
    from lake.tables import GraspRow

    return GraspRow(
        grasp_id=f"K{number}",
        campaign_id="benchmark",
        tool_id=f"benchmark/B01T{number // 108}",
        design_id="D0",
        object_id=number % 36,
        repeat=number % 3,
        status="ok",
        peak_force_n=10.0,
        setup_id="G0",
        setup_json="{}",
        bench="virtual",
    )
