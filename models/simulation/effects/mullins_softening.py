"""M2: cyclic stress softening; the first grasp is the stiffest."""

import math
from dataclasses import dataclass, replace

from models.records import Design, GraspContext, GraspSetup, Theta
from models.simulation.effects.base import Effect, with_modulus
from models.simulation.effects.spec import EffectSpec, amplitude, shape


@dataclass(frozen=True)
class MullinsSoftening(Effect):
    """Mullins effect over repeats: E_n = E [1 - d (1 - exp(-n / n0))] in the repeat with n repeats before it.

    `softening` d, the share of the modulus lost in the end, `scale_repeats` n0. Counted per object, because softening
    goes with the largest strain so far, and a new object brings its own.
    """

    softening: float
    scale_repeats: float
    repeat: int = 0

    def in_grasp(self, design: Design, setup: GraspSetup, context: GraspContext) -> Effect:
        """The effect in this repeat."""
        return replace(self, repeat=context.repeat)

    def modify_theta(self, theta: Theta, design: Design) -> Theta:
        """The softened modulus."""
        return with_modulus(theta, 1.0 + self.softening * math.expm1(-self.repeat / self.scale_repeats))


SPEC = EffectSpec(
    effect="mullins_softening",
    title="Cyclic softening over repeats (Mullins effect)",
    code="M2",
    layer="material",
    kind=MullinsSoftening,
    formula="E_n = E [1 - softening (1 - exp(-n / scale_repeats))], n: repeats before",
    source="Mullins 1969; Ogden & Roxburgh 1999",
    cost="P",
    parameters=(amplitude("softening", 0.0, 0.3, (0.05, 0.06)), shape("scale_repeats", 1.0, 20.0, (2.0, 3.0))),
    confusable_with=("friction_wear", "pressure_droop", "stress_relaxation"),
)
