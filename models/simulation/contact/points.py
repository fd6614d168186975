"""Contact points of a body: midpoints of a fine subdivision of its quadratic faces, in small patches."""

from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from fast.models.simulation.body.shape_functions import face_shape

KEPT_SUBDIVISIONS = 64  # of about twenty of a finger
PATCH_PIECES = 4  # points along one side of a patch: few enough to be near together, many enough to skip at once
_GOLDEN = 0.5 * (np.sqrt(5.0) - 1.0)


@dataclass(frozen=True)
class PointSpacing:
    """Largest distance of contact points along the finger (z) and across it (y), mm.

    A quarter of the objects' edge radius both ways: across matters for upright edges and rims (3 mm gives a 15 %
    higher peak on the cube turned by 45 deg). Points in air cost next to nothing.
    """

    along_mm: float = 0.25
    across_mm: float = 0.25
    is_staggered: bool = True
    """Whether columns are shifted along the finger, each by another part of a cell.

    A straight rim touches one straight row or two, and the force ripples with the distance of rows.
    """


class ContactPoints(NamedTuple):
    """Points (n) in patches (q) on faces (f) with k nodes each; points of a patch, patches of a face are in a row.

    The middle point of a patch is its first.
    """

    faces: np.ndarray
    """(f, k) nodes."""
    first_patch: np.ndarray
    """(f + 1) first patch of each face, and the number of all."""
    first_point: np.ndarray
    """(q + 1) first point of each patch, and the number of all."""
    shape: np.ndarray
    """(n, k) values at the points."""
    areas: np.ndarray
    """(n) undeformed, mm2."""
    reach: np.ndarray
    """(q) the largest sum of |N_a - N_a of the middle point| in a patch: against its middle point no point of it moves
    more than so many times the node of its face that moves most."""
    face_middle: np.ndarray
    """(f) the middle point of the whole face."""
    face_reach: np.ndarray
    """(f) reach of all its points from that."""


def contact_points(faces: np.ndarray, nodes: np.ndarray, spacing: PointSpacing) -> ContactPoints:
    """Make the points on faces (f, k) of undeformed nodes (n, 3)."""
    first_patch, first_point, face_middle = [0], [0], []
    shapes, areas = [], []
    for face in faces:
        shape, area, patch = _subdivide(nodes[face], spacing)
        face_middle.append(first_point[-1] + np.abs(shape - shape.mean(axis=0)).sum(axis=1).argmin())
        shapes.append(shape)
        areas.append(area)
        first_point.extend(first_point[-1] + np.cumsum(np.unique(patch, return_counts=True)[1]))
        first_patch.append(len(first_point) - 1)
    values, first, middle = (
        np.ascontiguousarray(np.vstack(shapes)),
        np.array(first_point, np.int32),
        np.array(face_middle, np.int32),
    )
    return ContactPoints(
        np.ascontiguousarray(faces, dtype=np.int32),
        np.array(first_patch, dtype=np.int32),
        first,
        values,
        np.concatenate(areas),
        _reach(values, first, first[:-1]),
        middle,
        _reach(values, first[first_patch], middle),
    )


def _reach(values: np.ndarray, first: np.ndarray, middle: np.ndarray) -> np.ndarray:
    """Return the reach (g) of point groups from their middle points (g), with shape values (n, k) of all points."""
    difference = np.abs(values - np.repeat(values[middle], np.diff(first), axis=0)).sum(axis=1)
    return np.maximum.reduceat(difference, first[:-1])


def _subdivide(corners: np.ndarray, spacing: PointSpacing) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return shape values (p, k), areas (p) in mm2 and patch numbers (p) of the points of one face with nodes (k, 3).

    Patches are in a row, and their points from the middle outwards.
    """
    if len(corners) == 8:
        along = np.linalg.norm(corners[1] - corners[0])
        across = np.linalg.norm(corners[3] - corners[0])
        n_r, n_s = max(int(np.ceil(along / spacing.along_mm)), 1), max(int(np.ceil(across / spacing.across_mm)), 1)
        pieces = _divide_square(n_r, n_s, _find_way(corners) if spacing.is_staggered else None)
    else:
        longest = max(np.linalg.norm(corners[i] - corners[j]) for i, j in ((0, 1), (1, 2), (2, 0)))
        n = max(int(np.ceil(longest / spacing.along_mm)), 1)
        points = _divide_triangle(n)
        pieces = _divide_face(len(corners), points, np.floor(points * n).astype(int), 0.5 / len(points))
    tangent = np.einsum("pkc,ki->pci", pieces.gradients, corners)
    area = np.linalg.norm(np.cross(tangent[:, 0], tangent[:, 1]), axis=1) * pieces.share
    return pieces.values, area[pieces.order], pieces.patch


class _Pieces(NamedTuple):
    """A subdivision of a face in its own coordinates; square faces of the same counts share one.

    `values` (p, k) and `patch` (p) in the order of the points, `gradients` (p, k, 2) in that of the cells, `order` (p)
    from one to the other, `share` of a cell in the area of the face's own coordinates.
    """

    values: np.ndarray
    gradients: np.ndarray
    patch: np.ndarray
    order: np.ndarray
    share: float


def _divide_face(k: int, points: np.ndarray, pieces: np.ndarray, share: float) -> _Pieces:
    """Return the subdivision of a face with k nodes into cells (p, 2) with midpoints (p, 2)."""
    values, gradients = face_shape(k, points)
    blocks = pieces // PATCH_PIECES
    patch = np.unique(blocks[:, 0] * (blocks[:, 1].max() + 1) + blocks[:, 1], return_inverse=True)[1]
    middles = np.column_stack([np.bincount(patch, weights=column) for column in pieces.T]) / np.bincount(patch)[:, None]
    order = np.lexsort((((pieces - middles[patch]) ** 2).sum(axis=1), patch))
    return _Pieces(values[order], gradients, patch[order], order, share)


class _Way(NamedTuple):
    """How a face runs in space: rows up (1) or down (-1), columns from the middle plane outwards or towards it.

    Neighbours number their corners in different ways. Shifts by the face's own numbers would leave gaps between them.
    """

    up: int
    is_outwards: bool


def _find_way(corners: np.ndarray) -> _Way:
    along = corners[1] - corners[0]
    return _Way(int(np.sign(along[np.abs(along).argmax()])), bool(abs(corners[0][1]) <= abs(corners[3][1])))


@lru_cache(maxsize=KEPT_SUBDIVISIONS)
def _divide_square(n_r: int, n_s: int, way: _Way | None) -> _Pieces:
    """Divide a face with 8 nodes into n_r by n_s cells; staggered if its way in space is given."""
    pieces = np.column_stack([np.repeat(np.arange(n_r), n_s), np.tile(np.arange(n_s), n_r)])
    at = pieces + 0.5
    if way is not None:
        shifts = way.up * _spread_shifts(n_s)
        at[:, 0] += (shifts if way.is_outwards else shifts[::-1])[pieces[:, 1]]
    return _divide_face(8, 2.0 * at / np.array([n_r, n_s]) - 1.0, pieces, 4.0 / (n_r * n_s))


def _spread_shifts(n: int) -> np.ndarray:
    """Spread n shifts (n) evenly from -0.5 to 0.5, neighbours far apart: ranks of multiples of the golden ratio."""
    ranks = np.argsort(np.argsort(np.arange(n) * _GOLDEN % 1.0))
    return (ranks + 0.5) / n - 0.5


def _divide_triangle(n: int) -> np.ndarray:
    """Return the centroids (n^2, 2) of the uniform subdivision of the unit triangle."""
    upright = [((i + 1 / 3) / n, (j + 1 / 3) / n) for i in range(n) for j in range(n - i)]
    inverted = [((i + 2 / 3) / n, (j + 2 / 3) / n) for i in range(n) for j in range(n - i - 1)]
    return np.array(upright + inverted)
