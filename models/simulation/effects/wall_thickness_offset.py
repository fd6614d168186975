"""G1: print dilation; every wall is thicker or thinner than drawn."""

from dataclasses import dataclass

import shapely
from shapely import affinity
from shapely.geometry import Polygon, box

from models.records import Design
from models.simulation.effects.base import Effect
from models.simulation.effects.spec import EffectSpec, amplitude


@dataclass(frozen=True)
class WallThicknessOffset(Effect):
    """Every printed wall and rib is thicker than drawn by `offset_mm` (negative: thinner).

    The profile grows by half the offset on all sides. It is then moved so that the front wall stays the plane
    x = 0, and cut or continued at the base and the tip plane, so stroke and height keep their meaning.
    """

    offset_mm: float

    def modify_profile(self, profile: Polygon, design: Design) -> Polygon:
        """The profile (x, z in mm) that is really printed."""
        if self.offset_mm == 0.0:
            return profile
        x_min, z_min, x_max, z_max = profile.bounds
        window = box(x_min - 1.0, z_min, x_max + 1.0, z_max)
        half = 0.5 * self.offset_mm
        if half > 0.0:
            printed = profile.buffer(half, join_style="mitre")
        else:
            # Growing the empty space inside the window thins the walls and leaves the cut ends in place.
            printed = profile.difference(window.difference(profile).buffer(-half, join_style="mitre"))
        moved = affinity.translate(printed, xoff=half).intersection(window)
        return max(shapely.get_parts(moved), key=lambda part: part.area)


SPEC = EffectSpec(
    effect="wall_thickness_offset",
    title="Printed walls are thicker than drawn",
    code="G1",
    layer="geometry",
    kind=WallThicknessOffset,
    formula="every wall and rib is thicker by offset_mm",
    source="tolerance of material jetting, +-0.1 mm",
    cost="F",
    parameters=(amplitude("offset_mm", -0.3, 0.3, (0.05, 0.08)),),
    confusable_with=("load_cell_gain", "print_anisotropy", "batch_ageing"),
)
