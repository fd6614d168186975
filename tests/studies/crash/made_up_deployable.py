"""The made-up campaign of `tests.studies.benchmarks.made_up_campaign` as a flow that a Prefect worker can start."""

from pathlib import Path
from typing import Any

from prefect import flow
from prefect.states import State

from fast.flows.deployments import ended
from fast.flows.server.crashed_runs import CONTINUED
from tests.studies.benchmarks.made_up_campaign import run_made_up_campaign


@flow(name=CONTINUED, flow_run_name="run {config}")
def campaign(config: str, lake: str, auto_print: bool = True) -> State[Any]:
    """As `flows.deployments.campaign`, with made-up physics."""
    from fast.flows.progress import ProgressReporter

    def work() -> str:
        outcome = run_made_up_campaign(
            Path(config), Path(lake), auto_print=auto_print, reporter=ProgressReporter(_say_nothing, _say_nothing)
        )
        return f"campaign {outcome.campaign_id} is {'complete' if outcome.is_complete else 'not complete'}"

    return ended(work)


def _say_nothing(line: str) -> None:
    """Nobody listens."""
