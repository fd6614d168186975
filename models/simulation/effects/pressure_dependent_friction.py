"""C4: friction that falls with the contact pressure."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from models.simulation.effects.base import Effect
from models.simulation.effects.spec import EffectSpec, amplitude, shape

LEAST_SHARE = 0.05  # of the reference pressure: below it the power law would grow without bound


@dataclass(frozen=True)
class PressureDependentFriction(Effect):
    """mu(p) = mu (p / p0)^-k, with `exponent` k (1/3: a smooth Hertzian contact) and `reference_mpa` p0.

    p is the last converged pressure of the contact point, frozen over a time step, and at least 5 % of p0. Brings in a
    pressure of its own, so forces are no longer in proportion to Young's modulus.
    """

    scales_with_modulus: ClassVar[bool] = False

    exponent: float
    reference_mpa: float

    def friction_factor(self, slip_mm: np.ndarray, pressure_mpa: np.ndarray) -> np.ndarray | float:
        """Factor on the friction coefficient per contact point (n)."""
        if self.exponent == 0.0:
            return 1.0
        return np.asarray(np.maximum(pressure_mpa / self.reference_mpa, LEAST_SHARE) ** -self.exponent)


SPEC = EffectSpec(
    effect="pressure_dependent_friction",
    title="Friction falls with the contact pressure",
    code="C4",
    layer="contact",
    kind=PressureDependentFriction,
    formula="mu(p) = mu (p / reference_mpa)^-exponent, p: pressure of the point",
    source="elastic contact of one asperity: Hertz; rubber: Schallamach 1952",
    cost="F",
    parameters=(amplitude("exponent", 0.0, 1.0 / 3.0, (0.12, 0.1)), shape("reference_mpa", 0.01, 0.2, (0.05, 0.05))),
    confusable_with=("shear_adhesion", "hyperelastic_stiffening", "static_kinetic_friction"),
)
