"""The outline of a finger as an SVG path."""

import numpy as np

from fast.models.records import Design


def profile_path(design: Design) -> str:
    """Return the SVG path of the finger's profile, base included, z upwards, in mm."""
    profile = design.draw_section()
    rings = [np.array(ring.coords) for ring in (profile.exterior, *profile.interiors)]
    return "".join(_ring(ring, design.height_mm) for ring in rings)


def _ring(points: np.ndarray, height_mm: float) -> str:
    return "M" + "L".join(f"{x:.2f} {height_mm - z:.2f}" for x, z in points) + "Z"
