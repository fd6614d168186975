"""The viewer as a process: it listens on loopback, sends nothing, says where it is, and does not fail in silence."""

import re
import socket
import urllib.request
from pathlib import Path

import psutil
import pytest
import rerun as rr

from fast.flows.viewer import window
from fast.flows.viewer.window import check_viewer, find_port, open_viewer
from fast.models.errors import FastError
from tests.flows.cli.cli_lakes import Fast, everything_in, proposed_lake


@pytest.fixture
def recording(tmp_path) -> Path:
    path = tmp_path / "x.rrd"
    with rr.RecordingStream("fast", recording_id="x") as stream:
        stream.save(path)
        stream.log("text", rr.TextLog("hello"))
    return path


def is_open(host: str, port: int) -> bool:
    with socket.socket() as probe:
        return probe.connect_ex((host, port)) == 0


@pytest.fixture
def no_screen(monkeypatch):
    for name in window.SCREENS:
        monkeypatch.delenv(name, raising=False)


def test_the_page_is_of_this_machine_and_may_ask_this_machine_only(recording, no_screen, monkeypatch):
    monkeypatch.delenv("CI", raising=False)
    with open_viewer(recording, is_page=True) as viewer:
        process = psutil.Process(viewer.process.pid)
        assert process.environ()["CI"]  # the switch of its usage data
        with urllib.request.urlopen(viewer.page_address, timeout=10) as answer:
            policy, page = answer.headers["Content-Security-Policy"], answer.read()
        assert b"Rerun" in page
        data_port, page_port = (int(re.search(r"127\.0\.0\.1:(\d+)/", address)[1])
                                for address in (viewer.data_address, viewer.page_address))  # fmt: skip
        for port in (data_port, page_port):
            assert is_open("127.0.0.1", port)
            assert not is_open("127.0.0.2", port)  # as it would be if it listened on all addresses
        assert policy.endswith(f"connect-src 'self' http://127.0.0.1:{data_port}")
        assert "https:" not in policy
        with urllib.request.urlopen(viewer.page_address.partition("?")[0] + "re_viewer.js", timeout=10) as answer:
            assert len(answer.read()) > 10_000
        started = [process, *process.children(recursive=True)]
        assert len(started) > 1  # `rerun` is a script that starts the viewer
    _, alive = psutil.wait_procs(started, timeout=10)
    assert alive == []


def test_two_viewers_do_not_meet(recording):
    with open_viewer(recording, is_page=True) as one, open_viewer(recording, is_page=True) as other:
        assert one.page_address != other.page_address
        assert one.data_address != other.data_address


def test_without_a_screen_a_sentence_names_web_before_anything_is_written(no_screen, capsys, tmp_path):
    lake = proposed_lake(tmp_path)
    before = everything_in(lake)
    assert "add --web" in Fast(capsys).refused("view", "quick", "--lake", lake)
    assert everything_in(lake) == before


def test_a_viewer_that_fails_is_one_sentence_and_no_success(recording, no_screen):
    with pytest.raises(FastError) as failure, open_viewer(recording, is_page=False) as viewer:
        viewer.wait()
    assert "DISPLAY is set" in str(failure.value)
    assert "try --web" in str(failure.value)


def test_the_address_stands_alone_on_the_last_line(no_screen, capsys, tmp_path, monkeypatch):
    def close(viewer: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(window.Viewer, "wait", close)
    answer = Fast(capsys)("view", "quick", "--web", "--lake", proposed_lake(tmp_path))
    assert answer.status == 0
    assert re.fullmatch(r"http://127\.0\.0\.1:\d+/\?url=\S+", answer.err.splitlines()[-1])


def test_a_port_that_is_taken_is_left_alone():
    with socket.create_server(("127.0.0.1", 0)) as taken:
        assert find_port(taken.getsockname()[1]) not in (0, taken.getsockname()[1])


def test_a_screen_is_enough(monkeypatch):
    monkeypatch.setenv("DISPLAY", ":0")
    check_viewer(is_page=False)
