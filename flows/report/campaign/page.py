"""Builds the report of a campaign: `index.html`, `figures/`, `data/`, nothing from the network."""

import logging
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path

from fast.flows.report.calibration.page import calibration_section
from fast.flows.report.campaign.account import write_cost, write_paper, write_provenance, write_tools
from fast.flows.report.campaign.content import Content
from fast.flows.report.campaign.finger import write_best
from fast.flows.report.campaign.insights import write_insights
from fast.flows.report.campaign.nights import write_nights
from fast.flows.report.campaign.objectives import write_objectives
from fast.flows.report.campaign.quality import headline, write_baselines, write_progress
from fast.flows.report.campaign.shapes import write_shapes
from fast.flows.report.campaign.simulation import write_agreement, write_moments
from fast.flows.report.campaign.surrogate import write_surrogate
from fast.flows.report.campaign.traces import write_traces
from fast.flows.report.campaign.work import write_work
from fast.flows.report.folder import Folder, write_sections
from fast.flows.report.html import Page
from fast.lake.store import Lake
from fast.models.errors import UsageError
from fast.tasks.templates import moment
from fast.tasks.traces.anomalies import update_anomalies
from fast.tasks.traces.features import update_features

_LOG = logging.getLogger(__name__)

NAV = {
    "best": "Best finger",
    "taught": "What it taught",
    "moments": "A grasp",
    "progress": "Tool quality",
    "objectives": "Objectives",
    "baselines": "Approaches",
    "traces": "Traces",
    "shapes": "Shapes",
    "work": "Grasp work",
    "agreement": "Simulation",
    "nights": "New simulators",
    "calibration": "Calibration",
    "supplement": "Sensitivities",
    "tools": "Tools",
    "surrogate": "Surrogate",
    "cost": "Cost",
    "paper": "Paper",
    "provenance": "Provenance",
}

SECTIONS = (
    write_best,
    write_insights,
    write_moments,
    write_progress,
    write_objectives,
    write_baselines,
    write_traces,
    write_shapes,
    write_work,
    write_agreement,
    write_nights,
    calibration_section,
    write_tools,
    write_surrogate,
    write_cost,
    write_paper,  # knows what the sections above have drawn
    write_provenance,
)


def write_report(lake: Lake, campaign_id: str, out: Path, against: Sequence[Lake] = ()) -> Path:
    """Write the report of a campaign as it stands, finished or not, into the folder `out`.

    Everything is read from the lake; campaigns of the lakes `against` are drawn beside it. Returns the path of
    `out/index.html`; files of an earlier report in the same folder are replaced.

    Raises:
        UsageError: there is no such campaign, or the folder cannot be written.
    """
    content = Content.load(lake, campaign_id, against)
    campaign = content.campaign
    page = Page(
        title=campaign.name or campaign_id,
        kicker=f"FAST campaign {campaign_id}",
        footer=f"Campaign {campaign_id}. Written {moment(datetime.now(UTC))} UTC from the lake. In mm, N, J, s, MPa.",
        nav=NAV,
    )
    return write_sections(Folder(Path(out)), content, page, headline, SECTIONS)


def add_features(lake: Lake, campaign_id: str) -> None:
    """Features and flags of traces that lack them, as by `fast features`; without any trace, nothing happens."""
    try:
        update_features(lake, campaign_id)
        update_anomalies(lake, campaign_id)
    except UsageError as error:  # the report says itself what has not been measured
        _LOG.info("report of %s without features: %s", campaign_id, error)
