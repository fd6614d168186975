"""G5: mount, tool changer or jaw give way under the closing force."""

from dataclasses import dataclass
from typing import ClassVar

from models.simulation.effects.base import Effect
from models.simulation.effects.spec import EffectSpec, amplitude


@dataclass(frozen=True)
class BaseCompliance(Effect):
    """A spring in series with the finger: at a closing force N its base stays behind the jaw by C N.

    `compliance_mm_per_n` C. N is the force at the end of the closing; in the lift the base stays where it is then, so
    that other closing distances of the simulator without the effect tell what it does. Brings in a stiffness of its
    own, so forces are no longer in proportion to Young's modulus.
    """

    scales_with_modulus: ClassVar[bool] = False

    compliance_mm_per_n: float

    def base_compliance_mm_per_n(self) -> float:
        """How far the base of a finger stays behind per force of closing."""
        return self.compliance_mm_per_n


SPEC = EffectSpec(
    effect="base_compliance",
    title="Mount or tool changer give way under the closing force",
    code="G5",
    layer="actuation",
    kind=BaseCompliance,
    formula="closing of a finger shortened by compliance_mm_per_n N, N: closing force in the end",
    source="springs in series",
    cost="C",
    parameters=(amplitude("compliance_mm_per_n", 0.0, 0.1, (0.02, 0.02)),),
    confusable_with=("force_limited_closing", "rib_imperfection", "pressure_droop"),
)
