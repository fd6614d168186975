"""Shapes of the object classes: from named sizes to rows of primitives, about the shape's own axis z."""

from collections.abc import Callable, Mapping

import numpy as np

from fast.models.objects import primitives

Sizes = Mapping[str, float]

_SEGMENTS_PER_TURN = 16


def _sphere(sizes: Sizes) -> np.ndarray:
    return np.stack([primitives.sphere(sizes["diameter_mm"] / 2)])


def _ellipsoid(sizes: Sizes) -> np.ndarray:
    return np.stack([primitives.ellipsoid(sizes["size_x_mm"], sizes["size_y_mm"], sizes["size_z_mm"])])


def _cylinder(sizes: Sizes) -> np.ndarray:
    radius, half = sizes["diameter_mm"] / 2, sizes["length_mm"] / 2
    profile = [(0, -half), (radius, -half), (radius, half), (0, half)]
    return np.stack([primitives.lathe(profile, sizes["rounding_mm"])])


def _tube(sizes: Sizes) -> np.ndarray:
    radius, bore, half = sizes["diameter_mm"] / 2, sizes["bore_mm"] / 2, sizes["length_mm"] / 2
    profile = [(bore, -half), (radius, -half), (radius, half), (bore, half)]
    return np.stack([primitives.lathe(profile, sizes["rounding_mm"])])


def _torus(sizes: Sizes) -> np.ndarray:
    return np.stack([primitives.torus(sizes["ring_diameter_mm"] / 2, sizes["tube_diameter_mm"] / 2)])


def _spiral(sizes: Sizes) -> np.ndarray:
    """Make a helix of round wire, as rods from point to point."""
    n = int(np.ceil(sizes["turns"] * _SEGMENTS_PER_TURN))
    turn = np.linspace(0, sizes["turns"], n + 1)
    radius, angle = sizes["coil_diameter_mm"] / 2, 2 * np.pi * turn
    path = np.stack([radius * np.cos(angle), radius * np.sin(angle), sizes["pitch_mm"] * turn], axis=1)
    rods = zip(path[:-1], path[1:], strict=True)
    return np.stack([primitives.capsule(start, end, sizes["wire_diameter_mm"] / 2) for start, end in rods])


def _cone_profile(sizes: Sizes) -> list[tuple[float, float]]:
    base, top, half = sizes["base_mm"] / 2, sizes["top_mm"] / 2, sizes["height_mm"] / 2
    tip = [(top, half), (0.0, half)] if top > 0 else [(0.0, half)]
    return [(0.0, -half), (base, -half), *tip]


def _cone(sizes: Sizes) -> np.ndarray:
    return np.stack([primitives.lathe(_cone_profile(sizes), sizes["rounding_mm"])])


def _pyramid(sizes: Sizes) -> np.ndarray:
    return np.stack([primitives.square_lathe(_cone_profile(sizes), sizes["rounding_mm"])])


def _diamond(sizes: Sizes) -> np.ndarray:
    """Make two square pyramids, base to base."""
    profile = [(0, -sizes["height_mm"] / 2), (sizes["width_mm"] / 2, 0), (0, sizes["height_mm"] / 2)]
    return np.stack([primitives.square_lathe(profile, sizes["rounding_mm"])])


def _diabolo(sizes: Sizes) -> np.ndarray:
    """Make two cones, tip to tip."""
    end, waist, half = sizes["end_mm"] / 2, sizes["waist_mm"] / 2, sizes["height_mm"] / 2
    profile = [(0, -half), (end, -half), (waist, 0), (end, half), (0, half)]
    return np.stack([primitives.lathe(profile, sizes["rounding_mm"])])


def _hourglass(sizes: Sizes) -> np.ndarray:
    """Make two rims joined by cones to a straight neck."""
    end, waist, half = sizes["end_mm"] / 2, sizes["waist_mm"] / 2, sizes["height_mm"] / 2
    neck, rim = sizes["neck_mm"] / 2, half - sizes["rim_mm"]
    right = [(end, -half), (end, -rim), (waist, -neck), (waist, neck), (end, rim), (end, half)]
    return np.stack([primitives.lathe([(0, -half), *right, (0, half)], sizes["rounding_mm"])])


def _cube(sizes: Sizes) -> np.ndarray:
    return np.stack([primitives.box(sizes["size_x_mm"], sizes["size_y_mm"], sizes["size_z_mm"], sizes["rounding_mm"])])


def _prism(sizes: Sizes) -> np.ndarray:
    """Make a regular prism with one flat side towards +x, `apothem_mm` from the axis."""
    n = int(sizes["sides"])
    angles = (np.arange(n) - 0.5) * 2 * np.pi / n
    radius = sizes["apothem_mm"] / np.cos(np.pi / n)
    outline = [(float(radius * np.cos(a)), float(radius * np.sin(a))) for a in angles]
    return np.stack([primitives.prism(outline, sizes["height_mm"], sizes["rounding_mm"])])


def _jack(sizes: Sizes) -> np.ndarray:
    """Make three crossed rods with balls on their ends."""
    ball = sizes["ball_diameter_mm"] / 2
    reach = sizes["length_mm"] / 2 - ball
    ends = [sign * reach * axis for axis in np.eye(3) for sign in (-1.0, 1.0)]
    rods = [primitives.capsule(ends[2 * i], ends[2 * i + 1], sizes["rod_diameter_mm"] / 2) for i in range(3)]
    balls = [primitives.moved(primitives.sphere(ball)[None], end)[0] for end in ends]
    return np.stack(rods + balls)


SHAPES: dict[str, Callable[[Sizes], np.ndarray]] = {
    "sphere": _sphere,
    "ellipsoid": _ellipsoid,
    "cylinder": _cylinder,
    "disc": _cylinder,
    "torus": _torus,
    "spiral": _spiral,
    "tube": _tube,
    "diamond": _diamond,
    "pyramid": _pyramid,
    "triangle": _prism,
    "jack": _jack,
    "cone": _cone,
    "diabolo": _diabolo,
    "hourglass": _hourglass,
    "cube": _cube,
    "prism": _prism,
}
