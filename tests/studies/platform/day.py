"""A day in a lab, scripted: serve, start a campaign, answer the print form in a browser, watch, read the report.

The bench is virtual and small; server, worker, pages, forms, schedule and notifications are the real ones.
"""

import json
import math
import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from datetime import UTC, datetime, timedelta
from functools import partial
from pathlib import Path
from typing import Any

from fast.flows.server.access import Api, own_login
from fast.flows.server.lab import CHECKOUT
from fast.flows.server.server import ask_server, find_server
from fast.models.errors import FastError
from tests.studies.benchmarks.base import Options, Tables
from tests.studies.platform.browser import Browser, open_browser
from tests.studies.platform.inbox import open_inbox
from tests.studies.platform.sockets import family, is_loopback, listening

LIMIT_S = 1800.0
CLICK_S = 30.0
CAMPAIGN = "day"
_CONFIG = """
name = "day"
seed = 2
[schedule]
initial_tools = 2
tools_per_batch = 2
guided_batches = 1
initial_simulations = 2
simulations_per_batch = 1
[objects]
ids = [0, 14]
repeats = 2
[bench]
world = "world.toml"
[execution]
simulation_workers = 1
print_poll_s = 1.0
notify_virtual = true
"""


def measure_day(options: Options) -> Tables:
    """A day in a lab on a virtual bench, with server, worker, browser and schedule; --figure FOLDER keeps pictures."""
    with tempfile.TemporaryDirectory(prefix="fast-day-") as folder:
        messages: list[dict[str, Any]] = []
        day = Day(Path(folder), options.figure, options.tell)
        with open_inbox(messages) as address, day.serving(address), open_browser(height=1900) as browser:
            day.live(browser)
            day.check_messages(messages)
        return {"day": day.steps}


class Day:
    """The steps of the day, each with the seconds it took."""

    def __init__(self, folder: Path, pictures: Path | None, tell: Callable[[str], None]) -> None:
        self.steps: list[dict[str, Any]] = []
        self._folder, self._pictures, self._tell = folder, pictures, tell
        self._lake = folder / "lake"
        self._api = Api("")
        self._serve_pid = 0
        self._since_s = time.monotonic()

    def live(self, browser: Browser) -> None:
        """All steps, in order; each raises when the lab does not do what it should."""
        self._check_sockets()
        self._schedule_recalibration()
        self._start("run-campaign/campaign", config=str(self._folder / "day.toml"))
        form = self._wait_for_form()
        self._answer_badly(browser, form)
        self._kill_server()
        self._answer_well(browser, form)
        self._confirm("B01")
        self._look(browser, f"/runs/flow-run/{self._campaign_run()}", "gantry", "campaign-measuring")
        self._wait_for_batch(2)
        self._confirm("B02")
        self._wait_for("the campaign to end", self._campaign_end)
        self._step("campaign complete", self._campaign_end())
        self._run_other_deployments()
        self._look(browser, f"/runs/flow-run/{self._campaign_run()}", "Completed", "campaign-run")
        self._look_at_report(browser)
        self._check_recalibration()

    @contextmanager
    def serving(self, notify: str) -> Iterator[None]:
        """`fast serve` for as long as the `with` block lasts; it must stop cleanly. `notify`: where messages go."""
        world = (CHECKOUT / "worlds" / "quick.toml").read_text(encoding="utf-8").replace("5.0", "8.0")
        (self._folder / "world.toml").write_text(world, encoding="utf-8")
        (self._folder / "day.toml").write_text(_CONFIG, encoding="utf-8")
        kept = {key: value for key, value in os.environ.items() if not key.startswith("PREFECT_")}
        environment = {**kept, "FAST_NOTIFY": notify, "PYTHONPATH": str(CHECKOUT)}
        words = ["serve", "--lake", str(self._lake), "--port", str(_free_port()), "--json"]
        command = [sys.executable, "-m", "fast.flows.cli.main", *words]
        child = subprocess.Popen(command, cwd=CHECKOUT, env=environment, stdout=subprocess.PIPE, text=True)
        ready = child.stdout.readline() if child.stdout else ""
        try:
            if not ready:
                raise FastError("`fast serve` ended before it was ready; run it by hand to see why.")
            told = json.loads(ready)
            self._api, self._serve_pid = Api(told["api_url"], own_login(self._lake)), child.pid
            self._step("server, worker and deployments ready", ", ".join(told["deployments"]))
            yield
        finally:
            members = family(child.pid)
            child.send_signal(signal.SIGINT)
            status = child.wait(timeout=120)
            left = [pid for pid in members if Path(f"/proc/{pid}").exists() and pid != child.pid]
            self._step("Ctrl-C", f"exit status {status}, {len(left)} processes left")

    def _check_sockets(self) -> None:
        addresses = {address for address, _ in listening(family(self._serve_pid))}
        if not addresses or not all(map(is_loopback, addresses)):
            raise FastError(f"the lab listens on {sorted(addresses)}; only the loopback address was asked for.")
        self._step("listens on loopback only", ", ".join(sorted(addresses)))

    def _schedule_recalibration(self) -> None:
        """A schedule in two minutes beside the one of prefect.yaml, so that the day need not last until 06:00."""
        found = ask_server(self._api, "/deployments/name/recalibrate/recalibrate")
        at = datetime.now(UTC) + timedelta(minutes=2)
        daily = {"schedule": {"cron": f"{at.minute} {at.hour} * * *", "timezone": "UTC"}, "active": True}
        ask_server(self._api, f"/deployments/{found['id']}/schedules", [daily])

    def _campaign_end(self) -> str:
        """What the completed run of the campaign says; a crashed one is continued in another run."""
        named = {"flows": {"name": {"any_": ["run-campaign"]}}}
        runs = ask_server(self._api, "/flow_runs/filter", named)
        ended = [run["state"]["message"] for run in runs if run["state"]["type"] == "COMPLETED"]
        return str(ended[0]) if ended else ""

    def _run_other_deployments(self) -> None:
        """What else the pages offer, on a campaign that is complete: each says that nothing is left to do."""
        config = str(self._folder / "day.toml")
        runs = {
            "run-batch/run_batch": self._start("run-batch/run_batch", config=config, batch=1),
            "simulate/simulate": self._start("simulate/simulate", config=config),
        }
        for name, run_id in runs.items():
            self._wait_for(name, partial(self._has_ended, run_id))
            self._step(name, self._state(run_id)["message"])

    def _has_ended(self, run_id: str) -> bool:
        return self._state(run_id)["type"] in ("COMPLETED", "FAILED")

    def _start(self, deployment: str, **parameters: Any) -> str:
        """Id of a new run of a deployment, on the lake of the day."""
        found = ask_server(self._api, f"/deployments/name/{deployment}")
        body = {"parameters": {"lake": str(self._lake), **parameters}}
        return str(ask_server(self._api, f"/deployments/{found['id']}/create_flow_run", body)["id"])

    def _wait_for_form(self) -> str:
        """Id of the run that waits with a form."""
        self._wait_for("the print form", self._suspended)
        self._step("form waits", "the campaign asks a person to print and mount B01")
        return self._suspended()

    def _suspended(self) -> str:
        tagged = {"flow_runs": {"tags": {"all_": ["needs-you"]}, "state": {"type": {"any_": ["PAUSED"]}}}}
        runs = ask_server(self._api, "/flow_runs/filter", tagged)
        return str(runs[0]["id"]) if runs else ""

    def _answer_badly(self, browser: Browser, form: str) -> None:
        """Reject a tool without a reason: the form must come back and say so."""
        self._open_form(browser, form)
        browser.type_into("Your name", "Ada")
        browser.choose("What became", "rejected", 1)
        self._submit(browser, form)
        self._wait_for("the form to come back", lambda: self._suspended() == form and self._times_asked(form) > 1)
        self._step("bad answer asks again", "a tool rejected without a reason")

    def _kill_server(self) -> None:
        """SIGKILL of the server while a form waits: `fast serve` starts it again, and the form is still there."""
        address = json.loads((self._lake / ".state" / "server.json").read_text(encoding="utf-8"))
        os.kill(address["pid"], signal.SIGKILL)
        self._wait_for("the server to be gone", lambda: find_server(self._lake) is None)
        self._wait_for("the server to be back", lambda: find_server(self._lake) is not None)
        self._step("server killed and started again", "the form still waits")

    def _answer_well(self, browser: Browser, form: str) -> None:
        self._open_form(browser, form)
        browser.wait_for_words("could not be used")
        browser.type_into("Your name", "Ada")
        browser.type_into("Material lot", "TPU 26-117")
        browser.type_into("Front wall", "2.55", 0)
        browser.choose("What became", "print again", 1)
        browser.type_into("Reason", "warped", 1)
        self._picture(browser, "print-form")
        self._submit(browser, form)
        self._wait_for("the form to be read", lambda: self._state(form)["type"] == "COMPLETED")
        self._step("form accepted", self._state(form)["message"])

    def _open_form(self, browser: Browser, form: str) -> None:
        browser.open(f"{self._api.page}/runs/flow-run/{form}")
        browser.click("Resume")
        browser.wait("document.querySelectorAll('.p-modal .p-label').length > 16")

    def _submit(self, browser: Browser, form: str) -> None:
        """Click until the answer is taken: the page says `Oops` when the server's database is busy."""
        before, clicked_s = self._state(form)["id"], -math.inf

        def is_taken() -> bool:
            nonlocal clicked_s
            if self._state(form)["id"] != before:
                return True
            if time.monotonic() - clicked_s > CLICK_S:
                browser.click("Submit")
                clicked_s = time.monotonic()
            return False

        self._wait_for("the answer to be taken", is_taken)

    def _confirm(self, batch: str) -> None:
        """The word of a person on the command line."""
        words = ["print", "confirm", f"{CAMPAIGN}/{batch}", "--operator", "Ada", "--lake", str(self._lake)]
        command = [sys.executable, "-m", "fast.flows.cli.main", *words]
        done = subprocess.run(command, cwd=CHECKOUT, capture_output=True, text=True, timeout=LIMIT_S)
        if done.returncode:
            raise FastError(f"`fast print confirm` refused: {done.stderr.strip()}")
        self._step(f"{batch} confirmed on the command line", done.stdout.strip())

    def _wait_for_batch(self, batch: int) -> None:
        sheet = self._lake / "outputs" / CAMPAIGN / f"B{batch:02d}-print" / "sheet.html"
        self._wait_for(f"the sheet of B{batch:02d}", sheet.exists)
        self._step(f"B{batch:02d} proposed", "from measurements and simulations")

    def _campaign_run(self) -> str:
        which = {"flow_runs": {"name": {"any_": [f"campaign {CAMPAIGN}"]}}}
        newest_first = {**which, "sort": "START_TIME_DESC"}
        return str(ask_server(self._api, "/flow_runs/filter", newest_first)[0]["id"])

    def _look_at_report(self, browser: Browser) -> None:
        browser.open(f"{self._api.page}/outputs/{CAMPAIGN}/report/index.html")
        title = browser.wait("document.readyState === 'complete' && document.querySelector('h1')?.innerText")
        self._picture(browser, "report")
        self._step("report opens", str(title))

    def _check_recalibration(self) -> None:
        def ended() -> list[dict[str, Any]]:
            which = {"flow_runs": {"state": {"type": {"any_": ["COMPLETED"]}}}}
            runs = ask_server(self._api, "/flow_runs/filter", which)
            return [run for run in runs if run["auto_scheduled"] and run["name"].startswith("recalibrate")]

        self._wait_for("a scheduled recalibration", lambda: bool(ended()))
        self._step("scheduled recalibration fired", ended()[0]["state"]["message"])

    def check_messages(self, messages: Sequence[Mapping[str, Any]]) -> None:
        """The notifications of the day: one that needs a person, one at the end."""
        titles = [message["title"] for message in messages]
        if not (any("needs you" in title for title in titles) and any("is done" in title for title in titles)):
            raise FastError(f"the notifications were {titles}; one that needs a person and one at the end were due.")
        self._step("notifications", "; ".join(titles))

    def _times_asked(self, form: str) -> int:
        states = ask_server(self._api, f"/flow_run_states/?flow_run_id={form}")
        return sum(state["name"] == "Suspended" for state in states)

    def _state(self, run_id: str) -> dict[str, Any]:
        found: dict[str, Any] = ask_server(self._api, f"/flow_runs/{run_id}")["state"]
        return found

    def _look(self, browser: Browser, path: str, words: str, name: str) -> None:
        browser.open(f"{self._api.page}{path}")
        browser.wait_for_words(words)
        self._picture(browser, name)

    def _picture(self, browser: Browser, name: str) -> None:
        if self._pictures is not None:
            browser.picture(self._pictures / f"{name}.png")

    def _wait_for(self, what: str, condition: Callable[[], Any]) -> None:
        deadline = time.monotonic() + LIMIT_S
        while time.monotonic() < deadline:
            try:
                if condition():
                    return
            except OSError:
                pass  # the server is busy, or being started again
            time.sleep(1)
        raise FastError(f"waited {LIMIT_S:.0f} s for {what}.")

    def _step(self, step: str, what: str) -> None:
        now_s = time.monotonic()
        self.steps.append({"step": step, "seconds": round(now_s - self._since_s, 1), "what": what})
        self._since_s = now_s
        self._tell(f"{step}: {what}")


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])
