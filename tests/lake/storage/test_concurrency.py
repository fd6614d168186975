import multiprocessing
import time
from pathlib import Path

import pytest

from fast.lake.maintenance import check, compact
from fast.lake.provenance import Provenance
from fast.lake.store import Lake
from fast.lake.tables.campaign import EventRow, GraspRow, SimTraceRow, TraceRow
from fast.models.errors import LakeError

PROVENANCE = Provenance(code_version="x", code_dirty=False)
ROWS_PER_APPEND = 5


def rows_of(writer: int, i: int) -> list[EventRow | SimTraceRow]:
    names = [f"{writer}-{i}-{k}" for k in range(ROWS_PER_APPEND)]
    events = [EventRow(event_id=f"E{name}", campaign_id="c", kind="test", message=name) for name in names]
    channel = [0.0, 1.0, 2.0]
    return [
        *events,
        *(SimTraceRow(simulation_id=f"S{n}", time_s=channel, lift_mm=channel, force_n=channel) for n in names),
    ]


def write(root: Path, writer: int, n: int) -> None:
    lake = Lake.open(root)
    for i in range(n):
        lake.append(rows_of(writer, i), PROVENANCE)


def merge(root: Path, stop: "multiprocessing.synchronize.Event") -> None:
    lake = Lake.open(root)
    while not stop.is_set():
        for table in (EventRow, SimTraceRow):
            compact(lake, table)
        time.sleep(0.02)


def test_readers_see_whole_appends_while_others_write_and_merge(tmp_path):
    root = tmp_path / "lake"
    lake = Lake.open(root, create=True)
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["fast.lake.maintenance"])
    stop = context.Event()
    n_writers, n_appends = 2, 12
    writers = [context.Process(target=write, args=(root, w, n_appends)) for w in range(n_writers)]
    mergers = [context.Process(target=merge, args=(root, stop)) for _ in range(2)]
    for process in (*writers, *mergers):
        process.start()
    seen = []
    while any(process.is_alive() for process in writers):
        counts = [
            lake.query(f"SELECT count(*) AS n FROM {table}").to_pylist()[0]["n"] for table in ("sim_traces", "events")
        ]
        seen.append(counts)
        assert all(count % ROWS_PER_APPEND == 0 for count in counts)
        assert lake.query("SELECT sum(len(force_n)) AS n FROM sim_traces").to_pylist()[0]["n"] in (
            None,
            *range(0, 2000, 15),
        )
    stop.set()
    for process in (*writers, *mergers):
        process.join(60)
        assert process.exitcode == 0
    for before, after in zip(seen, seen[1:], strict=False):
        assert before[0] <= after[0]
        assert before[1] <= after[1]
    total = n_writers * n_appends * ROWS_PER_APPEND
    assert len(lake.ids(EventRow)) == len(lake.ids(SimTraceRow)) == total
    assert lake.query("SELECT count(*) AS n FROM events").to_pylist() == [{"n": total}]
    assert check(lake) == []


def die_while_writing(root: Path) -> None:
    lake = Lake.open(root)
    for i in range(10_000):
        lake.append(rows_of(9, i), PROVENANCE)


def test_a_killed_writer_leaves_only_whole_files(tmp_path):
    lake = Lake.open(tmp_path / "lake", create=True)
    context = multiprocessing.get_context("forkserver")
    for _ in range(3):
        process = context.Process(target=die_while_writing, args=(lake.root,))
        process.start()
        n_before = len(lake.ids(EventRow))
        deadline = time.monotonic() + 30
        while len(lake.ids(EventRow)) <= n_before and time.monotonic() < deadline and not n_before:
            time.sleep(0.01)
        process.kill()
        process.join(30)
        events = lake.ids(EventRow)
        assert events
        assert len(events) % ROWS_PER_APPEND == 0
        assert {e[1:] for e in events} <= {s[1:] for s in lake.ids(SimTraceRow)}
        assert not [finding for finding in check(lake) if finding.kind in ("torn", "wrong_schema")]


def test_a_trace_survives_its_file_being_merged_away(tmp_path):
    lake = Lake.open(tmp_path / "lake", create=True)
    channel = [0.0, 1.0]
    for i in range(3):
        lake.append([TraceRow(grasp_id=f"K{i}", time_s=channel, lift_mm=channel, force_n=[i, i])], PROVENANCE)
    assert lake.trace("K1").force_n[0] == 1
    compact(Lake.open(lake.root), TraceRow)
    assert lake.trace("K1").force_n[0] == 1
    assert lake.query("SELECT count(*) AS n FROM traces").to_pylist() == [{"n": 3}]
    with pytest.raises(LakeError):
        lake.trace("K9")
    assert lake.rows(GraspRow) == []


def write_and_read_in_forks(root: Path) -> None:
    lake = Lake.open(root)
    assert lake.query("SELECT sum(len(force_n)) AS n FROM sim_traces").to_pylist() == [{"n": 15}]
    process = multiprocessing.get_context("fork").Process(target=write, args=(root, 1, 1))
    reader = multiprocessing.get_context("fork").Process(target=lake.ids, args=(EventRow,))
    for child in (process, reader):
        child.start()
    for child in (process, reader):
        child.join(30)
        child.kill()
        assert child.exitcode == 0
    assert len(lake.ids(EventRow)) == 2 * ROWS_PER_APPEND


def test_a_forked_process_opens_its_own_connection(tmp_path):
    """The forks leave a process of their own: where a flow has run, Prefect's hooks make every fork exit with 1."""
    lake = Lake.open(tmp_path / "lake", create=True)
    lake.append(rows_of(0, 0), PROVENANCE)
    parent = multiprocessing.get_context("spawn").Process(target=write_and_read_in_forks, args=(lake.root,))
    parent.start()
    parent.join(120)
    parent.kill()
    assert parent.exitcode == 0
