"""Checks of `fast doctor` that do not need the solver: versions, server, notifications."""

import json
import os

import pytest

from fast.flows.cli import doctor
from fast.flows.server.server import state_folder


def noted(url):
    return json.dumps({"api_url": url, "pid": os.getpid(), "owner_pid": os.getpid()})


@pytest.fixture(autouse=True)
def _no_server_named(monkeypatch):
    monkeypatch.delenv("FAST_PREFECT_API_URL", raising=False)


def test_a_package_of_another_version_fails_with_its_fix(monkeypatch, tmp_path):
    lock = tmp_path / "requirements.lock"
    lock.write_text("prefect==1.0\nnumpy==1.0\n")
    monkeypatch.setattr("fast.flows.cli.doctor.LOCK", lock)
    check = doctor._versions()
    assert not check.ok
    assert "prefect is 3.8.8, the lock says 1.0; run `make clean setup`. (and 1 more)" in check.note


def test_the_server_of_a_lake_is_found(monkeypatch, tmp_path):
    assert "none of this lake" in doctor._running(tmp_path)
    state_folder(tmp_path).mkdir(parents=True)
    (tmp_path / ".state" / "server.json").write_text(noted("http://127.0.0.1:4999/api"))
    monkeypatch.setattr("fast.flows.server.server.is_healthy", lambda url: True)
    key = tmp_path / ".state" / "key"
    assert doctor._running(tmp_path) == f"of this lake: http://127.0.0.1:4999/?key={key.read_text().strip()}"
    assert key.stat().st_mode & 0o777 == 0o600
    # Only a server of this machine is believed: the file may come from elsewhere with a copied lake.
    (tmp_path / ".state" / "server.json").write_text(noted("http://elsewhere:80/api"))
    assert "none of this lake" in doctor._running(tmp_path)


def test_addresses_of_notifications_are_understood_or_named(monkeypatch):
    monkeypatch.delenv("FAST_NOTIFY", raising=False)
    assert "set FAST_NOTIFY" in doctor._notifications()
    monkeypatch.setenv("FAST_NOTIFY", "json://127.0.0.1:9/x mailto://a:b@example.org")
    assert doctor._notifications() == "2 addresses in FAST_NOTIFY; nothing was sent"
    monkeypatch.setenv("FAST_NOTIFY", "json://127.0.0.1:9/x nothing")
    check = doctor._try("notifications", doctor._notifications, "correct FAST_NOTIFY")
    assert (check.ok, check.note) == (False, "1 of 2 addresses in FAST_NOTIFY are not understood; correct FAST_NOTIFY")
