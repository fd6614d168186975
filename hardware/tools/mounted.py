"""What is mounted in the dock, and what it should weigh."""

from dataclasses import dataclass
from functools import cached_property

from fast.models.design.fin_ray import FinRay
from fast.models.records import Design

ADAPTOR_MASS_KG = 0.260  # head-side plate, jaws and quick-change pin of every tool, without fingers
_PRINT_DENSITY_KG_PER_MM3 = 1.17e-6  # rubber-like photopolymers and their mixtures: 1.12 to 1.20 g/cm3
_RIGID_BASE_HEIGHT_MM = 10.0


@dataclass(frozen=True)
class MountedTool:
    """A tool in a slot of the dock. `mass_kg` is weighed if somebody did, else estimated from the design."""

    tool_id: str
    design: Design
    mass_kg: float | None = None

    @cached_property
    def expected_mass_kg(self) -> float:
        """Mass that the load cell should gain when the tool is picked up."""
        return self.mass_kg if self.mass_kg is not None else estimate_tool_mass_kg(self.design)


def estimate_tool_mass_kg(design: Design) -> float:
    """Estimate the mass of adaptor and both fingers, from wall lengths; good to a few per cent of the whole tool.

    Each finger is a front wall, a back wall, the ribs at mid length, a triangular tip and a rigid base.
    """
    if not isinstance(design, FinRay):
        finger_mm3 = (design.measure_section_mm2() + design.length_mm * _RIGID_BASE_HEIGHT_MM) * design.width_mm
        return ADAPTOR_MASS_KG + 2 * finger_mm3 * _PRINT_DENSITY_KG_PER_MM3
    cavity_mm = design.height_mm - design.tip_length_mm
    walls_mm2 = (design.front_thickness_mm + design.back_thickness_mm) * cavity_mm
    mean_depth_mm = 0.6 * design.length_mm
    ribs_mm2 = design.rib_count * design.rib_thickness_mm * mean_depth_mm
    tip_mm2 = 0.5 * design.tip_length_mm * (design.length_mm * design.tip_length_mm / design.height_mm + 3.0)
    base_mm2 = design.length_mm * _RIGID_BASE_HEIGHT_MM
    finger_mm3 = (walls_mm2 + ribs_mm2 + tip_mm2 + base_mm2) * design.width_mm
    return ADAPTOR_MASS_KG + 2 * finger_mm3 * _PRINT_DENSITY_KG_PER_MM3
