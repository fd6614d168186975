"""Flows that a Prefect worker can start from a deployment (see prefect.yaml)."""

import logging
from pathlib import Path

from prefect import flow

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
