"""Gap discovery without a person: search again when measurements are new, and tell people what was found."""

from collections.abc import Callable

from fast.flows.campaign.events import announce_gap
from fast.flows.campaign.notify import KINDS, SILENT, Notifier, notifier
from fast.flows.gap.folder import find_page, write_folder
from fast.flows.gap.search import GapOutcome, GapRequest, run_gap
from fast.flows.progress import ProgressReporter
from fast.lake.store import Lake
from fast.lake.tables.campaign import CampaignRow, GraspRow
from fast.lake.tables.imported import is_imported
from fast.tasks.calibration.mean_data import TooLittleDataError
from fast.tasks.campaign.config import read_stored_config
from fast.tasks.campaign.flow_runs import record_sentence

FLOW = "close-gap"


def watch_gap(lake: Lake, request: GapRequest, flow_run_id: str, reporter: ProgressReporter) -> str:
    """Search the lake for its gap if anything is new; a sentence says what was found, or why nothing was done.

    A new answer gets its page in the lake's outputs, and is an event of the Prefect server. If it found anything, the
    addresses in FAST_NOTIFY are told.

    Raises:
        FastError: the search could not be done; what it simulated is in the lake.
    """
    return record_sentence(
        lake, FLOW, flow_run_id, request.campaign_id, request.seed, lambda: _search(lake, request, reporter)
    )


def _search(lake: Lake, request: GapRequest, reporter: ProgressReporter) -> str:
    try:
        outcome = search_and_announce(lake, request, reporter)
    except TooLittleDataError as error:
        return f"nothing to search: {error}"
    page = f"; page {find_page(lake, outcome)}" if outcome.is_new else ""
    return f"{outcome.sentence}{page}"


def search_and_announce(
    lake: Lake, request: GapRequest, reporter: ProgressReporter, should_stop: Callable[[], bool] = lambda: False
) -> GapOutcome:
    """Search a lake; a new answer gets its page and an event, and people are told of a gap.

    Raises:
        TooLittleDataError: there is nothing to search.
        FastError: the search could not be done; what it simulated is in the lake.
    """
    outcome = run_gap(lake, request, reporter, should_stop)
    if not outcome.is_new:
        return outcome
    page = write_folder(lake, outcome)
    announce_gap(lake, outcome.run.gap_id, outcome.sentence, outcome.run.findings.alarm)
    if outcome.run.findings.alarm:
        title = f"FAST found a gap: {request.campaign_id or lake.address}"
        _notifier(lake, request.campaign_id).send("gap", title, markdown(outcome, str(page)))
    return outcome


def _notifier(lake: Lake, campaign_id: str | None) -> Notifier:
    """Return a notifier that speaks if any searched campaign would: a real bench's, or a virtual one that asks."""
    wanted = {} if campaign_id is None else {"campaign_id": campaign_id}
    measured = {(row["campaign_id"], row["bench"]) for row in lake.rows(GraspRow, **wanted)}
    configs = {row.campaign_id: row.config_toml for row in lake.records(CampaignRow)}
    found = (_notifier_of(name, configs.get(name), bench == "virtual") for name, bench in sorted(measured))
    return next((speaker for speaker in found if "gap" in speaker.kinds), SILENT)


def _notifier_of(campaign_id: str, config_toml: str | None, is_virtual: bool) -> Notifier:
    """Return the notifier of a campaign's config; an imported one has none and speaks unless its bench was virtual."""
    if config_toml is None or is_imported(config_toml):
        return notifier(is_virtual, KINDS)
    config = read_stored_config(config_toml, campaign_id)
    return notifier(is_virtual, config.execution.notify, config.execution.notify_virtual)


def markdown(outcome: GapOutcome, page: str) -> str:
    """Write the answer for a message."""
    findings = outcome.run.findings
    lines = [f"# {outcome.sentence}", ""]
    for number, found in enumerate(findings.rounds, start=1):
        lines.append(f"- round {number}, {found.named.kind}: {found.named.sentence}")
        lines += [f"  - {found.refused}"] if found.refused else []
        lines += [f"  - {where.sentence}" for where in found.where[:3]]
    lines += [
        f"- asked: {one.promised} grasps were promised to tell, {one.spent} were made: {one.outcome}"
        for one in findings.asked
    ]
    if findings.next_experiment is not None:
        lines.append(f"- next experiment: {findings.next_experiment.sentence}")
    lines += [f"- ranking: {findings.ranking.sentence}"] if findings.ranking is not None else []
    lines += [f"- warning: {sentence}" for sentence in findings.warnings]
    return "\n".join([*lines, "", f"Page: `{page}`"])
