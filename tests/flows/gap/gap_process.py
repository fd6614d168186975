"""What a worker and a recalibration do, in a process of its own, on the server that is named; no physics, no NUTS.

Arguments: a lake, then words. `pool` makes the work pool of prefect.yaml, `deploy` the deployment, `run` runs the flow,
`announce` sends the event of a new calibration; `search` searches without a server. Prints the messages of the flow's
states. DIE_AT=bank kills the process in the middle of the bank, DIE_AT=local in the middle of the one around the fitted
theta, DIE_AT=chains while it samples the simulator with what was named, DIE_AT=show when that is calibrated and not yet
compared with the one before.
"""

import os
import runpy
import signal
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

from fast.flows.server.access import Api
from fast.flows.server.environment import named_server
from fast.flows.server.server import configure_client
from fast.lake.store import Lake
from fast.tasks.simulation.plan import SimulationPlan


def main(root: Path, words: list[str], api: Api | None) -> None:
    """Do what the words say, in order."""
    if api is not None:
        configure_client(api, root)
    commands = {"pool": make_pool, "deploy": deploy, "run": run_flow, "announce": announce, "search": search}
    for word in words:
        commands[word](root)


def make_pool(root: Path) -> None:
    """The work pool that the deployments name."""
    from tests.flows.calibration.recalibrate_process import make_pool

    make_pool(root)


def deploy(_: Path) -> None:
    """Deploy the flow as a person would: the command line of Prefect, which ends the process unless it is caught."""
    sys.argv = ["prefect", "--no-prompt", "deploy", "--name", "close_gap"]
    try:
        runpy.run_module("prefect", run_name="__main__")
    except SystemExit as end:
        if end.code:
            raise


def run_flow(root: Path) -> None:
    """Run the deployment's flow as a worker would."""
    from fast.flows.deployments import close_gap
    from tests.flows.undrawn import leave_undrawn
    from tests.synthetic.rehearsal import USUAL

    make_up()
    patch = pytest.MonkeyPatch()
    # One of its own takes minutes.
    patch.setattr("fast.models.gap.evidence.rehearsal.rehearse_panel", lambda *_, **__: USUAL)
    leave_undrawn(patch)
    state = close_gap(lake=str(root), workers=1, return_state=True)
    sys.stdout.write(f"{state.type.value}: {state.message}\n")
    sys.stdout.flush()


def search(root: Path) -> None:
    """Search a lake as `fast gap` does."""
    from fast.flows.gap.search import GapRequest, run_gap
    from fast.flows.progress import ProgressReporter

    make_up()
    outcome = run_gap(
        Lake.open(root), GapRequest("demo", rehearsed=8), ProgressReporter(lambda _: None, lambda _: None)
    )
    sys.stdout.write(f"{outcome.sentence}\n")


def make_up() -> None:
    """Made-up answers in the place of finite elements, and normal draws in the place of NUTS."""
    from fast.flows.gap import search
    from fast.models.gap.fit import posterior
    from fast.tasks.gap.bank import HELD_OUT, LOCAL_BANK, WIDE_BANK
    from tests.tasks.calibration.trace_lake import PROVENANCE, normal_draws
    from tests.tasks.gap.gap_lake import plan_rows

    dies_at, n_sampled, asked = os.environ.get("DIE_AT"), 0, ""
    last = {"bank": WIDE_BANK, "local": LOCAL_BANK, "show": HELD_OUT}.get(dies_at or "")
    as_asked = search.Simulator.simulate

    def note(simulator: search.Simulator, what: str, plans: Sequence[SimulationPlan]) -> None:
        nonlocal asked
        asked = what
        as_asked(simulator, what, plans)

    def simulate(lake: Lake, plans: Sequence[SimulationPlan], *_: Any) -> None:
        is_last = asked == last
        if dies_at == "show" and is_last:
            os.kill(os.getpid(), signal.SIGKILL)
        for plan in plans:
            known = set(lake.query("SELECT simulation_id AS id FROM simulations").column("id").to_pylist())
            rows = [row for row in plan_rows([plan]) if getattr(row, "simulation_id", "") not in known]
            lake.append(rows[: len(rows) // 2] if is_last else rows, PROVENANCE)
            if is_last:
                os.kill(os.getpid(), signal.SIGKILL)

    def sample(*words: Any, **options: Any) -> Any:
        nonlocal n_sampled
        n_sampled += 1
        if dies_at == "chains" and n_sampled == 2:  # the first is of theta alone
            os.kill(os.getpid(), signal.SIGKILL)
        return normal_draws(*words, **options)

    search.simulate_missing, posterior.sample = simulate, sample
    search.Simulator.simulate = note  # type: ignore[method-assign]


def announce(root: Path) -> None:
    """Send the event that a recalibration sends when it found something new."""
    from prefect.events.worker import EventsWorker

    from fast.flows.campaign.events import announce_calibrated

    announce_calibrated(Lake.open(root), "C0", "calibration C0")
    EventsWorker.drain_all(timeout=20)


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2:], named_server())
