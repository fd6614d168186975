"""What a worker and a campaign do, in a process of its own, on the server that is named; made-up draws.

Arguments: a lake, then words. `pool` makes the work pool of prefect.yaml, `run` the flow, `measure` appends grasps of
more tools, `announce` sends a campaign's event. Prints the messages of the flow's states.
"""

import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

from fast.flows.server.access import Api
from fast.flows.server.environment import named_server
from fast.flows.server.server import configure_client
from fast.lake.store import Lake
from tests.tasks.calibration.calibration_lake import CONFIG, PROVENANCE, made_up_result, measured_rows


def made_up(problem, settings, progress=None):
    """Draws in the place of the sampler's."""
    return made_up_result(problem, settings)


def main(root: Path, words: list[str], api: Api | None) -> None:
    """Do what the words say, in order."""
    sys.modules["fast.models.calibration.means.calibrate"] = SimpleNamespace(calibrate=made_up)  # type: ignore[assignment]
    assert api is not None
    configure_client(api, root)
    for word in words:
        {"pool": make_pool, "run": run_flow, "measure": measure, "announce": announce}[word](root)


def make_pool(root: Path) -> None:
    """The work pool that the deployments name."""
    from prefect import get_client
    from prefect.client.schemas.actions import WorkPoolCreate

    with get_client(sync_client=True) as client:
        client.create_work_pool(WorkPoolCreate(name="lab", type="process"))


def run_flow(root: Path) -> None:
    """Run the deployment's flow as a worker would."""
    from fast.flows.deployments import recalibrate
    from tests.flows.undrawn import leave_undrawn

    leave_undrawn(pytest.MonkeyPatch())
    state = recalibrate(lake=str(root), simulate=0, chains=2, draws=100, tune=50, return_state=True)
    sys.stdout.write(f"{state.type.value}: {state.message}\n")
    sys.stdout.flush()


def measure(root: Path) -> None:
    """Grasps of five tools more."""
    Lake.open(root).append(measured_rows(5, first=20), PROVENANCE)


def announce(root: Path) -> None:
    """Send the event that a campaign sends when the batches of a stage are measured."""
    import tomllib

    from prefect.events.worker import EventsWorker

    from fast.flows.campaign.events import announce_measured
    from fast.tasks.campaign.campaign import Campaign
    from fast.tasks.campaign.config import CampaignConfig

    config = CampaignConfig.model_validate(tomllib.loads(CONFIG.format(name="small", tier="production")))
    announce_measured(Campaign(Lake.open(root), config), [1, 2])
    EventsWorker.drain_all(timeout=20)


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2:], named_server())
