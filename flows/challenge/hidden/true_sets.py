"""Sets of true grasps that worlds are made of: a base, or one hidden law, on every design and object of a panel."""

from collections.abc import Sequence

from fast.flows.challenge.hidden.truth import TrueGrasp
from fast.models.records import Record, Theta

MODULUS_MPA = 9.2
RESPONDING, LOWER, WIDER, RAISED = "base-0", "lower friction", "wider closing", "raised objects"
CHANNELS = ("time_s", "lift_mm", "force_n")


class TrueSet(Record):
    """A panel of true grasps at one theta: what it is called, and its law with parameters (none: a base).

    is_other: whether the law is the second one that is known for its effect.
    """

    name: str
    theta: tuple[float, float]
    law: str = ""
    is_other: bool = False
    parameters: dict[str, float] = {}
    raised_mm: float = 0.0

    def grasps(self, designs: Sequence[int], objects: Sequence[int]) -> list[list[TrueGrasp]]:
        """Grasps by design, since a design's grasps share a mesh."""
        theta = Theta(young_modulus_mpa=MODULUS_MPA, friction=self.theta[0], poisson_ratio=self.theta[1])
        return [
            [
                TrueGrasp(
                    theta=theta,
                    design=design,
                    object_id=obj,
                    law=self.law,
                    is_other=self.is_other,
                    parameters=self.parameters,
                    raised_mm=self.raised_mm,
                )
                for obj in objects
            ]
            for design in designs
        ]
