"""Flows that a Prefect worker can start from a deployment (see prefect.yaml)."""

import logging
from pathlib import Path
from typing import Any

from prefect import flow
from prefect.runtime import flow_run
from prefect.states import Completed, State

logger = logging.getLogger(__name__)


@flow(name="run-campaign", flow_run_name="run {config}")
def campaign(config: str, lake: str = "lake-data", auto_print: bool = False) -> bool:
    """Start the campaign of a config file, or continue it; True when its schedule is complete."""
    from flows.launch import Voice, run_campaign

    voice = Voice(progress=logger.info, announce=logger.warning)
    return run_campaign(Path(config), lake, auto_print=auto_print, voice=voice).is_complete


@flow(name="report", flow_run_name="report {campaign}")
def report(campaign: str, lake: str = "lake-data") -> str:
    """Write the report of a campaign; returns the path of its page."""
    from flows.report.build import write_report
    from lake.store import Lake

    found = Lake.open(lake)
    return str(write_report(found, campaign, found.root / "outputs" / campaign / "report"))


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
) -> State[Any]:
    """Calibrate the simulator of a lake again if anything is new; the state of the run says what was done.

    `simulate`: points of the Latin hypercube, simulated once. `campaign`: None is all measurements of the lake.
    """
    from flows.calibrate import CalibrationOrder
    from flows.launch import Voice
    from flows.recalibration import recalibrate_lake
    from lake.store import Lake
    from models.calibration.hypercube import HypercubePlan
    from models.calibration.settings import CalibrationSettings

    settings = CalibrationSettings(chains=chains, draws=draws, tune=tune, workers=workers, print_scatter=print_scatter)
    order = CalibrationOrder(settings, campaign, hypercube=HypercubePlan(n=simulate) if simulate else None)
    voice = Voice(progress=logger.info, announce=logger.warning)
    sentence = recalibrate_lake(Lake.open(lake), order, str(flow_run.get_id()), voice)
    return Completed(message=sentence)
