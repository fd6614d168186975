"""How far a simulated peak scatters between prints and mountings: its slopes, times what a lab states of these."""

from typing import NamedTuple

import numpy as np
from pydantic import Field

from fast.models.design.fin_ray import FinRay
from fast.models.records import Design, Record, Slopes
from fast.models.units import spell_name, unit_of

_WALLS = "wall_offset_mm"


class Scatter(NamedTuple):
    """Standard deviation of the peak in N, None if nothing of it is known; missing: tolerances that it leaves out."""

    sd_n: float | None
    missing: tuple[str, ...]


class Tolerances(Record):
    """One standard deviation of each, between prints and mountings of one design; 0 leaves one out."""

    wall_offset_mm: float = Field(default=0.1, ge=0, le=1, description="of a print: all walls and ribs alike")
    offset_z_mm: float = Field(default=0.2, ge=0, le=5, description="height at which the object stands")
    closed_gap_mm: float = Field(default=0.2, ge=0, le=5, description="distance at which the jaws stop")

    @property
    def stated(self) -> dict[str, float]:
        """Those above 0, by the names of the parameters that slopes are by."""
        return {name: sd for name, sd in self.model_dump().items() if sd > 0.0}

    def names_for(self, design: Design) -> tuple[str, ...]:
        """Parameters by which slopes are needed; the walls of a family that is no fin ray are its own affair."""
        return tuple(name for name in self.stated if name != _WALLS or isinstance(design, FinRay))

    def describe(self, scatter: Scatter) -> str:
        """The tolerances that a scatter is of, in words."""
        known = {name: sd for name, sd in self.stated.items() if name not in scatter.missing}
        return ", ".join(f"{spell_name(name)} {sd:g} {unit_of(name)}" for name, sd in known.items())

    def find_scatter(self, slopes: Slopes) -> Scatter:
        """Scatter of the peak, to first order, of parameters that are independent of each other."""
        known = {name: sd * slopes.by[name].peak_n for name, sd in self.stated.items() if name in slopes.by}
        missing = tuple(name for name in self.stated if name not in known)
        return Scatter(float(np.linalg.norm(list(known.values()))) if known else None, missing)
