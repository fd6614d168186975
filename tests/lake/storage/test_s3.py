"""A lake on a real S3-compatible server: what works in a folder works there, and what fails is one sentence."""

import io
import multiprocessing
import os
import signal
import time
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from fast.lake import leases
from fast.lake.leases import exclusive
from fast.lake.maintenance import Finding, check, compact, stats
from fast.lake.provenance import Provenance
from fast.lake.storage.s3_client import Connection
from fast.lake.store import Lake
from fast.lake.tables.campaign import TABLES, EventRow, GraspRow, TraceRow
from fast.models.errors import FastError, LakeError, LostLeaseError, UsageError
from tests.lake.lease_race import race_for_lease
from tests.lake.storage.object_server import BUCKET, READER, WRITER, ObjectServer
from tests.lake.storage.relay import Relay
from tests.lake.storage.test_concurrency import ROWS_PER_APPEND, rows_of
from tests.lake.storage.test_crash_kills import N_FIRST, N_LAST, acknowledged, kill_often, look

PROVENANCE = Provenance(code_version="x", code_dirty=False)
N_WRITERS, N_APPENDS = 2, 6


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    server = ObjectServer(tmp_path_factory.mktemp("objects") / "server")
    server.start()
    yield server
    server.kill()


@pytest.fixture
def relay(server):
    relay = Relay(server.port)
    yield relay
    relay.close()


@pytest.fixture
def address(server, relay, tmp_path, monkeypatch):
    use(monkeypatch, {**server.environment(endpoint=relay.endpoint), "XDG_STATE_HOME": str(tmp_path / "state")})
    return f"s3://{BUCKET}/labs/{tmp_path.name}"


@pytest.fixture
def lake(address):
    return Lake.open(address, create=True)


@pytest.fixture
def filled(lake, make_grasp):
    for repeat in range(3):
        lake.append(make_grasp(repeat=repeat, peak_n=10.0 + repeat), PROVENANCE)
    return lake


def use(monkeypatch: pytest.MonkeyPatch, environment: dict[str, str]) -> None:
    for name, value in environment.items():
        monkeypatch.setenv(name, value)


def elsewhere(lake: Lake, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Lake:
    """The same lake as another machine sees it, without the copies that are here."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "another machine"))
    found = Lake.open(lake.address)
    assert found.root != lake.root
    return found


def peaks(lake: Lake) -> list[int]:
    return sorted(round(row["peak_force_n"]) for row in lake.rows(GraspRow))


def test_rows_and_traces_come_back_on_another_machine(filled, server, make_grasp, make_trace, monkeypatch, tmp_path):
    assert [key.split("/")[0] for key in server.keys(filled.address)] == ["grasps"] * 3 + ["lake.json"] + ["traces"] * 3
    there = elsewhere(filled, monkeypatch, tmp_path)
    assert peaks(there) == peaks(filled) == [10, 11, 12]
    name = make_grasp(repeat=2)[0].grasp_id
    assert there.trace(name).force_n == pytest.approx(make_trace(12.0).force_n)
    assert there.query("SELECT count(*) AS n FROM traces").to_pylist() == [{"n": 3}]
    with there.connect() as connection:
        assert connection.sql("SELECT count(*) FROM traces WHERE list_max(force_n) > 9").fetchall() == [(3,)]
    assert {row.table: row.n_rows for row in stats(there) if row.n_rows} == {"grasps": 3, "traces": 3}


def test_an_address_may_come_as_a_path_and_names_are_told_apart(lake, monkeypatch):
    for same in (Path(lake.address), f"{lake.address}/"):
        assert (Lake.open(same).address, Lake.open(same).root) == (lake.address, lake.root)
    others = {Lake(f"s3://{BUCKET}/{name}").root for name in ("a/b", "a-b", "a/B")}
    monkeypatch.setenv("AWS_ENDPOINT_URL", "http://127.0.0.1:9")
    assert len(others | {Lake(f"s3://{BUCKET}/a/b").root}) == 4


@pytest.mark.parametrize("address", ["gs://lab/lake", "s3://", "http://127.0.0.1/lab"])
def test_another_address_is_refused(address):
    with pytest.raises(UsageError, match=r"is no lake: give a folder or s3://BUCKET/PREFIX with --lake"):
        Lake.open(address, create=True)


def test_a_query_lists_and_fetches_only_what_is_new(filled, relay, make_grasp, monkeypatch, tmp_path):
    assert filled.ids(GraspRow)
    relay.take()
    filled.ids(GraspRow)
    assert [request.split("?")[0] for request in relay.take()] == [f"GET /{BUCKET}"]
    filled.append(make_grasp(repeat=3), PROVENANCE)
    assert [request.split()[0] for request in relay.take()] == ["GET"] * 2 + ["PUT"] * 2  # names first
    filled.ids(GraspRow)
    assert len(relay.take()) == 1  # what was written here is here
    there = elsewhere(filled, monkeypatch, tmp_path)
    relay.take()
    there.ids(GraspRow)
    assert sorted(request.split()[0] for request in relay.take()) == ["GET"] * (2 + 4) + ["HEAD"] * 4
    for table in ("grasps", "traces"):
        assert there.query(f"SELECT count(*) AS n FROM {table}").to_pylist() == [{"n": 4}]


def test_rows_appended_again_count_once(filled, make_grasp):
    filled.append(make_grasp(repeat=2, peak_n=12.0), PROVENANCE)
    assert peaks(filled) == [10, 11, 12]
    filled.append(make_grasp(repeat=2, peak_n=15.0), PROVENANCE)
    assert peaks(filled) == [10, 11, 15]
    for table in ("grasps", "traces"):
        compact(filled, table)
    assert peaks(filled) == [10, 11, 15]


def test_compaction_leaves_one_object_with_every_row(filled, server, monkeypatch, tmp_path):
    there = elsewhere(filled, monkeypatch, tmp_path)
    assert peaks(there) == [10, 11, 12]
    result = compact(filled, TraceRow)
    assert (result.n_files_before, result.n_files_after, result.n_rows) == (3, 1, 3)
    assert len([key for key in server.keys(filled.address) if key.startswith("traces/")]) == 1
    assert compact(there, TraceRow).n_files_before == 1
    for lake in (filled, there):
        assert lake.query("SELECT count(*) AS n FROM traces").to_pylist() == [{"n": 3}]
        assert len(list((lake.root / "traces").iterdir())) == 1
        assert check(lake) == []


def test_a_compaction_that_dies_before_it_removes_doubles_nothing(filled, monkeypatch):
    def die(*_: object) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr(Connection, "delete", die)
        with pytest.raises(KeyboardInterrupt):
            compact(filled, TraceRow)
    assert filled.query("SELECT count(*) AS n FROM traces").to_pylist() == [{"n": 3}]
    assert compact(filled, TraceRow).n_files_after == 1
    assert filled.query("SELECT count(*) AS n FROM traces").to_pylist() == [{"n": 3}]


def write(environment: dict[str, str], address: str, writer: int) -> None:
    os.environ.update(environment)
    lake = Lake.open(address)
    for i in range(N_APPENDS):
        lake.append(rows_of(writer, i), PROVENANCE)


def merge(environment: dict[str, str], address: str, stop: "multiprocessing.synchronize.Event") -> None:
    os.environ.update(environment)
    lake = Lake.open(address)
    while not stop.is_set():
        for table in ("events", "sim_traces"):
            compact(lake, table)


def test_readers_see_whole_appends_while_others_write_and_merge(lake, server, relay, tmp_path):
    """Two writers and a compaction, each with a working folder of its own or shared with the reader."""
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["fast.lake.maintenance"])
    stop = context.Event()
    here = {**server.environment(endpoint=relay.endpoint), "XDG_STATE_HOME": os.environ["XDG_STATE_HOME"]}
    there = here | {"XDG_STATE_HOME": str(tmp_path / "another machine")}
    writers = [context.Process(target=write, args=(e, lake.address, w)) for w, e in enumerate([here, there])]
    merger = context.Process(target=merge, args=(there, lake.address, stop))
    for process in (*writers, merger):
        process.start()
    n_seen = 0
    while any(process.is_alive() for process in writers):
        n_traces, n_events = (
            lake.query(f"SELECT count(*) AS n FROM {t}")["n"][0].as_py() for t in ("sim_traces", "events")
        )
        assert n_traces % ROWS_PER_APPEND == n_events % ROWS_PER_APPEND == 0
        assert n_events >= n_seen
        n_seen = n_events
    stop.set()
    for process in (*writers, merger):
        process.join(60)
        assert process.exitcode == 0
    assert len(lake.ids(EventRow)) == N_WRITERS * N_APPENDS * ROWS_PER_APPEND
    assert lake.query("SELECT sum(len(force_n)) AS n FROM sim_traces")["n"][0].as_py() == 3 * len(lake.ids(EventRow))
    assert check(lake) == []


def kill_often_there(environment: dict[str, str], address: str, acks: Path, n_kills: int) -> None:
    os.environ.update(environment)
    kill_often(address, acks, n_kills)


@pytest.mark.parametrize("n_kills", [4, pytest.param(100, marks=pytest.mark.study)])
def test_kills_at_random_moments_lose_tear_and_double_nothing(lake, server, tmp_path, n_kills):
    acks = tmp_path / "acknowledged.txt"
    acks.touch()
    # Past the relay: a killed client is not a cut wire.
    environment = {**server.environment(), "XDG_STATE_HOME": str(tmp_path / "another machine")}
    killer = multiprocessing.get_context("spawn").Process(
        target=kill_often_there, args=(environment, lake.address, acks, n_kills)
    )
    killer.start()
    n_seen = 0
    try:
        while killer.is_alive():
            n_now = look(lake, acks)
            assert n_now >= n_seen
            n_seen = n_now
    finally:
        killer.terminate()
        killer.join(60)
    assert killer.exitcode == 0
    done = acknowledged(acks)
    assert done == set(range(len(done)))
    assert look(lake, acks) == look(Lake.open(lake.address), acks) == len(done) > N_FIRST + N_LAST
    assert check(lake) == []


def test_what_a_dying_process_left_in_the_working_folder_goes(filled):
    left = filled.root / "grasps" / ".writing-1-x"
    left.write_text("")
    assert peaks(filled) == [10, 11, 12]
    assert left.exists()
    os.utime(left, (0, 0))
    assert peaks(filled) == [10, 11, 12]
    assert not left.exists()


def die_within_an_upload(environment: dict[str, str], path: str) -> None:
    os.environ.update(environment)
    with Connection(BUCKET).files.open_output_stream(path) as stream:
        stream.write(b"x" * 2**24)
        stream.flush()
        os.kill(os.getpid(), signal.SIGKILL)


def test_a_writer_killed_within_an_upload_leaves_nothing_to_see(filled, server, relay):
    before = server.keys(filled.address)
    path = f"{filled.address.removeprefix('s3://')}/traces/rows-killed.parquet"
    process = multiprocessing.get_context("spawn").Process(
        target=die_within_an_upload, args=(server.environment(endpoint=relay.endpoint), path)
    )
    relay.take()
    process.start()
    process.join(60)
    assert process.exitcode == -signal.SIGKILL
    assert [request for request in relay.take() if "partNumber=" in request], "it died before it sent anything"
    assert server.keys(filled.address) == before
    assert check(filled) == []


@pytest.mark.parametrize("n_passed", [0, 1])
def test_a_server_that_goes_within_an_append_costs_a_sentence(filled, relay, make_grasp, n_passed):
    rows = make_grasp(repeat=7, peak_n=17.0)
    relay.cut_after(2 + n_passed)  # the names were told
    with pytest.raises(LakeError) as caught:
        filled.append(rows, PROVENANCE)
    assert str(caught.value) == (
        f"{filled.address} did not take all rows of this call, and some may be missing ({relay.endpoint} does not "
        "answer): start it or correct AWS_ENDPOINT_URL, then run the same command again, which duplicates nothing."
    )
    with pytest.raises(LakeError, match="could not be read .* does not answer"):
        filled.rows(GraspRow)
    relay.mend()
    assert peaks(filled) == [10, 11, 12]  # the samples come first, and are no grasp
    filled.append(rows, PROVENANCE)
    assert peaks(filled) == [10, 11, 12, 17]
    assert filled.query("SELECT count(*) AS n FROM traces").to_pylist() == [{"n": 4}]
    assert check(filled) == []
    assert not list(filled.root.rglob(".writing-*"))


def test_a_server_that_goes_within_a_compaction_loses_nothing(filled, relay):
    filled.ids(TraceRow)
    for n_passed in (1, 3):  # while the merged object is written, while the others are removed
        relay.cut_after(n_passed)
        with pytest.raises(LakeError, match="does not answer"):
            compact(filled, TraceRow)
        relay.mend()
        assert filled.query("SELECT count(*) AS n FROM traces").to_pylist() == [{"n": 3}]
    compact(filled, TraceRow)
    assert check(filled) == []


def refused(address: str, *, create: bool = False) -> str:
    with pytest.raises(FastError) as caught:
        Lake.open(address, create=create)
    return str(caught.value)


def test_what_the_server_refuses_is_one_sentence(filled, server, relay, make_grasp, monkeypatch):
    key = "correct AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY, or the permissions of this key, then run the same"
    assert refused("s3://elsewhere/lake", create=True) == (
        "s3://elsewhere/lake could not be made a lake (there is no such bucket): make it, or give another --lake."
    )
    assert refused(f"s3://{BUCKET}/none").startswith(f"s3://{BUCKET}/none is not a lake: give another --lake")
    assert refused(f"s3://{BUCKET}/labs", create=True) == (
        f"s3://{BUCKET}/labs is not empty and not a lake; nothing was written: give a new prefix with --lake."
    )
    use(monkeypatch, server.environment(READER, relay.endpoint))
    lake = Lake.open(filled.address)
    assert peaks(lake) == [10, 11, 12]
    with pytest.raises(UsageError, match=rf"did not take all rows .* \(access denied\): {key}"):
        lake.append(make_grasp(repeat=5), PROVENANCE)
    assert peaks(lake) == [10, 11, 12]
    use(monkeypatch, server.environment((WRITER[0], "wrong"), relay.endpoint))
    assert f"could not be read (access denied): {key}" in refused(filled.address)
    for name in ("AWS_ACCESS_KEY_ID", "AWS_SECRET_ACCESS_KEY"):
        monkeypatch.delenv(name)
    assert f"could not be read (access denied; AWS_ACCESS_KEY_ID is not set): {key}" in refused(filled.address)
    monkeypatch.setenv("AWS_ENDPOINT_URL", "http://127.0.0.1:9")
    assert "http://127.0.0.1:9 does not answer" in refused(filled.address)


def test_a_lake_that_is_deleted_is_not_an_empty_one(filled, server):
    assert peaks(filled) == [10, 11, 12]
    server.files().delete_dir(filled.address.removeprefix("s3://"))
    with pytest.raises(LakeError, match=r"is gone, or its bucket is; the copies in .* were kept"):
        filled.rows(GraspRow)
    assert len(list((filled.root / "grasps").iterdir())) == 3


def test_check_names_and_sets_aside_what_does_not_belong(filled, server):
    base = filled.address.removeprefix("s3://")
    wrong = pa.BufferOutputStream()
    pq.write_table(pa.table({"surprise": [1]}), wrong)
    for name, data in (
        ("grasps/rows-torn.parquet", b"torn"),
        ("traces/rows-wrong.parquet", wrong.getvalue()),
        ("grasps/notes.txt", b"mine"),
        ("holiday.jpg", b"sea"),
    ):
        with server.files().open_output_stream(f"{base}/{name}") as stream:
            stream.write(data)
    with pytest.raises(LakeError, match=r"rows-torn\.parquet is not a whole Parquet file"):
        filled.rows(GraspRow)
    found = check(filled)
    assert {(finding.kind, finding.path) for finding in found} == {
        ("torn", f"{filled.address}/grasps/rows-torn.parquet"),
        ("wrong_schema", f"{filled.address}/traces/rows-wrong.parquet"),
        ("foreign", f"{filled.address}/grasps/notes.txt"),
        ("foreign", f"{filled.address}/holiday.jpg"),
    }
    moved: list[Finding] = check(filled, quarantine=True)
    aside = [key for key in server.keys(filled.address) if key.startswith("quarantine/")]
    assert {str(finding.moved_to).removeprefix(f"{filled.address}/") for finding in moved} < set(aside)
    assert len(aside) == 2 * len(found)
    assert check(filled) == []
    assert peaks(filled) == [10, 11, 12]


def test_a_damaged_copy_is_fetched_again(filled):
    assert peaks(filled) == [10, 11, 12]
    first, second, _ = sorted((filled.root / "grasps").iterdir())
    first.write_bytes(first.read_bytes()[:100])  # as after a power cut
    assert peaks(filled) == peaks(Lake.open(filled.address)) == [10, 11, 12]
    second.write_bytes(bytes(second.stat().st_size))
    assert check(filled) == []
    assert peaks(Lake.open(filled.address)) == [10, 11, 12]


@pytest.mark.study
def test_more_objects_than_a_page_of_the_listing(lake, relay):
    n_appends = 1001
    for i in range(n_appends):
        lake.append([EventRow(event_id=f"E{i}", campaign_id="c", kind="k", message="")], PROVENANCE)
    assert len(lake.ids(EventRow)) == n_appends
    relay.take()
    assert len(lake.ids(EventRow)) == n_appends
    assert [request.split("?")[0] for request in relay.take()] == [f"GET /{BUCKET}"] * 2


def test_an_append_costs_little_more_than_one_into_a_folder(lake, make_grasp, tmp_path):
    """In time of this process; the bench waits for it."""
    rows = [make_grasp(repeat=repeat % 3, attempt=repeat // 3) for repeat in range(20)]

    def append_all(target: Lake) -> float:
        started = time.process_time()
        for grasp in rows:
            target.append(grasp, PROVENANCE)
        return time.process_time() - started

    there, here = append_all(lake), append_all(Lake.open(tmp_path / "folder", create=True))
    assert there < 8 * here
    assert len(lake.ids(GraspRow)) == len({row[0].grasp_id for row in rows})
    assert {row.table for row in stats(lake) if row.n_rows} == {"grasps", "traces"} <= {row.table for row in TABLES}


class _GoesWhileRead:
    """A store whose object is removed between the opening and the reading of it, as pyarrow reports that."""

    def open_input_stream(self, path: str) -> io.BytesIO:
        class Stream(io.BytesIO):
            def read(self, size: int | None = -1) -> bytes:
                raise OSError("AWS Error RESOURCE_NOT_FOUND during GetObject operation: ")

        return Stream()


def test_an_object_that_goes_while_it_is_read_is_not_there(monkeypatch):
    monkeypatch.setattr(Connection, "files", _GoesWhileRead())
    with pytest.raises(FileNotFoundError, match="lab/one"):
        Connection("lab").get("lab/one")


def test_of_many_that_take_a_lease_at_once_one_owns_and_who_lost_it_writes_no_row(lake, make_grasp, monkeypatch):
    assert race_for_lease(lake.address, 6) == (1, 5)
    monkeypatch.setattr(leases, "CHECKED_S", 0.0)
    with exclusive(lake.storage, "gantry", "busy"):
        epoch = max(int(Path(name).name.partition("-")[0]) for name in lake.storage.small_files("leases/gantry"))
        assert lake.storage.claim("leases/gantry", f"{epoch + 1:08d}", "{}") is not None  # by another host
        with pytest.raises(LostLeaseError, match=r"no longer owns the gantry of s3://.*was taken over"):
            lake.append(make_grasp(), PROVENANCE)
    assert peaks(lake) == []
