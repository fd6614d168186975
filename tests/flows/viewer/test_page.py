"""The viewer as a page: who has the key gets Rerun's page and the recording, and Rerun itself is gone by then."""

import os
import re
import socket
import stat
import threading
from pathlib import Path

import httpx
import psutil
import pytest

from fast.flows.cli import results
from fast.flows.server.access import Api, address_for_person
from fast.flows.viewer import page
from fast.flows.viewer.page import POLICY, RECORDING, open_page, read_files
from fast.models.errors import FastError
from tests.flows.cli.cli_lakes import Fast, proposed_lake

LOGIN = "fast:open"


@pytest.fixture(autouse=True)
def no_password(monkeypatch):
    monkeypatch.delenv("FAST_PASSWORD", raising=False)


@pytest.fixture(scope="module")
def files():
    return read_files()


@pytest.fixture
def recording(tmp_path) -> Path:
    path = tmp_path / "x.rrd"
    path.write_bytes(b"first ")
    return path


def test_the_page_asks_this_server_only_and_brings_its_cookie(files):
    assert not [one for one in psutil.Process().children(recursive=True) if "rerun_cli" in one.cmdline()]
    content, kind = files["/"]
    assert kind.startswith("text/html")
    assert b'credentials: "same-origin"' in content  # or the recording would be refused
    assert content.startswith(b"<!doctype html>")
    assert len(files["/re_viewer_bg.wasm"][0]) > 10_000_000
    assert "http" not in POLICY


def test_the_printed_address_leads_a_browser_to_the_recording(recording, files, monkeypatch):
    monkeypatch.setattr(page, "read_files", lambda: files)
    is_whole = threading.Event()
    is_whole.set()
    with open_page(recording, LOGIN, is_whole) as address, httpx.Client(follow_redirects=True) as browser:
        answer = browser.get(address)
        home = address.partition("/?")[0]
        assert address == address_for_person(Api(f"{home}/api", LOGIN))
        assert b"Rerun" in answer.content
        assert answer.headers["content-security-policy"] == POLICY
        asked = answer.url.params["url"]
        assert asked == f"{home}{RECORDING}"
        assert browser.get(asked).content == b"first "
        assert browser.get(f"{home}/re_viewer.js").content == files["/re_viewer.js"][0]
        assert browser.get(f"{home}/elsewhere").status_code == 404
    with pytest.raises(httpx.TransportError):
        httpx.get(home)


def test_a_recording_that_grows_comes_as_it_grows_and_ends_when_it_is_whole(recording, files, monkeypatch):
    monkeypatch.setattr(page, "read_files", lambda: files)
    is_whole = threading.Event()
    with open_page(recording, LOGIN, is_whole) as address, httpx.Client(follow_redirects=True) as browser:
        browser.get(address)
        with browser.stream("GET", f"{address.partition('/?')[0]}{RECORDING}", timeout=60.0) as answer:
            pieces = answer.iter_raw()
            assert next(pieces) == b"first "
            with recording.open("ab") as file:
                file.write(b"second ")
            assert next(pieces) == b"second "
            with recording.open("ab") as file:
                file.write(b"last")
            is_whole.set()
            assert b"".join(pieces) == b"last"


def test_two_pages_do_not_meet_and_a_port_that_is_taken_is_left_alone(recording, files, monkeypatch):
    monkeypatch.setattr(page, "read_files", lambda: files)
    with socket.create_server(("127.0.0.1", 0)) as taken:
        monkeypatch.setattr(page, "PORT", taken.getsockname()[1])
        with (
            open_page(recording, LOGIN, threading.Event()) as one,
            open_page(recording, LOGIN, threading.Event()) as two,
        ):
            assert len({one, two, f"http://127.0.0.1:{page.PORT}/?key=open"}) == 3


def test_a_viewer_that_fails_is_one_sentence_and_sends_no_usage_data(tmp_path, monkeypatch):
    program = tmp_path / "rerun"
    program.write_text(f"#!/bin/sh\nenv > {tmp_path}/environment\necho no viewer today >&2\nexit 3\n")
    program.chmod(program.stat().st_mode | stat.S_IXUSR)
    monkeypatch.setenv("RERUN_CLI_PATH", str(program))
    monkeypatch.setenv("FORCE_RERUN_ANALYTICS", "1")
    monkeypatch.delenv("CI", raising=False)
    with pytest.raises(FastError, match=r"did not start: no viewer today; write the recording with --save FILE"):
        read_files()
    given = (tmp_path / "environment").read_text().splitlines()
    assert "CI=1" in given
    assert not any(line.startswith("FORCE_RERUN_ANALYTICS") for line in given)


def test_the_address_stands_alone_on_the_last_line(capsys, tmp_path, files, monkeypatch):
    def close(_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(page, "read_files", lambda: files)
    monkeypatch.setattr(results, "wait_for", close)
    lake = proposed_lake(tmp_path)
    answer = Fast(capsys)("view", "quick", "--lake", lake)
    assert answer.status == 0
    key = (lake / ".state" / "key").read_text().strip()
    assert re.fullmatch(rf"http://127\.0\.0\.1:\d+/\?key={key}", answer.err.splitlines()[-1])
    assert os.listdir(lake / "outputs" / "quick") == ["quick.rrd"]
