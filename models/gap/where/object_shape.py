"""What fingers feel of an object: how wide it is at each height, and the word for that."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from models.objects.catalogue import get_object
from models.objects.distance import distance

N_HEIGHTS = 12
FAMILIES = ("straight sides", "a bulge", "a waist", "a narrow top", "a wide top")
_X_MM = np.linspace(0.0, 26.0, 105)
_Y_MM = np.linspace(-12.0, 12.0, 9)  # narrower than the narrowest finger
_ALIKE = 0.12  # of the width: less than that is still straight


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
    """The shape of an object of the catalogue.

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
