"""Messages to people who are not looking, received by a server of our own."""

import logging

import pytest

from fast.flows.campaign.notify import VARIABLE, notifier
from tests.flows.server.local_server import local_server


@pytest.fixture
def inbox(monkeypatch):
    with local_server(lambda request: (200, {})) as (address, seen):
        monkeypatch.setenv(VARIABLE, address.replace("http://", "json://"))
        yield seen


def test_a_message_reaches_every_address(inbox, monkeypatch):
    import os

    monkeypatch.setenv(VARIABLE, f"{os.environ[VARIABLE]}/one {os.environ[VARIABLE]}/two")
    assert notifier(is_virtual=False).send("needs_you", "FAST needs you", "print batch quick/B01")
    assert sorted(request.path for request in inbox) == ["/one", "/two"]
    body = inbox[0].body
    assert (body["title"], body["message"], body["type"]) == ("FAST needs you", "print batch quick/B01", "info")


def test_a_stop_is_told_as_a_failure(inbox):
    assert notifier(is_virtual=False).send("stopped", "FAST stopped", "tool 4 is lost")
    assert inbox[0].body["type"] == "failure"


def test_a_virtual_bench_is_silent_unless_asked(inbox):
    assert not notifier(is_virtual=True).send("done", "done", "done")
    assert inbox == []
    assert notifier(is_virtual=True, even_virtual=True).send("done", "done", "done")


def test_only_what_is_wanted_is_sent(inbox):
    assert not notifier(is_virtual=False, kinds=("gap",)).send("done", "done", "done")
    assert notifier(is_virtual=False, kinds=("gap",)).send("gap", "gap", "stress relaxation")
    assert len(inbox) == 1


def test_without_an_address_nothing_happens(monkeypatch):
    monkeypatch.delenv(VARIABLE, raising=False)
    assert not notifier(is_virtual=False).send("done", "done", "done")


def test_a_message_that_is_not_taken_is_a_warning_without_the_address(monkeypatch, caplog):
    with (
        local_server(lambda request: (500, {})) as (address, _),
        caplog.at_level(logging.WARNING, "fast.flows.campaign.notify"),
    ):
        monkeypatch.setenv(VARIABLE, address.replace("http://", "json://user:secret@"))
        assert not notifier(is_virtual=False).send("done", "all done", "done")
    assert "'all done' did not reach all 1 addresses of FAST_NOTIFY" in caplog.text
    assert "secret" not in caplog.text
