"""Strata: what tools and objects are split by, and the words for it.

An object is what fingers feel of it: how wide it is at each height, and the word for that.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from fast.models.objects.catalogue import get_object
from fast.models.objects.distance import distance
from fast.models.records import Design
from fast.models.units import spell_name, unit_of

N_HEIGHTS = 12
FAMILY = "object shape"
FAMILIES = ("straight sides", "a bulge", "a waist", "a narrow top", "a wide top")
OBJECT_FEATURES = ("object width", "object height", *FAMILIES)
_X_MM = np.linspace(0.0, 26.0, 105)
_Y_MM = np.linspace(-12.0, 12.0, 9)  # narrower than the narrowest finger
_ALIKE = 0.12  # of the width: less than that is still straight
# What a tool with much or little of a parameter is called; {} is the limit.
_TOOLS = {
    "length_mm": ("fingers deeper than {:.0f} mm", "fingers up to {:.0f} mm deep"),
    "width_mm": ("fingers wider than {:.1f} mm", "fingers up to {:.1f} mm wide"),
    "height_mm": ("fingers longer than {:.0f} mm", "fingers up to {:.0f} mm long"),
    "tip_length_mm": ("tips over {:.1f} mm", "tips under {:.1f} mm"),
    "front_thickness_mm": ("front walls over {:.2f} mm", "front walls under {:.2f} mm"),
    "back_thickness_mm": ("back walls over {:.2f} mm", "back walls under {:.2f} mm"),
    "rib_thickness_mm": ("ribs over {:.2f} mm", "ribs under {:.2f} mm"),
    "rib_count": ("more than {:.0f} ribs", "{:.0f} ribs or fewer"),
    "rib_angle_deg": ("rib angles above {:.0f} deg", "rib angles below {:.0f} deg"),
}
_OBJECTS = {
    "object width": ("objects wider than {:.0f} mm", "objects up to {:.0f} mm wide"),
    "object height": ("objects taller than {:.0f} mm", "objects up to {:.0f} mm tall"),
}


@dataclass(frozen=True, eq=False)
class ObjectShape:
    """An object as two fingers that close along x meet it.

    half_width_mm: N_HEIGHTS, from its foot to its top. `family`: one of `FAMILIES`.
    """

    object_id: int
    name: str
    object_class: str
    height_mm: float
    half_width_mm: np.ndarray

    @property
    def width_mm(self) -> float:
        """Largest width along the closing direction."""
        return float(2.0 * self.half_width_mm.max())

    @property
    def family(self) -> str:
        """How the width goes with height: thirds of it are compared."""
        low, middle, high = (float(part.max()) for part in np.array_split(self.half_width_mm, 3))
        waist = float(np.array_split(self.half_width_mm, 3)[1].min())
        slack = _ALIKE * max(low, middle, high)
        bottom, top = self.half_width_mm[0], self.half_width_mm[-1]
        if waist < min(low, high) - slack:
            return "a waist"
        if top < bottom - slack and low >= middle - slack / 4:
            return "a narrow top"
        if bottom < top - slack and high >= middle - slack / 4:
            return "a wide top"
        return "a bulge" if min(bottom, top) < middle - slack else "straight sides"

    @property
    def numbers(self) -> np.ndarray:
        """The shape as eight numbers for regressions: width, height, and six half widths from foot to top, mm."""
        return np.array([self.width_mm, self.height_mm, *self.half_width_mm[:: N_HEIGHTS // 6]])


@lru_cache(maxsize=64)
def object_shape(object_id: int) -> ObjectShape:
    """Return the shape of an object of the catalogue.

    Raises:
        UsageError: there is no such object.
    """
    obj = get_object(object_id)
    heights_mm = (np.arange(N_HEIGHTS) + 0.5) / N_HEIGHTS * obj.height_mm
    x, y, z = np.meshgrid(_X_MM, _Y_MM, heights_mm, indexing="ij")
    points = np.column_stack([x.ravel(), y.ravel(), z.ravel()])
    is_inside = distance(obj.primitives, points).reshape(x.shape) <= 0.0
    furthest = np.where(is_inside, x, 0.0).max(axis=(0, 1))
    return ObjectShape(object_id, obj.name, obj.object_class, obj.height_mm, furthest)


def list_tool_features(designs: Sequence[Design]) -> tuple[str, ...]:
    """List names of the parameters that all designs have and that are numbers: the nine of fin rays."""
    shared = [name for name in type(designs[0]).model_fields if all(name in type(d).model_fields for d in designs)]
    return tuple(name for name in shared if not isinstance(getattr(designs[0], name), str))


def make_tool_table(designs: Sequence[Design], features: Sequence[str]) -> np.ndarray:
    """Make a table of the design parameters of the tools, t x features."""
    return np.array([[getattr(d, name) for name in features] for d in designs], dtype=float)


def make_object_table(objects: Sequence[int]) -> np.ndarray:
    """Make a table of width, height and, as 0 or 1, the family of the objects, o x 7."""
    shapes = [object_shape(number) for number in objects]
    return np.array([[s.width_mm, s.height_mm, *(s.family == f for f in FAMILIES)] for s in shapes], dtype=float)


def number_families(objects: Sequence[int]) -> np.ndarray:
    """Number the family that each object is of, o."""
    return np.array([FAMILIES.index(object_shape(number).family) for number in objects])


def describe_condition(feature: str, limit: float, is_above: bool) -> tuple[str, str]:
    """Describe what a split selects in words: for objects and for tools, one of them empty."""
    side = 0 if is_above else 1
    if feature in _TOOLS:
        if feature == "rib_count":
            limit = float(np.floor(limit))
        return "", _TOOLS[feature][side].format(limit)
    if feature in _OBJECTS:
        return _OBJECTS[feature][side].format(limit), ""
    if feature not in FAMILIES:
        return (
            "",
            f"{spell_name(feature)} {'over' if is_above else 'under'} {limit:.3g} {unit_of(feature) or ''}".rstrip(),
        )
    return (f"objects with {feature}" if is_above else f"objects without {feature}"), ""


def describe_stratum(conditions: tuple[tuple[str, str], ...]) -> str:
    """Describe conditions on objects and tools as one phrase, `everywhere` if there is none."""
    objects = [o for o, _ in conditions if o]
    tools = [t for _, t in conditions if t]
    parts = []
    if objects:
        parts.append("for " + " and ".join([objects[0], *(o.removeprefix("objects ") for o in objects[1:])]))
    if tools:
        parts.append("on tools with " + " and ".join(tools))
    return " ".join(parts) or "everywhere"
