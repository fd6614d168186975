"""Builds the report of a campaign: `index.html`, `figures/`, `data/`, nothing from the network."""

import logging
from collections.abc import Callable, Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from fast.flows.report.calibration.page import prepare_calibration
from fast.flows.report.campaign.account import prepare_cost, prepare_paper, prepare_provenance, prepare_tools
from fast.flows.report.campaign.content import Content
from fast.flows.report.campaign.finger import prepare_best
from fast.flows.report.campaign.insights import prepare_insights
from fast.flows.report.campaign.objectives import prepare_objectives
from fast.flows.report.campaign.quality import prepare_baselines, prepare_headline, prepare_progress
from fast.flows.report.campaign.shapes import prepare_shapes
from fast.flows.report.campaign.simulation import prepare_agreement, prepare_moments, prepare_nights
from fast.flows.report.campaign.surrogate import prepare_surrogate
from fast.flows.report.campaign.traces import prepare_traces
from fast.flows.report.campaign.work import prepare_work
from fast.flows.report.folder import Folder, write_page
from fast.lake.store import Lake
from fast.models.errors import UsageError
from fast.tasks.traces.anomalies import update_anomalies
from fast.tasks.traces.features import update_features

_LOG = logging.getLogger(__name__)

# What each section shows, in the order of the page: {} where nothing is measured yet, None leaves it out. The template
# `NAME.html.j2` in this folder shows it, with the campaign's content beside it.
SECTIONS: dict[str, Callable[[Content, Folder], Mapping[str, Any] | None]] = {
    "best": prepare_best,
    "taught": prepare_insights,
    "moments": prepare_moments,
    "progress": prepare_progress,
    "objectives": prepare_objectives,
    "baselines": prepare_baselines,
    "traces": prepare_traces,
    "shapes": prepare_shapes,
    "work": prepare_work,
    "agreement": prepare_agreement,
    "nights": prepare_nights,
    "calibration": prepare_calibration,
    "tools": prepare_tools,
    "surrogate": prepare_surrogate,
    "cost": prepare_cost,
    "paper": prepare_paper,  # knows what the sections above have drawn
    "provenance": prepare_provenance,
}


def write_report(lake: Lake, campaign_id: str, out: Path, against: Sequence[Lake] = ()) -> Path:
    """Write the report of a campaign as it stands, finished or not, into the folder `out`.

    Everything is read from the lake; campaigns of the lakes `against` are drawn beside it. Returns the path of
    `out/index.html`; files of an earlier report in the same folder are replaced.

    Raises:
        UsageError: there is no such campaign, or the folder cannot be written.
    """
    content = Content.load(lake, campaign_id, against)

    def prepare(folder: Folder) -> dict[str, object]:
        sections = {name: prepare_section(content, folder) for name, prepare_section in SECTIONS.items()}
        shown = {name: told for name, told in sections.items() if told is not None}
        return {"content": content, "headline": prepare_headline(content), "sections": shown, "now": datetime.now(UTC)}

    return write_page(Folder(Path(out)), "flows/report/campaign/page.html.j2", prepare)


def add_features(lake: Lake, campaign_id: str) -> None:
    """Add features and flags of traces that lack them, as by `fast features`; without any trace, nothing happens."""
    try:
        update_features(lake, campaign_id)
        update_anomalies(lake, campaign_id)
    except UsageError as error:  # the report says itself what has not been measured
        _LOG.info("report of %s without features: %s", campaign_id, error)
