"""A campaign's config file: TOML, composed from the sections that the layers own."""

import re
import tomllib
from pathlib import Path
from typing import Any, Literal

from pydantic import Field, model_validator

from fast.models.design.printability import PrintingRules
from fast.models.design.recipe import Recipe
from fast.models.design.reference import make_reference, reference_within
from fast.models.errors import ConfigError, UsageError
from fast.models.ids import canonical_json, content_id, id_in_lab, tool_label
from fast.models.material import TABLE_3, MaterialLot
from fast.models.records import GraspSetup, Record
from fast.models.scientist.objectives import MEAN_PEAK, OUTCOMES
from fast.models.scientist.surrogate.observations import MIN_OBSERVATIONS
from fast.models.simulation.tolerances import Tolerances
from fast.models.validation import closest, load_record, parse_toml
from fast.tasks.campaign.retired import drop_retired, refuse_retired
from fast.tasks.campaign.settings import (
    DesignSettings,
    Execution,
    GapSettings,
    NightSettings,
    ObjectPlan,
    Schedule,
    ScientistSettings,
    SimulatorSettings,
)

LOT_SUFFIX = ".toml"
RECIPE = "recipe"  # key of `[print]` that names a recipe file
BODIES = ("compliant", "rigid")
_FILES = ("bench.world", "bench.real", "material", "designs")  # keys of the science that name a file
NAME = r"^[a-z0-9][a-z0-9-]{0,40}$"
_ROUNDING_MM = 1e-6
_N_TRIED = 4  # designs drawn of a space that is not the paper's, to see whether they can be made
_LOT_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9 ._-]{0,60}")


class BenchChoice(Record):
    """Where tools are measured: a gantry (virtual on a world file, or real with `--real`), or a bench elsewhere."""

    kind: Literal["gantry", "folder"] = Field(
        default="gantry", description="folder: each batch is written as files, and measured by a bench of one's own"
    )
    world: str | None = Field(default=None, description="path of the world file, relative to the config")
    real: str | None = Field(default=None, description="path of the bench file with ports and addresses")
    name: str = Field(
        default="foreign",
        pattern=NAME,
        description="lower-case letters, digits, hyphens; what `grasps.bench` says of a bench of one's own",
    )
    max_force_n: float = Field(
        default=200.0, gt=0, le=10_000, description="a told force above it is refused; the paper's cell ends at 196"
    )

    @property
    def is_folder(self) -> bool:
        """Whether the bench is somebody else's, who is given files and gives files back."""
        return self.kind == "folder"

    @model_validator(mode="after")
    def _check_kind(self) -> "BenchChoice":
        if not self.is_folder and self.world is None:
            raise ValueError('world is missing; name a world file, or set kind = "folder" for a bench of your own')
        if self.is_folder and self.world is not None:
            raise ValueError('a bench of kind "folder" has no world; remove world')
        if self.is_folder and self.real is not None:
            raise ValueError('a bench of kind "folder" has no bench file; remove real')
        if {"gantry", "virtual", "real"} & {self.name}:
            raise ValueError(f"the name {self.name} is taken by the benches of this program; give another")
        return self


class CampaignConfig(Record):
    """Everything that defines a campaign.

    All but `execution` and `lab` is part of its hash; of `tolerances` the walls, where `robust_peak_n` is wanted.
    """

    name: str = Field(pattern=NAME, description="lower-case letters, digits, hyphens")
    lab: str | None = Field(
        default=None, pattern=NAME, description="lower-case letters, digits, hyphens; who prints and measures"
    )
    seed: int = Field(default=0, ge=0)
    """Of every draw."""
    material: str | None = Field(
        default=None, description="path of the file of the material lot, relative to the config"
    )
    designs: str | None = Field(
        default=None, description="path of a CSV file of designs of one's own, relative to the config"
    )
    design: DesignSettings = DesignSettings()
    """Which fingers may be made."""
    schedule: Schedule = Schedule()
    """How many tools and simulations."""
    objects: ObjectPlan = ObjectPlan()
    """What tools are measured on."""
    grasp: GraspSetup = GraspSetup()
    """How they are grasped."""
    simulator: SimulatorSettings = SimulatorSettings()
    """What the scientist consults."""
    scientist: ScientistSettings = ScientistSettings()
    """How designs are proposed."""
    gap: GapSettings = GapSettings()
    """Whether the campaign looks for what its simulator misses."""
    tolerances: Tolerances = Tolerances()
    """How prints and mountings scatter, for the +- of simulated peaks and for `robust_peak_n`."""
    night: NightSettings = NightSettings()
    """Whether it simulates with a new simulator between batches."""
    bench: BenchChoice
    """Where tools are measured."""
    print: Recipe | None = None
    """How tools are printed; None: nobody says."""
    execution: Execution = Execution()
    """How the work is spread; changes no result."""

    @model_validator(mode="after")
    def _check_first_data(self) -> "CampaignConfig":
        n = self.schedule.initial_tools + self.n_simulated_first
        if self.schedule.guided_batches and n < MIN_OBSERVATIONS:
            raise ValueError(
                f"schedule.initial_tools and initial_simulations give the surrogate {n} observations before the first "
                f"guided batch, it needs {MIN_OBSERVATIONS}; raise one of them"
            )
        return self

    @property
    def campaign_id(self) -> str:
        """The name under which everything of the campaign is stored: `<name>`, or `<lab>.<name>`."""
        return id_in_lab(self.name, self.lab)

    @property
    def wants_copies(self) -> bool:
        """Whether an objective or limit is of what most copies of a drawing hold."""
        return any(OUTCOMES[name].is_of_copies for name in self.scientist.wanted & set(OUTCOMES))

    @property
    def n_simulated_first(self) -> int:
        """Designs that are simulated before the first guided batch."""
        return self.schedule.initial_simulations + self.simulator.simulate_tools * self.schedule.initial_tools

    @property
    def max_grasp_attempts(self) -> int:
        """Failures after which a grasp is given up; one that a person tells of a bench of their own is final."""
        return 1 if self.bench.is_folder else self.execution.max_grasp_attempts

    @property
    def science(self) -> dict[str, Any]:
        """The part that decides results, as JSON data."""
        # What a config does not use of later sections and keys leaves it the hash that it had before there were any.
        # The lab is no part of it: two labs with one config do the same.
        unused: dict[str, Any] = {"execution": True, "lab": True}
        unused["tolerances"] = {"offset_z_mm", "closed_gap_mm"} if self.wants_copies else True
        unused |= {"material": True} if not self.material else {}
        unused |= {"designs": True} if self.designs is None else {}
        unused |= {"bench": {"kind", "name", "max_force_n"} if not self.bench.is_folder else {"max_force_n"}}
        # When a campaign ends decides no row of it.
        unused["schedule"] = {"stop", "stop_margin"}
        unused["schedule"] |= {
            name for name in ("reference_tools", "reference", "alike", "simpler") if not getattr(self.schedule, name)
        }
        unused |= {"print": {"recipe"} if self.print else True}  # what its file is called decides nothing
        unused |= {"design": True if self.design == DesignSettings() else set() if self.design.equal else {"equal"}}
        unused |= {"gap": True} if self.gap == GapSettings() else {}
        unused |= {"night": True} if self.night == NightSettings() else {}
        own = {"surrogate", "constraint", "best_predicted", "prior_campaigns", "objectives", "at_least", "at_most"}
        defaults = ScientistSettings()
        same = {key: True for key in own if getattr(self.scientist, key) == getattr(defaults, key)}
        unused["scientist"] = same | ({} if self.scientist.printing.min_wall_mm else {"printing": {"min_wall_mm"}})
        unused["objects"] = {"files", "places", "file_ids"}  # what a file is called decides nothing
        science = self.model_dump(mode="json", exclude=unused)
        if self.objects.files:
            science["objects"]["own"] = [list(pair) for pair in self.objects.own_places]
        return science

    @property
    def printing_rules(self) -> PrintingRules:
        """What a tool must keep to be printed: `scientist.printing`, with the wall and the gap of the recipe."""
        rules = self.scientist.printing
        return rules if self.print is None else self.print.limit(rules)

    @property
    def proposal_rules(self) -> PrintingRules | None:
        """The rules of printing that proposals keep, if any."""
        return self.printing_rules if self.scientist.manufacturable else None

    @property
    def config_hash(self) -> str:
        """Id of the part that decides results."""
        return content_id("H", self.science)


def load_config(path: Path) -> CampaignConfig:
    """Read and check a campaign config.

    Raises:
        ConfigError: the file is missing, is not TOML, or has a wrong value or key, or one that is gone.
    """
    data = read_toml(path, "campaign config")
    refuse_retired(data, str(path))
    if isinstance(data.get("print"), dict):
        data["print"] = read_recipe(data["print"], path)
    config = with_own_objects(load_record(CampaignConfig, data, str(path)), path)
    _check_science(config, str(path))
    if config.bench.world is not None:
        world = relative_to(path, config.bench.world)
        if not world.is_file():
            raise ConfigError(f"{path}: world file `{world}` does not exist; set bench.world to an existing file.")
    if config.material is not None:
        read_lot(relative_to(path, config.material))
    return config


def read_stored_config(config_toml: str, campaign_id: str) -> CampaignConfig:
    """Read the config that a lake keeps of a campaign, without keys that are gone since it was written.

    Raises:
        ConfigError: a newer program wrote it.
    """
    return load_record(CampaignConfig, drop_retired(tomllib.loads(config_toml)), f"stored config of {campaign_id}")


def with_own_objects(config: CampaignConfig, path: Path) -> CampaignConfig:
    """Return the config with the numbers of the objects that its `objects.files` hold, which this process then knows.

    Raises:
        ConfigError: a file cannot be used, two hold the same object, or one is not what the config says it was.
    """
    if not config.objects.files:
        return config
    from fast.tasks.objects import read_objects  # loads meshes; the 36 do without

    found = read_objects([relative_to(path, name) for name in config.objects.files])
    numbers = {name: obj.object_id for name, obj in zip(config.objects.files, found, strict=True)}
    for name, object_id in config.objects.file_ids.items():
        if numbers.get(name) != object_id:
            raise ConfigError(
                f"{path}: `{name}` is no longer object {object_id}; bring the old file back, or leave out "
                "objects.file_ids and give the campaign another name."
            )
    objects = config.objects.model_copy(update={"file_ids": numbers})
    return config.model_copy(update={"objects": objects})


def read_recipe(section: dict[str, Any], path: Path) -> dict[str, Any]:
    """Read the section `[print]` of a config, filled up with the recipe file that it may name; the section goes first.

    Raises:
        ConfigError: the file is missing, is not TOML, or names a file itself.
    """
    named = section.get("recipe")
    if not isinstance(named, str):
        return {"name": path.stem, **section}
    file = relative_to(path, named)
    told = read_toml(file, "recipe file")
    if RECIPE in told:
        raise ConfigError(f"{file}: a recipe file names no other one; remove `{RECIPE}`.")
    load_record(Recipe, {"name": file.stem, **told}, str(file))
    bodies = {key: {**told[key], **section[key]} for key in BODIES if isinstance(section.get(key), dict)}
    return {"name": file.stem, **told, **section, **bodies}


def read_lot(path: Path) -> MaterialLot:
    """Read and check the file of a lot, whose name is the name of the lot.

    Raises:
        ConfigError: the file is missing, has a wrong value, key or name, or measures nothing.
    """
    lot = load_record(MaterialLot, read_toml(path, "material lot"), str(path))
    if path.suffix != LOT_SUFFIX or not _LOT_NAME.fullmatch(path.stem) or path.stem == TABLE_3:
        raise ConfigError(
            f"{path}: the name of a lot is that of its file, here `{path.name}`; it must be letters, digits, spaces, "
            f"`.`, `_` or `-`, end in {LOT_SUFFIX}, and not be `{TABLE_3}`; rename the file."
        )
    if not lot.measured:
        raise ConfigError(f"{path}: nothing is measured; add a table such as [young_modulus].")
    return lot


def world_path(config_path: Path, config: CampaignConfig) -> Path:
    """Return the world file of a config.

    Raises:
        ConfigError: its bench is one's own, which has none.
    """
    if config.bench.world is None:
        raise ConfigError(
            f'{config_path}: bench.kind is "folder", so there is no virtual bench to use; name a world in bench.world.'
        )
    return relative_to(config_path, config.bench.world)


def relative_to(config_path: Path, name: str) -> Path:
    """Return a file named in a config, relative to the config's own folder."""
    return (config_path.parent / name).resolve()


def read_toml(path: Path, what: str) -> dict[str, Any]:
    """Parse a TOML file, with one sentence for a missing or broken one."""
    try:
        text = path.read_text(encoding="utf-8-sig")
    except FileNotFoundError as error:
        raise ConfigError(f"{what} `{path}` does not exist; give the path of a TOML file.") from error
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(
            f"{what} `{path}` cannot be read ({_cause(error)}); check the path and its permissions."
        ) from error
    return parse_toml(text, f"{what} `{path}`")


def _cause(error: OSError | UnicodeDecodeError) -> str:
    return error.strerror or str(error) if isinstance(error, OSError) else str(error)


def differences(old: dict[str, Any], new: dict[str, Any]) -> list[str]:
    """Return `section.key old -> new` for every value in which two configs differ.

    A file is the same where one path ends as the other does, as `../worlds/a.toml` and `/lab/worlds/a.toml` do: which
    folder a path of the lake is relative to is not kept.
    """
    flat_old, flat_new = dict(_flatten(old)), dict(_flatten(new))
    changes = []
    for key in sorted(flat_old.keys() | flat_new.keys()):
        before, after = flat_old.get(key), flat_new.get(key)
        if before != after and not (key in _FILES and _may_be_same_file(before, after)):
            changes.append(f"{key} {canonical_json(before)} -> {canonical_json(after)}")
    return changes


def _may_be_same_file(one: str | None, other: str | None) -> bool:
    """Return whether two paths, without their steps up, end the same as far as the shorter goes."""
    if one is None or other is None:
        return False
    parts = [[part for part in Path(name).parts if part != ".."] for name in (one, other)]
    n = min(len(found) for found in parts)
    return parts[0][-n:] == parts[1][-n:]


def _flatten(data: dict[str, Any], prefix: str = "") -> list[tuple[str, Any]]:
    pairs: list[tuple[str, Any]] = []
    for key, value in data.items():
        pairs += _flatten(value, f"{prefix}{key}.") if isinstance(value, dict) else [(prefix + key, value)]
    return pairs


def _check_science(config: CampaignConfig, source: str) -> None:
    """Refuse unknown effects, functions that are not there, and what cannot be printed or learned."""
    from fast.models.own_code import load_own
    from fast.models.simulation.effects.catalogue import build_effects

    try:
        config.grasp.check_stroke()
        _check_design(config)
        _check_recipe(config)
        _check_simpler(config)
        _check_references(config)
        _check_objectives(config)
        build_effects(config.simulator.effects)
        for name in config.scientist.own_functions:
            load_own(name)
    except UsageError as error:
        sentence = str(error)
        raise ConfigError(f"{source}: {sentence[:1].lower()}{sentence[1:]}") from error


def _check_recipe(config: CampaignConfig) -> None:
    """Refuse a recipe that cannot print what the campaign may propose: a wall too thin, a finger larger than the bed.

    Raises:
        UsageError: with the value and the limit.
    """
    from fast.models.design.tray import check_bed

    recipe, space = config.print, config.design.space
    if config.schedule.reference is not None:
        make_reference(config.schedule.reference, space.family)
    if recipe is None:
        return
    largest = dict(zip(space.names, space.upper, strict=True))
    check_bed(largest["length_mm"], largest["height_mm"], recipe.bed_mm, "the largest sizes of [design]")
    for column in space.walls:
        name, lowest = space.names[column], space.lower[column]
        if lowest < recipe.wall_mm - _ROUNDING_MM:
            raise UsageError(
                f"the recipe {recipe.name} prints walls from {recipe.wall_mm:g} mm ({recipe.wall_rule}), `{name}` may "
                f"be {lowest:g} mm; set design.ranges.{name} = [{recipe.wall_mm:g}, "
                f"{largest[name]:g}] or change the recipe."
            )


def _check_simpler(config: CampaignConfig) -> None:
    """Refuse simpler fingers that the design cannot have.

    Raises:
        UsageError: with those that it can.
    """
    if not config.schedule.simpler:
        return
    from fast.models.scientist.insights.simplest import name_criteria  # half a second of imports

    known = name_criteria(config.design.space, reference_within(config.design.space))
    for name in config.schedule.simpler:
        if name not in known:
            raise UsageError(
                f"no finger of `{config.design.family}` within the ranges of [design] is simpler by `{name}`; "
                f"schedule.simpler may name {' or '.join(f'`{one}`' for one in known)}."
            )


def _check_references(config: CampaignConfig) -> None:
    """Refuse names of reference tools that no batch of the schedule has.

    Raises:
        UsageError: with the first of them.
    """
    schedule = config.schedule
    if isinstance(schedule.reference_tools, int):
        return
    batches = [batch for stage in range(schedule.n_stages) for batch in schedule.batches_of(stage)]
    known = {tool_label(batch, slot) for batch in batches for slot in range(schedule.tools_of(batch))}
    for name in schedule.reference_tools:
        campaign_id, _, label = name.rpartition("/")
        if campaign_id not in ("", config.campaign_id) or label not in known:
            raise UsageError(
                f"schedule.reference_tools names `{name}`, which this campaign never prints; name a tool by batch (1 "
                f"to {batches[-1]}) and slot (0 to {schedule.tools_of(1) - 1} in the first), e.g. {tool_label(1, 0)}."
            )
    if len(set(schedule.reference_tools)) < schedule.n_references:
        raise UsageError("schedule.reference_tools names a tool twice; give each once.")


def _check_objectives(config: CampaignConfig) -> None:
    """Refuse objectives and limits of which the first batches teach too little.

    Raises:
        UsageError: with the name, and what to raise or to take instead.
    """
    if config.wants_copies:
        _check_copies(config)
    if not config.schedule.guided_batches:
        return
    for name in sorted(config.scientist.wanted & set(OUTCOMES) - {MEAN_PEAK.name}):
        is_simulated = OUTCOMES[name].is_simulated
        n = config.n_simulated_first if is_simulated else config.schedule.initial_tools
        if n < MIN_OBSERVATIONS:
            of, key = ("simulated designs", "initial_simulations") if is_simulated else ("tools", "initial_tools")
            raise UsageError(
                f"the objective or limit `{name}` is learned from {MIN_OBSERVATIONS} {of} at least, there are {n} "
                f"before the first guided batch; raise schedule.{key}."
            )


def _check_copies(config: CampaignConfig) -> None:
    """Refuse to ask what prints of a drawing hold where nothing is known of how they differ.

    Raises:
        UsageError: with what to set or to take instead.
    """
    wants = "`robust_peak_n` is of prints with thicker and thinner walls"
    if not config.design.space.walls:
        family = config.design.space.family.family
        raise UsageError(
            f"{wants}, and the family `{family}` has no parameter that ends in `_thickness_mm`; take `mean_peak_n`."
        )
    if not config.tolerances.wall_offset_mm:
        raise UsageError(
            f"{wants}, and tolerances.wall_offset_mm is 0; set it to the standard deviation of your walls in mm, or "
            "take `mean_peak_n`."
        )


def _check_design(config: CampaignConfig) -> None:
    """Draw a few random designs: they are what the family of a user's own is tried on.

    Raises:
        UsageError: the design space has no such parameter or no room.
        ConfigError: a section cannot be printed and mounted.
    """
    import numpy as np

    from fast.models.design.families import check_section

    for name in config.schedule.alike:
        if name not in config.design.space.names:
            raise UsageError(f"schedule.alike names `{name}`; {closest(name, list(config.design.space.names))}")
    if config.design == DesignSettings():
        return
    for design in config.design.space.random_designs(_N_TRIED, np.random.default_rng(config.seed)):
        check_section(design)
