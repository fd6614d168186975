"""The four kinds of sides that the paper tells apart by their traces (Figs. 5c to 5f), and which object has which."""

from typing import Literal, get_args

import numpy as np

from fast.models.objects.catalogue import OBJECTS

Sides = Literal["flat sides", "curved sides", "tapers inwards", "pronounced geometry"]
SIDES: tuple[Sides, ...] = get_args(Sides)

MEANINGS: dict[Sides, str] = {
    "flat sides": "holds firmly until contact is lost",
    "curved sides": "holds stably, with a steady decline",
    "tapers inwards": "unstable, a narrow peak of force",
    "pronounced geometry": "the force follows the contour",
}

# By the outline that the fingers meet, as the object stands: parallel to the lift; narrowing all the way up; with a
# waist, an overhang or separate parts; all others bulge.
_TAPERS_INWARDS = {19, 20, 24, 25}
_PRONOUNCED = {13, 22, 23, 26, 28, 29}
_FLAT = {4, 5, 7, 8, 14, 21, 30, 31, 32, 33, 34}


def sides_of(object_id: int) -> Sides:
    """The sides that an object of the catalogue shows to the fingers."""
    if object_id in _TAPERS_INWARDS:
        return "tapers inwards"
    if object_id in _PRONOUNCED:
        return "pronounced geometry"
    return "flat sides" if object_id in _FLAT else "curved sides"


SIDES_OF_OBJECTS = np.array([SIDES.index(sides_of(obj.object_id)) for obj in OBJECTS])
