"""Simulations on a real Dask scheduler with two workers, and what happens when one of them is lost."""

import os
import signal
import threading
import time
from concurrent.futures import BrokenExecutor, ThreadPoolExecutor
from pathlib import Path

import psutil
import pytest

from fast.lake.store import Lake
from fast.lake.tables.campaign import SimulationRow
from fast.models.design.space import BEST_PUBLISHED, numbered_design
from fast.models.errors import ConfigError, FastError
from fast.tasks.campaign.campaign import Campaign
from fast.tasks.campaign.config import CampaignConfig
from fast.tasks.simulation.engine import check_engine, open_engine
from fast.tasks.simulation.simulate import simulate_design
from tests.tasks.simulation.dask_cluster import Cluster, cluster
from tests.tasks.traces.made_up_grasps import made_up, pid_after, slowly_made_up

pytest.importorskip("distributed", reason="the extra `scale` is not installed")
LIMIT_S = 120.0
DESIGNS = [BEST_PUBLISHED, numbered_design(3)]


def campaign_at(root: Path, deadline_s: float = 60.0) -> Campaign:
    data = {
        "name": "scale",
        "objects": {"ids": [0, 14]},
        "simulator": {"mesh": {"edge_mm": 12}, "grasp_deadline_s": deadline_s},
        "grasp": {"max_lift_mm": 2},
        "bench": {"world": ""},
    }
    return Campaign(Lake.open(root, create=True), CampaignConfig.model_validate(data))


@pytest.fixture(scope="module")
def two_workers(tmp_path_factory: pytest.TempPathFactory):
    with cluster(tmp_path_factory.mktemp("dask"), 2) as found:
        yield found


@pytest.fixture
def engine(two_workers: Cluster):
    found = open_engine(two_workers.address, 2, LIMIT_S)
    deadline = time.monotonic() + LIMIT_S
    while len(found.present()) < 2:  # type: ignore[attr-defined]
        assert time.monotonic() < deadline
        time.sleep(0.1)
    yield found
    found.close()


def pids_of(engine) -> set[int]:
    """Process ids of the workers, by asking them."""
    with engine.lend() as one, engine.lend() as other:
        return {one.submit(os.getpid).result(LIMIT_S), other.submit(os.getpid).result(LIMIT_S)}


@pytest.mark.parametrize(
    ("address", "words"),
    [
        ("dask", "is no engine; write"),
        ("dask://127.0.0.1", "is no engine"),
        ("dask://node7:8786", "in the clear.*write dask\\+tls://"),
        ("tls://node7:8786", "is no engine"),
    ],
)
def test_an_engine_is_local_loopback_or_encrypted(address, words):
    with pytest.raises(ValueError, match=words):
        check_engine(address)
    with pytest.raises(ConfigError, match=words):
        open_engine(address, 1, LIMIT_S)


@pytest.mark.parametrize("address", ["local", "dask://127.0.0.1:8786", "dask+tls://node7:8786"])
def test_an_engine_is_part_of_the_config_and_not_of_its_hash(address):
    data = {"name": "scale", "bench": {"world": ""}}
    plain = CampaignConfig.model_validate(data)
    chosen = CampaignConfig.model_validate({**data, "execution": {"engine": address}})
    assert chosen.config_hash == plain.config_hash


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_the_cluster_gives_the_numbers_of_this_machine(engine, tmp_path):
    here, there = campaign_at(tmp_path / "here"), campaign_at(tmp_path / "there")
    local = open_engine("local", 1, LIMIT_S)
    try:
        for design in DESIGNS:
            simulate_design(here, design, pool=local)
    finally:
        local.close()
    with ThreadPoolExecutor(2) as threads:
        assert sum(threads.map(lambda design: simulate_design(there, design, pool=engine), DESIGNS)) == 0
    numbers = ("simulation_id", "status", "peak_force_n", "contact_force_n", "work_j", "n_newton")
    expected, found = (
        sorted(tuple(row[name] for name in numbers) for row in campaign.lake.rows(SimulationRow))
        for campaign in (here, there)
    )
    assert found == expected
    assert len(found) == 4


def test_users_share_the_workers_and_calls_of_one_user_stay_together(engine):
    with engine.lend() as one, engine.lend() as other:
        mine = {one.submit(os.getpid).result(LIMIT_S) for _ in range(5)}
        theirs = {other.submit(os.getpid).result(LIMIT_S) for _ in range(5)}
    assert len(mine) == len(theirs) == 1
    assert mine != theirs


def test_nothing_listens_beyond_loopback(two_workers):
    listening = []
    for process in [two_workers.scheduler, *two_workers.workers]:
        family = [psutil.Process(process.pid), *psutil.Process(process.pid).children(recursive=True)]
        for member in family:
            listening += [c.laddr.ip for c in member.net_connections("inet") if c.status == psutil.CONN_LISTEN]
    assert listening
    assert {ip for ip in listening if ip not in ("127.0.0.1", "::1")} == set()


def test_results_and_failures_are_rows_as_on_this_machine(engine, tmp_path, monkeypatch):
    monkeypatch.setattr("fast.tasks.simulation.simulate.attempt_grasp", made_up)
    campaign = campaign_at(tmp_path)
    assert simulate_design(campaign, BEST_PUBLISHED, pool=engine) == 1
    rows = {row["object_id"]: (row["status"], row["reason"]) for row in campaign.lake.rows(SimulationRow)}
    assert rows == {0: ("ok", ""), 14: ("failed", "no_convergence")}


def test_nothing_is_lost_when_a_worker_is_killed_in_a_design(engine, tmp_path, monkeypatch):
    monkeypatch.setattr("fast.tasks.simulation.simulate.attempt_grasp", slowly_made_up)
    campaign = campaign_at(tmp_path)
    (victim, *_) = pids_of(engine)
    threading.Timer(1.0, os.kill, (victim, signal.SIGKILL)).start()
    with ThreadPoolExecutor(2) as threads:
        assert sum(threads.map(lambda design: simulate_design(campaign, design, pool=engine), DESIGNS)) == 2
    rows = campaign.lake.rows(SimulationRow)
    assert len(rows) == 4
    assert {row["reason"] for row in rows} == {"", "no_convergence"}


def test_what_a_killed_worker_had_is_done_by_another(engine):
    before = pids_of(engine)
    with engine.lend() as worker:
        pid = worker.submit(os.getpid).result(LIMIT_S)
        running = worker.submit(pid_after, 3.0)
        threading.Timer(1.0, os.kill, (pid, signal.SIGKILL)).start()
        assert running.result(LIMIT_S) != pid
        assert worker.submit(os.getpid).result(LIMIT_S) != pid
    deadline = time.monotonic() + LIMIT_S
    while len(pids_of(engine)) < 2 and time.monotonic() < deadline:
        time.sleep(0.2)
    assert pids_of(engine) != before  # the nanny has replaced it


def test_a_call_that_hangs_ends_its_worker(two_workers):
    impatient = open_engine(two_workers.address, 1, 1.0)
    try:
        with impatient.lend() as worker, pytest.raises(BrokenExecutor):
            worker.submit(pid_after, 600.0).result(LIMIT_S)
    finally:
        impatient.close()


def test_a_worker_of_several_threads_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(
        "fast.tasks.simulation.engine_dask.CONNECT_LIMIT_S", 10.0
    )  # so long a client looks for a lost scheduler too
    with cluster(tmp_path, 0) as found:
        found.add_worker(n_threads=2)
        engine = open_engine(found.address, 1, LIMIT_S)
        try:
            with engine.lend() as worker, pytest.raises(FastError, match="has 2 threads.*start it with --nthreads 1"):
                worker.submit(os.getpid).result(LIMIT_S)
            found.scheduler.kill()
            found.scheduler.wait()
            with pytest.raises(FastError, match=r"scheduler of .* is gone; what was simulated is in the lake"):
                _ask_until_it_fails(engine)
        finally:
            engine.close()


def test_nobody_at_the_address_is_one_sentence(monkeypatch):
    monkeypatch.setattr("fast.tasks.simulation.engine_dask.CONNECT_LIMIT_S", 1.0)
    with pytest.raises(FastError, match="no Dask scheduler answers at dask://127.0.0.1:9 within 1 s"):
        open_engine("dask://127.0.0.1:9", 1, LIMIT_S)


def _ask_until_it_fails(engine) -> None:
    deadline = time.monotonic() + LIMIT_S
    while time.monotonic() < deadline:
        with engine.lend() as worker:
            worker.submit(os.getpid).result(LIMIT_S)
