"""How hard an object is pressed in a grasp: what decides whether a delicate one is bruised."""

import numpy as np

from fast.models.simulation.contact.law import ContactState

PATCH_MM2 = 10.0  # the pressure at a point has no limit at an edge, that of an area has


def patch_pressure(pressure: np.ndarray, areas_mm2: np.ndarray, patch_mm2: float = PATCH_MM2) -> float:
    """Return the mean pressure over the `patch_mm2` of a contact that are pressed most, connected or not.

    pressure, areas_mm2: of the points that touch (n). Where fewer touch, the rest of the patch has no pressure.
    """
    order = np.argsort(-pressure, kind="stable")
    area = areas_mm2[order]
    inside = np.clip(patch_mm2 - (np.cumsum(area) - area), 0.0, area)
    return float(pressure[order] @ inside) / patch_mm2


class PressureGauge:
    """Follows the pressure of one finger on the object; `largest` is the largest so far, in the units it is given."""

    def __init__(self, areas_mm2: np.ndarray, is_half: bool) -> None:
        """Take `areas_mm2`: of every contact point (n); those of half a finger have mirror images."""
        self.largest = 0.0
        self._areas_mm2, self._patch_mm2 = areas_mm2, PATCH_MM2 / 2.0 if is_half else PATCH_MM2

    def add(self, contact: ContactState) -> None:
        """Take note of the pressures of a step."""
        areas_mm2 = self._areas_mm2[contact.points]
        self.largest = max(self.largest, patch_pressure(contact.pressure, areas_mm2, self._patch_mm2))
