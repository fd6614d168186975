"""The runs of a flow as rows of the lake: who ran what, when, and how it ended."""

import logging
import os
import socket
from collections.abc import Callable
from datetime import UTC, datetime

from fast.lake.provenance import Provenance, current_provenance
from fast.lake.store import Lake
from fast.lake.tables.campaign import FlowRunRow
from fast.models.errors import FastError

_LOG = logging.getLogger(__name__)


def record_run(
    lake: Lake, flow: str, campaign_id: str, flow_run_id: str, work: Callable[[], bool], provenance: Provenance
) -> bool:
    """Do `work`, which returns True when it is complete; the lake has a row of it from its start on.

    Only one process may run this flow of this campaign at a time: runs before it that never ended have died.
    """
    for row in lake.records(FlowRunRow, flow=flow, campaign_id=campaign_id, status="running"):
        lake.append([row.model_copy(update={"status": "died", "reason": "its process ended unheard"})], provenance)
    run = _begin(lake, flow, flow_run_id, campaign_id)
    lake.append([run], provenance)
    try:
        is_complete = work()
    except BaseException as error:
        _append_end(lake, run, "failed", _reason(error), provenance)
        raise
    _append_end(lake, run, "completed" if is_complete else "interrupted", "", provenance)
    return is_complete


def record_sentence(
    lake: Lake, flow: str, flow_run_id: str, campaign_id: str | None, seed: int, work: Callable[[], str]
) -> str:
    """Do the work of a run that nobody watches; the lake has a row with the sentence that it ends with, or its error.

    `flow_run_id` is Prefect's.
    """
    run, provenance = _begin(lake, flow, flow_run_id, campaign_id), current_provenance(seed=seed)
    try:
        sentence = work()
    except BaseException as error:
        _append_end(lake, run, "failed", _reason(error), provenance)
        raise
    _append_end(lake, run, "completed", sentence, provenance)
    return sentence


def _begin(lake: Lake, flow: str, flow_run_id: str, campaign_id: str | None) -> FlowRunRow:
    return FlowRunRow(
        flow_run_id=flow_run_id,
        flow=flow,
        name=f"{flow} {campaign_id or lake.address}",
        campaign_id=campaign_id,
        status="running",
        started_at=datetime.now(UTC),
        host=socket.gethostname(),
        process_id=os.getpid(),
    )


def _reason(error: BaseException) -> str:
    return str(error) or type(error).__name__


def _append_end(lake: Lake, run: FlowRunRow, status: str, reason: str, provenance: Provenance) -> None:
    """Write how a run ended; a lake that cannot be written must not hide the error that ended it."""
    try:
        lake.append(
            [run.model_copy(update={"status": status, "reason": reason, "ended_at": datetime.now(UTC)})], provenance
        )
    except FastError as error:
        _LOG.warning("the end of the run %s was not written: %s", run.name, error)
