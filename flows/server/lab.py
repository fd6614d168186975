"""What stands while a lab works: the lab's page, the Prefect server, a worker, and the deployments of prefect.yaml."""

import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

import psutil

from fast.flows.server.access import address_for_person
from fast.flows.server.child_process import CHECKOUT, ChildProcess
from fast.flows.server.crashed_runs import end_crashed_runs
from fast.flows.server.environment import (
    FOLDER_VARIABLE,
    LAB_VARIABLE,
    LOGIN_VARIABLE,
    SERVER_VARIABLE,
    make_environment,
)
from fast.flows.server.loopback import LOOPBACK
from fast.flows.server.page_port import PageServer, find_page, listen
from fast.flows.server.run_process import ASKED_S
from fast.flows.server.server import (
    address_for_others,
    ask_server,
    find_server,
    get_api,
    in_turn,
    is_healthy,
    note_server,
    reach_named_server,
    start_server,
    state_folder,
    stop_server,
)
from fast.flows.server.worker_process import POOL
from fast.lake.store import Lake
from fast.models.errors import FastError

POOL_LIMIT_S = 300.0
DEPLOY_LIMIT_S = 600.0
SWEEP_S = 5.0  # between looks for flow runs whose process is gone
WORKER_POLL_S = "5"  # between the worker's looks for runs to start, where Prefect waits 10 s


@dataclass(frozen=True)
class LabPlan:
    """How the lab is to stand. `host`: where server and page listen; `n_runs`: flow runs of the worker at once.

    `page_port`: of the lab's page, None is 4210, or a free one where that is taken.
    """

    port: int
    host: str = LOOPBACK
    n_runs: int = 4
    page_port: int | None = None


class Lab:
    """Page, server and worker of a lake, all watched."""

    def __init__(self, lake: Lake, plan: LabPlan) -> None:
        self._lake = lake
        self._swept_s = 0.0
        self._server: ChildProcess | None = None
        self._runs: list[psutil.Process] = []
        with in_turn(lake.root):
            api = reach_named_server()
            if api is None:
                refuse_second(lake.root)
                self._server = start_server(lake.root, plan.port, plan.host)
                api = get_api(self._server)
            self._page = PageServer(lake, listen(plan.page_port, plan.host))
        self.api, self.page = api, self._page.api
        self._environment = {
            **make_environment(self.api, state_folder(lake.root)),
            # What the worker starts uses this server, also while it is started again.
            SERVER_VARIABLE: self.api.url,
            "FAST_CHECKOUT": str(CHECKOUT),
            FOLDER_VARIABLE: os.getcwd(),
            LAB_VARIABLE: str(os.getpid()),
            "FAST_LAKE": address_for_others(lake),
        }
        if self.api.login:
            self._environment[LOGIN_VARIABLE] = self.api.login
        self._environment.setdefault("PREFECT_WORKER_QUERY_SECONDS", WORKER_POLL_S)
        self._page.start()
        log = state_folder(lake.root) / "worker.log"
        self._n_runs = plan.n_runs
        self._worker = ChildProcess("fast.flows.server.worker_process", [str(os.getpid())], self._environment, log)
        self._worker.start()

    def deploy(self) -> list[str]:
        """Apply prefect.yaml; returns the names of the deployments.

        Raises:
            FastError: the worker made no pool, or Prefect refused a deployment.
        """
        self.prepare_pool()
        command = [sys.executable, "-m", "prefect", "--no-prompt", "deploy", "--all"]
        done = subprocess.run(
            command, cwd=CHECKOUT, env=self._environment, capture_output=True, text=True, timeout=DEPLOY_LIMIT_S
        )
        if done.returncode:
            last = " ".join((done.stderr or done.stdout).strip().splitlines()[-3:])
            raise FastError(f"the deployments of {CHECKOUT / 'prefect.yaml'} were not accepted: {last}")
        return sorted(found["name"] for found in ask_server(self.api, "/deployments/filter", {}))

    def tend(self, progress: Callable[[str], None]) -> None:
        """Start again what died, and campaigns whose process did; what they need is in the database and in the lake."""
        if self._server is not None and self._server.restart_if_dead():
            note_server(self._lake.root, self._server)
            progress(f"the Prefect server had died and was started again; its log is {self._server.log_path}")
        self.find_runs()
        if self._worker.restart_if_dead():
            progress(f"the worker had died and was started again; its log is {self._worker.log_path}")
        # A server that is still starting would hold this up, and with it the start of the worker.
        if time.monotonic() - self._swept_s > SWEEP_S and is_healthy(self.api):
            self._swept_s = time.monotonic()
            only_worker_since = None if self._server is None else self._worker.since
            for sentence in end_crashed_runs(self.api, and_continue=True, worker_since=only_worker_since).sentences:
                progress(sentence)

    def close(self) -> None:
        """Stop the page and the worker, ask its runs to pause and wait for them, then stop the server."""
        self._page.close()
        runs = self.find_runs()
        self._worker.stop()
        for run in runs:
            with suppress(psutil.NoSuchProcess):
                run.terminate()
        psutil.wait_procs(runs, ASKED_S)
        if self._server is not None:
            stop_server(self._lake.root, self._server)

    def find_runs(self) -> list[psutil.Process]:
        """Find the processes of the runs that the worker, or one that died before it, has begun and that go on."""
        self._runs = [run for run in {*self._runs, *self._worker.list_children()} if run.is_running()]
        return self._runs

    @property
    def pids(self) -> tuple[int, int]:
        """Process ids of the server (0: it is not ours) and of the worker."""
        return self._server.pid if self._server else 0, self._worker.pid

    def prepare_pool(self) -> None:
        """Wait until the worker has made its pool, and limit the runs at once: the server starts no more of them.

        Raises:
            FastError: it does not.
        """
        deadline = time.monotonic() + POOL_LIMIT_S
        while True:
            try:
                ask_server(self.api, f"/work_pools/{POOL}", {"concurrency_limit": self._n_runs}, method="PATCH")
                return
            except OSError as error:
                if time.monotonic() > deadline or not self._worker.is_alive():
                    raise FastError(
                        f"the worker did not start within {POOL_LIMIT_S:.0f} s; its log is {self._worker.log_path}."
                    ) from error
            time.sleep(0.5)


def refuse_second(lake_root: Path) -> None:
    """Raise FastError if a server of this lake runs already."""
    server = find_server(lake_root)
    if server is not None:
        address = address_for_person(find_page(lake_root) or server)
        raise FastError(
            f"a server of this lake runs already: {address}; use that one, or first end the command that started it."
        )


@contextmanager
def open_lab(lake: Lake, plan: LabPlan) -> Iterator[Lab]:
    """Open a lab that stands as long as the `with` block lasts."""
    lab = Lab(lake, plan)
    try:
        yield lab
    finally:
        lab.close()
