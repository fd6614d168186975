"""The test object as one finger sees it."""

import numpy as np

from models.objects.catalogue import RigidObject
from models.objects.distance import distance, distance_and_normal
from models.objects.primitives import mirrored, moved
from models.records import Placement


class ObjectObstacle:
    """A rigid object in the frame of one finger (which stands on the +x side); a `models.simulation.contact.law.Solid`.

    For the finger on the other side the object is mirrored in x: its distance at (x, y, z) is the object's at
    (-x, y, z).
    """

    def __init__(self, obj: RigidObject, placement: Placement, *, is_mirrored: bool) -> None:
        rows = moved(obj.primitives, np.array([placement.offset_x_mm, 0.0, placement.offset_z_mm]))
        self.primitives = mirrored(rows) if is_mirrored else rows

    def distance(self, points: np.ndarray) -> np.ndarray:
        """See `models.simulation.contact.law.Obstacle`."""
        return distance(self.primitives, points)

    def normal(self, points: np.ndarray) -> np.ndarray:
        """See `models.simulation.contact.law.Obstacle`."""
        return distance_and_normal(self.primitives, points)[1]
