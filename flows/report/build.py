"""Builds the report of a campaign: `index.html`, `figures/`, `data/`, nothing from the network."""

import logging
from datetime import UTC, datetime
from pathlib import Path

from flows.report.account import cost_section, provenance_section, tools_section
from flows.report.calibration import calibration_section
from flows.report.comparison import agreement_section, traces_section, work_section
from flows.report.content import Content
from flows.report.folder import Folder
from flows.report.page import moment, page, text
from flows.report.results import best_section, headline, progress_section
from flows.report.style import figure_style
from flows.report.surrogate import surrogate_section
from lake.store import Lake

_LOG = logging.getLogger(__name__)

NAV = {
    "best": "Best finger",
    "progress": "Tool quality",
    "traces": "Traces",
    "work": "Grasp work",
    "agreement": "Simulation",
    "calibration": "Calibration",
    "tools": "Tools",
    "surrogate": "Surrogate",
    "cost": "Cost",
    "provenance": "Provenance",
}


def write_report(lake: Lake, campaign_id: str, out: Path) -> Path:
    """Write the report of a campaign as it stands, finished or not, into the folder `out`.

    Everything is read from the lake. Returns the path of `out/index.html`; files of an earlier report
    in the same folder are replaced.

    Raises:
        UsageError: there is no such campaign, or the folder cannot be written.
    """
    content = Content.load(lake, campaign_id)
    folder = Folder(Path(out))
    with figure_style():
        body = "".join(
            build(content, folder)
            for build in (
                best_section,
                progress_section,
                traces_section,
                work_section,
                agreement_section,
                calibration_section,
                tools_section,
                surrogate_section,
                cost_section,
                provenance_section,
            )
        )
        top = headline(content)
    campaign = content.campaign
    written = moment(datetime.now(UTC))
    footer = text(f"Campaign {campaign.campaign_id}. Written {written} UTC from the lake. Units: mm, N, J, s, MPa.")
    index = folder.root / "index.html"
    title = campaign.name or campaign.campaign_id
    index.write_text(page(title, f"FAST campaign {campaign.campaign_id}", top, NAV, body, footer), encoding="utf-8")
    _LOG.info("report of %s written to %s", campaign.campaign_id, index)
    return index
