"""One campaign: its config on its lake. What every task is given, and all it may know."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from lake.provenance import Provenance, current_provenance
from lake.store import Lake
from lake.tables import CampaignRow
from models.ids import seed_from
from models.records import SimulatorVersion
from tasks.config import CampaignConfig
from tasks.state import CampaignState, derive_state


@dataclass(frozen=True)
class Campaign:
    """A config and the lake in which the campaign lives; its id is the config's name."""

    lake: Lake
    config: CampaignConfig

    @property
    def campaign_id(self) -> str:
        """The name under which everything of the campaign is stored."""
        return self.config.name

    @property
    def version(self) -> SimulatorVersion:
        """The simulator that the scientist consults."""
        return self.config.simulator.version

    @property
    def object_ids(self) -> tuple[int, ...]:
        """Objects that every tool and every simulated design meets."""
        return self.config.objects.object_ids

    @property
    def output(self) -> Path:
        """Folder for what people read: print trays, report, recordings."""
        return self.lake.root / "outputs" / self.campaign_id

    def state(self) -> CampaignState:
        """Where the campaign stands now, from the lake."""
        return derive_state(self.lake, self.campaign_id, self.version.version_id, self.config.grasp.setup_id)

    def seed(self, *parts: str | int) -> int:
        """A random seed for one decision, the same whenever it is taken again."""
        return seed_from(self.config.seed, self.campaign_id, *parts)

    def provenance(self, seed: int = 0, parents: Sequence[str] = ()) -> Provenance:
        """Provenance of rows written for this campaign."""
        return current_provenance(self.config.config_hash, seed, parents)


def stored_provenance(lake: Lake, campaign_id: str, parents: Sequence[str] = ()) -> Provenance:
    """Provenance of rows about a campaign from a person, who has no config at hand: with the one in the lake."""
    stored = lake.rows(CampaignRow, campaign_id=campaign_id)
    return current_provenance(stored[-1]["config_hash"] if stored else "", parents=parents)
