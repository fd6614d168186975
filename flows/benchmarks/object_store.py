"""What a lake in an object store costs: appending, noticing, a trace by id, compacting, the first look of a machine."""

import os
import statistics
import tempfile
import time
import uuid
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from typing import TYPE_CHECKING

from flows.benchmarks.base import Tables
from models.errors import UsageError

if TYPE_CHECKING:
    from lake.store import Lake

N_BATCH, N_LOOKED_UP = 1_080, 50


def measure_object_store() -> Tables:
    """What a batch of 1,080 grasps costs in the object store FAST_LAKE=s3://BUCKET/PREFIX, in a lake made there."""
    from lake.storage.s3_client import Connection
    from lake.store import Lake

    address = os.environ.get("FAST_LAKE", "")
    if not address.startswith("s3://"):
        raise UsageError(
            f"FAST_LAKE is `{address}`, this benchmark needs an object store: set it to s3://BUCKET/PREFIX."
        )
    with _machine():
        lake = Lake.open(f"{address.rstrip('/')}/benchmark-{uuid.uuid4().hex[:8]}", create=True)
        try:
            return {"object_store": [{"n_grasps": N_BATCH, **_costs(lake, N_BATCH)}]}
        finally:
            path = lake.address.removeprefix("s3://")
            Connection(path.split("/")[0]).files.delete_dir(path)


def _costs(lake: "Lake", n_grasps: int) -> dict[str, float]:
    from flows.benchmarks.made_up_lake import rows
    from lake.maintenance import compact
    from lake.provenance import current_provenance
    from lake.store import Lake
    from lake.tables.campaign import GraspRow, TraceRow

    provenance = current_provenance()
    grasps = list(rows(0, n_grasps))
    append_s, seen_s = [], []
    for number, grasp in enumerate(grasps):
        append_s.append(_wall(partial(lake.append, grasp, provenance)))
        if number < N_LOOKED_UP:
            seen_s.append(_wall(partial(_look, lake)))
    _look(lake)
    ids = [str(grasp[0].__dict__["grasp_id"]) for grasp in grasps[:N_LOOKED_UP]]
    with _machine():
        first_look_s = _wall(lambda: _look(Lake.open(lake.address)))
    loose_trace_s = [_wall(partial(lake.trace, grasp_id)) for grasp_id in ids]
    compact_s = _wall(lambda: [compact(lake, table) for table in (GraspRow, TraceRow)])
    _look(lake)
    return {
        "append_wall_ms": 1e3 * statistics.median(append_s),
        "append_95_percent_wall_ms": 1e3 * statistics.quantiles(append_s, n=20)[-1],
        "seen_wall_ms": 1e3 * statistics.median(seen_s),
        "first_look_wall_s": first_look_s,
        "trace_wall_ms": 1e3 * statistics.median(loose_trace_s),
        "compact_wall_s": compact_s,
        "trace_compacted_wall_ms": 1e3 * statistics.median(_wall(partial(lake.trace, each)) for each in ids),
        "unchanged_wall_ms": 1e3 * statistics.median(_wall(partial(_look, lake)) for _ in ids),
    }


@contextmanager
def _machine() -> Iterator[None]:
    """Work as on a machine that has no copy of any object yet."""
    name = "XDG_STATE_HOME"
    before = os.environ.get(name)
    with tempfile.TemporaryDirectory(prefix="fast-objects-") as folder:
        os.environ[name] = folder
        try:
            yield
        finally:
            if before is None:
                del os.environ[name]
            else:
                os.environ[name] = before


def _look(lake: "Lake") -> None:
    """Have the lake read what is new."""
    from lake.tables.campaign import GraspRow, TraceRow

    for table in (GraspRow, TraceRow):
        lake.has(table, "")


def _wall(work: Callable[[], object]) -> float:
    """Wall seconds of `work`, which waits for the network."""
    start = time.perf_counter()
    work()
    return time.perf_counter() - start
