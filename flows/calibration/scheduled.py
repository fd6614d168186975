"""Recalibration without a person: calibrate again when measurements or simulations are new, else say why not."""

from fast.flows.calibration.calibrate import CalibrationOrder, run_calibration, write_page
from fast.flows.progress import ProgressReporter
from fast.lake.store import Lake
from fast.models.errors import FastError
from fast.tasks.calibration.mean_data import TooLittleDataError
from fast.tasks.campaign.flow_runs import record_sentence

FLOW = "recalibrate"


def recalibrate_lake(lake: Lake, order: CalibrationOrder, flow_run_id: str, reporter: ProgressReporter) -> str:
    """Calibrate the lake if anything is new; a sentence says what was done, or why nothing was.

    The run and its sentence are a row of `flow_runs`. A new calibration gets its page, which shows theta over time, in
    the lake's outputs, and is an event of the Prefect server.

    Raises:
        FastError: the calibration could not be done, or gave no simulator version.
    """
    seed = order.settings.seed
    return record_sentence(
        lake, FLOW, flow_run_id, order.campaign_id, seed, lambda: _recalibrate(lake, order, reporter)
    )


def _recalibrate(lake: Lake, order: CalibrationOrder, reporter: ProgressReporter) -> str:
    from fast.flows.campaign.events import announce_calibrated

    try:
        outcome = run_calibration(lake, order, reporter)
    except TooLittleDataError as error:
        return f"nothing to calibrate: {error}"
    if outcome.row.version_id is None:
        raise FastError(outcome.sentence)
    if not outcome.is_new:
        return outcome.sentence
    reporter.progress(f"page: {write_page(lake, outcome)}")
    announce_calibrated(lake, outcome.row.calibration_id, outcome.sentence)
    return " ".join([f"{outcome.sentence}.", *outcome.row.warnings])
