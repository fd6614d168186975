"""Gap discovery without a person: search again when measurements are new, and tell people what was found."""

from prefect.artifacts import create_markdown_artifact

from flows.events import announce_gap
from flows.gap import GapOrder, GapOutcome, run_gap
from flows.gap_folder import write_folder
from flows.launch import Voice
from flows.noted_run import NotedRun
from lake.store import Lake
from tasks.calibration_data import TooLittleDataError

FLOW = "close-gap"


def watch_gap(lake: Lake, order: GapOrder, flow_run_id: str, voice: Voice) -> str:
    """Search the lake for its gap if anything is new; a sentence says what was found, or why nothing was done.

    A new answer gets its page in the lake's outputs, and is an artifact and an event of the Prefect server.

    Raises:
        FastError: the search could not be done; what it simulated is in the lake.
    """
    return NotedRun(lake, FLOW, flow_run_id, order.campaign_id, order.seed).of(lambda: _search(lake, order, voice))


def _search(lake: Lake, order: GapOrder, voice: Voice) -> str:
    try:
        outcome = run_gap(lake, order, voice)
    except TooLittleDataError as error:
        return f"nothing to search: {error}"
    if not outcome.is_new:
        return outcome.sentence
    page = write_folder(lake, outcome)
    create_markdown_artifact(markdown(outcome, str(page)), key="gap", description="what the simulator misses")
    announce_gap(lake, outcome.run.gap_id, outcome.sentence, outcome.run.findings.alarm)
    return f"{outcome.sentence}; page {page}"


def markdown(outcome: GapOutcome, page: str) -> str:
    """The answer for the page of a flow run."""
    findings = outcome.run.findings
    lines = [f"# {outcome.sentence}", ""]
    for number, found in enumerate(findings.rounds, start=1):
        lines.append(f"- round {number}, {found.named.kind}: {found.named.sentence}")
        lines += [f"  - {where.sentence}" for where in found.where[:3]]
    if findings.next_experiment is not None:
        lines.append(f"- next experiment: {findings.next_experiment.sentence}")
    lines += [f"- warning: {sentence}" for sentence in findings.warnings]
    return "\n".join([*lines, "", f"Page: `{page}`"])
