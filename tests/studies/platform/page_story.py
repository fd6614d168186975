"""The lab's page from the first start to the result, in a browser, on a screen and on a phone; no terminal but one.

The bench is virtual and small; `fast serve`, its worker, the campaign and the browser are the real ones. The server is
killed in the middle. A stranger tries what the page takes, and gets nothing.
"""

import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import psutil

from fast.flows.server.access import own_login
from fast.flows.server.lab import CHECKOUT
from fast.lake.store import Lake
from fast.models.errors import FastError
from tests.flows.campaign.made_up_search import ask_person
from tests.flows.page.served import open_browser, say_name
from tests.studies.benchmarks.base import Options, Rows, Tables

LIMIT_S = 600.0
WIDTHS = (1200, 390)
_PEOPLE = CHECKOUT / "tests" / "data" / "cases" / "people"
_CONFIG = """
name = "story"
seed = 2
[schedule]
initial_tools = 2
tools_per_batch = 2
guided_batches = 1
initial_simulations = 2
simulations_per_batch = 1
[objects]
ids = [0, 14, 28, 30]
repeats = 3
[bench]
world = "{world}"
[execution]
simulation_workers = 1
print_poll_s = 1.0
"""


def measure_page_story(options: Options) -> Tables:
    """A campaign from start to result on the page alone, with a killed server, at both widths; --figure FOLDER."""
    steps: Rows = []
    for width in WIDTHS:
        with tempfile.TemporaryDirectory(prefix="fast-page-") as folder:
            story = Story(Path(folder), width, options.figure, options.tell)
            story.tell_all()
            steps += story.steps
    return {"page-story": steps}


class Story:
    """The steps at one width, each with the seconds that it took."""

    def __init__(self, folder: Path, width: int, pictures: Path | None, tell: Callable[[str], None]) -> None:
        self.steps: Rows = []
        self._lake, self._width, self._pictures, self._tell = folder / "lake", width, pictures, tell
        self._ports = [_free_port(), _free_port()]
        self._since_s = time.monotonic()

    def tell_all(self) -> None:
        """All steps, in order; each raises when the page does not do what it should."""
        with self._serving() as address, open_browser(address, self._width) as page:
            page.set_default_timeout(1000 * LIMIT_S)
            self._begin(page)
            self._confirm(page, "B01")
            self._watch_force(page)
            self._pause(page)
            self._kill_server()
            page.wait_for_selector("#lost:visible")
            self._step("the server is killed", "the page says so")
            with self._serving():
                page.wait_for_selector("#lost", state="hidden")
                self._step("the server is back", "the page comes back by itself")
                self._go_on(page)
                self._answer_search(page)
                self._drop(page)
                self._confirm(page, "B02")
                self._see_result(page)
                self._try_as_stranger(address)

    def _begin(self, page: Any) -> None:
        say_name(page, "Ada")
        self._open(page, "Start")
        page.fill("#config", _CONFIG.format(world="none.toml"))
        page.wait_for_selector("#checked:has-text('none.toml')")
        page.fill("#config", _CONFIG.format(world=CHECKOUT / "worlds" / "quick.toml"))
        page.wait_for_selector("#checked:has-text('4 tools in 2 stages, 48 grasps')")
        page.click("button:has-text('Start the campaign')")
        page.wait_for_selector("#said:has-text('is started')")
        self._wait(lambda: (self._lake / "campaigns").exists(), "the campaign to begin")
        self._picture(page, "start")
        self._step("started", page.inner_text("#said"))

    def _confirm(self, page: Any, batch: str) -> None:
        """Wait until a batch is asked for, which may take a proposal, and say that it is printed."""
        end_s = time.monotonic() + LIMIT_S
        while not page.locator(f"form[aria-label='Batch story/{batch}']").count():
            if time.monotonic() > end_s:
                raise FastError(f"batch {batch} was not asked for within {LIMIT_S:.0f} s.")
            page.wait_for_timeout(1000)
            self._open(page, "To do", "story")
        self._picture(page, f"todo-{batch}")
        page.click(f"form[aria-label='Batch story/{batch}'] button:has-text('Printed and mounted')")
        page.wait_for_selector("#said:has-text('2 tools mounted, 0 rejected')")
        self._step(f"{batch} confirmed", page.inner_text("#said"))

    def _watch_force(self, page: Any) -> None:
        self._open(page, "Now", "story")
        page.wait_for_selector("#live-force:not(:empty)")
        before = page.inner_text("#live-force")
        page.wait_for_function("before => document.querySelector('#live-force').textContent !== before", arg=before)
        self._picture(page, "now")
        self._step("the force moves", f"{before}, then {page.inner_text('#live-force')}")

    def _pause(self, page: Any) -> None:
        page.click("button:has-text('Finish this grasp')")
        page.wait_for_selector("#word:has-text('paused')")
        self._step("paused", page.inner_text("#word"))

    def _go_on(self, page: Any) -> None:
        page.click(".orders button:has-text('Continue')")
        page.wait_for_selector("#said:has-text('goes on within a minute')")
        page.wait_for_selector("#word:has-text('running')")
        self._step("continued", page.inner_text("#word"))

    def _answer_search(self, page: Any) -> None:
        """A search that cannot tell ribs from walls asks for a calliper."""
        ask_person(Lake.open(self._lake), "story")
        self._open(page, "To do", "story")
        page.fill("form[aria-label='A number for search P0'] input[name='value']", "0,02")
        page.click("form[aria-label='A number for search P0'] button:has-text('Keep')")
        page.wait_for_selector("#said:has-text('0.02 is kept')")
        self._step("a search is answered", page.inner_text("#said"))

    def _drop(self, page: Any) -> None:
        """A bench of one's own in the same lake: a tenfold number is asked about, the right table is taken."""
        self._fast("ask", str(_PEOPLE / "pull.toml"), "--lake", str(self._lake))
        self._open(page, "To do", "pull")
        page.set_input_files(".drop input", _PEOPLE / "tenfold.csv")
        page.wait_for_selector(".dropped:has-text('a decimal point? It would be 4.98 N')")
        self._picture(page, "todo-tenfold")
        page.click("button:has-text('Not this file')")
        page.set_input_files(".drop input", _PEOPLE / "good.csv")
        page.click("button:has-text('Write it')")
        page.wait_for_selector("#said:has-text('48 grasps written')")
        self._step("a tenfold number is asked about", page.inner_text("#said"))

    def _see_result(self, page: Any) -> None:
        self._open(page, "Now", "story")
        page.wait_for_selector("#word:has-text('complete')")
        self._open(page, "Results", "story")
        page.click("a:has-text('story/B02T0')")
        page.wait_for_selector("[data-drawn] canvas")
        self._picture(page, "result")
        self._step("result", page.inner_text("h1"))

    def _try_as_stranger(self, address: str) -> None:
        """No key, another name, another site, no token: nothing is told and nothing written."""
        base = address.partition("?")[0]
        tries = {
            "no key": (401, {}),
            "another name": (403, {"Host": "evil.example"}),
            "another site": (403, {"Origin": "http://evil.example"}),
        }
        for path in ("", "todo", "api/v1/campaigns", "bench/reading", "orders/stop", "bench/order"):
            for name, (status, headers) in tries.items():
                found = _ask(base + path, headers)
                if found != status:
                    raise FastError(f"a stranger with {name} got {found} of /{path}, {status} was expected.")
        self._step("a stranger gets nothing", ", ".join(tries))

    def _open(self, page: Any, tab: str, campaign: str = "") -> None:
        page.click(f"nav a:has-text('{tab}')")
        if campaign and page.input_value("#campaign") != campaign:
            with page.expect_navigation():
                page.select_option("#campaign", campaign)
        if page.evaluate("() => document.documentElement.scrollWidth") > self._width:
            raise FastError(f"the tab {tab} is wider than {self._width} px.")

    @contextmanager
    def _serving(self) -> Iterator[str]:
        """`fast serve` on the same ports again and again, with a worker that is ready."""
        words = ["serve", "--lake", str(self._lake), "--port", str(self._ports[0]), "--page-port", str(self._ports[1])]
        command = [sys.executable, "-m", "fast.flows.cli.main", *words]
        process = subprocess.Popen(command, cwd=CHECKOUT, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
        self._process = process
        try:
            for line in process.stdout or ():
                if line.startswith("worker ready"):
                    break
            key = own_login(self._lake).partition(":")[2]
            yield f"http://127.0.0.1:{self._ports[1]}/?key={key}"
        finally:
            process.terminate()
            process.wait()

    def _kill_server(self) -> None:
        """SIGKILL of `fast serve`; what it started ends with it."""
        children = psutil.Process(self._process.pid).children(recursive=True)
        os.kill(self._process.pid, signal.SIGKILL)
        psutil.wait_procs(children, timeout=LIMIT_S)

    def _fast(self, *words: str) -> None:
        done = subprocess.run([sys.executable, "-m", "fast.flows.cli.main", *words], cwd=CHECKOUT, capture_output=True)
        if done.returncode:
            raise FastError(f"`fast {words[0]}` refused: {done.stderr.decode().strip()}")

    def _wait(self, is_so: Callable[[], bool], what: str, pause_s: float = 0.5) -> None:
        end_s = time.monotonic() + LIMIT_S
        while not is_so():
            if time.monotonic() > end_s:
                raise FastError(f"waited {LIMIT_S:.0f} s for {what}.")
            time.sleep(pause_s)

    def _picture(self, page: Any, name: str) -> None:
        if self._pictures is not None:
            self._pictures.mkdir(parents=True, exist_ok=True)
            page.screenshot(path=str(self._pictures / f"{name}-{self._width}.png"))

    def _step(self, name: str, words: str) -> None:
        now_s = time.monotonic()
        self.steps.append({"width_px": self._width, "step": name, "s": round(now_s - self._since_s, 1), "said": words})
        self._since_s = now_s
        self._tell(f"{self._width} px: {name}: {words}")


def _ask(address: str, headers: dict[str, str]) -> int:
    try:
        with urllib.request.urlopen(urllib.request.Request(address, headers=headers), timeout=30) as answer:
            return int(answer.status)
    except urllib.error.HTTPError as error:
        return error.code


def _free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        return int(listener.getsockname()[1])
