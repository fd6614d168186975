"""The fin ray, the paper's family of fingers: its parameters, and the profile that is extruded over the width."""

import math
from typing import Any, ClassVar

import numpy as np
import shapely
from pydantic import Field
from shapely import affinity
from shapely.geometry import LineString, Polygon, box
from shapely.geometry.base import BaseGeometry

from fast.models.errors import UsageError
from fast.models.records import Design

BASE_HEIGHT_MM = 3.0  # rigid mounting base, printed in another material below the compliant body
APEX_EXTRA_MM = 1.0  # the apex is this much longer in x than the front wall is thick
MIN_CAVITY_AREA_MM2 = 2.25  # smaller cavities, and
MIN_CAVITY_WIDTH_MM = 1.0  # parts of cavities thinner than this, are filled: a printer cannot resolve them
MIN_EDGE_MM = 0.08  # half the shortest edge of a usual fillet; shorter ones would only make sliver elements
ARC_SEGMENTS = 4  # per quarter circle of a fillet


class FinRay(Design):
    """A fin-ray finger in nine parameters, with the ranges of the paper (Problem definition)."""

    family: ClassVar[str] = "fin-ray"

    length_mm: float = Field(ge=19, le=35, description="depth at the base, closing direction x")
    width_mm: float = Field(ge=28, le=35, description="along y")
    height_mm: float = Field(ge=90, le=120, description="along z, base to apex")
    tip_length_mm: float = Field(ge=20, le=30, description="solid tip, from the apex along z")
    front_thickness_mm: float = Field(ge=2, le=3, description="wall that touches the object")
    back_thickness_mm: float = Field(ge=2, le=3, description="slanted wall")
    rib_thickness_mm: float = Field(ge=2, le=3)
    """Of every rib."""
    rib_count: int = Field(ge=1, le=10)
    """Between the walls."""
    rib_angle_deg: float = Field(ge=-40, le=40, description="from the horizontal")

    @property
    def content(self) -> dict[str, Any]:
        """See `Design`."""
        return self.model_dump() if type(self) is FinRay else super().content

    @property
    def tip_height_mm(self) -> float:
        """Length of the solid tip."""
        return self.tip_length_mm

    def draw_section(self, fillet_mm: float = 0.5, arc_segments: int = ARC_SEGMENTS) -> Polygon:
        """See `Design` and `planar_profile`."""
        return planar_profile(self, fillet_mm, arc_segments)

    def list_voids(self) -> list[Polygon]:
        """List the voids between the ribs above the base as drawn, mm: sharp, and however small."""
        above = box(0.0, BASE_HEIGHT_MM, self.length_mm, self.height_mm)
        return [part for void in _voids(self) for part in _polygons(void.intersection(above))]

    def measure_section_mm2(self) -> float:
        """Measure the area between outline and voids, however small these are."""
        return float(_outline(self).area) - sum(float(void.area) for void in self.list_voids())


def take_fin_ray(design: Design, what: str) -> FinRay:
    """Take the design, which must be a fin ray for `what`.

    Raises:
        UsageError: it is of another family.
    """
    if not isinstance(design, FinRay):
        raise UsageError(f"{what} is for fin rays; a finger of the family `{design.family}` has no such part.")
    return design


def planar_profile(design: FinRay, fillet_mm: float = 0.5, arc_segments: int = ARC_SEGMENTS) -> Polygon:
    """Draw the compliant body of a finger in the (x, z) plane, mm, with its voids as holes.

    The lowest void is open towards the base.
    x = 0 is the front wall's outer plane, x > 0 points away from the object; z runs from the top of the
    rigid base (`BASE_HEIGHT_MM`) to the apex (`height_mm`). Ribs are strips centred between the walls,
    equally spaced over the cavity and turned by `rib_angle_deg` about their middle. Inner corners carry
    fillets of radius `fillet_mm`, as printed ones do; 0 leaves them sharp. A fillet is drawn with `arc_segments`
    per quarter circle; with one it is a chamfer of the same area.
    """
    printable = [void for part in _voids(design) for void in _printable(part, fillet_mm, arc_segments)]
    # The lowest void is open towards the base, so it is a notch of the outline and no hole.
    parts = _polygons(_outline(design).difference(shapely.union_all(printable)))
    body = max(parts, key=lambda part: part.area)
    return shapely.geometry.polygon.orient(Polygon(_above_base(body), body.interiors))


def _voids(design: FinRay) -> list[Polygon]:
    return _polygons(_cavity(design).difference(shapely.union_all(_ribs(design))))


def _above_base(body: Polygon) -> np.ndarray:
    """Return the outline without points just above the base, where a rib that ends in its corner leaves them."""
    points = np.array(body.exterior.coords)
    height = points[:, 1] - BASE_HEIGHT_MM
    return points[(height < math.ulp(BASE_HEIGHT_MM)) | (height >= MIN_EDGE_MM)]


def _outline(design: FinRay) -> BaseGeometry:
    top, apex_x = design.height_mm, design.front_thickness_mm + APEX_EXTRA_MM
    whole = Polygon([(0.0, 0.0), (design.length_mm, 0.0), (apex_x, top), (0.0, top)])
    return whole.intersection(box(0.0, BASE_HEIGHT_MM, design.length_mm, top))


def _back_side(design: FinRay) -> tuple[np.ndarray, np.ndarray]:
    """Return two points of the inner side of the slanted back wall."""
    foot = np.array([design.length_mm, 0.0])
    apex = np.array([design.front_thickness_mm + APEX_EXTRA_MM, design.height_mm])
    along = (apex - foot) / np.linalg.norm(apex - foot)
    inward = np.array([-along[1], along[0]])
    offset = design.back_thickness_mm * inward
    return foot + offset, apex + offset


def _cavity(design: FinRay) -> BaseGeometry:
    """Draw the space between the walls below the solid tip; it goes on below the base, which has no fillets."""
    foot, apex = _back_side(design)
    top = design.height_mm - design.tip_length_mm
    direction = apex - foot
    start, end, far_x = foot - direction, apex + direction, -4 * design.length_mm
    inner = Polygon([(far_x, start[1]), start, end, (far_x, end[1])])
    window = box(design.front_thickness_mm, -BASE_HEIGHT_MM, 2 * design.length_mm, top)
    return inner.intersection(window)


def cavity_share(points: np.ndarray, design: FinRay) -> np.ndarray:
    """Return how far points (n, 2) in mm are across the cavity: 0 from the front wall on, 1 from the back wall on."""
    back_x = _back_x(design, points[:, 1])
    return np.clip((points[:, 0] - design.front_thickness_mm) / (back_x - design.front_thickness_mm), 0.0, 1.0)


def is_in_rib(points: np.ndarray, design: FinRay) -> np.ndarray:
    """Return a mask (n) of points (n, 2) in mm between the walls, below the tip: material there belongs to a rib."""
    share = cavity_share(points, design)
    return np.asarray((share > 0.0) & (share < 1.0) & (points[:, 1] < design.height_mm - design.tip_length_mm))


def rib_centres(design: FinRay) -> np.ndarray:
    """Return points (n, 2) in mm half way between the walls, about which the ribs are turned."""
    bottom, top = BASE_HEIGHT_MM, design.height_mm - design.tip_length_mm
    z = bottom + (top - bottom) * np.arange(1, design.rib_count + 1) / (design.rib_count + 1)
    return np.column_stack([(design.front_thickness_mm + _back_x(design, z)) / 2, z])


def _back_x(design: FinRay, z: np.ndarray) -> np.ndarray:
    """Return the inner side of the back wall at heights z (n)."""
    foot, apex = _back_side(design)
    return np.asarray(foot[0] + (apex[0] - foot[0]) * (z - foot[1]) / (apex[1] - foot[1]))


def _ribs(design: FinRay) -> list[BaseGeometry]:
    reach = 4 * design.length_mm  # longer than any cavity is wide at any angle
    ribs = []
    for x, z in rib_centres(design).tolist():
        middle = LineString([(x - reach, z), (x + reach, z)])
        strip = middle.buffer(design.rib_thickness_mm / 2, cap_style="flat")
        ribs.append(affinity.rotate(strip, design.rib_angle_deg, origin=(x, z)))
    return ribs


def _printable(cavity: Polygon, fillet_mm: float, arc_segments: int) -> list[Polygon]:
    """Return a cavity without its slivers, its corners rounded; nothing when it is too small to print."""
    radius = max(MIN_CAVITY_WIDTH_MM / 2, fillet_mm)
    core = cavity.buffer(-radius, join_style="mitre")
    parts = []
    for part in _polygons(core):
        if fillet_mm > 0:
            grown = _rounded(part.buffer(radius - fillet_mm, join_style="mitre"), fillet_mm, arc_segments)
        else:
            grown = part.buffer(radius, join_style="mitre", mitre_limit=10)
        parts += [p for p in _polygons(grown.intersection(cavity)) if p.area >= MIN_CAVITY_AREA_MM2]
    return [_clean(part) for part in parts]


def _rounded(core: Polygon, fillet_mm: float, arc_segments: int) -> BaseGeometry:
    """Grow a convex core by the fillet radius all around."""
    if arc_segments > 1:
        return core.buffer(fillet_mm, quad_segs=arc_segments)
    corners = np.array(shapely.geometry.polygon.orient(core).exterior.coords[:-1])
    along = np.roll(corners, -1, axis=0) - corners
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    points = []
    for corner, before, after in zip(corners, np.roll(along, 1, axis=0), along, strict=True):
        sine, cosine = before[0] * after[1] - before[1] * after[0], float(before @ after)
        outward = np.array([before[1] + after[1], -before[0] - after[0]])
        tip = corner + fillet_mm * outward / (1.0 + cosine)
        # Between the tip of the corner and an arc that turns by phi lie r^2 (tan(phi/2) - phi/2).
        turn = math.atan2(sine, cosine)
        leg = fillet_mm * math.sqrt(max(2.0 * (math.tan(turn / 2) - turn / 2) / max(sine, 1e-12), 0.0))
        points += [tip - leg * before, tip + leg * after] if leg > MIN_EDGE_MM else [tip]
    return Polygon(points)


def _clean(polygon: Polygon) -> Polygon:
    """Drop points that make very short edges, and any holes (there are none in a cavity)."""
    return Polygon(shapely.remove_repeated_points(shapely.simplify(polygon, 1e-3), MIN_EDGE_MM).exterior)


def _polygons(geometry: BaseGeometry) -> list[Polygon]:
    parts = shapely.get_parts(geometry)
    return [part for part in parts if isinstance(part, Polygon) and part.area > math.ulp(1.0)]


class GradedFinRay(FinRay):
    """The paper's fin ray with a modulus of its own for the ribs, and for a pad on the front of the tip.

    The moduli are factors on that of the walls, which calibration infers. PolyJet blends of one soft and one hard
    resin span a wider range than the factors here (Shore A 30 to 95, about 1 to 20 MPa).
    """

    family: ClassVar[str] = "graded-fin-ray"

    rib_modulus_factor: float = Field(default=1.0, ge=0.3, le=3.0, description="modulus of the ribs over the walls'")
    tip_modulus_factor: float = Field(default=1.0, ge=0.3, le=3.0, description="modulus of the tip over the walls'")

    def scale_modulus(self, points: np.ndarray) -> np.ndarray:
        """Return the factor (n) on Young's modulus at section points (n, 2), mm: of ribs, of the solid tip, else 1."""
        is_tip = points[:, 1] > self.height_mm - self.tip_length_mm
        factor = np.where(is_in_rib(points, self), self.rib_modulus_factor, 1.0)
        return np.where(is_tip, self.tip_modulus_factor, factor)
