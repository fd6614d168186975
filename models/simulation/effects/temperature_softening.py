"""M5: the material softens as lab and tools warm up."""

import math
from dataclasses import dataclass, replace

from models.records import Design, GraspContext, GraspSetup, Theta
from models.simulation.effects.base import Effect, with_modulus
from models.simulation.effects.spec import EffectSpec, amplitude, shape


@dataclass(frozen=True)
class TemperatureSoftening(Effect):
    """E(T) = E [1 - c (T - T0)] with a temperature that settles, T - T0 = dT (1 - exp(-t / tau)).

    Force data hold only the product `softening` = c dT, the share of the modulus lost when warm (negative: the lab
    cools). `warm_up_s` tau, t the clock time since the batch began. c is 0.01 to 0.04 per kelvin for print materials
    near their glass transition, so 0.1 is 2.5 to 10 K.
    """

    softening: float
    warm_up_s: float
    clock_s: float = 0.0

    def in_grasp(self, design: Design, setup: GraspSetup, context: GraspContext) -> Effect:
        """The effect at this time of the batch."""
        return replace(self, clock_s=context.clock_s)

    def modify_theta(self, theta: Theta, design: Design) -> Theta:
        """The modulus at the present temperature."""
        return with_modulus(theta, 1.0 + self.softening * math.expm1(-self.clock_s / self.warm_up_s))


SPEC = EffectSpec(
    effect="temperature_softening",
    title="The material softens as it warms over the batch",
    code="M5",
    layer="material",
    kind=TemperatureSoftening,
    formula="E(t) = E [1 - softening (1 - exp(-t / warm_up_s))], t: clock time since the batch began",
    source="linear softening below the glass transition: Ward & Sweeney 2012; Newton's law of heating",
    cost="P",
    parameters=(amplitude("softening", -0.3, 0.4, (0.1, 0.1)), shape("warm_up_s", 300.0, 36000.0, (3600.0, 3600.0))),
    confusable_with=("load_cell_drift", "friction_wear", "pressure_droop", "batch_ageing"),
)
