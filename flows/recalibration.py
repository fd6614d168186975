"""Recalibration without a person: calibrate again when measurements or simulations are new, else say why not."""

import os
import socket
from datetime import UTC, datetime
from typing import Literal

from flows.calibrate import CalibrationOrder, CalibrationOutcome, run_calibration
from flows.launch import Voice
from flows.theta_history import write_theta_history
from lake.provenance import current_provenance
from lake.store import Lake
from lake.tables import FlowRunRow
from models.errors import FastError
from tasks.calibration_data import TooLittleDataError

FLOW = "recalibrate"


def recalibrate_lake(lake: Lake, order: CalibrationOrder, flow_run_id: str, voice: Voice) -> str:
    """Calibrate the lake if anything is new; a sentence says what was done, or why nothing was.

    The run and its sentence are a row of `flow_runs`. After a new calibration the picture of theta over time is drawn
    again, in `outputs/calibration` of the lake.

    Raises:
        FastError: the calibration could not be done, or gave no simulator version.
    """
    started_at = datetime.now(UTC)
    try:
        sentence = _recalibrate(lake, order, voice)
    except BaseException as error:
        _note(lake, order, flow_run_id, started_at, "failed", str(error) or type(error).__name__)
        raise
    _note(lake, order, flow_run_id, started_at, "completed", sentence)
    return sentence


def _recalibrate(lake: Lake, order: CalibrationOrder, voice: Voice) -> str:
    try:
        outcome = run_calibration(lake, order, voice)
    except TooLittleDataError as error:
        return f"nothing to calibrate: {error}"
    if outcome.row.version_id is None:
        raise FastError(outcome.sentence)
    if not outcome.is_new:
        return outcome.sentence
    _show_drift(lake, order, outcome, voice)
    return " ".join([f"{outcome.sentence}.", *outcome.row.warnings])


def _show_drift(lake: Lake, order: CalibrationOrder, outcome: CalibrationOutcome, voice: Voice) -> None:
    folder = lake.root / "outputs" / "calibration"
    picture = write_theta_history(lake, outcome.row.base_version_id, order.campaign_id, folder)
    if picture is not None:
        voice.progress(f"theta over time: {picture}")


def _note(
    lake: Lake,
    order: CalibrationOrder,
    flow_run_id: str,
    started_at: datetime,
    status: Literal["completed", "failed"],
    reason: str,
) -> None:
    row = FlowRunRow(
        flow_run_id=flow_run_id,
        flow=FLOW,
        name=f"{FLOW} {order.campaign_id or lake.address}",
        campaign_id=order.campaign_id,
        status=status,
        reason=reason,
        started_at=started_at,
        ended_at=datetime.now(UTC),
        host=socket.gethostname(),
        process_id=os.getpid(),
    )
    lake.append([row], current_provenance(seed=order.settings.seed))
