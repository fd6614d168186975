"""M7: ribs and walls, printed along other directions, are not equally stiff."""

from dataclasses import dataclass

import numpy as np

from models.design.profile import cavity_share
from models.records import Design
from models.simulation.effects.base import Effect
from models.simulation.effects.spec import EffectSpec, amplitude


@dataclass(frozen=True)
class PrintAnisotropy(Effect):
    """The modulus of the ribs is 1 + a times that of walls and tip, with `rib_excess` a.

    Strands or layers run along the walls and across the ribs, or the other way round. Each part is isotropic:
    thin parts bend and stretch along themselves, so of a transversely isotropic material the one modulus along each
    part counts.
    """

    rib_excess: float

    def stiffness_factor(self, points: np.ndarray, design: Design) -> np.ndarray | float:
        """Factor (n) on the modulus of elements with their middle at `points` (n, 2) of the section, mm."""
        if self.rib_excess == 0.0:
            return 1.0
        share = cavity_share(points, design)
        is_rib = (share > 0.0) & (share < 1.0) & (points[:, 1] < design.height_mm - design.tip_length_mm)
        return np.where(is_rib, 1.0 + self.rib_excess, 1.0)


SPEC = EffectSpec(
    effect="print_anisotropy",
    title="Ribs and walls differ in modulus (print direction)",
    code="M7",
    layer="material",
    kind=PrintAnisotropy,
    formula="E of ribs = (1 + rib_excess) E of walls and tip",
    source="anisotropy of printed parts: Ahn et al. 2002",
    cost="F",
    parameters=(amplitude("rib_excess", -0.4, 0.4, (0.1, 0.15)),),
    confusable_with=("wall_thickness_offset", "batch_ageing"),
)
