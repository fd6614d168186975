"""Effects of the contact layer."""

from dataclasses import dataclass

import numpy as np

from models.effects.base import Effect


@dataclass(frozen=True)
class StaticKineticFriction(Effect):
    """Friction that changes from its static to its kinetic value as a point slips (slip weakening).

    mu(s) = mu_s [r + (1 - r) exp(-s / s0)], with mu_s the friction of theta, s the accumulated slip of the contact
    point in mm, `kinetic_ratio` r = mu_k / mu_s and `slip_scale_mm` s0. r = 1 is Coulomb friction. The factor is
    frozen over a time step; below s0 = 0.2 mm it would chatter (notes/fem.md section 10).
    """

    kinetic_ratio: float
    slip_scale_mm: float

    def friction_factor(self, slip_mm: np.ndarray, pressure_mpa: np.ndarray) -> np.ndarray | float:
        """Factor on the friction coefficient per contact point (n)."""
        if self.kinetic_ratio == 1.0:
            return 1.0
        return self.kinetic_ratio + (1.0 - self.kinetic_ratio) * np.exp(-slip_mm / self.slip_scale_mm)
