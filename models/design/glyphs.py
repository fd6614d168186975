"""Id marks: a stroke font for the labels of tools, as printable outlines."""

import shapely
from shapely import affinity
from shapely.geometry import LineString
from shapely.geometry.base import BaseGeometry

from fast.models.errors import UsageError

# Strokes on a grid 4 wide and 6 high; a stroke is a chain of points.
_GLYPHS: dict[str, tuple[tuple[tuple[float, float], ...], ...]] = {
    "0": (((1, 0), (3, 0), (4, 1), (4, 5), (3, 6), (1, 6), (0, 5), (0, 1), (1, 0)), ((1, 1.6), (3, 4.4))),
    "1": (((0.8, 4.8), (2, 6), (2, 0)), ((0.8, 0), (3.2, 0))),
    "2": (((0, 5), (1, 6), (3, 6), (4, 5), (4, 3.9), (0, 0), (4, 0)),),
    "3": (((0, 6), (4, 6), (2, 3.6), (3, 3.6), (4, 2.6), (4, 1), (3, 0), (1, 0), (0, 1)),),
    "4": (((3, 0), (3, 6), (0, 1.8), (4, 1.8)),),
    "5": (((4, 6), (0.4, 6), (0, 3.4), (3, 3.6), (4, 2.6), (4, 1), (3, 0), (1, 0), (0, 0.8)),),
    "6": (((3.4, 6), (1.4, 5.2), (0, 3), (0, 1), (1, 0), (3, 0), (4, 1), (4, 2.4), (3, 3.4), (1, 3.4), (0, 2.4)),),
    "7": (((0, 6), (4, 6), (1.4, 0)),),
    "8": (((1, 3.2), (0, 4.2), (0, 5), (1, 6), (3, 6), (4, 5), (4, 4.2), (3, 3.2), (1, 3.2), (0, 2.2), (0, 1), (1, 0),
           (3, 0), (4, 1), (4, 2.2), (3, 3.2)),),
    "9": (((0.6, 0), (2.6, 0.8), (4, 3), (4, 5), (3, 6), (1, 6), (0, 5), (0, 3.6), (1, 2.6), (3, 2.6), (4, 3.6)),),
    "B": (((0, 0), (0, 6), (2.8, 6), (3.7, 5.2), (3.7, 4), (2.8, 3.2), (0, 3.2)),
          ((2.8, 3.2), (4, 2.2), (4, 1), (3, 0), (0, 0))),
    "T": (((0, 6), (4, 6)), ((2, 6), (2, 0))),
    "-": (((0.8, 3), (3.2, 3)),),
}  # fmt: skip
_ADVANCE = 5.6
_GLYPH_HEIGHT = 6.0
_STROKE_WIDTH = 0.9  # of the grid; 0.75 mm on a glyph 5 mm high


def is_mark(text: str) -> bool:
    """Return whether every character has a glyph."""
    return all(character in _GLYPHS for character in text)


def text_outline(text: str, height_mm: float) -> BaseGeometry:
    """Draw the outline of `text` as polygons, centred on the origin, glyphs `height_mm` high.

    Raises:
        UsageError: a character has no glyph (digits, B, T and hyphen have one).
    """
    strokes = []
    for place, character in enumerate(text):
        if character not in _GLYPHS:
            raise UsageError(f"id mark `{text}`: no glyph for `{character}`; marks are made of {''.join(_GLYPHS)}.")
        strokes += [
            LineString([(x + place * _ADVANCE, y) for x, y in chain]).buffer(_STROKE_WIDTH / 2, quad_segs=2)
            for chain in _GLYPHS[character]
        ]
    outline = shapely.union_all(strokes).simplify(0.02)  # without the specks where strokes meet
    scale = height_mm / _GLYPH_HEIGHT
    centred = affinity.translate(outline, -((len(text) - 1) * _ADVANCE + 4) / 2, -_GLYPH_HEIGHT / 2)
    return affinity.scale(centred, scale, scale, origin=(0, 0))
