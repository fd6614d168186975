"""C9: the fingers meet before, or behind, their plane of symmetry."""

from dataclasses import dataclass

from models.simulation.effects.base import Effect
from models.simulation.effects.spec import EffectSpec, amplitude


@dataclass(frozen=True)
class FingerFingerContact(Effect):
    """Each finger is stopped, without friction, where it comes within `half_gap_mm` of the plane between the fingers.

    The simulator's own fingers meet in that plane. Positive: something keeps them apart (flash, pads, a finger that is
    wider towards the other); above half the closed gap they touch even without an object. Negative: they pass each
    other that far before they touch. The plane stands for the mirrored finger, which is exact for a symmetric grasp:
    two mirrored surfaces do not slide on each other.
    """

    half_gap_mm: float

    def finger_stop_mm(self) -> float:
        """Distance of the stop from the plane between the fingers, mm."""
        return self.half_gap_mm


SPEC = EffectSpec(
    effect="finger_finger_contact",
    title="Fingers touch each other early or late",
    code="C9",
    layer="contact",
    kind=FingerFingerContact,
    formula="x >= half_gap_mm for the front of a finger, x = 0 the plane between the fingers",
    source="unilateral contact (Signorini)",
    cost="F",
    parameters=(amplitude("half_gap_mm", -5.0, 15.0, (10.0, 3.0)),),
    confusable_with=("object_edge_radius",),
)
