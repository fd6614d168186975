"""A fin ray of two materials: ribs and tip pad of another modulus than the walls, as multi-material printers make."""

from typing import ClassVar

import numpy as np
from pydantic import Field

from fast.models.design.fin_ray import FinRay, is_in_rib


class GradedFinRay(FinRay):
    """The paper's fin ray with a modulus of its own for the ribs, and for a pad on the front of the tip.

    The moduli are factors on that of the walls, which calibration infers. PolyJet blends of one soft and one hard
    resin span a wider range than the factors here (Shore A 30 to 95, about 1 to 20 MPa).
    """

    family: ClassVar[str] = "graded-fin-ray"

    rib_modulus_factor: float = Field(default=1.0, ge=0.3, le=3.0, description="modulus of the ribs over the walls'")
    tip_modulus_factor: float = Field(default=1.0, ge=0.3, le=3.0, description="modulus of the tip over the walls'")

    def scale_modulus(self, points: np.ndarray) -> np.ndarray:
        """Factor (n) on Young's modulus at points (n, 2) of the section, mm: of ribs, of the solid tip, else 1."""
        is_tip = points[:, 1] > self.height_mm - self.tip_length_mm
        factor = np.where(is_in_rib(points, self), self.rib_modulus_factor, 1.0)
        return np.where(is_tip, self.tip_modulus_factor, factor)
