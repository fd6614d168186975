"""What a printer and the person who cleans its prints ask of a finger, as rules that a design keeps or breaks."""

import math

import numpy as np
from pydantic import Field

from fast.models.design.space import FIN_RAYS, DesignSpace
from fast.models.records import Design, Record

_ROUNDING_MM = 0.005  # a wall of just the limit is not below it


class PrintingRules(Record):
    """Limits of what is printed; all are checked on sharp corners, as drawn."""

    min_cavity_mm: float = Field(
        default=3.0, ge=0, le=20, description="circle that must fit into every cavity: what removes support reaches in"
    )
    max_mass_g: float | None = Field(
        default=None, gt=0, description="of one finger with its base, without support: material and time"
    )
    min_wall_mm: float = Field(default=0.0, ge=0, le=10, description="thinnest wall or rib; a recipe raises it")


def broken_rules(design: Design, rules: PrintingRules) -> list[str]:
    """Say what is wrong with a design, one phrase for each rule it breaks; nothing when it can be printed.

    A cavity without room for the circle, such as the wedge between a steep rib and the tip, keeps its support or is
    filled (`models.design.fin_ray` fills what a printer cannot resolve): the finger is not the one that was meant.

    Example:
        >>> from fast.models.design.space import BEST_PUBLISHED
        >>> broken_rules(BEST_PUBLISHED, PrintingRules(max_mass_g=20.0))
        ['mass 32.7 g, limit 20 g']
    """
    # The rules are part of every campaign's config, which is often read without a design.
    import shapely

    broken = []
    voids = design.list_voids()
    is_tight = shapely.is_empty(shapely.buffer(voids, -rules.min_cavity_mm / 2, join_style="mitre"))
    if is_tight.any():
        count = int(is_tight.sum())
        broken.append(f"{count} of {len(voids)} cavities narrower than {rules.min_cavity_mm:g} mm")
    if rules.min_wall_mm > 0 and (thinnest := _find_thin(design, rules.min_wall_mm)):
        broken.append(f"{thinnest} thinner than {rules.min_wall_mm:g} mm")
    if rules.max_mass_g is not None:
        mass_g = estimate_mass_g(design)
        if mass_g > rules.max_mass_g:
            broken.append(f"mass {mass_g:.1f} g, limit {rules.max_mass_g:g} g")
    return broken


def printable(points: np.ndarray, rules: PrintingRules, space: DesignSpace = FIN_RAYS) -> np.ndarray:
    """Return the mask of the unit-cube points (n x d) whose designs break no rule; a millisecond each."""
    return np.array([not broken_rules(design, rules) for design in space.from_unit(points)], dtype=bool)


def _find_thin(design: Design, min_wall_mm: float) -> str:
    """Find where a section is thinner than a circle of this width, in words; empty where it is not.

    What a circle cannot reach is lost when the section is opened by it (eroded, then dilated). Corners of less than the
    circle's own area are no walls.
    """
    import shapely

    section, radius = design.draw_section(0.0), min_wall_mm / 2 - _ROUNDING_MM
    opened = shapely.buffer(shapely.buffer(section, -radius, join_style="mitre"), radius, join_style="mitre")
    lost = [part for part in shapely.get_parts(section.difference(opened)) if part.area > radius**2 * math.pi]
    if not lost:
        return ""
    highest = max(part.bounds[3] for part in lost)
    lowest = min(part.bounds[1] for part in lost)
    return f"material {lowest:.0f} to {highest:.0f} mm above the foot"


def estimate_mass_g(design: Design) -> float:
    """Estimate the mass of one printed finger with its base, without support."""
    from fast.models.design.fin_ray import BASE_HEIGHT_MM
    from fast.models.design.finger import DENSITY_G_PER_MM3  # trimesh takes half a second to import

    base_mm3 = design.length_mm * design.width_mm * BASE_HEIGHT_MM
    return DENSITY_G_PER_MM3 * (design.measure_section_mm2() * design.width_mm + base_mm3)
