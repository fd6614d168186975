import subprocess
import sys
import time
from datetime import datetime, timedelta
from types import SimpleNamespace

import pytest

from fast.hardware.parts.safe_state import EmergencyStopError, StopAskedError, Verb
from fast.lake.leases import exclusive, is_held
from fast.lake.store import Lake
from fast.models.errors import FastError, LakeError
from fast.tasks.campaign.requests import (
    Requests,
    append_event,
    append_request,
    note_verbs,
    requested_verb,
    require_acknowledgement,
    require_room,
)
from fast.tasks.simulation.pool import WorkerPool


def _die() -> None:
    import os

    os._exit(3)


def _double(number: int) -> int:
    return 2 * number


def test_requests_count_only_after_the_last_start(campaign):
    lake = campaign.lake
    append_event(lake, "small", "started", "")
    assert requested_verb(lake, "small") is None
    append_event(lake, "small", "pause", "")
    assert requested_verb(lake, "small") == "pause"
    append_event(lake, "small", "started", "")
    assert requested_verb(lake, "small") is None


@pytest.fixture
def clock(monkeypatch):
    """A shell's clock; `off` sets it."""

    class Clock(datetime):
        off = timedelta(0)

        @classmethod
        def now(cls, tz=None):
            return datetime.now(tz) + cls.off

    monkeypatch.setattr("fast.lake.provenance.datetime", Clock)
    return Clock


@pytest.mark.parametrize("hours", [-24, -1, 1, 24])
def test_a_stop_of_a_shell_with_a_wrong_clock_is_heard(campaign, clock, hours):
    requests = Requests(campaign.lake, "small")
    append_event(campaign.lake, "small", "started", "")
    clock.off = timedelta(hours=hours)
    shell = Lake.open(campaign.lake.root)
    append_request(shell, "small", Verb.PAUSE, "")
    append_request(shell, "small", Verb.STOP, "")
    assert requests.verb() is Verb.STOP
    clock.off = timedelta(0)
    append_event(campaign.lake, "small", "started", "")
    assert requests.verb() is None


def test_a_request_means_the_run_that_it_was_made_for(campaign):
    """A shell looks who runs, and is slow; meanwhile that run ends and another begins."""
    lake = campaign.lake
    for token in ("first", "second"):
        append_event(lake, "small", "started", "", run=token)
    append_event(lake, "small", Verb.STOP, "", run="first")
    assert requested_verb(lake, "small") is None
    append_event(lake, "small", Verb.PAUSE, "", run="second")
    assert requested_verb(lake, "small") is Verb.PAUSE
    append_event(lake, "small", Verb.ESTOP, "", run="a single step, which writes no start")
    assert requested_verb(lake, "small") is Verb.ESTOP


def test_a_request_names_the_run_that_holds_the_campaign(campaign):
    with exclusive(campaign.lake.storage, "campaign-small", "busy") as lease:
        append_request(campaign.lake, "small", Verb.STOP, "")  # it comes before the start is written
        append_event(campaign.lake, "small", "started", "", run=lease.token)
        assert requested_verb(campaign.lake, "small") is Verb.STOP


def test_requests_asked_again_are_heard_when_they_come_and_read_only_then(campaign, monkeypatch):
    requests = Requests(campaign.lake, "small")
    append_event(campaign.lake, "small", "started", "")
    assert requests.verb() is None
    append_event(campaign.lake, "small", "pause", "")
    assert requests.verb() is Verb.PAUSE
    with monkeypatch.context() as patched:
        patched.setattr("fast.tasks.campaign.requests.requested_verb", None)
        assert requests.verb() is Verb.PAUSE
    append_event(campaign.lake, "small", "started", "")
    assert requests.verb() is None


def test_lock_refuses_a_second_owner_and_frees_itself_when_the_owner_is_killed(campaign):
    code = (
        "import sys, time; from pathlib import Path; from fast.lake.store import Lake\n"
        "from fast.lake.leases import exclusive\n"
        "with exclusive(Lake.open(Path(sys.argv[1])).storage, 'gantry', 'busy'):\n"
        "    print('held', flush=True); time.sleep(60)"
    )
    owner = subprocess.Popen([sys.executable, "-c", code, str(campaign.lake.root)], stdout=subprocess.PIPE, text=True)
    with owner:
        assert owner.stdout is not None
        assert owner.stdout.readline() == "held\n"
        assert is_held(campaign.lake.storage, "gantry")
        with (
            pytest.raises(FastError, match=f"busy \\(process {owner.pid} on .+, since 20.+ UTC\\); wait for it"),
            exclusive(campaign.lake.storage, "gantry", "busy"),
        ):
            pass
        owner.kill()
    with exclusive(campaign.lake.storage, "gantry", "busy"):
        assert is_held(campaign.lake.storage, "gantry")
    assert not is_held(campaign.lake.storage, "gantry")


def test_pool_works_on_after_a_worker_died():
    pool = WorkerPool(1)
    try:
        assert pool.call(_double, 4) == 8
        with pytest.raises(Exception, match="terminated abruptly"):
            pool.call(_die)
        assert pool.call(_double, 5) == 10
    finally:
        pool.close()


def test_workers_do_not_outlive_a_killed_parent():
    code = (
        "import os, time\nfrom fast.tasks.simulation.pool import WorkerPool\n"
        "if __name__ == '__main__':\n    print(WorkerPool(1).call(os.getpid), flush=True); time.sleep(60)"
    )
    parent = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
    with parent:
        assert parent.stdout is not None
        worker = int(parent.stdout.readline())
        parent.kill()
    deadline = time.monotonic() + 15
    while _is_alive(worker) and time.monotonic() < deadline:
        time.sleep(0.1)
    assert not _is_alive(worker)


def _is_alive(pid: int) -> bool:
    try:
        with open(f"/proc/{pid}/stat") as file:
            return file.read().rsplit(")", 1)[1].split()[0] != "Z"
    except FileNotFoundError:
        return False


def test_an_emergency_stop_is_noted_and_waits_for_a_person(campaign):
    lake = campaign.lake
    append_event(lake, "small", "started", "")
    with pytest.raises(EmergencyStopError), note_verbs(lake, "small"):
        raise EmergencyStopError("The emergency stop was pressed.")
    assert requested_verb(lake, "small") is Verb.ESTOP
    with pytest.raises(FastError, match="does not go on by itself.*--acknowledge; nothing was moved"):
        require_acknowledgement(lake, "small", is_acknowledged=False)
    require_acknowledgement(lake, "small", is_acknowledged=True)
    append_event(lake, "small", "started", "")
    require_acknowledgement(lake, "small", is_acknowledged=False)


@pytest.mark.parametrize("verb", [Verb.STOP, Verb.ABORT])
def test_a_persons_stop_is_a_normal_end(campaign, verb):
    append_event(campaign.lake, "small", verb, "")
    with note_verbs(campaign.lake, "small"):
        raise StopAskedError(verb)
    assert requested_verb(campaign.lake, "small") is verb
    require_acknowledgement(campaign.lake, "small", is_acknowledged=False)


def test_a_disk_that_is_nearly_full_is_named_before_the_next_grasp(campaign, monkeypatch):
    with exclusive(campaign.lake.storage, "gantry", "busy"):
        require_room(campaign.lake)
        monkeypatch.setattr("shutil.disk_usage", lambda path: SimpleNamespace(free=12e6))
        with pytest.raises(LakeError, match="has 12 MB left, limit 100 MB; the bench stopped before the next grasp"):
            require_room(campaign.lake)
