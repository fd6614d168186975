import errno
import logging
import socket
import threading
import time
from datetime import UTC, datetime
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fast.hardware.bench import LogFolders, open_virtual_bench
from fast.hardware.parts.safe_state import StopAskedError, Verb
from fast.hardware.wire import log_files as wire_files
from fast.hardware.wire.log import WireEntry, WireLog
from fast.hardware.wire.log_files import WireFiles, list_logs, read_log, read_session
from fast.hardware.wire.modbus import tcp_link
from fast.models.errors import InterlockError, UsageError
from tests.hardware.safety.scenario_bench import TOOLS, WORLD, physics
from tests.waiting import wait_for


@pytest.fixture(autouse=True)
def _short_period(monkeypatch):
    monkeypatch.setattr(wire_files, "WRITE_PERIOD_S", 0.01)


def test_memory_is_bounded():
    log = WireLog(capacity=3, now_s=lambda: 1.5)
    for n in range(5):
        log.record("sent" if n % 2 else "received", b"\x18%d" % n)
    assert [entry.data for entry in log.entries()] == [b"\x182", b"\x183", b"\x184"]
    assert log.entries()[-1].as_text() == "1.500000 < b'\\x184'"


@given(st.floats(0, 1e7), st.sampled_from(["sent", "received", "note"]), st.binary(max_size=300))
def test_a_line_keeps_every_byte(time_s, direction, data):
    entry = WireEntry(round(time_s, 6), direction, data)
    assert WireEntry.from_text(entry.as_text()) == entry
    assert "\n" not in entry.as_text()


@given(st.text(max_size=60))
def test_rubbish_is_refused_and_never_run(text):
    with pytest.raises(ValueError, match="no line of a wire log"):
        WireEntry.from_text(text)
    with pytest.raises(ValueError, match="no line of a wire log"):
        WireEntry.from_text(f"1.000000 > b'' + {text}'")


def test_files_hold_what_the_memory_held(tmp_path):
    log = WireLog()
    log.note("opened")
    with WireFiles(tmp_path / "bench-log") as files:
        files.follow(log, "gantry", "/dev/ttyACM0")
        for n in range(500):
            log.record("sent", b"%d\n" % n)
            log.record("received", b"ok\r\n")
    (path,) = list_logs(tmp_path / "bench-log")
    assert path.name == f"{files.session}-gantry-0001.log"
    recorded = read_session(path)
    assert recorded.entries == tuple(e._replace(time_s=round(e.time_s, 6)) for e in log.entries())
    header = recorded.header
    assert (header.device, header.port, header.session) == ("gantry", "/dev/ttyACM0", files.session)
    assert abs(header.wall_time(recorded.entries[0].time_s) - datetime.now(UTC)).total_seconds() < 60
    assert not recorded.is_cut
    log.record("sent", b"the log of a closed session goes on in memory")


def test_a_killed_process_loses_only_the_last_instant(tmp_path):
    log = WireLog()
    files = WireFiles(tmp_path)
    files.follow(log, "plc", "here")
    log.record("sent", b"x")
    assert wait_for(lambda: any("b'x'" in path.read_text() for path in list_logs(tmp_path)))
    files.close()


def test_the_oldest_files_of_a_device_make_room(tmp_path):
    limit_bytes = 64_000
    for session in range(3):
        log = WireLog()
        with WireFiles(tmp_path, limit_bytes) as files:
            files.follow(log, "gantry", "a")
            files.follow(WireLog(), "plc", "nothing said, no file")
            for _ in range(40):
                log.record("sent", bytes(1000))
                wait_for(lambda log=log: not log._unwritten)
        assert read_session(list_logs(tmp_path)[-1]).is_cut == (session > 0 or sum_bytes(tmp_path) > limit_bytes / 2)
    assert limit_bytes / 2 < sum_bytes(tmp_path) <= limit_bytes + 5000
    assert {path.name.split("-")[2] for path in list_logs(tmp_path)} == {"gantry"}


def sum_bytes(folder):
    return sum(path.stat().st_size for path in list_logs(folder))


def test_a_full_disk_stops_nothing_and_is_tried_again(tmp_path, monkeypatch, caplog):
    monkeypatch.setattr(wire_files, "RETRY_S", 0.2)
    is_full = threading.Event()
    is_full.set()
    room = wire_files._Channel._make_room

    def make_room(channel):
        if is_full.is_set():
            raise OSError(errno.ENOSPC, "No space left on device")
        room(channel)

    monkeypatch.setattr(wire_files._Channel, "_make_room", make_room)
    log = WireLog()
    with caplog.at_level(logging.WARNING), WireFiles(tmp_path) as files:
        files.follow(log, "gantry", "a")
        log.record("sent", b"one")
        assert wait_for(lambda: "goes on in memory only: [Errno 28]" in caplog.text)
        is_full.clear()
        assert wait_for(lambda: bool(log.record("sent", b"more")) or list_logs(tmp_path))
    assert log.entries()[0].data == b"one"
    first = read_log(list_logs(tmp_path)[0]).entries[0]
    assert first.direction == "note"
    assert first.data.endswith(b" earlier pieces were not written")


def test_a_folder_that_cannot_be_made_stops_nothing(caplog):
    log = WireLog()
    with WireFiles(Path("/proc/bench-log")) as files:
        files.follow(log, "gantry", "a")
        log.record("sent", b"one")
    assert "goes on in memory only" in caplog.text
    assert [entry.data for entry in log.entries()] == [b"one"]


def test_pieces_that_nobody_fetched_are_counted():
    log = WireLog(capacity=10)
    log.keep_for_writing()
    for n in range(25):
        log.record("sent", b"%d" % n)
    taken, n_lost = log.take_unwritten()
    assert ([int(entry.data) for entry in taken], n_lost) == (list(range(15, 25)), 15)
    assert log.take_unwritten()[1] == 0


def test_a_torn_end_is_left_out_and_a_wrong_line_is_named(tmp_path):
    log = WireLog()
    with WireFiles(tmp_path) as files:
        files.follow(log, "gantry", "a")
        log.record("sent", b"one")
        log.record("sent", b"two")
    (path,) = list_logs(tmp_path)
    text = path.read_text()
    path.write_text(text[:-4])
    assert [entry.data for entry in read_log(path).entries] == [b"one"]
    path.write_text(text.replace("> b'one'", "> one"))
    with pytest.raises(UsageError, match="line 2: .*is no line of a wire log; remove the line"):
        read_log(path)
    path.write_text("hello\n")
    with pytest.raises(UsageError, match="is no wire log: it does not begin with"):
        read_log(path)
    with pytest.raises(UsageError, match="cannot be read: No such file"):
        read_log(tmp_path / "none.log")


def test_a_modbus_answer_in_pieces_is_logged_once():
    request = bytes.fromhex("0001 0000 0006 01 03 0006 0001")
    answer = bytes.fromhex("0001 0000 0005 01 03 02 002a")

    def serve(server):
        line, _ = server.accept()
        with line:
            line.recv(100)
            for piece in (answer[:3], answer[3:8], answer[8:]):
                line.sendall(piece)
                time.sleep(0.05)

    with socket.create_server(("127.0.0.1", 0)) as server:
        thread = threading.Thread(target=serve, args=(server,))
        thread.start()
        link = tcp_link("device", "127.0.0.1", server.getsockname()[1])
        assert link.read_registers(3, 6, 1) == [42]
        link.close()
        thread.join()
    entries = link.log.entries()
    assert b"".join(e.data for e in entries if e.direction == "received") == answer
    assert entries[1].data == request
    assert [e.data for e in entries if e.direction == "note"] == [b"opened", b"closed"]


def test_a_virtual_bench_in_memory_writes_its_last_traffic_when_an_error_ends_it(tmp_path):
    def pick_from_an_empty_slot(bench):
        bench.virtual.inject("slots_empty")
        bench.clock.sleep(0.1)  # a scan of the PLC
        bench.changer.pick(3)

    with pytest.raises(InterlockError, match="Slot 3 should hold"):
        work(tmp_path, pick_from_an_empty_slot)
    logs = list_logs(tmp_path)
    assert sorted(read_log(path).header.device for path in logs) == ["gantry", "load-cell", "plc"]
    said = b"".join(entry.data for path in logs for entry in read_log(path).entries)
    assert b"$H\n" in said


def test_it_writes_nothing_when_all_is_well_or_a_person_stops_it(tmp_path):
    def stop(bench):
        with bench.supervisor.guard():
            bench.supervisor.ask(Verb.STOP)
            bench.clock.sleep(1.0)

    work(tmp_path, lambda bench: bench.gantry.move_to(x_mm=700.0))
    with pytest.raises(StopAskedError):
        work(tmp_path, stop)
    assert list_logs(tmp_path) == []


def work(folder, do):
    with open_virtual_bench(WORLD, TOOLS, physics, wires="memory", logs=LogFolders(on_a_fault=folder)) as bench:
        do(bench)
