"""Flows that a Prefect worker can start from a deployment (see prefect.yaml)."""

import logging
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

from prefect import flow
from prefect.runtime import flow_run
from prefect.states import Completed, Failed, State

from fast.flows.server.environment import FOLDER_VARIABLE
from fast.flows.server.run_process import mark_run
from fast.models.errors import FastError

logger = logging.getLogger(__name__)


def ended(work: Callable[[], str]) -> State[Any]:
    """Return how a run ends: completed with the sentence of `work`, or failed with the reason, nothing before it."""
    mark_run()
    try:
        return Completed(message=work())
    except FastError as error:
        return Failed(message=str(error))


def find_config(config: str) -> Path:
    """Find a config by its path: from the folder where `fast serve` was started, else from that of the program."""
    own = Path(os.environ.get(FOLDER_VARIABLE, "."), config)
    return own if own.exists() else Path(config)


@flow(name="run-campaign", flow_run_name="run {config}")
def campaign(config: str, lake: str = "lake-data", auto_print: bool = False) -> State[Any]:
    """Start the campaign of a config file on its virtual bench, or continue it; a real bench needs a terminal."""
    from fast.flows.campaign.launch import run_campaign
    from fast.flows.progress import ProgressReporter

    def work() -> str:
        reporter = ProgressReporter(progress=logger.info, announce=logger.warning)
        outcome = run_campaign(find_config(config), lake, auto_print=auto_print, reporter=reporter)
        if not outcome.is_complete:
            return f"campaign {outcome.campaign_id} was asked to {outcome.ended_by}; run it again to continue."
        return f"campaign {outcome.campaign_id} is complete; report {outcome.report}"

    return ended(work)


@flow(name="run-batch", flow_run_name="run batch {batch} of {config}")
def run_batch(config: str, batch: int, lake: str = "lake-data") -> State[Any]:
    """Measure what is missing of a confirmed batch on the virtual bench of its campaign."""
    from fast.flows.campaign.single_steps import measure_one_batch

    return ended(lambda: measure_one_batch(find_config(config), lake, batch))


@flow(name="simulate", flow_run_name="simulate {config}")
def simulate(config: str, lake: str = "lake-data") -> State[Any]:
    """Simulate the proposed designs of a campaign on the objects that they miss."""
    from fast.flows.campaign.single_steps import simulate_missing

    return ended(lambda: simulate_missing(find_config(config), lake))


@flow(name="report", flow_run_name="report {campaign}")
def report(campaign: str, lake: str = "lake-data") -> State[Any]:
    """Write the report of a campaign; the state of the run says where its page is."""
    from fast.flows.report.campaign.page import write_report
    from fast.lake.store import Lake

    def work() -> str:
        found = Lake.open(lake)
        return f"report {write_report(found, campaign, found.root / 'outputs' / campaign / 'report')}"

    return ended(work)


@flow(name="recalibrate", flow_run_name="recalibrate {lake}")
def recalibrate(
    lake: str = "lake-data",
    campaign: str | None = None,
    simulate: int = 100,
    chains: int = 4,
    draws: int = 1000,
    tune: int = 1000,
    workers: int = 2,
    print_scatter: float = 0.0,
    lot: str | None = None,
) -> State[Any]:
    """Calibrate the simulator of a lake again if anything is new; the state of the run says what was done.

    `simulate`: points of the Latin hypercube, simulated once. `campaign`: None is all measurements of the lake.
    `lot`: the material lot of the priors; None is the one that the campaigns name.
    """
    from fast.flows.calibration.calibrate import CalibrationRequest, recalibrate_lake
    from fast.flows.progress import ProgressReporter
    from fast.lake.store import Lake
    from fast.models.calibration.inference.settings import CalibrationSettings
    from fast.models.calibration.means.hypercube import HypercubePlan

    settings = CalibrationSettings(chains=chains, draws=draws, tune=tune, workers=workers, print_scatter=print_scatter)
    order = CalibrationRequest(settings, campaign, hypercube=HypercubePlan(n=simulate) if simulate else None, lot=lot)
    reporter = ProgressReporter(progress=logger.info, announce=logger.warning)
    return ended(lambda: recalibrate_lake(Lake.open(lake), order, str(flow_run.get_id()), reporter))


@flow(name="close-gap", flow_run_name="close gap {lake}")
def close_gap(
    lake: str = "lake-data",
    campaign: str | None = None,
    rounds: int = 4,
    seed: int = 0,
    budget_minutes: float | None = None,
    workers: int = 2,
) -> State[Any]:
    """Search a lake for what its simulator misses, if anything is new; the state of the run says what was found.

    `budget_minutes`: of simulating; what is left is simulated by the next run. `campaign`: None is all measurements.
    """
    from fast.flows.gap.scheduled import watch_gap
    from fast.flows.gap.search import GapRequest
    from fast.flows.progress import ProgressReporter
    from fast.lake.store import Lake

    order = GapRequest(campaign, seed, rounds, budget_minutes).with_workers(workers)
    reporter = ProgressReporter(progress=logger.info, announce=logger.warning)
    return ended(lambda: watch_gap(Lake.open(lake), order, str(flow_run.get_id()), reporter))


@flow(name="lend", flow_run_name="{holder} moves a virtual bench by hand")
def lend(holder: str, world: str = "worlds/quick.toml", lake: str = "lake-data") -> State[Any]:
    """Lend a virtual bench to the lab's page, where a person moves it by hand, until that is over."""
    from fast.flows.campaign.lend import lend_bench
    from fast.lake.store import Lake

    return ended(lambda: lend_bench(Lake.open(lake), find_config(world), None, lambda: False, holder))
