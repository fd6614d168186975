"""M6: a print batch that has aged or taken up moisture; the tool modulus of a batch."""

from dataclasses import dataclass

from models.records import Design, Theta
from models.simulation.effects.base import Effect, with_modulus
from models.simulation.effects.spec import EffectSpec, amplitude


@dataclass(frozen=True)
class BatchAgeing(Effect):
    """Post-cure and moisture change the modulus with age, E(t) = E [1 + b log(1 + t / t0)].

    All grasps of a batch are made within hours and ageing takes days, so only its `change` = b log(1 + t / t0) at the
    time of the test acts. It is an exact alias of the modulus of the batch's tools.
    """

    change: float

    def modify_theta(self, theta: Theta, design: Design) -> Theta:
        """The modulus of the aged tool."""
        return with_modulus(theta, 1.0 + self.change)


SPEC = EffectSpec(
    effect="batch_ageing",
    title="Ageing or moisture of a print batch",
    code="M6",
    layer="material",
    kind=BatchAgeing,
    formula="E' = E (1 + change), change = b log(1 + t / t0) at age t",
    source="physical ageing, logarithmic in time: Struik 1978",
    cost="P",
    parameters=(amplitude("change", -0.3, 0.3, (0.0, 0.1)),),
    confusable_with=("temperature_softening",),
    alias_of="tool_modulus",
)
