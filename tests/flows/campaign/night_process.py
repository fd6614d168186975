"""A campaign with `night.active` in a process of its own; its search is made up, everything else is real.

Arguments: config, lake, and where the process kills itself: `search`, the number of designs of the night that are done
by then, or `never`.
"""

import os
import signal
import sys
from itertools import count
from pathlib import Path
from typing import Any

from fast.flows.campaign import launch
from fast.flows.cli.main import leave
from fast.flows.gap.search import GapOutcome, GapRequest
from fast.flows.progress import ProgressReporter
from fast.lake.provenance import current_provenance
from fast.lake.store import Lake
from fast.lake.tables.campaign import CalibrationRow
from fast.lake.tables.catalogue_rows import version_rows
from fast.models.gap.findings import Decision, Verdict
from fast.models.records import Theta
from fast.models.simulation.version import SimulatorVersion
from fast.tasks.gap.findings import find_newest_run, write_run
from tests.flows.campaign.made_up_search import write_made_up_run

BASE = SimulatorVersion()
TRUER = SimulatorVersion(theta=Theta(friction=0.7))


def main(config: Path, lake: Path, dies_at: str) -> None:
    """Run the campaign to its end, or to its death."""
    configure = launch.configure_client

    def configure_and_patch(api_url: str, root: Path) -> None:
        configure(api_url, root)
        _patch(dies_at)  # Prefect reads its settings when first imported, so only now

    launch.configure_client = configure_and_patch

    def say(line: str) -> None:
        sys.stdout.write(f"{line}\n")
        sys.stdout.flush()

    launch.run_campaign(config, lake, auto_print=True, reporter=ProgressReporter(say, say))


def _patch(dies_at: str) -> None:
    from fast.flows.campaign import gap_step
    from fast.flows.campaign.night import NightLoop

    def search(lake: Lake, request: GapRequest, *_: Any) -> GapOutcome:
        known = find_newest_run(lake, request.campaign_id)
        if known is not None:
            return GapOutcome(known, False)
        if dies_at == "search":
            os.kill(os.getpid(), signal.SIGKILL)
        accept_truer(lake, request.campaign_id)
        run = find_newest_run(lake, request.campaign_id)
        assert run is not None
        return GapOutcome(run, True)

    gap_step.search_and_announce = search
    finish, numbers = NightLoop.finish, count(1)

    def finish_and_die(self: NightLoop, future: Any) -> bool:
        is_mine = finish(self, future)
        if is_mine and str(next(numbers)) == dies_at:
            os.kill(os.getpid(), signal.SIGKILL)
        return is_mine

    NightLoop.finish = finish_and_die  # type: ignore[method-assign]


def accept_truer(lake: Lake, campaign_id: str | None) -> None:
    """What a search leaves behind that found another theta, which was accepted."""
    row = CalibrationRow(
        calibration_id="C",
        campaign_id=campaign_id,
        base_version_id=BASE.version_id,
        version_id=TRUER.version_id,
        data="trace",
        status="ok",
        sampler="made up",
        n_designs=2,
        n_objects=1,
        n_simulations=2,
        n_chains=4,
        n_draws=100,
        n_tune=100,
    )
    lake.append([*version_rows(TRUER), row], current_provenance())
    named = Decision(kind="none", probability=0.9, sentence="Nothing is missing but theta.")
    run = write_made_up_run(lake, campaign_id, "A", named, None)
    verdict = Verdict(
        present_version_id=BASE.version_id,
        version_id=TRUER.version_id,
        present_rmse_n=0.5,
        rmse_n=0.2,
        is_accepted=True,
        sentence="better",
    )
    judged = run.model_copy(update={"findings": run.findings.model_copy(update={"verdict": verdict})})
    write_run(lake, judged, "theta was accepted", current_provenance())


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]), sys.argv[3])
    leave(0)
