"""What a campaign starts from: the file of its bench or of its virtual world, and its entry in the lake."""

import json
import re
import tomllib
from collections import defaultdict
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from fast.hardware.arm.settings import ArmSettings
from fast.hardware.bench import BenchSettings
from fast.hardware.own_bench import OwnBenchSettings
from fast.hardware.parts.layout import N_SLOTS
from fast.hardware.virtual.world.file import World, load_world
from fast.lake.store import Lake
from fast.lake.tables.campaign import CampaignRow, ProposalRow, ToolRow
from fast.lake.tables.catalogue_rows import object_rows
from fast.lake.tables.imported import IMPORTED, is_imported
from fast.lake.tables.row import Row
from fast.models.design.recipe import Recipe
from fast.models.errors import ConfigError, UsageError
from fast.models.ids import content_id
from fast.models.objects.catalogue import get_object, name_object
from fast.models.objects.catalogue import register as register_object
from fast.models.own_code import is_own, load_own
from fast.models.records import Placement
from fast.models.validation import load_record
from fast.tasks.campaign.campaign import Campaign
from fast.tasks.campaign.config import (
    BODIES,
    CampaignConfig,
    differences,
    read_stored_config,
    read_toml,
    relative_to,
)
from fast.tasks.campaign.material import store_lot
from fast.tasks.campaign.own_designs import OWN
from fast.tasks.scientist.prior import check_prior

RealBench = BenchSettings | ArmSettings | OwnBenchSettings
"""What a bench file says: of a gantry, an arm, or a machine with a driver of the user's own."""

GROWABLE = ("schedule.guided_batches", "schedule.simpler", "designs ")  # what batches to come are made of


def read_real_bench(path: Path) -> RealBench:
    """Read and check the bench file of a gantry, or of another machine, which says its `kind`.

    Raises:
        ConfigError: the file is missing, or has a wrong value or key.
        UsageError: the driver that it names cannot be found.
    """
    data = read_toml(path, "bench file")
    if is_own(str(data.get("kind", ""))):
        own = load_record(OwnBenchSettings, data, str(path))
        load_own(own.kind)
        return own
    return load_record(ArmSettings, data, str(path)) if "kind" in data else read_bench(path)


def check_fits(config: CampaignConfig, config_path: Path, settings: RealBench, path: Path) -> None:
    """Refuse a campaign that asks for what the arm or gantry of this bench file cannot do.

    Raises:
        ConfigError: with what is missing, and where.
    """
    if isinstance(settings, OwnBenchSettings):
        return  # its driver checks
    if isinstance(settings, ArmSettings):
        _check_rack(config, path, "rack_mm has", len(settings.rack_mm))
        if missing := [name_object(one) for one in config.objects.object_ids if one not in settings.mounts_mm]:
            raise ConfigError(f"{path}: mounts_mm has no place of {', '.join(missing)}; teach and add it.")
        limits = settings.limits
    else:
        _check_rack(config, path, "layout.n_slots is", settings.layout.n_slots)
        _check_places(config, path, settings)
        limits = settings.layout.limits
    try:
        limits.check(config.grasp)
    except UsageError as error:
        raise ConfigError(f"{config_path}: {error}") from error


def _check_rack(config: CampaignConfig, path: Path, said: str, n_slots: int) -> None:
    schedule = config.schedule
    if schedule.n_references and n_slots < N_SLOTS:
        raise ConfigError(
            f"{path}: reference tools hang in the last of {N_SLOTS} slots, {said} {n_slots}; add the others, or set "
            "schedule.reference_tools to 0."
        )
    if n_slots < schedule.tools_per_batch:
        raise ConfigError(
            f"{path}: {said} {n_slots}, a batch has {schedule.tools_per_batch} tools; add slots, or lower "
            "schedule.tools_per_batch."
        )


def _check_places(config: CampaignConfig, path: Path, settings: BenchSettings) -> None:
    layout = config.objects.stand_on(settings.layout)
    try:
        for slot in range(config.schedule.tools_per_batch):
            layout.dock_xy_mm(slot)
        for object_id in config.objects.object_ids:
            layout.grasp_xy_mm(object_id, Placement())
    except UsageError as error:
        raise ConfigError(f"{path}: {error}") from error


def read_bench(path: Path) -> BenchSettings:
    """Read and check the file with the addresses of a gantry; its journal lies beside it.

    Raises:
        ConfigError: the file is missing, or has a wrong value or key, or is of another machine.
    """
    data = read_toml(path, "bench file")
    if "kind" in data:
        raise ConfigError(
            f"{path} is the bench file of another machine (it has `kind`), this is for gantries; use "
            "`fast campaign run --real`."
        )
    settings = load_record(BenchSettings, data, str(path))
    journal = path.parent / settings.journal if settings.journal else path.with_suffix(".journal.jsonl")
    return settings.model_copy(update={"journal": str(journal.resolve())})


def read_world(path: Path) -> World:
    """Read and check a world file.

    Raises:
        ConfigError: the file is missing, or has a wrong value, key or effect.
    """
    try:
        return load_world(path.read_text(encoding="utf-8-sig"), str(path))
    except OSError as error:
        raise ConfigError(f"world file `{path}` cannot be read: {error.strerror}; give an existing file.") from error
    except UnicodeDecodeError as error:
        raise ConfigError(f"world file `{path}` is not a text file; give a TOML file.") from error


def enter(campaign: Campaign, config_path: Path) -> None:
    """Write campaign, objects and material lot of a config file to the lake; what is there is not written again.

    Raises:
        ConfigError: the lake has a campaign of this name with another config, the lot's file cannot be used, or the
            file of designs changed what is proposed already, or a prior campaign teaches nothing.
    """
    _check_own_designs(campaign)
    check_prior(campaign)
    register(campaign, config_path.read_text(encoding="utf-8-sig"))
    if campaign.config.material is not None:
        store_lot(campaign.lake, relative_to(config_path, campaign.config.material))


def is_known(lake: Lake, config: CampaignConfig) -> bool:
    """Return whether the lake has the campaign of a config, started with this very config.

    Raises:
        ConfigError: it has one of this name with another config.
    """
    name = config.campaign_id
    known = lake.rows(CampaignRow, campaign_id=name)
    is_adopted = _is_adopted(known)
    if is_adopted and not config.bench.is_folder:
        raise ConfigError(
            f"campaign `{name}` of this lake was imported, and its bench is elsewhere; give the config another name, "
            'or continue it with bench.kind = "folder" (docs/how-to/bring-your-own-bench.md).'
        )
    if known and not is_adopted:
        before = read_stored_config(known[-1]["config_toml"], name)
        changes = differences(before.science, config.science)
        has_told_same = before.tolerances == config.tolerances  # what reports read; hardly part of the hash
        if not changes and has_told_same and known[-1]["config_hash"] == config.config_hash:
            return True  # an older program gave the same config another hash: rows of now are found by a row of its own
        if not all(change.startswith(GROWABLE) for change in changes):
            raise ConfigError(
                f"campaign `{name}` was started with another config ({'; '.join(changes)}); "
                "undo the change or give the new config another name."
            )
    return False


def _is_adopted(known: Sequence[Mapping[str, Any]]) -> bool:
    """Return whether the rows of a campaign say that another lab's is continued here."""
    return bool(known) and is_imported(known[-1]["config_toml"])


def register(campaign: Campaign, config_toml: str) -> None:
    """Write campaign and objects to the lake, or check that the config is the one it was started with.

    Raises:
        ConfigError: the lake has a campaign of this name with another config.
    """
    own = [campaign.lake.find_object(number) or get_object(number) for number in campaign.config.objects.own_ids]
    for obj in own:
        register_object(obj)  # the shape that the lake has: what was simulated with it stays comparable
    if is_known(campaign.lake, campaign.config):
        return
    name = campaign.campaign_id
    is_adopted = _is_adopted(campaign.lake.rows(CampaignRow, campaign_id=name))
    objects = campaign.config.objects
    stored = _with_recipe(_with_file_ids(config_toml, objects.file_ids), campaign.config.print)
    row = CampaignRow(campaign_id=name, name=name, config_toml=stored)
    provenance = campaign.provenance(campaign.config.seed)
    if is_adopted:  # before the campaign: a crash between them leaves one that is still imported, and adopted again
        campaign.lake.append(_proposals_of_imported(campaign), provenance)
    campaign.lake.append([row, *object_rows(own)], provenance)
    if own:
        from fast.tasks.objects import warn_of_shape  # loads meshes; the 36 do without

        for obj in own:
            warn_of_shape(obj)


def _with_file_ids(config_toml: str, file_ids: dict[str, int]) -> str:
    """Return the text of a config with the numbers of its own objects, which outlive their files.

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


def _with_recipe(config_toml: str, recipe: Recipe | None) -> str:
    """Return the text of a config with all of its recipe, which outlives the recipe's file.

    Raises:
        ConfigError: the text has no place for it.
    """
    if recipe is None:
        return config_toml
    text, said = config_toml, tomllib.loads(config_toml)["print"]
    whole = recipe.model_dump(mode="json", exclude_none=True)
    tables = {"print": whole} | {f"print.{key}": whole.pop(key) for key in BODIES}
    for name, values in tables.items():
        there = said if name == "print" else said.get(name.removeprefix("print."), {})
        lines = [f"{k} = {json.dumps(v, ensure_ascii=False)}" for k, v in values.items() if k not in there]
        header = re.search(rf"^[ \t]*\[{re.escape(name)}\][ \t]*(#.*)?$", text, re.MULTILINE)
        if header is None:
            text = "\n".join([text.rstrip(), "", f"[{name}]", *lines, ""])
        else:
            text = "\n".join([text[: header.end()], *lines]) + text[header.end() :]
    try:
        is_whole = load_record(Recipe, tomllib.loads(text)["print"], "[print]") == recipe
    except (tomllib.TOMLDecodeError, ConfigError):
        is_whole = False
    if not is_whole:
        raise ConfigError("the config's `print` must be a table of its own, [print]; write it so.")
    return text


def _proposals_of_imported(campaign: Campaign) -> list[Row]:
    """Return imported tools as tools of the campaign: its first batches, measured, which stay with their lab."""
    tools = sorted(campaign.lake.records(ToolRow, campaign_id=campaign.campaign_id), key=lambda t: (t.batch, t.slot))
    return [
        ProposalRow(
            proposal_id=content_id("P", [campaign.campaign_id, tool.batch, tool.slot, tool.slot]),
            campaign_id=campaign.campaign_id,
            batch=tool.batch,
            slot=tool.slot,
            index=tool.slot,
            fidelity="real",
            design_id=tool.design_id,
            acquisition=IMPORTED,
            n_real=0,
            n_sim=0,
            n_pending=0,
        )
        for tool in tools
    ]


def _check_own_designs(campaign: Campaign) -> None:
    """Raise ConfigError where the file of designs has other ones for a batch than those that were proposed."""
    rows = campaign.lake.rows(ProposalRow, campaign_id=campaign.campaign_id, fidelity="real")
    found: dict[int, list[tuple[int, str]]] = defaultdict(list)
    for row in rows:
        found[row["batch"]] += [(row["slot"], row["design_id"])] if row["acquisition"] == OWN else []
    for batch, slots in found.items():
        now = [own.design.design_id for own in campaign.own_designs.get(batch, ()) if own.rule == OWN]
        if [design_id for _, design_id in sorted(slots)] != now:
            path = campaign.config.designs
            file = "the config names no file of designs, which" if path is None else f"`{path}`"
            raise ConfigError(
                f"{file} has {len(now)} designs for batch {batch}, which is proposed already with "
                f"{len(slots)} designs of one's own; leave its rows as they were, and give new designs a later batch."
            )
