"""What the lab's page costs on a lake of the paper's size: the first paint, and pages that stay open.

Tools, grasps and simulations are made up; the page's process is the real one, asked as its script asks. While something
is simulated, a row is appended every second.
"""

import base64
import http.client
import socket
import tempfile
import threading
import time
import tomllib
import urllib.request
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import psutil

from fast.flows.server.access import Api
from fast.flows.server.page_port import PageServer, listen
from fast.lake.store import Lake
from fast.lake.tables.campaign import GraspRow, SimulationRow, TraceRow
from fast.lake.tables.requests import setup_columns
from fast.models.ids import canonical_json
from fast.models.records import Trace
from fast.models.traces import initial_force_n, peak_force_n, work_j
from fast.tasks.bench.print import PrintConfirmation, confirm_print
from fast.tasks.campaign.campaign import Campaign
from fast.tasks.campaign.config import CampaignConfig
from fast.tasks.campaign.setup import register
from fast.tasks.scientist.propose import propose_initial
from tests.studies.benchmarks.base import Options, Tables

N_TOOLS, N_SIMULATED, N_PAGES, N_SAMPLES = 110, 850, 20, 880
WATCHED_S = 60.0
_CONFIG = f"""
name = "paper"
seed = 1
[schedule]
initial_tools = {N_TOOLS}
tools_per_batch = 10
guided_batches = 1
initial_simulations = {N_SIMULATED}
simulations_per_batch = 100
[bench]
world = "worlds/lab.toml"
"""
# What the script of an open page asks for when there is news (assets/page.js).
_ASKED = ("/now/part?campaign=paper", "/now/map?campaign=paper", "/api/v1/todo")


def measure_page_cost(options: Options) -> Tables:
    """First paint of the lab's page on a lake of 11,880 grasps, and CPU of 1 and 20 open pages, idle and simulating."""
    with tempfile.TemporaryDirectory(prefix="fast-page-cost-") as folder:
        campaign = fill(Path(folder) / "lake")
        options.tell("the lake is made")
        page = PageServer(campaign.lake, listen(0))
        try:
            rows = [_measure_paint(campaign, page)]
            options.tell(f"{rows[0]}")
            rows += [_watch(campaign, page, n, is_busy) for n in (1, N_PAGES) for is_busy in (False, True)]
        finally:
            page.close()
    return {"page-cost": rows}


def fill(root: Path) -> Campaign:
    """A campaign of the paper's size, measured and simulated to the last row."""
    config = CampaignConfig.model_validate(_read_toml(_CONFIG))
    campaign = Campaign(Lake.open(root, create=True), config)
    register(campaign, _CONFIG)
    propose_initial(campaign)
    batches = sorted({tool.batch for tool in campaign.state().tools})
    for batch in batches:
        confirm_print(campaign.lake, "paper", batch, PrintConfirmation(operator="nobody", confirmed_by="auto"))
    state, rng = campaign.state(), np.random.default_rng(1)
    grasps = [row for tool in state.tools for row in _grasps_of(campaign, tool, rng)]
    campaign.lake.append(grasps, campaign.provenance())
    designs = [one.design for one in state.simulations] + [tool.design for tool in state.tools]
    campaign.lake.append(
        [_simulation(campaign, d.design_id, o, rng) for d in designs for o in campaign.object_ids],
        campaign.provenance(),
    )
    return campaign


def _grasps_of(campaign: Campaign, tool: Any, rng: np.random.Generator) -> Iterator[Any]:
    time_s = np.arange(1, N_SAMPLES + 1) / 80.0
    lift_mm = 5.0 * np.clip(time_s - 1.4, 0.0, None)
    trace = Trace(time_s, lift_mm, 8.0 * np.sin(np.pi * np.clip(lift_mm / 48.0, 0.0, 1.0)) ** 2)
    for order, (object_id, repeat) in enumerate(campaign.config.objects.list_grasps(tool.slot)):
        grasp_id = GraspRow.make_id(tool.tool_id, object_id, repeat, 0)
        yield TraceRow.of(grasp_id, trace)
        yield GraspRow(
            grasp_id=grasp_id,
            campaign_id="paper",
            tool_id=tool.tool_id,
            batch=tool.batch,
            slot=tool.slot,
            design_id=tool.design.design_id,
            object_id=object_id,
            repeat=repeat,
            order=108 * (10 * tool.batch + tool.slot) + order,
            status="ok",
            peak_force_n=peak_force_n(trace) * float(rng.uniform(0.5, 2.0)),
            work_j=work_j(trace),
            initial_force_n=initial_force_n(trace),
            bench="virtual",
            **setup_columns(campaign.config.grasp),
        )


def _simulation(campaign: Campaign, design_id: str, object_id: int, rng: np.random.Generator) -> SimulationRow:
    setup, version_id = campaign.config.grasp, campaign.version.version_id
    return SimulationRow(
        simulation_id=SimulationRow.make_id(design_id, object_id, version_id, setup.setup_id),
        design_id=design_id,
        object_id=object_id,
        version_id=version_id,
        setup_id=setup.setup_id,
        setup_json=canonical_json(setup.model_dump()),
        status="ok",
        peak_force_n=float(rng.uniform(4.0, 20.0)),
    )


def _measure_paint(campaign: Campaign, page: PageServer) -> dict[str, Any]:
    """The first page of a new process, and pages after something was written."""
    begun_s = time.monotonic()
    _get(page.api, "/start")  # the process starts, and has read nothing of the campaign's grasps yet
    start_s = time.monotonic() - begun_s
    first = _cost(page, lambda: _get(page.api, "/?campaign=paper"))
    known = _cost(page, lambda: _get(page.api, "/?campaign=paper"))
    _append(campaign, 0)
    time.sleep(1.0)
    again = _cost(page, lambda: _get(page.api, "/?campaign=paper"))
    return {
        "what": "first paint",
        "process_starts_s": start_s,
        "first_s": first[0],
        "first_cpu_s": first[1],
        "known_s": known[0],
        "known_cpu_s": known[1],
        "after_a_row_s": again[0],
        "after_a_row_cpu_s": again[1],
    }


def _watch(campaign: Campaign, page: PageServer, n_pages: int, is_busy: bool) -> dict[str, Any]:
    """CPU of the page's process while pages are open, in % of a core."""
    with ExitStack() as stack:
        for _ in range(n_pages):
            stack.enter_context(open_page(page.api))
        time.sleep(5.0)
        before_s, begun_s, number = _cpu_s(page), time.monotonic(), 1
        while time.monotonic() - begun_s < WATCHED_S:
            time.sleep(1.0)
            if is_busy:
                _append(campaign, number := number + 1)
        share = (_cpu_s(page) - before_s) / (time.monotonic() - begun_s)
    words = "while something is simulated" if is_busy else "idle"
    return {"what": f"{n_pages} open pages, {words}", "cpu_percent": 100 * share}


@contextmanager
def open_page(page: Api) -> Iterator[None]:
    """A page that follows the campaign, and asks what its script asks when there is news, at most every two seconds."""
    asked = _request(page, "/events?campaign=paper")
    connection = http.client.HTTPConnection(asked.host, timeout=600)
    connection.request("GET", asked.selector, headers=dict(asked.header_items()))
    line, answer = connection.sock, connection.getresponse()
    is_over, has_news = threading.Event(), threading.Event()

    def listen_on() -> None:
        try:
            for text in answer:
                if text.startswith((b"event: news", b"event: standing")):
                    has_news.set()
        except (OSError, http.client.HTTPException):  # closed under its hands
            return

    def ask() -> None:
        while not is_over.wait(2.0):
            if has_news.is_set():
                has_news.clear()
                for path in _ASKED:
                    _get(page, path)

    threads = [threading.Thread(target=work, daemon=True) for work in (listen_on, ask)]
    for thread in threads:
        thread.start()
    try:
        yield
    finally:
        is_over.set()
        threads[1].join()
        line.shutdown(socket.SHUT_RDWR)  # who reads may wait for half a minute else


def _append(campaign: Campaign, number: int) -> None:
    rng = np.random.default_rng(number)
    row = _simulation(campaign, f"D{number:012x}{time.monotonic_ns():x}", number % 36, rng)
    campaign.lake.append([row], campaign.provenance())


def _get(page: Api, path: str) -> bytes:
    with urllib.request.urlopen(_request(page, path), timeout=600) as answer:
        content: bytes = answer.read()
        return content


def _request(page: Api, path: str) -> urllib.request.Request:
    login = base64.b64encode((page.login or "").encode()).decode()
    return urllib.request.Request(page.url.removesuffix("/api") + path, headers={"Authorization": f"Basic {login}"})


def _cost(page: PageServer, work: Any) -> tuple[float, float]:
    cpu_s, wall_s = _cpu_s(page), time.monotonic()
    work()
    return time.monotonic() - wall_s, _cpu_s(page) - cpu_s


def _cpu_s(page: PageServer) -> float:
    times = psutil.Process(page.pid).cpu_times()
    return float(times.user + times.system)


def _read_toml(text: str) -> dict[str, Any]:
    return tomllib.loads(text)
