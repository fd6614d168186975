"""C5: adhesion that resists sliding even without pressure."""

from dataclasses import dataclass
from typing import ClassVar

from models.simulation.effects.base import Effect
from models.simulation.effects.spec import EffectSpec, amplitude


@dataclass(frozen=True)
class ShearAdhesion(Effect):
    """The friction limit is tau = tau0 + mu p wherever the finger touches, with `shear_strength_mpa` tau0.

    Its share of the force goes with the contact area. Normal adhesion is left out: by JKR it is 1.5 pi w R, at most
    60 mN here. Brings in a stress of its own, so forces are no longer in proportion to Young's modulus.
    """

    scales_with_modulus: ClassVar[bool] = False

    shear_strength_mpa: float

    def adhesion_mpa(self) -> float:
        """The friction limit at no pressure, MPa."""
        return self.shear_strength_mpa


SPEC = EffectSpec(
    effect="shear_adhesion",
    title="Adhesion resists sliding in proportion to the contact area",
    code="C5",
    layer="contact",
    kind=ShearAdhesion,
    formula="friction limit = shear_strength_mpa + mu p",
    source="two-term friction law: Derjaguin 1934; Bowden & Tabor 1950",
    cost="F",
    parameters=(amplitude("shear_strength_mpa", 0.0, 0.05, (0.005, 0.006)),),
    confusable_with=("pressure_dependent_friction", "load_cell_offset"),
)
