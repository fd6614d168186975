"""Start or continue a campaign: check everything that can be checked, take the lock, find a Prefect server."""

from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING

from fast.flows.dependencies import CAMPAIGN, require
from fast.flows.progress import ProgressReporter
from fast.flows.server.access import address_for_person
from fast.flows.server.crashed_runs import end_crashed_runs
from fast.flows.server.environment import named_server
from fast.flows.server.page_port import serve_page
from fast.flows.server.server import configure_client, report_ignored, server
from fast.flows.server.surroundings import check_surroundings
from fast.hardware.virtual.world.file import World
from fast.lake.leases import exclusive
from fast.lake.store import Lake
from fast.models.errors import ConfigError
from fast.tasks.campaign.campaign import Campaign, read_own_designs
from fast.tasks.campaign.config import CampaignConfig, load_config, relative_to, world_path
from fast.tasks.campaign.requests import STARTED, append_event, lease_name, require_acknowledgement
from fast.tasks.campaign.setup import RealBench, check_fits, enter, read_real_bench, read_world

if TYPE_CHECKING:
    from fast.flows.campaign.process import CampaignOutcome
    from fast.hardware.virtual.world.physics import Physics

ConfirmReal = Callable[[Path, RealBench], None]  # raises when there is no leave to move


def run_campaign(
    config_path: Path,
    lake: Path | str,
    *,
    auto_print: bool,
    reporter: ProgressReporter,
    confirm_real: ConfirmReal | None = None,
    is_acknowledged: bool = False,
    physics_of_truth: "Physics | None" = None,
) -> "CampaignOutcome":
    """Start a campaign, or continue it where the lake says it stands.

    `confirm_real` drives the real bench of the config, unless it raises for lack of leave; None is a virtual bench.
    `is_acknowledged`: a person has looked after an emergency stop. `physics_of_truth`: what a virtual bench measures,
    None for the finite elements of its world.

    Raises:
        UsageError: config, world, lake or this machine cannot be used, or a package is missing; nothing was written.
        FastError: another process runs this campaign, an emergency stop is not acknowledged, or the bench stopped.
    """
    require(CAMPAIGN)
    config = load_config(config_path)
    own_designs = read_own_designs(config_path, config)
    bench: World | RealBench | None = None
    if confirm_real is not None:
        bench = _real_bench(config, config_path, confirm_real)
    elif not config.bench.is_folder:
        bench = read_world(world_path(config_path, config))
    check_surroundings()
    found = Lake.open(lake, create=True)
    campaign = Campaign(found, config, config_path=config_path, own_designs=own_designs)
    name = campaign.campaign_id
    with ExitStack() as stack:
        stack.callback(campaign.lake.close)
        busy = f"campaign {name} is already being run"
        lease = stack.enter_context(exclusive(campaign.lake.storage, lease_name(name), busy))
        require_acknowledgement(campaign.lake, name, is_acknowledged)
        enter(campaign, config_path)
        how = {"config": str(config_path.resolve()), "auto_print": auto_print, "real": confirm_real is not None}
        append_event(campaign.lake, name, STARTED, "started or continued", run=lease.token, **how)
        reporter.progress("starting the Prefect server (some seconds, a minute on a busy machine)")
        if (sentence := report_ignored()) and named_server() is None:
            reporter.progress(sentence)
        api = stack.enter_context(server(campaign.lake.root))
        page = stack.enter_context(serve_page(campaign.lake))
        configure_client(api, campaign.lake.root)
        for sentence in end_crashed_runs(api).sentences:
            reporter.progress(sentence)
        reporter.announce(f"Campaign {name}; the lab's page: {address_for_person(page)}")
        reporter.progress(f"flows of Prefect: {address_for_person(api)}")
        # Prefect reads its settings when first imported, so only now.
        from fast.flows.campaign.process import run_in_process

        return run_in_process(
            campaign, bench, auto_print=auto_print, reporter=reporter, physics_of_truth=physics_of_truth
        )


def _real_bench(config: CampaignConfig, config_path: Path, confirm: ConfirmReal) -> RealBench:
    if config.bench.is_folder:
        raise ConfigError(f'{config_path}: bench.kind is "folder", so there is nothing to drive; leave out --real.')
    if config.bench.real is None:
        raise ConfigError(f"{config_path}: --real needs `bench.real`, the file with ports and addresses; add it.")
    path = relative_to(config_path, config.bench.real)
    settings = read_real_bench(path)
    check_fits(config, config_path, settings, path)
    confirm(path, settings)
    return settings
