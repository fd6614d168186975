"""How far prints and mountings of one design scatter, as a lab states it."""

from pydantic import Field

from fast.models.records import Record
from fast.models.units import spell_name, unit_of


class Tolerances(Record):
    """One standard deviation of each, between prints and mountings of one design; 0 leaves one out."""

    wall_offset_mm: float = Field(default=0.1, ge=0, le=1, description="of a print: all walls and ribs alike")
    offset_z_mm: float = Field(default=0.2, ge=0, le=5, description="height at which the object stands")
    closed_gap_mm: float = Field(default=0.2, ge=0, le=5, description="distance at which the jaws stop")

    @property
    def stated(self) -> dict[str, float]:
        """Those above 0, by the names of the parameters that slopes are by."""
        return {name: sd for name, sd in self.model_dump().items() if sd > 0.0}

    def describe(self, missing: tuple[str, ...] = ()) -> str:
        """Describe the tolerances in words, but for those that are missing."""
        known = {name: sd for name, sd in self.stated.items() if name not in missing}
        return ", ".join(f"{spell_name(name)} {sd:g} {unit_of(name)}" for name, sd in known.items())
