"""C1: friction that changes from its static to its kinetic value as a point slips."""

from dataclasses import dataclass

import numpy as np

from models.simulation.effects.base import Effect
from models.simulation.effects.spec import EffectSpec, amplitude, shape


@dataclass(frozen=True)
class StaticKineticFriction(Effect):
    """Slip weakening (or strengthening, as elastomers show on the rising branch of Grosch's curve).

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


SPEC = EffectSpec(
    effect="static_kinetic_friction",
    title="Friction falls from static to kinetic with slip",
    code="C1",
    layer="contact",
    kind=StaticKineticFriction,
    formula="mu(s) = mu [kinetic_ratio + (1 - kinetic_ratio) exp(-s / slip_scale_mm)], s: slip of the point",
    source="slip weakening: Ida 1972; elastomers: Grosch 1963",
    cost="F",
    parameters=(
        amplitude("kinetic_ratio", 0.3, 1.5, (0.8, 0.2), neutral=1.0),
        shape("slip_scale_mm", 0.2, 10.0, (1.0, 1.0)),
    ),
    confusable_with=("load_cell_lag", "stress_relaxation", "pressure_dependent_friction"),
)
