"""C8: the objects' edges are rounder or sharper than drawn."""

from dataclasses import dataclass

from models.objects.catalogue import RigidObject
from models.simulation.effects.base import Effect
from models.simulation.effects.spec import EffectSpec, amplitude

LEAST_RADIUS_MM = 0.5  # twice the spacing of contact points (models.simulation.contact.points)


@dataclass(frozen=True)
class ObjectEdgeRadius(Effect):
    """Edges of radius r are rounded with r + `extra_radius_mm` instead; faces stay where they are.

    The sharp body is shrunk by the new radius and its distance offset by the same, as for the objects' own rounding
    (`models.objects.primitives`); what stands on a tip or an edge stands lower for it. Objects without edges (spheres,
    tori, the jack, the spiral) are left alone.
    """

    extra_radius_mm: float

    def modify_object(self, obj: RigidObject) -> RigidObject:
        """The object as it was really made."""
        radius_mm = obj.parameters.get("rounding_mm")
        if self.extra_radius_mm == 0.0 or radius_mm is None:
            return obj
        made_mm = max(radius_mm + self.extra_radius_mm, LEAST_RADIUS_MM)
        return obj.model_copy(update={"parameters": obj.parameters | {"rounding_mm": made_mm}})


SPEC = EffectSpec(
    effect="object_edge_radius",
    title="Edges of the objects are rounder than drawn",
    code="C8",
    layer="contact",
    kind=ObjectEdgeRadius,
    formula="edge radius + extra_radius_mm, faces unchanged",
    source="tolerance of fused deposition, +-0.2 mm",
    cost="F",
    parameters=(amplitude("extra_radius_mm", -0.5, 2.0, (0.3, 0.4)),),
    confusable_with=("finger_finger_contact", "wall_thickness_offset"),
)
