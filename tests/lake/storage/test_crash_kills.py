"""Writers and compactions killed with SIGKILL at random moments, while a reader looks at the lake all the time."""

import multiprocessing
import os
import random
import signal
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from fast.lake.maintenance import check, compact
from fast.lake.provenance import Provenance
from fast.lake.store import Lake
from fast.lake.tables.campaign import EventRow, Row, SimTraceRow

PROVENANCE = Provenance(code_version="x", code_dirty=False)
ROWS_PER_APPEND = 3
N_SAMPLES = 200
N_UNKILLED = 1000  # appends of a writer whose killer died first
N_LAST = 5  # appends of the writer that nobody kills
N_FIRST = 5  # appends of the writer that is timed, so that kills fall into the work of a busy machine too
WRITER_LIVES = 10  # at most, in appends
COMPACTION_LIVES = 24
LONGEST_APPEND_S = 0.05
COMPACT_EVERY = 4
SEED = 20261121


def rows_of(append: int) -> list[Row]:
    """Rows whose whole content follows from their id, the samples first as in a campaign."""
    rows: list[Row] = []
    for k in range(ROWS_PER_APPEND):
        samples = [append + k / 8] * N_SAMPLES
        rows += [
            SimTraceRow(simulation_id=f"{append}-{k}", time_s=samples, lift_mm=samples, force_n=samples),
            EventRow(event_id=f"{append}-{k}", campaign_id="c", kind="test", message=str(append)),
        ]
    return rows


def acknowledged(acks: Path) -> set[int]:
    return set(map(int, acks.read_text().split()))


def write(root: Path, acks: Path, n: int = N_UNKILLED) -> None:
    """Go on after the last acknowledged append, redoing one that was cut off; acknowledge each one that returned."""
    first = max(acknowledged(acks), default=-1) + 1
    lake = Lake.open(root)
    out = os.open(acks, os.O_WRONLY | os.O_APPEND)
    for append in range(first, first + n):
        lake.append(rows_of(append), PROVENANCE)
        os.write(out, f"{append}\n".encode())


def merge(root: Path) -> None:
    lake = Lake.open(root)
    for table in (SimTraceRow, EventRow):
        compact(lake, table)


def forked(work: Callable[..., None], *arguments: Path) -> int:
    pid = os.fork()
    if pid:
        return pid
    try:
        work(*arguments)
        os._exit(0)
    finally:
        os._exit(1)


def kill_often(root: Path, acks: Path, n_kills: int) -> None:
    """Start and kill writers one after the other, and beside every fourth a compaction."""
    random_ = random.Random(SEED)
    started = time.monotonic()
    write(root, acks, N_FIRST)
    append_s = min((time.monotonic() - started) / N_FIRST, LONGEST_APPEND_S)
    for turn in range(n_kills):
        doomed = [(random_.uniform(0, WRITER_LIVES * append_s), forked(write, root, acks))]
        if turn % COMPACT_EVERY == 0:
            doomed.append((random_.uniform(0, COMPACTION_LIVES * append_s), forked(merge, root)))
        started = time.monotonic()
        for lives_s, pid in sorted(doomed):
            time.sleep(max(0.0, started + lives_s - time.monotonic()))
            os.kill(pid, signal.SIGKILL)
            _, status = os.waitpid(pid, 0)
            if os.WIFEXITED(status) and os.WEXITSTATUS(status):
                os._exit(3)  # it failed before it was killed; its traceback is on stderr
    write(root, acks, N_LAST)


def look(lake: Lake, acks: Path) -> int:
    """Check everything a reader can see; returns the number of appends it saw."""
    wanted = acknowledged(acks)
    events = lake.query("SELECT message::INTEGER AS append, count(*) AS n FROM events GROUP BY ALL").to_pylist()
    seen = {row["append"] for row in events}
    assert wanted <= seen, f"acknowledged and lost: {wanted - seen}"
    assert all(row["n"] == ROWS_PER_APPEND for row in events), "an append is torn or twice there"
    traces = lake.query(
        "SELECT split_part(simulation_id, '-', 1)::INTEGER AS append, split_part(simulation_id, '-', 2)::INTEGER AS k, "
        "count(*) AS n, min(len(force_n)) AS n_samples, min(list_min(force_n)) AS lowest, "
        "max(list_max(time_s)) AS highest FROM sim_traces GROUP BY ALL"
    ).to_pylist()
    for row in traces:
        value = row["append"] + row["k"] / 8
        assert (row["n"], row["n_samples"], row["lowest"], row["highest"]) == (1, N_SAMPLES, value, value)
    assert seen <= {row["append"] for row in traces}, "a row is there without its samples"
    assert len(traces) % ROWS_PER_APPEND == 0
    return len(seen)


@pytest.mark.parametrize("n_kills", [12, pytest.param(200, marks=pytest.mark.study)])
def test_kills_at_random_moments_lose_tear_and_double_nothing(tmp_path, n_kills):
    lake = Lake.open(tmp_path / "lake", create=True)
    acks = tmp_path / "acknowledged.txt"
    acks.touch()
    killer = multiprocessing.get_context("spawn").Process(target=kill_often, args=(lake.root, acks, n_kills))
    killer.start()
    n_looks = n_seen = 0
    try:
        while killer.is_alive():
            n_now = look(lake, acks)
            assert n_now >= n_seen
            n_seen, n_looks = n_now, n_looks + 1
    finally:
        killer.terminate()
        killer.join(60)
    assert killer.exitcode == 0
    done = acknowledged(acks)
    assert done == set(range(len(done)))
    assert look(lake, acks) == look(Lake.open(lake.root), acks) == len(done)
    assert n_looks > 5
    assert len(done) > N_FIRST + N_LAST, "no append was acknowledged between kills: the moments are badly chosen"

    leftovers = list(lake.root.rglob(".writing-*"))
    assert leftovers, "no kill hit a write: the moments are badly chosen"
    long_ago = time.time() - 7200
    for path in leftovers:
        os.utime(path, (long_ago, long_ago))
    assert {(finding.kind, finding.path) for finding in check(lake)} == {("leftover", path) for path in leftovers}
    check(lake, quarantine=True)
    assert check(lake) == []
    assert look(lake, acks) == len(done)
