"""The folder of a gap search: its page and `findings.json`."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from fast.flows.gap.bench_plan import describe_command
from fast.flows.gap.search import GapOutcome
from fast.lake.store import Lake
from fast.lake.tables.campaign import GraspRow

if TYPE_CHECKING:
    from fast.flows.report.gap.sentences import GapPage, ThetaRow
    from fast.tasks.gap.calibrate import CalibratedSimulator


def find_page(lake: Lake, outcome: GapOutcome) -> Path:
    """Find where the page of a search is in the lake's outputs."""
    from fast.flows.report.gap.page import PAGE

    return lake.root / "outputs" / outcome.run.gap_id / PAGE


def write_folder(lake: Lake, outcome: GapOutcome, out: Path | None = None) -> Path:
    """Write the page of a search, by default in the lake's outputs; returns its path.

    Of a search that is only told again, a page that is there stays; elsewhere it has only the answer.

    Raises:
        UsageError: the folder cannot be written.
    """
    from fast.flows.report.gap.page import PAGE, write_gap_report

    run = outcome.run
    folder = out or lake.root / "outputs" / run.gap_id
    if not outcome.is_new and (folder / PAGE).is_file():
        return folder / PAGE
    of = f"{run.campaign_id or lake.address}, {run.n_grasps} grasps"
    return write_gap_report(_collect_page(lake, outcome), folder, run.gap_id, of)


def _collect_page(lake: Lake, outcome: GapOutcome) -> "GapPage":
    from fast.flows.report.gap.sentences import GapPage
    from fast.models.gap.where.cells import find_unsure_cells

    rounds, evaluation = outcome.rounds, outcome.evaluation
    asked = outcome.run.findings.next_experiment
    command = "" if asked is None else describe_command(asked, outcome.run.campaign_id, lake.address)
    if not rounds or evaluation is None:
        return GapPage(outcome.run.findings, assumed=_assumed(outcome), command=command)
    surrogate = rounds[-1].proposed.fit.features.surrogate
    return GapPage(
        findings=outcome.run.findings,
        where=tuple(one.where for one in rounds),
        residuals=rounds[0].residuals,
        evaluation=evaluation,
        theta=_theta_rows(rounds[0].before, rounds[-1].after, _is_real(lake, outcome.run.campaign_id)),
        assumed=_assumed(outcome),
        unsure=find_unsure_cells(surrogate.bank, surrogate.grasps.tools),
        command=command,
    )


def _theta_rows(before: "CalibratedSimulator", after: "CalibratedSimulator", is_real: bool) -> "tuple[ThetaRow, ...]":
    """List constants before and after; no instrument has measured the material of a virtual bench."""
    from fast.flows.report.gap.sentences import INDEPENDENT, ThetaRow
    from fast.models.calibration.means.problem import THETA

    known = INDEPENDENT if is_real else {}
    return tuple(ThetaRow(name, _interval(before, name), _interval(after, name), known.get(name)) for name in THETA)


def _is_real(lake: Lake, campaign_id: str | None) -> bool:
    """Return whether any grasp that was searched is of a real bench."""
    wanted = {} if campaign_id is None else {"campaign_id": campaign_id}
    return any(row["bench"] == "real" for row in lake.rows(GraspRow, **wanted))


def _interval(model: "CalibratedSimulator", name: str) -> tuple[float, float, float]:
    """Return the median and the 90 % interval."""
    low, median, high = np.quantile(model.draws[:, model.names.index(name)], [0.05, 0.5, 0.95])
    return float(median), float(low), float(high)


def _assumed(outcome: GapOutcome) -> tuple[str, ...]:
    run = outcome.run
    return (
        f"Held out, chosen from seed {run.seed} before any force was read: split {run.split_id}.",
        f"Simulator before: {run.before_version_id}; after: {run.after_version_id}; campaigns' own: "
        f"{run.base_version_id}.",
    )
