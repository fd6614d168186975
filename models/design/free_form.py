"""A planar free-form finger: a density over the inside of a wedge says where there is material.

The density is a smooth surface through values on a coarse grid; where it is below one half there is a void. A length
scale bounds what is thin: voids and what is left between them are opened and closed by circles of one millimetre
(morphological filters, as in topology optimisation: Sigmund 2007, Struct. Multidisc. Optim. 33:401).
"""

import math
from typing import ClassVar

import numpy as np
import shapely
from pydantic import Field
from shapely.geometry import Polygon
from shapely.geometry.base import BaseGeometry

from fast.models.design.fin_ray import APEX_EXTRA_MM, BASE_HEIGHT_MM, MIN_EDGE_MM
from fast.models.records import Design

LENGTH_SCALE_MM = 2.0  # no void and no bridge between voids is thinner
TIP_MM = 22.0  # solid, from the apex down: the middle of the paper's range
MIN_VOID_MM2 = 6.0
_GRID = (41, 121)  # points across and along, on which the density is evaluated: 0.5 to 1 mm apart
_CHORD_MM = 0.25  # how far the outline of a void may be from its polygon
_ROWS, _COLUMNS = 3, 4  # of the density's values: across the finger, and from the base to the tip
_BELOW = 0.03  # how far a void goes on below the base, as a share of the cavity's height: it is open there


def _density(place: str) -> float:
    """Make a field for one value of the density; `place` says where it lies."""
    value: float = Field(ge=0, le=1, description=f"density {place}; below 0.5 is a void")
    return value


class FreeForm(Design):
    """A wedge with a straight front wall, a straight back wall and whatever the density leaves between them.

    `front`, `middle` and `back` are the density next to the front wall, half way, and next to the back wall, numbered
    from the base (1) to the tip (4).
    """

    family: ClassVar[str] = "free-form"

    length_mm: float = Field(ge=19, le=35, description="depth at the base, closing direction x")
    width_mm: float = Field(ge=28, le=35, description="along y")
    height_mm: float = Field(ge=90, le=120, description="along z, base to apex")
    front_thickness_mm: float = Field(ge=2, le=3, description="wall that touches the object")
    back_thickness_mm: float = Field(ge=2, le=3, description="slanted wall")
    front_1: float = _density("at the front wall, near the base")
    front_2: float = _density("at the front wall, lower middle")
    front_3: float = _density("at the front wall, upper middle")
    front_4: float = _density("at the front wall, near the tip")
    middle_1: float = _density("half way, near the base")
    middle_2: float = _density("half way, lower middle")
    middle_3: float = _density("half way, upper middle")
    middle_4: float = _density("half way, near the tip")
    back_1: float = _density("at the back wall, near the base")
    back_2: float = _density("at the back wall, lower middle")
    back_3: float = _density("at the back wall, upper middle")
    back_4: float = _density("at the back wall, near the tip")

    @property
    def tip_height_mm(self) -> float:
        """Length of the solid tip."""
        return TIP_MM

    def draw_section(self, fillet_mm: float = 0.5, arc_segments: int = 4) -> Polygon:
        """Draw the wedge without its voids, mm (see `Design`); voids are round already, so fillets change nothing."""
        body = self._outline().difference(shapely.union_all(self._find_voids()))
        parts = [part for part in shapely.get_parts(body) if isinstance(part, Polygon)]
        return shapely.geometry.polygon.orient(max(parts, key=lambda part: part.area))

    def list_voids(self) -> list[Polygon]:
        """List the voids above the base, mm."""
        inside = [part for void in self._find_voids() for part in shapely.get_parts(void.intersection(self._outline()))]
        return [part for part in inside if isinstance(part, Polygon) and part.area > math.ulp(1.0)]

    def _outline(self) -> Polygon:
        apex_x, top = self.front_thickness_mm + APEX_EXTRA_MM, self.height_mm
        foot_x = self._back_x(np.array([BASE_HEIGHT_MM]))[0]
        return Polygon([(0.0, BASE_HEIGHT_MM), (foot_x, BASE_HEIGHT_MM), (apex_x, top), (0.0, top)])

    def _back_x(self, z_mm: np.ndarray) -> np.ndarray:
        """Return the outer side of the back wall at heights z (n)."""
        apex_x = self.front_thickness_mm + APEX_EXTRA_MM
        return self.length_mm + (apex_x - self.length_mm) * z_mm / self.height_mm

    def _find_voids(self) -> list[Polygon]:
        """Find the voids after the filters of the length scale; the lowest may reach below the base."""
        from skimage.measure import find_contours

        padded = np.pad(self._evaluate_density(), 1, constant_values=1.0)
        drawn = [Polygon(self._place(contour)) for contour in find_contours(padded, 0.5) if len(contour) > 3]
        # Contours around material inside a void bound an island, which nothing holds: it goes.
        void: BaseGeometry = shapely.union_all(
            [Polygon(part.exterior) for p in drawn for part in _polygons(p.buffer(0))]
        )
        radius = LENGTH_SCALE_MM / 2
        void = void.buffer(-radius).buffer(2 * radius).buffer(-radius)
        return [_simplify(part) for part in _polygons(void) if part.area >= MIN_VOID_MM2]

    def _evaluate_density(self) -> np.ndarray:
        """Evaluate the smooth density on the grid, across x along."""
        from scipy.interpolate import RectBivariateSpline

        values = [[getattr(self, f"{row}_{column}") for column in range(1, _COLUMNS + 1)] for row in _names()]
        across, along = (np.linspace(0.0, 1.0, n) for n in (_ROWS, _COLUMNS))
        spline = RectBivariateSpline(across, along, np.array(values), kx=_ROWS - 1, ky=_COLUMNS - 1)
        return np.asarray(spline(*(np.linspace(0.0, 1.0, n) for n in _GRID)))

    def _place(self, contour: np.ndarray) -> np.ndarray:
        """Place points (n, 2) of the padded grid as (x, z) in mm between the walls and below the tip."""
        share = np.clip((contour - 1.0) / (np.array(_GRID) - 1.0), 0.0, 1.0)
        top = self.height_mm - TIP_MM
        bottom = BASE_HEIGHT_MM - _BELOW * (top - BASE_HEIGHT_MM)
        z = bottom + share[:, 1] * (top - bottom)
        lean = (self.length_mm - self.front_thickness_mm - APEX_EXTRA_MM) / self.height_mm
        inner_back = self._back_x(z) - self.back_thickness_mm * math.hypot(1.0, lean)
        depth = np.maximum(inner_back - self.front_thickness_mm, 0.0)
        return np.column_stack([self.front_thickness_mm + share[:, 0] * depth, z])


def _names() -> tuple[str, ...]:
    return "front", "middle", "back"


def _polygons(geometry: BaseGeometry) -> list[Polygon]:
    return [part for part in shapely.get_parts(geometry) if isinstance(part, Polygon) and not part.is_empty]


def _simplify(void: Polygon) -> Polygon:
    """Simplify a void to a polygon of few corners, without holes."""
    return Polygon(shapely.remove_repeated_points(shapely.simplify(void, _CHORD_MM), MIN_EDGE_MM).exterior)
