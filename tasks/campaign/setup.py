"""What a campaign starts from: the file of its bench or of its virtual world, and its entry in the lake."""

import json
import tomllib
from pathlib import Path

from hardware.bench import BenchSettings
from hardware.virtual.world.file import World, load_world
from lake.tables.campaign import CampaignRow
from lake.tables.catalogue_rows import object_rows
from lake.tables.imported import is_imported
from models.errors import ConfigError
from models.objects.catalogue import get_object
from models.validation import load_record
from tasks.campaign.campaign import Campaign
from tasks.campaign.config import CampaignConfig, differences, read_toml, relative_to
from tasks.campaign.material import store_lot

GROWABLE = "schedule.guided_batches"  # a campaign may be made longer while it runs


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


def enter(campaign: Campaign, config_path: Path) -> None:
    """Write campaign, objects and material lot of a config file to the lake; what is there is not written again.

    Raises:
        ConfigError: the lake has a campaign of this name with another config, or the lot's file cannot be used.
    """
    register(campaign, config_path.read_text(encoding="utf-8"))
    if campaign.config.material is not None:
        store_lot(campaign.lake, relative_to(config_path, campaign.config.material))


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
    objects = campaign.config.objects
    own = [get_object(object_id) for object_id in objects.own_ids]
    row = CampaignRow(campaign_id=name, name=name, config_toml=_with_file_ids(config_toml, objects.file_ids))
    campaign.lake.append([row, *object_rows(own)], campaign.provenance(campaign.config.seed))


def _with_file_ids(config_toml: str, file_ids: dict[str, int]) -> str:
    """The text of a config with the numbers of its own objects, which outlive their files.

    Raises:
        ConfigError: the text has no place for them.
    """
    if not file_ids or tomllib.loads(config_toml)["objects"].get("file_ids") == file_ids:
        return config_toml
    lines = [f"{json.dumps(name, ensure_ascii=False)} = {object_id}" for name, object_id in file_ids.items()]
    text = "\n".join([config_toml.rstrip(), "", "[objects.file_ids]", *lines, ""])
    try:
        tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise ConfigError("the config's `objects` must be a table of its own, [objects]; write it so.") from error
    return text
