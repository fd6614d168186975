"""A1: pneumatic jaws that stall."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from models.simulation.effects.base import Effect
from models.simulation.effects.spec import EffectSpec, amplitude

UNLIMITED_N = 1e6  # stands for infinity, which no config file can hold


@dataclass(frozen=True)
class ForceLimitedClosing(Effect):
    """Closing ends where the finger pushes back with `max_force_n` per jaw.

    The cylinder's force is pressure times piston area times efficiency (30 psi = 0.207 MPa on a 16 to 32 mm bore:
    10 to 60 N a jaw, notes/gap.md A1). Breaks the scaling of forces with Young's modulus. `UNLIMITED_N` changes
    nothing.
    """

    scales_with_modulus: ClassVar[bool] = False

    max_force_n: float

    def closing_force_limit_n(self) -> float:
        """The stall force of one jaw, N."""
        return self.max_force_n if self.max_force_n < UNLIMITED_N else np.inf


SPEC = EffectSpec(
    effect="force_limited_closing",
    title="Pneumatic jaws stall at their largest force",
    code="A1",
    layer="actuation",
    kind=ForceLimitedClosing,
    formula="closing ends where the closing force of a jaw reaches max_force_n",
    source="force = pressure x piston area x efficiency",
    cost="C",
    parameters=(amplitude("max_force_n", 1.0, UNLIMITED_N, (60.0, 40.0), neutral=UNLIMITED_N),),
    confusable_with=("base_compliance", "rib_imperfection", "wall_thickness_offset"),
)
