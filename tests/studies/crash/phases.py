"""The phases of a campaign's life, each as one piece of work on a copy of the lake that the phase before left.

All of it is the product but the physics, which is made up, and Prefect, which holds no data.
"""

import tomllib
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fast.flows.report import folder as report_folder
from fast.flows.report.campaign import page as report_page
from fast.flows.report.folder import Folder
from fast.lake.handoff.import_folder import import_handoff
from fast.lake.leases import exclusive
from fast.lake.maintenance import compact
from fast.lake.provenance import current_provenance
from fast.lake.store import Lake
from fast.lake.tables.campaign import TABLES
from fast.tasks.bench.print import PrintConfirmation, confirm_print
from fast.tasks.campaign import requests
from fast.tasks.campaign.campaign import Campaign
from fast.tasks.campaign.config import CampaignConfig
from fast.tasks.campaign.requests import STARTED, append_event, lease_name
from fast.tasks.campaign.setup import register
from fast.tasks.campaign.state import CampaignState
from fast.tasks.scientist.fit import fit
from fast.tasks.scientist.observe import closed_batches, observe, observed_rows
from fast.tasks.scientist.propose import propose_initial, propose_tools
from fast.tasks.simulation import simulate as simulating
from tests.studies.benchmarks.fingerprints import fingerprint_world
from tests.studies.benchmarks.made_up_batch import Batch, measure_missing
from tests.studies.benchmarks.made_up_campaign import made_up_attempt

NAME = "study"
BATCH = Batch(n_tools=4, object_ids=(3, 14, 29), n_repeats=1)
WORLD = fingerprint_world(BATCH.labels)
_TOML = f"""
name = "{NAME}"
[schedule]
initial_tools = 4
tools_per_batch = 4
initial_simulations = 4
guided_batches = 1
[objects]
ids = {list(BATCH.object_ids)}
repeats = {BATCH.n_repeats}
order = "random"
[bench]
world = "world.toml"
"""
HANDOFF = "handoff"  # folder beside the lake that `import` takes


@dataclass(frozen=True)
class Phase:
    """`work` on the folder that holds the lake; it starts from what the phase `after` left, or from nothing."""

    name: str
    after: str | None
    work: Callable[[Path], object]


class _Inline:
    """An engine whose worker is the caller."""

    ends_hangs = True

    @contextmanager
    def lend(self) -> Iterator["_Inline"]:
        """Itself."""
        yield self

    def submit(self, function: Callable[..., Any], *arguments: Any) -> "Future[Any]":
        """The result, made at once."""
        future: Future[Any] = Future()
        future.set_result(function(*arguments))
        return future

    def restart(self) -> None:
        """Nothing hangs here."""

    def close(self) -> None:
        """There is nobody to let go."""


_inline: Any = _Inline()


def _campaign(folder: Path) -> Campaign:
    config = CampaignConfig.model_validate(tomllib.loads(_TOML))
    return Campaign(Lake.open(folder / "lake", create=True), config)


def _start(folder: Path) -> None:
    campaign = _campaign(folder)
    register(campaign, _TOML)
    with exclusive(campaign.lake.storage, lease_name(NAME), "busy") as lease:
        append_event(campaign.lake, NAME, STARTED, "started or continued", run=lease.token)
        propose_initial(campaign)
        if not campaign.state().is_confirmed(1):
            confirm_print(campaign.lake, NAME, 1, PrintConfirmation(operator="nobody", confirmed_by="auto"))


def _simulate(folder: Path) -> None:
    campaign = _campaign(folder)
    simulating.attempt_grasp = lambda job: made_up_attempt(job, 0.0)
    simulating.WRITE_S = 0.0
    state = campaign.state()
    for design in [*(s.design for s in state.simulations), *(t.design for t in state.tools)]:
        simulating.simulate_design(campaign, design, pool=_inline)


def _measure(folder: Path) -> None:
    campaign = _campaign(folder)
    vars(requests)["LEAST_FREE_MB"] = 0.0  # else the bench stops long before a small disk is full
    measure_missing(campaign, WORLD, lambda *_: None)


def _known(campaign: Campaign) -> tuple[CampaignState, Any, Any]:
    state = campaign.state()
    closed = closed_batches(campaign, state)
    data = observe(campaign, state, closed)
    return state, data, fit(campaign, 2, data, observed_rows(campaign, state, closed))


def _fit(folder: Path) -> None:
    _known(_campaign(folder))


def _search(folder: Path) -> None:
    campaign = _campaign(folder)
    if campaign.state().tools_of(2):
        return
    state, data, surrogate = _known(campaign)
    propose_tools(campaign, 2, data, surrogate, state)


def _report(folder: Path) -> None:
    campaign = _campaign(folder)
    # Drawing, and the grasp that the report simulates once more, cost minutes and no row.
    vars(report_folder)["save_svg"] = _draw_nothing
    draw = Folder.draw
    setattr(Folder, "draw", lambda *of, **_: draw(*of[:3]))  # noqa: B010 - a stand-in that writes no PNG for print
    report_page.SECTIONS.pop("moments")
    report_page.add_features(campaign.lake, NAME)
    report_page.write_report(campaign.lake, NAME, folder / "lake" / "outputs" / NAME / "report")


def _draw_nothing(figure: object, path: Path) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("<svg/>")


def _import(folder: Path) -> None:
    import_handoff(Lake.open(folder / "lake", create=True), folder / HANDOFF, current_provenance())


def _compact(folder: Path) -> None:
    lake = Lake.open(folder / "lake")
    for table in TABLES:
        compact(lake, table)


PHASES = (
    Phase("start-up", None, _start),
    Phase("simulation", "start-up", _simulate),
    Phase("gantry", "simulation", _measure),
    Phase("fit", "gantry", _fit),
    Phase("search", "fit", _search),
    Phase("report", "search", _report),
    Phase("import", None, _import),
    Phase("compaction", "gantry", _compact),
)
