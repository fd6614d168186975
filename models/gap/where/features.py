"""What tools and objects are split by."""

import numpy as np

from models.design.space import PARAMETERS
from models.gap.where.object_shape import FAMILIES, object_shape
from models.gap.where.residuals import Residuals

TOOL_FEATURES = PARAMETERS
FAMILY = "object shape"
OBJECT_FEATURES = ("object width", "object height", *FAMILIES)


def tool_table(residuals: Residuals) -> np.ndarray:
    """Design parameters of the tools, t x 9."""
    return np.array([[getattr(d, name) for name in PARAMETERS] for d in residuals.designs], dtype=float)


def object_table(residuals: Residuals) -> np.ndarray:
    """Width, height and, as 0 or 1, the family of the objects, o x 7."""
    shapes = [object_shape(number) for number in residuals.objects]
    return np.array([[s.width_mm, s.height_mm, *(s.family == f for f in FAMILIES)] for s in shapes], dtype=float)


def family_numbers(residuals: Residuals) -> np.ndarray:
    """Which family each object is of, o."""
    return np.array([FAMILIES.index(object_shape(number).family) for number in residuals.objects])
