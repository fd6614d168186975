"""A simulator version, everything that decides a simulated number, and the tiers that come with the program."""

from typing import Any, Literal, get_args

from pydantic import Field, field_validator

from fast.models.errors import UsageError
from fast.models.ids import content_id
from fast.models.records import EffectValue, GivenRecord, Theta
from fast.models.validation import closest


class MeshSettings(GivenRecord):
    """Which mesher, how fine. `extruded` is the production mesher of fin rays, `tetwild` meshes any body.

    The defaults are the production mesh. Walls are one element thick, short at the joints and at most `edge_mm`
    long between them; `refine` divides every element in the section into four and draws the fillets rounder.
    """

    mesher: Literal["extruded", "tetwild"] = "extruded"
    """Hexahedra and wedges, or tetrahedra."""
    edge_mm: float = Field(default=8.0, gt=0.5, le=20, description="longest edge along the walls")
    refine: int = Field(default=0, ge=0, le=2, description="uniform divisions of the section (extruded only)")
    layers: int = Field(default=1, ge=1, le=6, description="quadratic layers over the half width (extruded only)")
    fillet_mm: float = Field(default=0.5, ge=0, le=1.5, description="radius of the printed joint fillets")


# The mesh of the reference tier: six times the production unknowns; the tube's peak is 0.4 % above that at 25 times.
FINEST_MESH = MeshSettings(refine=1, layers=2)


class ContactSettings(GivenRecord):
    """How stiff a finger's surface meets an object: every simulator's own choice; see `ContactLaw` for the defaults.

    In N/mm3 at the reference modulus; stiffnesses are in proportion to E for any other.
    """

    normal_n_per_mm3: float = Field(default=4.0, gt=0, description="pressure per depth of penetration")
    tangential_n_per_mm3: float = Field(default=4.0, gt=0, description="shear per slip, before the surface slides")


# The code whose contact points lie in straight rows; it can still be simulated with, as the force ripples by them.
IN_ROWS = "3"

# Lakes may hold versions of the removed tier `screening`, a plane section of the finger: they are read, listed and
# compared; `check_tier` refuses to simulate with them.
Tier = Literal["screening", "production", "reference"]
REMOVED_TIER = "screening"


class SimulatorVersion(GivenRecord):
    """FEM settings + theta + an ordered list of effects: everything that decides a simulated number."""

    theta: Theta = Theta()
    effects: tuple[EffectValue, ...] = ()
    mesh: MeshSettings = MeshSettings()
    contact: ContactSettings = ContactSettings()
    tier: Tier = "production"
    fem_version: str = "4"
    """Of the code: what it simulates is comparable only within one."""

    @field_validator("tier", mode="before")
    @classmethod
    def _name_usable_tiers(cls, tier: Any) -> Any:
        if tier not in get_args(Tier):
            raise ValueError(f"it must be {' or '.join(TIERS)}; change it.")
        return tier

    @property
    def version_id(self) -> str:
        """Id derived from the whole content; versions that are older than the settings of contact keep theirs."""
        is_usual = self.contact == ContactSettings()
        return content_id("V", self.model_dump(exclude={"contact"} if is_usual else None))


TIERS = {
    "production": SimulatorVersion(),
    "reference": SimulatorVersion(tier="reference", mesh=FINEST_MESH),
}


def find_tier(name: str) -> SimulatorVersion:
    """Find the simulator version of a tier.

    Raises:
        UsageError: the tier was removed, or there is none of this name.
    """
    check_tier(name)
    if name not in TIERS:
        raise UsageError(f"there is no tier `{name}`; {closest(name, list(TIERS))}")
    return TIERS[name]


def check_tier(tier: str) -> None:
    """Refuse to simulate with a tier that the simulator no longer has.

    Raises:
        UsageError: the tier was removed.
    """
    if tier == REMOVED_TIER:
        raise UsageError(
            f"The simulator tier `{REMOVED_TIER}` was removed; simulate with `production` (its stored results stay "
            "readable)."
        )
