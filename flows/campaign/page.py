"""The campaign's page in Prefect: progress, next time a person is needed, best so far, tools, report, recording."""

import base64
import io
import logging
import time
from datetime import datetime
from pathlib import Path
from typing import Any, cast
from uuid import UUID

from prefect import get_client
from prefect.artifacts import create_markdown_artifact, create_progress_artifact
from prefect.client.schemas.actions import ArtifactUpdate
from prefect.settings import PREFECT_CLIENT_MAX_RETRIES, temporary_settings

from fast.flows.campaign.forecast import Forecast, forecast
from fast.flows.campaign.progress import MOST_CPU, Workload, count_work
from fast.flows.gap.bench_plan import describe_command
from fast.flows.progress import RateEstimate
from fast.flows.server.server_process import OUTPUTS
from fast.lake.query.engine import Mark
from fast.lake.tables.campaign import GraspRow, ProposalRow, SimulationRow, ToolRow
from fast.tasks.bench.asked import read_open_requests
from fast.tasks.campaign.campaign import Campaign
from fast.tasks.campaign.night_story import describe_nights
from fast.tasks.campaign.simulator_versions import at_present
from fast.tasks.campaign.state import format_ranking, rank_tools
from fast.tasks.gap.findings import GapRun, find_newest_run
from fast.tasks.gap.readings import is_answered
from fast.tasks.scientist.insights.advice import read_advice

logger = logging.getLogger(__name__)

INTERVAL_S = 60.0  # each update is two requests, and two events that the server keeps for days
QUIET_S = 600.0  # between updates while nothing happens: the page says as of when it is
PICTURE_DPI = 110
_ASKED = (
    "SELECT count(*) AS n, count(*) FILTER (state = 'made') AS made FROM asked_grasps WHERE campaign_id = $campaign"
)
_SHOWN = (ProposalRow, ToolRow, GraspRow, SimulationRow)  # news of these change the page


class CampaignPage:
    """Two artifacts of the flow run, kept up to date: a progress bar and a page. Made inside the flow."""

    def __init__(self, campaign: Campaign) -> None:
        self._campaign = campaign
        self._grasps, self._simulations = RateEstimate(), RateEstimate()
        self._next_s = time.monotonic() + INTERVAL_S
        self._quiet_until_s = 0.0
        self._marks: list[Mark] = []
        self._picture: tuple[int, str] = (0, "")
        name = campaign.campaign_id
        key = name.replace(".", "-")  # of artifacts: Prefect takes letters, digits and dashes
        # Called from a synchronous flow they return the id, not a coroutine.
        self._progress = cast(
            UUID, create_progress_artifact(0.0, f"{key}-progress", "grasps done, measured and simulated")
        )
        page = create_markdown_artifact(self.text(with_picture=False), f"{key}-page", f"Campaign {name}")
        self._page = cast(UUID, page)

    def update(self, *, now: bool = False) -> None:
        """Write both artifacts again, `now` or if it is time and something happened; seldom, where that costs much."""
        began_s = time.monotonic()
        if not now and began_s < self._next_s:
            return
        before_s = time.thread_time()
        try:
            if now or self._has_news(began_s):
                self._write()
                self._quiet_until_s = began_s + QUIET_S
        except Exception as error:  # whatever a server that restarts makes of it: the campaign goes on without its page
            logger.warning("the campaign's page was not written: %s", error)
        pause_s = (time.thread_time() - before_s) / MOST_CPU
        self._next_s = began_s + min(max(pause_s, INTERVAL_S), QUIET_S)

    def _has_news(self, now_s: float) -> bool:
        marks = [self._campaign.lake.mark(table) for table in _SHOWN]
        known, self._marks = self._marks, marks
        return marks != known or now_s > self._quiet_until_s

    def _write(self) -> None:
        text = self.text()
        # At once or not at all: the campaign waits for it, and so do those who ask it to pause.
        with temporary_settings({PREFECT_CLIENT_MAX_RETRIES: 0}), get_client(sync_client=True) as client:
            client.update_artifact(self._page, ArtifactUpdate(data=text))
            client.update_artifact(self._progress, ArtifactUpdate(data=round(100.0 * self._load.fraction, 1)))

    def text(self, *, with_picture: bool = True) -> str:
        """The page as Markdown, from the lake as it is now."""
        campaign = at_present(self._campaign)
        state = campaign.state()
        self._load = count_work(campaign, state)
        now_s = time.monotonic()
        self._grasps.update(self._load.grasps_done, now_s)
        self._simulations.update(self._load.simulated_done, now_s)
        seen = forecast(campaign, state, self._grasps.seconds_left(1), self._simulations.seconds_left(1))
        tools = rank_tools(campaign.lake, campaign.campaign_id)
        return format_page(campaign, self._load, seen, tools, self._picture_of(tools) if with_picture else "")

    def _picture_of(self, tools: list[dict[str, Any]]) -> str:
        """Tool quality by batch with the best so far, as an address with the picture in it; drawn when it changed."""
        n_grasps = sum(tool["n_grasps"] for tool in tools)
        if n_grasps != self._picture[0]:
            self._picture = (n_grasps, draw_best_so_far(self._campaign))
        return self._picture[1]


def format_page(campaign: Campaign, load: Workload, seen: Forecast, tools: list[dict[str, Any]], picture: str) -> str:
    """What the page says."""
    now = datetime.now().astimezone()
    lines = [
        f"# Campaign {campaign.campaign_id}",
        f"**{seen.in_words(now)}**",
        f"{load.grasps_done} of {load.grasps_total} grasps measured, {load.simulated_done} of "
        f"{load.simulated_total} simulated; as of {now:%H:%M %Z, %d %B}.",
    ]
    if campaign.config.gap.active:
        lines.append(_describe_gap(campaign))
    if campaign.config.night.active:
        lines += describe_nights(campaign)
    said = read_advice(campaign.lake, campaign.campaign_id)
    if tools:
        best = tools[0]
        lines.append(f"Best so far: **{best['tool_id']}**, {best['tool_quality_n']:.2f} N mean peak pull-off force.")
    lines += [f"After B{one.after_batch:02d}: {one.sentence}\n\nHealth, {one.tone}: {one.health}" for one in said[:1]]
    if picture:
        lines.append(f"![Tool quality by batch, and the best so far]({picture})")
    if tools:
        lines.append(format_ranking(tools))
    lines.append(_links(campaign))
    return "\n\n".join(lines)


def _describe_gap(campaign: Campaign) -> str:
    """What the search for gaps says, and how many of the grasps that it asked for are made."""
    run = find_newest_run(campaign.lake, campaign.campaign_id)
    if run is None:
        return "No search for what the simulator misses has ended yet."
    found = campaign.lake.query(_ASKED, {"campaign": campaign.campaign_id}).to_pylist()[0]
    ranking = run.findings.ranking
    told = [*(one.outcome for one in run.findings.asked), *([ranking.sentence] if ranking is not None else [])]
    named = "; ".join(one.named.sentence for one in run.findings.rounds)
    verdict = run.findings.verdict
    kept = [f"The simulator in use stays: {verdict.sentence}."] if verdict and not verdict.is_accepted else []
    said = " ".join([f"Simulator: {named}", f"Asked grasps: {found['n']}, made: {found['made']}.", *told, *kept])
    return "\n\n".join([said, *_describe_question(campaign, run)])


def _describe_question(campaign: Campaign, run: GapRun) -> list[str]:
    """What is still open: the question with what each outcome would mean, and how a person answers it."""
    asked = run.findings.next_experiment
    if asked is None:
        return []
    if asked.person is not None:
        if is_answered(campaign.lake, run.gap_id, asked.person.kind):
            return []
        command = describe_command(asked, campaign.campaign_id, campaign.lake.address)
        how = f"Answer it with `{command}`, or in the form of these pages."
        return [f"**A person is asked:** {asked.sentence}", how]
    if not read_open_requests(campaign.lake, search_id=run.gap_id):
        return []
    return [f"**The bench is asked:** {asked.sentence}"]


def draw_best_so_far(campaign: Campaign) -> str:
    """The report's figure of tool quality by batch as a `data:` address; empty before the first complete tool."""
    # Seconds of imports, which a campaign that goes on after a crash does not wait for.
    from fast.flows.report.campaign.content import Content
    from fast.flows.report.campaign.quality import draw_quality
    from fast.flows.report.style import figure_style

    content = Content.load(campaign.lake, campaign.campaign_id)
    if content.best is None:
        return ""
    file = io.BytesIO()
    with figure_style():
        draw_quality(content.tools, content.best).savefig(file, format="png", dpi=PICTURE_DPI)
    return f"data:image/png;base64,{base64.b64encode(file.getvalue()).decode()}"


def _links(campaign: Campaign) -> str:
    """Where report, recording and print sheets are; links work on the server that FAST starts."""
    here, name = campaign.output, campaign.campaign_id
    found: list[tuple[str, Path]] = [("report", here / "report" / "index.html"), ("recording", here / f"{name}.rrd")]
    found += [(f"print sheet {sheet.parent.name[:3]}", sheet) for sheet in sorted(here.glob("B*-print/sheet.html"))]
    links = [f"[{what}]({OUTPUTS}/{name}/{path.relative_to(here)})" for what, path in found if path.exists()]
    return f"{', '.join(links)} (all in `{here}`)" if links else f"Files will be in `{here}`."
