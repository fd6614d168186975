import subprocess
import sys
import time

import pytest

from models.errors import FastError
from tasks.control import append_event, exclusive, is_held, requested_verb
from tasks.pool import WorkerPool


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


def test_lock_refuses_a_second_owner_and_frees_itself_when_the_owner_is_killed(campaign):
    code = (
        "import sys, time; from pathlib import Path; from lake.store import Lake; from tasks.control import exclusive\n"
        "with exclusive(Lake.open(Path(sys.argv[1])), 'gantry', 'busy'):\n    print('held', flush=True); time.sleep(60)"
    )
    owner = subprocess.Popen([sys.executable, "-c", code, str(campaign.lake.root)], stdout=subprocess.PIPE, text=True)
    with owner:
        assert owner.stdout is not None
        assert owner.stdout.readline() == "held\n"
        assert is_held(campaign.lake, "gantry")
        with (
            pytest.raises(FastError, match=f"busy \\(process {owner.pid}\\)"),
            exclusive(campaign.lake, "gantry", "busy"),
        ):
            pass
        owner.kill()
    with exclusive(campaign.lake, "gantry", "busy"):
        assert is_held(campaign.lake, "gantry")
    assert not is_held(campaign.lake, "gantry")


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
        "import os, time\nfrom tasks.pool import WorkerPool\n"
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
