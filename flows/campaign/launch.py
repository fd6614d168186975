"""Start or continue a campaign: check everything that can be checked, take the lock, find a Prefect server."""

import tomllib
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from flows.cli.dependencies import CAMPAIGN, require
from flows.server.crashed_runs import end_crashed_runs
from flows.server.server import configure_client, server
from hardware.bench import BenchSettings
from hardware.safety.safe_state import Verb
from hardware.virtual.world.file import World, load_world
from lake.handoff.campaign import is_imported
from lake.store import Lake
from lake.tables.campaign import CampaignRow
from lake.tables.objects import object_rows
from models.errors import ConfigError
from models.validation import load_record
from tasks.campaign.campaign import Campaign
from tasks.campaign.config import CampaignConfig, differences, load_config, read_toml, relative_to
from tasks.campaign.requests import append_event, exclusive, require_acknowledgement

GROWABLE = "schedule.guided_batches"  # a campaign may be made longer while it runs


ConfirmReal = Callable[[Path, BenchSettings], None]  # bench file and what it says; raises when there is no leave


@dataclass(frozen=True)
class Outcome:
    """What a campaign left behind when its process ended; measured tools best first. `ended_by`: what was asked."""

    campaign_id: str
    is_complete: bool
    tools: list[dict[str, Any]]
    report: Path | None = None
    recording: Path | None = None
    ended_by: Verb | None = None


@dataclass(frozen=True)
class Voice:
    """How a long command speaks: `progress` may be skipped over, `announce` must be read."""

    progress: Callable[[str], None]
    announce: Callable[[str], None]


def run_campaign(
    config_path: Path,
    lake: Path | str,
    *,
    auto_print: bool,
    voice: Voice,
    confirm_real: ConfirmReal | None = None,
    is_acknowledged: bool = False,
) -> Outcome:
    """Start a campaign, or continue it where the lake says it stands.

    `confirm_real` drives the real bench of the config, unless it raises for lack of leave; None is a virtual bench.
    `is_acknowledged`: a person has looked after an emergency stop.

    Raises:
        UsageError: config, world or lake cannot be used, or a package is missing; nothing was written.
        FastError: another process runs this campaign, an emergency stop is not acknowledged, or the bench stopped.
    """
    require(CAMPAIGN)
    config = load_config(config_path)
    bench = _real_bench(config, config_path, confirm_real) if confirm_real else _virtual_bench(config, config_path)
    campaign = Campaign(Lake.open(lake, create=True), config)
    name = campaign.campaign_id
    with ExitStack() as stack:
        stack.callback(campaign.lake.close)
        busy = f"campaign {name} is already being run"
        stack.enter_context(exclusive(campaign.lake, f"campaign-{name}", busy))
        require_acknowledgement(campaign.lake, name, is_acknowledged)
        register(campaign, config_path.read_text(encoding="utf-8"))
        append_event(campaign.lake, name, "started", "started or continued")
        voice.progress("starting the Prefect server (ten seconds the first time, a minute on a busy machine)")
        api_url = stack.enter_context(server(campaign.lake.root))
        configure_client(api_url, campaign.lake.root)
        for sentence in end_crashed_runs(api_url).sentences:
            voice.progress(sentence)
        voice.announce(f"Campaign {name}; watch it at {api_url.removesuffix('/api')}")
        # Prefect reads its settings when first imported, so only now.
        from flows.campaign.session import run_session

        return run_session(campaign, bench, auto_print=auto_print, voice=voice)


def _virtual_bench(config: CampaignConfig, config_path: Path) -> World:
    return read_world(relative_to(config_path, config.bench.world))


def _real_bench(config: CampaignConfig, config_path: Path, confirm: ConfirmReal) -> BenchSettings:
    if config.bench.real is None:
        raise ConfigError(f"{config_path}: --real needs `bench.real`, the file with ports and addresses; add it.")
    path = relative_to(config_path, config.bench.real)
    settings = read_bench(path)
    confirm(path, settings)
    return settings


def read_bench(path: Path) -> BenchSettings:
    """Read and check the file with the addresses of a real bench; its journal lies beside it.

    Raises:
        ConfigError: the file is missing, or has a wrong value or key.
    """
    settings = load_record(BenchSettings, read_toml(path, "bench file"), str(path))
    journal = path.parent / settings.journal if settings.journal else path.with_suffix(".journal.jsonl")
    return settings.model_copy(update={"journal": str(journal.resolve())})


def read_world(path: Path) -> World:
    """Read and check a world file.

    Raises:
        ConfigError: the file is missing, or has a wrong value, key or effect.
    """
    try:
        return load_world(path.read_text(encoding="utf-8"), str(path))
    except OSError as error:
        raise ConfigError(f"world file `{path}` cannot be read: {error.strerror}; give an existing file.") from error
    except UnicodeDecodeError as error:
        raise ConfigError(f"world file `{path}` is not a text file; give a TOML file.") from error


def register(campaign: Campaign, config_toml: str) -> None:
    """Write campaign and objects to the lake, or check that the config is the one it was started with.

    Raises:
        ConfigError: the lake has a campaign of this name with another config.
    """
    name = campaign.campaign_id
    known = campaign.lake.rows(CampaignRow, campaign_id=name)
    if known and is_imported(known[-1]["config_toml"]):
        raise ConfigError(
            f"campaign `{name}` of this lake was imported and cannot be run; give the config another name."
        )
    if known:
        before = load_record(CampaignConfig, tomllib.loads(known[-1]["config_toml"]), f"stored config of {name}")
        changes = differences(before.science, campaign.config.science)
        if not changes:
            return
        if not all(change.startswith(GROWABLE) for change in changes):
            raise ConfigError(
                f"campaign `{name}` was started with another config ({'; '.join(changes)}); "
                "undo the change or give the new config another name."
            )
    row = CampaignRow(campaign_id=name, name=name, config_toml=config_toml)
    campaign.lake.append([row, *object_rows()], campaign.provenance(campaign.config.seed))
