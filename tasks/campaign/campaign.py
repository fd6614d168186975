"""One campaign: its config on its lake. What every task is given, and all it may know."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

from fast.lake.provenance import Provenance, current_provenance
from fast.lake.store import Lake
from fast.lake.tables.campaign import CampaignRow, SimulatorVersionRow
from fast.models.design.space import DesignSpace
from fast.models.ids import seed_from
from fast.models.own_code import load_constraint
from fast.models.records import Design
from fast.models.simulation.version import SimulatorVersion
from fast.tasks.campaign.config import CampaignConfig, relative_to
from fast.tasks.campaign.own_designs import OwnDesign, list_references, place_designs, read_designs
from fast.tasks.campaign.state import CampaignState, derive_state


@dataclass(frozen=True)
class Campaign:
    """A config and the lake in which the campaign lives; its id is the config's name, after that of its lab.

    `versions`: simulator versions of its stages so far, oldest first; none is the config's. `config_path`: its file,
    None where the config comes from the lake. `own_designs`: those of the config's file of designs, by batch.
    """

    lake: Lake
    config: CampaignConfig
    versions: tuple[SimulatorVersion, ...] = ()
    config_path: Path | None = None
    own_designs: Mapping[int, tuple[OwnDesign, ...]] = field(default_factory=dict)

    @property
    def campaign_id(self) -> str:
        """The name under which everything of the campaign is stored."""
        return self.config.campaign_id

    @property
    def version(self) -> SimulatorVersion:
        """The simulator that the scientist consults."""
        return self.versions[-1] if self.versions else self.config.simulator.version

    @cached_property
    def earlier_codes(self) -> tuple[SimulatorVersion, ...]:
        """Its versions as earlier programs simulated them: all but the code is the same. Oldest first."""
        own = self.versions or (self.version,)
        known = [row.version for row in self.lake.records(SimulatorVersionRow) if row.tier == self.version.tier]
        return tuple(one for one in known if one not in own and any(_is_other_code(one, version) for version in own))

    @property
    def older_versions(self) -> tuple[SimulatorVersion, ...]:
        """Those of its versions whose results are not those of the present one, newest first."""
        from fast.models.simulation.effects.scaling import force_ratio

        older: list[SimulatorVersion] = []
        for version in reversed((*self.earlier_codes, *self.versions)):
            if all(force_ratio(version, other) is None for other in (self.version, *older)):
                older.append(version)
        return tuple(older)

    def force_ratios(self, version: SimulatorVersion) -> dict[str, float]:
        """Return versions, by id, of the campaign with exactly the results of `version`, and the factors of forces.

        `version` itself comes last.
        """
        if not self.versions:
            return {version.version_id: 1.0}
        from fast.models.simulation.effects.scaling import force_ratio  # all effects, a tenth of a second of imports

        ratios = {v.version_id: ratio for v in self.versions if (ratio := force_ratio(v, version)) is not None}
        ratios.pop(version.version_id, None)
        return ratios | {version.version_id: 1.0}

    @property
    def object_ids(self) -> tuple[int, ...]:
        """Objects that every tool and every simulated design meets."""
        return self.config.objects.object_ids

    @cached_property
    def space(self) -> DesignSpace:
        """The designs that the campaign may make."""
        return self.config.design.space

    @property
    def constraint(self) -> Callable[[Design], bool] | None:
        """The constraint of one's own on designs, if the config names one."""
        name = self.config.scientist.constraint
        return None if name is None else load_constraint(name)

    @property
    def output(self) -> Path:
        """Folder for what people read: print trays, report, recordings."""
        return self.lake.root / "outputs" / self.campaign_id

    def state(self) -> CampaignState:
        """Return where the campaign stands now, from the lake."""
        present = frozenset(self.force_ratios(self.version))
        older = frozenset(v.version_id for v in (*self.earlier_codes, *self.versions)) - present
        return derive_state(self.lake, self.campaign_id, self.config.grasp.setup_id, present, older)

    def seed(self, *parts: str | int) -> int:
        """Return a random seed for one decision, the same whenever it is taken again, in every lab with this config."""
        return seed_from(self.config.seed, self.config.name, *parts)

    def provenance(self, seed: int = 0, parents: Sequence[str] = ()) -> Provenance:
        """Return the provenance of rows written for this campaign."""
        return current_provenance(self.config.config_hash, seed, parents)


def _is_other_code(one: SimulatorVersion, other: SimulatorVersion) -> bool:
    return one != other and one.model_copy(update={"fem_version": other.fem_version}) == other


def read_own_designs(config_path: Path, config: CampaignConfig) -> Mapping[int, tuple[OwnDesign, ...]]:
    """Read the reference finger of a config and the designs of the file that it names, by batch.

    Raises:
        UsageError: the file cannot be used, or a design can neither be printed nor placed.
    """
    family = config.design.space.family
    designs = list_references(config.schedule, family)
    if config.designs is not None:
        designs += read_designs(relative_to(config_path, config.designs), config.printing_rules, family)
    return place_designs(designs, config.schedule)


def stored_provenance(lake: Lake, campaign_id: str, parents: Sequence[str] = ()) -> Provenance:
    """Return provenance of rows about a campaign from a person, who has no config at hand: with the one in the lake."""
    stored = lake.rows(CampaignRow, campaign_id=campaign_id)
    return current_provenance(stored[-1]["config_hash"] if stored else "", parents=parents)
