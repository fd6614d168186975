"""The two bodies of a printed finger: compliant fin ray and rigid mounting base with its id mark."""

from dataclasses import dataclass

import numpy as np
import shapely
import trimesh
from shapely import affinity
from shapely.geometry import Polygon
from shapely.geometry.base import BaseGeometry

from fast.models.design.fin_ray import BASE_HEIGHT_MM
from fast.models.design.glyphs import text_outline
from fast.models.records import Design

MARK_DEPTH_MM = 0.6
MARK_HEIGHT_MM = 5.0
MARK_MARGIN_MM = 2.0  # free on either side; longer marks are made smaller
DENSITY_G_PER_MM3 = 1.15e-3  # Agilus30 and Vero are 1.14 to 1.18 g/cm3 by their data sheets


@dataclass(frozen=True)
class FingerBodies:
    """One finger in its own frame: x = 0 the front wall, y across the width, z from the base to the apex, mm."""

    compliant: trimesh.Trimesh
    rigid: trimesh.Trimesh

    @property
    def volume_mm3(self) -> float:
        """Volume of both bodies."""
        return float(self.compliant.volume + self.rigid.volume)

    @property
    def mass_g(self) -> float:
        """Mass of both bodies, without support material."""
        return self.volume_mm3 * DENSITY_G_PER_MM3


def finger_bodies(design: Design, mark: str | None = None, fillet_mm: float = 0.5) -> FingerBodies:
    """Make the watertight bodies of a finger; `mark` (e.g. `B07T8`) is engraved into the underside of the base."""
    compliant = _extrude(design.draw_section(fillet_mm), design.width_mm)
    rigid = trimesh.creation.box(bounds=_base_bounds(design))
    if mark:
        rigid = trimesh.boolean.difference([rigid, _engraving(design, mark)], engine="manifold")
    return FingerBodies(compliant, rigid)


def _base_bounds(design: Design) -> np.ndarray:
    half = design.width_mm / 2
    return np.array([[0.0, -half, 0.0], [design.length_mm, half, BASE_HEIGHT_MM]])


def _extrude(profile: Polygon, width_mm: float) -> trimesh.Trimesh:
    """Extrude an (x, z) polygon over the width, centred on y = 0."""
    body = trimesh.creation.extrude_polygon(profile, height=width_mm, engine="manifold")
    # (x, z, depth) -> (x, width/2 - depth, z): a rotation, so the surface keeps its outside.
    turn = np.array([[1, 0, 0, 0], [0, 0, -1, width_mm / 2], [0, 1, 0, 0], [0, 0, 0, 1]], dtype=float)
    return body.apply_transform(turn)


def _engraving(design: Design, mark: str) -> trimesh.Trimesh:
    """Make the mark a body that reaches `MARK_DEPTH_MM` into the base, readable from below, along the width."""
    outline: BaseGeometry = text_outline(mark, MARK_HEIGHT_MM)
    fit = min(1.0, (design.width_mm - 2 * MARK_MARGIN_MM) / (outline.bounds[2] - outline.bounds[0]))
    outline = affinity.scale(outline, fit, fit, origin=(0, 0))
    parts = [
        trimesh.creation.extrude_polygon(part, height=2 * MARK_DEPTH_MM, engine="manifold")
        for part in shapely.get_parts(outline)
    ]
    body = trimesh.boolean.union(parts, engine="manifold") if len(parts) > 1 else parts[0]
    # Text runs along +y and its top points to +x: seen from below (towards +z) it reads left to right.
    turn = np.array(
        [[0, 1, 0, design.length_mm / 2], [1, 0, 0, 0], [0, 0, -1, MARK_DEPTH_MM], [0, 0, 0, 1]], dtype=float
    )
    return body.apply_transform(turn)
