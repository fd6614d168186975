"""The outline of a profile while stations are set on it: boundary points, chords through the material, cells."""

import numpy as np
import shapely
from shapely.geometry import Polygon
from shapely.geometry.polygon import orient

SQUARE_ON = 0.8  # cosine: a ray through a wall ends only where it meets the other face within 37 deg of its normal
SNAP_TO_CORNER = 0.9  # a ray ends in a corner of the profile that is this near, in units of its length,
SNAP_TO_STATION = 0.35  # and in a station set before that is this near
TOUCHING = 1e-9


class Outline:
    """Rings of points with the material to their left, to which points and chords are added.

    `points` (x, z) in mm; `following[i]`: the next point of the ring; the first `n_corners` points are the corners
    of the profile.
    """

    def __init__(self, profile: Polygon) -> None:
        self.points: list[tuple[float, float]] = []
        self.following: list[int] = []
        self.chords: list[tuple[int, int]] = []
        turned = orient(profile)
        for ring in (turned.exterior, *turned.interiors):
            first, coordinates = len(self.points), ring.coords[:-1]
            self.points += [(float(x), float(z)) for x, z in coordinates]
            self.following += [*range(first + 1, first + len(coordinates)), first]
        self.n_corners = len(self.points)

    def sides(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the starts and ends (n, 2) of the boundary's sides, by the number of their starting point."""
        points = np.array(self.points)
        return points, points[self.following]

    def is_side(self, a: int, b: int) -> bool:
        """Return whether the boundary runs straight from a to b."""
        return self.following[a] == b

    def insert(self, a: int, point: np.ndarray) -> int:
        """Set a point on the side that starts at a."""
        self.points.append((float(point[0]), float(point[1])))
        self.following.append(self.following[a])
        self.following[a] = len(self.points) - 1
        return self.following[a]

    def divide(self, a: int, fractions: np.ndarray) -> list[int]:
        """Set points at ascending fractions of the side that starts at a."""
        start, end = np.array(self.points[a]), np.array(self.points[self.following[a]])
        added = []
        for fraction in fractions:
            a = self.insert(a, start + fraction * (end - start))
            added.append(a)
        return added

    def project(self, p: int, normal: np.ndarray, reach_mm: float) -> None:
        """Add the chord from p along `normal` to the opposite face, if there is one within reach."""
        origin = np.array(self.points[p])
        start, end = self.sides()
        along, offset = end - start, start - origin
        across = _cross(normal, along)
        with np.errstate(divide="ignore", invalid="ignore"):
            distance, place = _cross(offset, along) / across, _cross(offset, normal) / across
        length = np.hypot(*along.T)
        hit = (distance > 1e-6) & (place > -TOUCHING) & (place < 1.0 + TOUCHING)
        if not hit.any():
            return
        a = int(np.argmin(np.where(hit, distance, np.inf)))
        depth = float(distance[a])
        # The ray leaves the material where it runs along the outward normal of the side.
        if depth > reach_mm or across[a] < SQUARE_ON * length[a]:
            return
        b = self._near(a, float(place[a] * length[a]), float(length[a]), depth)
        target = origin + depth * normal if b is None else np.array(self.points[b])
        if self._is_crossed(p, (a, self.following[a]) if b is None else (b,), target):
            return
        if b is None:
            self.chords.append((p, self.insert(a, target)))
        elif not (self.is_side(p, b) or self.is_side(b, p) or {(p, b), (b, p)} & set(self.chords)):
            self.chords.append((p, b))

    def _near(self, a: int, place: float, length: float, depth: float) -> int | None:
        """Find an end of the side at a that may stand for the point at `place` mm along it."""
        ends = sorted(((place, a), (length - place, self.following[a])))
        for gap, end in ends:
            if gap <= (SNAP_TO_CORNER if end < self.n_corners else SNAP_TO_STATION) * depth:
                return end
        return None

    def _is_crossed(self, a: int, goal: tuple[int, ...], target: np.ndarray) -> bool:
        """Return whether the chord from point a to `target` meets a side or a chord with no end in a or `goal`."""
        points = np.array(self.points)
        ends = np.array([*enumerate(self.following), *self.chords])
        ends = ends[~np.isin(ends, (a, *goal)).any(axis=1)]
        p, start, end = points[a], points[ends[:, 0]], points[ends[:, 1]]
        apart = _cross(target - p, start - p) * _cross(target - p, end - p) > 0.0
        beside = _cross(end - start, p - start) * _cross(end - start, target - start) > 0.0
        return bool((~apart & ~beside).any())

    def parts(self) -> list[list[int]]:
        """Return the parts into which the chords cut the material, as counter-clockwise point numbers.

        A part with a hole is given as its triangles.
        """
        ends = np.array([*enumerate(self.following), *self.chords])
        number = {point: i for i, point in enumerate(self.points)}
        lines = shapely.linestrings(np.array(self.points)[ends])
        parts = []
        for face in shapely.get_parts(shapely.polygonize(lines)):
            pieces = shapely.get_parts(shapely.constrained_delaunay_triangles(face)) if face.interiors else [face]
            parts += [[number[point] for point in orient(piece).exterior.coords[:-1]] for piece in pieces]
        return [part for part in parts if not self._is_void(part)]

    def _is_void(self, part: list[int]) -> bool:
        """Return whether the boundary runs around the part the other way."""
        return all(self.is_side(b, a) for a, b in zip(part, np.roll(part, -1), strict=True))


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
