"""Runs whose process is gone are declared crashed, and campaigns of them continued; a server in memory stands in."""

import os
import re
import subprocess
import sys
import urllib.error
from datetime import UTC, datetime, timedelta

import pytest

from fast.flows.server import crashed_runs
from fast.flows.server.crashed_runs import (
    CONTINUES,
    MOST_PER_HOUR,
    ORPHAN_LIMIT_S,
    UNMARKED_LIMIT_S,
    end_crashed_runs,
    explain_death,
)
from fast.flows.server.run_process import RunningProcess, is_process_alive

NOW = datetime.now(UTC)
OWN = RunningProcess.own()


def gone_process() -> RunningProcess:
    child = subprocess.Popen([sys.executable, "-c", ""])
    child.wait()
    return RunningProcess(OWN.host, child.pid, OWN.started_s)


GONE = gone_process()


def run(number=1, state="RUNNING", tags=(), age_s=10.0, **changes):
    made = (NOW - timedelta(seconds=age_s)).isoformat()
    return {
        "id": f"run-{number}", "name": f"run {number}", "flow_id": "F", "deployment_id": "D", "tags": list(tags),
        "parameters": {"config": "a.toml"}, "infrastructure_pid": None, "auto_scheduled": False, "created": made,
        "state": {"type": state, "name": state.title(), "timestamp": made}, **changes,
    }  # fmt: skip


class Server:
    """Answers what is asked about runs, from runs in memory, newest first."""

    def __init__(self, *runs) -> None:
        self.runs = list(runs)
        self.task_runs = [{"id": "task-1"}]
        self.crashed: dict[str, str] = {}
        self.keys: set[str] = set()

    def __call__(self, api_url, path, body):
        if path == "/flows/filter":
            return [{"id": "F", "name": "run-campaign"}]
        if path == "/flow_runs/filter":
            states = body.get("flow_runs", {}).get("state", {}).get("type", {}).get("any_")
            return [r for r in self.runs if states is None or r["state"]["type"] in states]
        if path == "/task_runs/filter":
            return self.task_runs
        if match := re.fullmatch(r"/(?:flow|task)_runs/(.+)/set_state", path):
            assert body["force"]
            self.crashed[match[1]] = body["state"]["message"]
            for found in self.runs:
                if found["id"] == match[1]:
                    found["state"] = {**found["state"], "type": body["state"]["type"], "timestamp": NOW.isoformat()}
            return {}
        assert path == "/deployments/D/create_flow_run"
        if body["idempotency_key"] not in self.keys:
            self.keys.add(body["idempotency_key"])
            new = run(len(self.runs) + 1, "SCHEDULED", body["tags"], 0.0, parameters=body["parameters"])
            self.runs.insert(0, new)
        return {}


@pytest.fixture
def asked(monkeypatch):
    def serve(*runs) -> Server:
        server = Server(*runs)
        monkeypatch.setattr(crashed_runs, "ask_server", server)
        return server

    return serve


def test_a_process_is_known_by_host_id_and_start():
    assert RunningProcess.of_tags(["x", OWN.tag]) == OWN
    assert OWN.is_alive()
    assert not GONE.is_alive()
    assert not is_process_alive(os.getpid(), OWN.started_s - 100)  # another one had the id before
    assert RunningProcess.of_tags(["process:x", "campaign"]) is None


def test_a_zombie_is_not_alive():
    with subprocess.Popen([sys.executable, "-c", "pass"], stdout=subprocess.PIPE) as child:
        assert child.stdout is not None
        child.stdout.read()  # it has ended and nobody has asked how
        while is_process_alive(child.pid):
            pass


@pytest.mark.parametrize(
    ("found", "words"),
    [
        (run(tags=[OWN.tag]), None),
        (run(tags=[GONE.tag]), f"process {GONE.pid} on .* is gone: killed, or the machine went down"),
        (run(tags=[RunningProcess("elsewhere", GONE.pid, 0).tag]), None),
        (run(age_s=UNMARKED_LIMIT_S / 2), None),
        (run(age_s=2 * UNMARKED_LIMIT_S), "no process has said for 600 s that it does this run"),
        (run(age_s=2 * UNMARKED_LIMIT_S, infrastructure_pid=str(os.getpid())), None),
        (run(age_s=2 * UNMARKED_LIMIT_S, infrastructure_pid=str(GONE.pid)), "no process has said"),
    ],
    ids=("alive", "gone", "of another host", "just begun", "unmarked", "of a living worker", "of a dead worker"),
)
def test_why_a_run_is_dead(found, words):
    reason = explain_death(found, NOW)
    assert (reason is None) if words is None else re.search(words, reason)


@pytest.mark.parametrize(
    ("state", "age_s", "worker_age_s", "is_orphan"),
    [
        ("PENDING", 60.0, ORPHAN_LIMIT_S + 1, True),
        ("PENDING", 60.0, ORPHAN_LIMIT_S - 1, False),  # what the worker before had started may still be ending
        ("PENDING", 20.0, 40.0, False),  # taken by the present worker
        ("RUNNING", 60.0, 40.0, False),
    ],
)
def test_a_run_that_a_worker_had_taken_and_not_started_has_died_with_it(state, age_s, worker_age_s, is_orphan):
    reason = explain_death(run(state=state, age_s=age_s), NOW, NOW - timedelta(seconds=worker_age_s))
    assert (reason is not None) == is_orphan


def test_a_dead_run_and_its_tasks_are_crashed_and_a_live_one_is_left(asked):
    server = asked(run(1, tags=[GONE.tag]), run(2, tags=[OWN.tag]))
    (sentence,) = end_crashed_runs("").sentences
    assert sentence.startswith("run 1 has crashed: its process")
    assert set(server.crashed) == {"run-1", "task-1"}


def test_a_crashed_campaign_is_continued_once_with_the_same_parameters(asked):
    server = asked(run(1, tags=[GONE.tag]))
    assert end_crashed_runs("", and_continue=True).continued == ["run 1 has crashed and is continued"]
    assert [r["parameters"] for r in server.runs] == [{"config": "a.toml"}] * 2
    assert end_crashed_runs("", and_continue=True).sentences == []
    assert len(server.runs) == 2


@pytest.mark.parametrize(
    "last", [run(2, "COMPLETED"), run(2, "FAILED"), run(2, "CANCELLED"), run(2, "CRASHED", age_s=2 * 86400)]
)
def test_what_a_person_ended_or_forgot_is_not_continued(asked, last):
    server = asked(last, run(1, "CRASHED"))
    assert end_crashed_runs("", and_continue=True).sentences == []
    assert len(server.runs) == 2


def test_a_run_that_a_person_cancels_is_cancelled_when_its_process_is_gone(asked):
    server = asked(run(1, "CANCELLING", [GONE.tag]))
    assert end_crashed_runs("", and_continue=True).sentences == ["run 1 was cancelled"]
    assert [found["state"]["type"] for found in server.runs] == ["CANCELLED"]


def test_a_campaign_that_kills_its_process_is_given_up(asked, caplog):
    server = asked(*(run(n, "CRASHED", [CONTINUES]) for n in range(MOST_PER_HOUR, 0, -1)))
    assert end_crashed_runs("", and_continue=True).sentences == []
    assert len(server.runs) == MOST_PER_HOUR
    assert "was continued 20 times within an hour: no more" in caplog.text


def test_a_server_that_does_not_answer_is_asked_again_next_time(monkeypatch):
    def refuse(*words):
        raise urllib.error.URLError("refused")

    monkeypatch.setattr(crashed_runs, "ask_server", refuse)
    assert end_crashed_runs("").sentences == []
