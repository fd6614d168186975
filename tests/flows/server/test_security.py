"""What the lab lets in: addresses it listens on, passwords, pickles, paths, a second client of a bench."""

import asyncio
import os
import re
import signal
import socket

import httpx
import pytest

from fast.flows.cli.real import is_rehearsal
from fast.flows.server.lab import LabPlan, open_lab
from fast.flows.server.server import ANY_PORT, ask_server, state_folder
from fast.flows.server.server_process import add_outputs
from fast.flows.server.worker_process import POOL
from fast.hardware.bench import BenchSettings, open_real_bench
from fast.hardware.clock import ScaledClock
from fast.hardware.parts.layout import BenchLayout
from fast.hardware.virtual.bench import VirtualBench
from fast.hardware.virtual.world.file import World
from fast.lake.leases import exclusive
from fast.lake.store import Lake
from fast.models.errors import FastError
from tests.flows.cli.cli_lakes import ROOT, Fast, proposed_lake
from tests.studies.platform.sockets import family, is_loopback, listening
from tests.waiting import wait_for

OWN = ("flows", "tasks", "lake", "hardware", "models")
# Between a process and the workers it started, over their pipe; nothing from a lake or the network.
PIPES = {"models/calibration/inference/parallel_chains.py"}


def test_where_this_process_listens_is_seen():
    with socket.create_server(("127.0.0.1", 0)) as one, socket.create_server(("0.0.0.0", 0)) as other:
        assert listening({os.getpid()}) >= {one.getsockname(), other.getsockname()}
    assert os.getpid() in family(os.getppid())
    assert [is_loopback(a) for a in ("127.0.0.1", "::1", "0.0.0.0", "10.0.0.3")] == [True, True, False, False]


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_a_lab_answers_to_its_password_only_and_starts_again_what_dies(tmp_path, monkeypatch):
    monkeypatch.delenv("FAST_PREFECT_API_URL", raising=False)
    monkeypatch.setenv("FAST_PASSWORD", "open")
    with open_lab(Lake.open(tmp_path / "lake", create=True), LabPlan(ANY_PORT, n_runs=3)) as lab:
        lab.prepare_pool()
        assert ask_server(lab.api, f"/work_pools/{POOL}")["concurrency_limit"] == 3
        for login, status in ((None, 401), (("fast", "shut"), 401), (("fast", "open"), 200)):
            assert httpx.post(f"{lab.api.url}/flows/filter", json={}, auth=login, timeout=60.0).status_code == status
        assert "rejected" not in (state_folder(tmp_path / "lake") / "worker.log").read_text()  # events reach the worker
        killed, said = set(lab.pids), []
        for pid in killed:
            os.kill(pid, signal.SIGKILL)
        wait_for(lambda: lab.tend(said.append) or not killed & set(lab.pids))
        assert "the Prefect server had died and was started again" in "".join(said)
        assert "the worker had died and was started again" in "".join(said)


def test_own_code_unpickles_nothing_from_outside():
    loads = re.compile(r"pickle\.loads?\(|allow_pickle=True|\bjoblib\.load|torch\.load|yaml\.load\(|\beval\(|\bexec\(")
    found = {
        str(path.relative_to(ROOT))
        for name in OWN
        for path in (ROOT / name).rglob("*.py")
        if loads.search(path.read_text())
    }
    assert found <= PIPES


@pytest.mark.parametrize("host", ["0.0.0.0", "10.0.0.3"])
def test_others_are_let_in_with_a_password_only(capsys, tmp_path, monkeypatch, host):
    monkeypatch.delenv("FAST_PREFECT_API_URL", raising=False)
    monkeypatch.delenv("FAST_PASSWORD", raising=False)
    said = Fast(capsys).refused("serve", "--host", host, "--lake", tmp_path / "lake")
    assert f"--host {host} is reached by others; set a password in FAST_PASSWORD" in said
    assert not (tmp_path / "lake").exists()


def test_a_name_is_no_address(capsys, tmp_path, monkeypatch):
    monkeypatch.delenv("FAST_PREFECT_API_URL", raising=False)
    assert "is no IPv4 address" in Fast(capsys).refused("serve", "--host", "lab", "--lake", tmp_path / "lake")


class Client:
    """Requests to an application, without a server."""

    def __init__(self, app):
        self._app = app

    def get(self, path, headers=None):
        async def ask():
            transport = httpx.ASGITransport(app=self._app)
            async with httpx.AsyncClient(transport=transport, base_url="http://lab", follow_redirects=True) as client:
                return await client.get(path, headers=headers)

        return asyncio.run(ask())


async def _pages(scope, receive, send):
    await send({"type": "http.response.start", "status": 200, "headers": []})
    await send({"type": "http.response.body", "body": b"prefect"})


@pytest.fixture
def outputs(tmp_path):
    (tmp_path / "secret.txt").write_text("secret")
    folder = tmp_path / "outputs" / "quick"
    folder.mkdir(parents=True)
    (folder / "index.html").write_text("report")
    (folder / "out").symlink_to(tmp_path / "secret.txt")
    return tmp_path / "outputs"


def test_pages_show_the_output_folder_and_nothing_beside_it(outputs):
    client = Client(add_outputs(_pages, outputs))
    assert client.get("/outputs/quick/index.html").text == "report"
    assert client.get("/outputs/quick/").text == "report"
    assert client.get("/dashboard").text == "prefect"
    for path in ("/outputs/../secret.txt", "/outputs/%2e%2e/secret.txt", "/outputs/quick/out", "/outputs//etc/passwd"):
        assert "secret" not in client.get(path).text
        assert client.get(path).status_code == 404 or client.get(path).text == "prefect"


@pytest.mark.parametrize("batch", ["../x/B01", "quick/../B01", "/etc/B01", "quick/B01/..", "B01;ls"])
def test_a_batch_is_no_path(capsys, tmp_path, batch):
    lake = proposed_lake(tmp_path)
    said = Fast(capsys).refused("print", "confirm", batch, "--operator", "ada", "--lake", lake)
    assert "is not a batch" in said or "is not in this lake" in said


def test_a_second_client_of_a_bench_is_refused_and_the_first_goes_on(tmp_path):
    bench = VirtualBench(World(seed=7), {}, lambda request: None, ScaledClock(50.0), BenchLayout())
    at = bench.start(0, 0)
    settings = BenchSettings(
        serial_port=at.serial_port,
        plc_host=at.plc_host,
        plc_port=at.plc_port,
        transmitter_host=at.transmitter_host,
        transmitter_port=at.transmitter_port,
        journal=str(tmp_path / "journal.jsonl"),
    )
    assert is_rehearsal(settings)
    try:
        with open_real_bench(settings, {}, ScaledClock(50.0)) as first:
            before = first.gantry.position_mm()
            with (
                pytest.raises(FastError, match="another program has it"),
                open_real_bench(settings, {}, ScaledClock(50.0)),
            ):
                pass
            assert first.gantry.position_mm() == before
            first.clock.sleep(2.0)  # some heartbeats: the PLC still knows the first one as its own
            first.supervisor.require_ok()
    finally:
        bench.stop()


def test_the_bench_of_a_lake_has_one_owner(tmp_path):
    lake = Lake.open(tmp_path / "lake", create=True)
    busy = "the gantry of this lake is in use"
    with (
        exclusive(lake.storage, "gantry", busy),
        pytest.raises(FastError, match=busy),
        exclusive(lake.storage, "gantry", busy),
    ):
        pass
