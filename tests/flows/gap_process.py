"""What a worker and a recalibration do, in a process of its own, on the server of PREFECT_API_URL; no physics, no NUTS.

Arguments: a lake, then words. `pool` makes the work pool of prefect.yaml, `run` the flow, `announce` sends the event of
a new calibration. Prints the messages of the flow's states.
"""

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from flows.prefect_server import configure_client
from lake.store import Lake
from tasks.hypercube import SimulationPlan


def main(root: Path, words: list[str], api_url: str) -> None:
    """Do what the words say, in order."""
    configure_client(api_url, root)
    for word in words:
        {"pool": make_pool, "run": run_flow, "announce": announce}[word](root)


def make_pool(root: Path) -> None:
    """The work pool that the deployments name."""
    from tests.flows.recalibrate_process import make_pool

    make_pool(root)


def run_flow(root: Path) -> None:
    """Run the deployment's flow as a worker would."""
    import flows.gap
    from flows.deployable import close_gap
    from models.gap import joint
    from tests.tasks.gap_lake import plan_rows
    from tests.tasks.trace_lake import PROVENANCE, normal_draws

    def simulate(lake: Lake, plans: Sequence[SimulationPlan], *_: Any) -> None:
        lake.append(plan_rows(plans), PROVENANCE)

    flows.gap.simulate_missing, joint.sample = simulate, normal_draws
    state = close_gap(lake=str(root), workers=1, return_state=True)
    sys.stdout.write(f"{state.type.value}: {state.message}\n")
    sys.stdout.flush()


def announce(root: Path) -> None:
    """Send the event that a recalibration sends when it found something new."""
    from prefect.events.worker import EventsWorker

    from flows.events import announce_calibrated

    announce_calibrated(Lake.open(root), "C0", "calibration C0")
    EventsWorker.drain_all(timeout=20)


if __name__ == "__main__":
    import os

    main(Path(sys.argv[1]), sys.argv[2:], os.environ["PREFECT_API_URL"])
