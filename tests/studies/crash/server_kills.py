"""Flow process, worker and server of a lab killed at random moments of campaigns, which go on by themselves.

The lab is that of `fast serve`: the Prefect server, a worker, and the loop that starts again what died. The campaigns
are made up (`tests.studies.benchmarks.made_up_campaign`), so that a kill costs process starts and little else.
"""

import random
import shutil
import socket
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import psutil

from fast.flows.server.crashed_runs import CONTINUED
from fast.flows.server.lab import CHECKOUT, Lab, LabPlan, open_lab
from fast.flows.server.server import ask_server
from fast.lake.leases import exclusive, is_held
from fast.lake.store import Lake
from fast.models.errors import FastError
from fast.models.records import Record
from tests.studies.benchmarks.base import Options, Rows, Tables
from tests.studies.benchmarks.made_up_campaign import write_files
from tests.studies.benchmarks.outcomes import RecordFile, read_records
from tests.studies.crash.server_kill_judge import Progress, judge_campaign, judge_server

N_KILLS = 100
SEED = 20261121
TARGETS = (
    ("flow",), ("worker",), ("server",),
    ("flow", "worker"), ("flow", "server"), ("worker", "server"), ("flow", "worker", "server"),
)  # fmt: skip
EARLY_SHARE = 0.25  # of the kills; they come while what was killed before is still starting
LATEST_S = 6.0  # after the first new row, when the kill does not come early
CONTINUE_LIMIT_S = 900.0  # on a busy machine, three processes and their imports take minutes


class Kill(Record):
    """A kill and what came of it. `alive`: of the targets, those that ran; the others were still starting."""

    number: int
    campaign: str
    targets: tuple[str, ...]
    alive: tuple[str, ...]
    is_early: bool
    rows_before: int
    second_refused: bool | None = None
    continued_after_s: float | None = None
    problem: str = ""


def measure_server_kills(options: Options) -> Tables:
    """Flow process, worker and server killed at random in a lab that goes on by itself; --n kills (100)."""
    n_kills = options.n or N_KILLS
    known = list(read_records(options.results, Kill, "kill"))
    with _folder(options.results) as folder, RecordFile(options.results) as file:
        with open_lab(Lake.open(folder / "lake", create=True), LabPlan(_free_port())) as lab:
            study = _Study(folder, lab, options, file, known)
            study.run(n_kills)
            problems = study.problems()
    kills = study.kills
    return {"kills": summary(kills), "problems": [{"problem": text} for text in problems] or [{"problem": "none"}]}


class _Study:
    """Kills until there are enough, one campaign after the other."""

    def __init__(self, folder: Path, lab: Lab, options: Options, file: RecordFile, known: list[Kill]) -> None:
        self.kills = known
        self._folder, self._lab, self._options, self._file = folder, lab, options, file
        self._lake = Lake.open(folder / "lake")
        self._random = random.Random(SEED + len(known))
        self._deployment_id = _deploy(lab)
        last = known[-1].campaign if known else "kills-0"
        # Without its lake a campaign cannot go on: the next one begins in a new lake.
        self._name = last if last in self._names() else _after(last)
        self._started = time.monotonic()

    def run(self, n_kills: int) -> None:
        """Until there are `n_kills`, or the time is up; the last campaign is then left to end."""
        self._start_campaign()
        while len(self.kills) < n_kills and not self._is_late():
            if self._progress().is_complete:
                self._name = _after(self._name)
                self._start_campaign()
            kill = self._kill_once()
            self.kills.append(kill)
            self._file.append(kill)
            after = "early" if kill.is_early else f"went on after {kill.continued_after_s or 0:.0f} s"
            self._options.tell(f"kill {kill.number} of {n_kills}: {'+'.join(kill.targets)}, {after} {kill.problem}")
        self._wait_until(lambda: self._progress().is_complete and not self._pids()["flow"])

    def problems(self) -> list[str]:
        """What is not as it must be in the lake, on the server and of the locks, now that all is quiet."""
        names = self._names()
        found = [problem for name in names for problem in judge_campaign(self._lake, name)]
        found += judge_server(lambda path, body: ask_again(self._lab, path, body))
        found += [f"kill {kill.number}: {kill.problem}" for kill in self.kills if kill.problem]
        locks = ["gantry", *(f"campaign-{name}" for name in names)]
        return found + [f"the lock {lock} is stuck" for lock in locks if is_held(self._lake.storage, lock)]

    def _names(self) -> list[str]:
        """Campaigns that were begun in this lake."""
        return sorted(path.stem for path in self._folder.glob("kills-*.toml"))

    def _is_late(self) -> bool:
        return time.monotonic() - self._started > 60.0 * self._options.limit_minutes

    def _progress(self) -> Progress:
        return Progress.of(self._lake, self._name)

    def _start_campaign(self) -> None:
        config = write_files(self._folder, self._name)
        parameters = {"config": str(config), "lake": str(self._folder / "lake"), "auto_print": True}
        body = {"parameters": parameters, "idempotency_key": f"{self._name} from kill {len(self.kills)}"}
        ask_again(self._lab, f"/deployments/{self._deployment_id}/create_flow_run", body)
        self._wait_until(lambda: self._progress().n_rows > 0)

    def _kill_once(self) -> Kill:
        is_early = bool(self.kills) and self._random.random() < EARLY_SHARE
        self._tend_for(self._random.uniform(0.0, 4 * LATEST_S if is_early else LATEST_S))
        targets = self._random.choice(TARGETS)
        before, second_refused = self._progress().n_rows, self._is_second_refused()
        pids = self._pids()
        for target in targets:
            for pid in pids[target]:
                with suppress(psutil.NoSuchProcess):
                    psutil.Process(pid).kill()
        kill = Kill(
            number=len(self.kills) + 1, campaign=self._name, targets=targets,
            alive=tuple(target for target in targets if pids[target]), is_early=is_early, rows_before=before,
            second_refused=second_refused,
        )  # fmt: skip
        if is_early:
            return kill
        started = time.monotonic()
        try:
            self._wait_until(lambda: self._progress().n_rows > before or self._progress().is_complete)
        except FastError as error:
            return kill.model_copy(update={"problem": str(error)})
        problem = "a second owner of the campaign was let in" if second_refused is False else ""
        return kill.model_copy(update={"continued_after_s": time.monotonic() - started, "problem": problem})

    def _is_second_refused(self) -> bool | None:
        """Whether the campaign, run now, refuses another owner; None when it is not run at this moment."""
        lock = f"campaign-{self._name}"
        if not self._pids()["flow"] or not is_held(self._lake.storage, lock):
            return None
        try:
            with exclusive(self._lake.storage, lock, "busy"):
                return not is_held(self._lake.storage, lock)  # it ended just now
        except FastError:
            return True

    def _pids(self) -> dict[str, list[int]]:
        """Processes by role; those of a flow run are its own and those that started it."""
        server, worker = self._lab.pids
        flows = []
        with suppress(psutil.NoSuchProcess):
            flows = [child.pid for child in psutil.Process(worker).children()]
        return {"server": _alive(server), "worker": _alive(worker), "flow": flows or self._orphans()}

    def _orphans(self) -> list[int]:
        """Flow processes whose worker was killed before them."""
        return [p.info["pid"] for p in psutil.process_iter(["pid", "environ"]) if self._is_our_flow(p.info["environ"])]

    def _is_our_flow(self, environment: dict[str, str] | None) -> bool:
        found = environment or {}
        return found.get("PREFECT_API_URL") == self._lab.api.url and "PREFECT__FLOW_RUN_ID" in found

    def _tend_for(self, seconds: float) -> None:
        deadline = time.monotonic() + seconds
        while time.monotonic() < deadline:
            self._lab.tend(self._options.tell)
            time.sleep(0.2)

    def _wait_until(self, condition: Callable[[], bool]) -> None:
        """Look after the lab until the condition holds.

        Raises:
            FastError: it does not in time.
        """
        deadline = time.monotonic() + CONTINUE_LIMIT_S
        while not condition():
            if time.monotonic() > deadline:
                raise FastError(f"nothing new within {CONTINUE_LIMIT_S:.0f} s")
            self._tend_for(0.5)


def _after(name: str) -> str:
    """Name of the campaign after `kills-N`."""
    return f"kills-{int(name.rpartition('-')[2]) + 1}"


def _deploy(lab: Lab) -> str:
    """The deployment of the made-up campaign, as `prefect deploy` would make it; returns its id."""
    lab.prepare_pool()
    flow_id = ask_again(lab, "/flows/", {"name": CONTINUED})["id"]
    step = {"prefect.deployments.steps.set_working_directory": {"directory": str(CHECKOUT)}}
    deployment = {
        "name": "made-up-campaign",
        "flow_id": flow_id,
        "work_pool_name": "lab",
        "entrypoint": "tests.studies.crash.made_up_deployable.campaign",
        "pull_steps": [step],  # and no limit of runs at once: see prefect.yaml
    }
    return str(ask_again(lab, "/deployments/", deployment)["id"])


def ask_again(lab: Lab, path: str, body: dict[str, Any]) -> Any:
    """Answer of a server that may be busy, or killed; the same question twice must do no harm.

    Raises:
        FastError: it does not answer for long.
    """
    deadline = time.monotonic() + CONTINUE_LIMIT_S
    while True:
        try:
            return ask_server(lab.api, path, body, timeout_s=60.0)
        except OSError as error:
            if time.monotonic() > deadline:
                raise FastError(f"the server of the study does not answer: {error}; run it again.") from error
            time.sleep(2.0)


def summary(kills: list[Kill]) -> Rows:
    """A row for each set of targets and one for all: kills, and how long it took until a new row came."""
    rows: Rows = []
    for targets in (*TARGETS, None):
        chosen = [kill for kill in kills if targets in (None, kill.targets)]
        waits = sorted(kill.continued_after_s for kill in chosen if kill.continued_after_s is not None)
        reached = Counter(target for kill in chosen for target in kill.alive)
        rows.append(
            {
                "killed": "all" if targets is None else "+".join(targets),
                "kills": len(chosen),
                "early": sum(kill.is_early for kill in chosen),
                **{f"{role}_killed": reached[role] for role in ("flow", "worker", "server")},
                "second_owner_refused": sum(kill.second_refused is True for kill in chosen),
                "second_owner_let_in": sum(kill.second_refused is False for kill in chosen),
                "median_wait_s": waits[len(waits) // 2] if waits else None,
                "longest_wait_s": waits[-1] if waits else None,
                "problems": sum(bool(kill.problem) for kill in chosen),
            }
        )
    return rows


@contextmanager
def _folder(results: Path | None) -> Iterator[Path]:
    """Where the lake is: beside the results, so that a study can be continued, or for this time only."""
    if results is not None:
        folder = results.with_suffix(".lab").resolve()
        if not results.exists() and folder.exists():
            shutil.rmtree(folder)
        folder.mkdir(parents=True, exist_ok=True)
        yield folder
        return
    with tempfile.TemporaryDirectory(prefix="fast-server-kills-") as name:
        yield Path(name)


def _alive(pid: int) -> list[int]:
    return [pid] if pid and psutil.pid_exists(pid) else []


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])
