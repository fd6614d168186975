"""The test object as one finger sees it."""

import numpy as np

from models.objects.catalogue import RigidObject
from models.objects.distance import distance, distance_and_normal
from models.records import Placement


class ObjectObstacle:
    """A rigid object in the frame of one finger (which stands on the +x side).

    For the finger on the other side the object is mirrored in x: its distance at (x, y, z) is the object's at
    (-x, y, z).
    """

    def __init__(self, obj: RigidObject, placement: Placement, *, is_mirrored: bool) -> None:
        self._primitives = obj.primitives
        self._sign = np.array([-1.0 if is_mirrored else 1.0, 1.0, 1.0])
        self._offset = np.array([placement.offset_x_mm, 0.0, placement.offset_z_mm])

    def distance(self, points: np.ndarray) -> np.ndarray:
        """See `models.fem.contact.Obstacle`."""
        return distance(self._primitives, points * self._sign - self._offset)

    def normal(self, points: np.ndarray) -> np.ndarray:
        """See `models.fem.contact.Obstacle`."""
        return distance_and_normal(self._primitives, points * self._sign - self._offset)[1] * self._sign
