"""Solid primitives as rows of numbers, so that one compiled kernel measures any object.

A primitive is a *core* inflated by a radius: a sphere is a point, a capsule a segment, a torus a circle, and a body
with rounded edges is a smaller sharp one. Inflation rounds every outer edge with that radius and keeps the distance
exact. A solid is the union of its rows, an array (n_rows, N_COLUMNS):

| column | content |
|---|---|
| KIND | which core, one of the `POINT` ... `GRID` codes |
| RADIUS | inflation, mm |
| CENTRE, 3 | origin of the row's own frame, mm |
| ROTATION, 9 | row-major matrix, columns are the row's own axes in the object frame |
| N_VERTICES | vertices of the profile (LATHE, SQUARE_LATHE, PRISM) or of the convex hull (GRID) |
| LENGTH | half length (SEGMENT, PRISM) or radius (CIRCLE), mm; 1 if it is round about its own z axis (GRID) |
| REACH | radius about CENTRE of a ball that holds the inflated core, mm |
| VALUES, 16 | semi-axes (BOX, ELLIPSOID) or profile vertices, two numbers each, mm |

A GRID is a solid alone: its row has more columns. From VALUES on it holds the numbers of grid points along x, y and z,
their spacing and the place of the first one (mm), the vertices of the convex hull, then the coefficients of the spline
of its distance (mm), z running fastest. Then come the cells in which planes hold in place of the spline, in the order
of their grid points: how many there are before those of each pair of x and y (nx ny + 1), and of each cell the number
of its grid point along z and the column where its planes begin. Of these EDGE_SIGN is 1 for what lies behind all, -1
for what lies behind any, EDGE_COUNT how many there are, and from EDGE_PLANES on each has four numbers: its outward
normal, and how far it is from the first grid point along that, in spacings.
"""

from collections.abc import Sequence

import numpy as np

POINT, SEGMENT, CIRCLE, BOX, ELLIPSOID, LATHE, SQUARE_LATHE, PRISM, GRID = range(9)

KIND, RADIUS, CENTRE, ROTATION, N_VERTICES, LENGTH, REACH, VALUES = 0, 1, 2, 5, 14, 15, 16, 17
MAX_VERTICES = 8
N_COLUMNS = VALUES + 2 * MAX_VERTICES
GRID_VALUES = VALUES + 7  # hull and coefficients of a GRID
SPACING = VALUES + 3  # of a GRID
MOST_PLANES = 4
EDGE_SIGN, EDGE_COUNT, EDGE_PLANES = 0, 1, 2
EDGE_COLUMNS = EDGE_PLANES + 4 * MOST_PLANES
ROUND_TOLERANCE = 1e-12  # of a centre in mm and of the cosine of an axis with z

Vertices = Sequence[tuple[float, float]]


def sphere(radius_mm: float) -> np.ndarray:
    """Make the row of a sphere about the origin."""
    return _row(POINT, radius_mm)


def capsule(start: np.ndarray, end: np.ndarray, radius_mm: float) -> np.ndarray:
    """Make the row of a round rod with ball ends; `start`, `end` (3): the centres of its ends, mm."""
    half = (np.asarray(end, float) - start) / 2
    length = float(np.linalg.norm(half))
    row = _row(SEGMENT, radius_mm, length=length)
    row[CENTRE : CENTRE + 3] = start + half
    row[ROTATION : ROTATION + 9] = _frame_with_z(half / length).ravel()
    return row


def torus(ring_radius_mm: float, tube_radius_mm: float) -> np.ndarray:
    """Make the row of a ring about the z axis; `ring_radius_mm` is that of the tube's centre line."""
    return _row(CIRCLE, tube_radius_mm, length=ring_radius_mm)


def box(size_x_mm: float, size_y_mm: float, size_z_mm: float, rounding_mm: float) -> np.ndarray:
    """Make the row of a box about the origin with rounded edges."""
    return _row(BOX, rounding_mm, values=np.array([size_x_mm, size_y_mm, size_z_mm]) / 2 - rounding_mm)


def ellipsoid(size_x_mm: float, size_y_mm: float, size_z_mm: float) -> np.ndarray:
    """Make the row of an ellipsoid about the origin, from its three diameters."""
    return _row(ELLIPSOID, 0.0, values=np.array([size_x_mm, size_y_mm, size_z_mm]) / 2)


def lathe(profile: Vertices, rounding_mm: float) -> np.ndarray:
    """Make the row of a body turned about z.

    `profile`: at most 8 vertices (radius, z) in mm, anticlockwise in the plane with the radius to the right.
    """
    return _profile_row(LATHE, profile, rounding_mm)


def square_lathe(profile: Vertices, rounding_mm: float) -> np.ndarray:
    """Make the row of a body with square cross-sections, sides along x and y.

    `profile`: at most 8 vertices (half side, z) in mm, anticlockwise with the half side to the right.
    """
    return _profile_row(SQUARE_LATHE, profile, rounding_mm)


def prism(outline: Vertices, height_mm: float, rounding_mm: float) -> np.ndarray:
    """Make the row of a prism along z, centred in z; `outline`: at most 8 vertices (x, y), mm, anticlockwise."""
    return _profile_row(PRISM, outline, rounding_mm, length=height_mm / 2 - rounding_mm)


def grid(
    coefficients: np.ndarray,
    spacing_mm: float,
    origin_mm: np.ndarray,
    corners_mm: np.ndarray,
    *,
    is_round: bool,
) -> np.ndarray:
    """Make the row (1, columns) of a solid given by its signed distance on a grid, without edges.

    `coefficients` (nx, ny, nz): of the spline of degree 2 of the distance, mm; `origin_mm` (3): the first grid point;
    `corners_mm` (n, 3): vertices of the convex hull; `is_round`: about z.
    """
    no_edges = np.zeros(coefficients.shape[0] * coefficients.shape[1] + 1)
    values = [coefficients.shape, [spacing_mm], origin_mm, corners_mm.ravel(), coefficients.ravel(), no_edges]
    row = np.concatenate([np.zeros(VALUES), *(np.asarray(v, dtype=np.float64) for v in values)])
    row[KIND], row[N_VERTICES], row[LENGTH] = GRID, len(corners_mm), float(is_round)
    row[ROTATION : ROTATION + 9] = np.eye(3).ravel()
    row[REACH] = np.linalg.norm(corners_mm, axis=1).max()
    return row[None]


def rotated(rows: np.ndarray, rotation: np.ndarray) -> np.ndarray:
    """Turn rows (n, N_COLUMNS) about the origin by a rotation matrix (3, 3)."""
    turned = rows.copy()
    turned[:, CENTRE : CENTRE + 3] = rows[:, CENTRE : CENTRE + 3] @ rotation.T
    axes = rotation @ rows[:, ROTATION : ROTATION + 9].reshape(-1, 3, 3)
    turned[:, ROTATION : ROTATION + 9] = axes.reshape(-1, 9)
    return turned


def turn_about_z(angle_deg: float) -> np.ndarray:
    """Make the rotation matrix (3, 3) about the z axis, counter-clockwise seen from above."""
    angle = np.radians(angle_deg)
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def moved(rows: np.ndarray, shift: np.ndarray) -> np.ndarray:
    """Shift rows (n, N_COLUMNS) by (3) mm."""
    shifted = rows.copy()
    shifted[:, CENTRE : CENTRE + 3] += shift
    return shifted


def bounds(rows: np.ndarray) -> np.ndarray:
    """Compute the bounding box (2, 3) of a solid, mm: lowest and highest corner, exact."""
    high = np.max([_reach(row) for row in rows], axis=0)
    low = -np.max([_reach(row, sign=-1.0) for row in rows], axis=0)
    return np.stack([low, high])


def is_round(rows: np.ndarray) -> bool:
    """Return True if every row is a body of revolution about the z axis, so that a turn about it changes nothing."""
    return all(_is_round(row) for row in rows)


def mirrored(rows: np.ndarray) -> np.ndarray:
    """Mirror rows (n, N_COLUMNS) in x = 0; their frames become left-handed, which no distance minds."""
    return rotated(rows, np.diag([-1.0, 1.0, 1.0]))


def _is_round(row: np.ndarray) -> bool:
    """Return True if this row is a body of revolution about the z axis."""
    kind, values = int(row[KIND]), row[VALUES:]
    is_spherical = kind == POINT or (kind == ELLIPSOID and values[0] == values[1] == values[2])
    has_axis = kind in (SEGMENT, CIRCLE, LATHE) or (kind == ELLIPSOID and values[0] == values[1])
    has_axis = has_axis or (kind == GRID and row[LENGTH] == 1.0)
    is_upright = abs(row[ROTATION + 8]) > 1.0 - ROUND_TOLERANCE
    is_centred = float(np.abs(row[CENTRE : CENTRE + 2]).max()) < ROUND_TOLERANCE
    return is_centred and (is_spherical or (has_axis and is_upright))


def _row(
    kind: int, radius: float, *, length: float = 0.0, values: np.ndarray | None = None, n_vertices: int = 0
) -> np.ndarray:
    row = np.zeros(N_COLUMNS)
    row[KIND], row[RADIUS], row[LENGTH], row[N_VERTICES] = kind, radius, length, n_vertices
    row[ROTATION : ROTATION + 9] = np.eye(3).ravel()
    if values is not None:
        row[VALUES : VALUES + values.size] = values.ravel()
    row[REACH] = radius + _core_radius(kind, length, np.zeros((1, 3)) if values is None else values)
    return row


def _profile_row(kind: int, profile: Vertices, rounding: float, length: float = 0.0) -> np.ndarray:
    vertices = _shrunk(np.array(profile, float), rounding, has_axis=kind != PRISM)
    if len(vertices) > MAX_VERTICES:
        raise ValueError(f"a profile has {len(vertices)} vertices, at most {MAX_VERTICES} fit in a row; use fewer.")
    return _row(kind, rounding, length=length, values=vertices, n_vertices=len(vertices))


def _core_radius(kind: int, length: float, values: np.ndarray) -> float:
    """Find the largest distance of a core's points from its origin, mm; `values` as in VALUES."""
    if kind == ELLIPSOID:
        return float(values.max())
    # A square section reaches as far as its corners, (half side, half side, z).
    across = np.array([np.sqrt(2.0), 1.0]) if kind == SQUARE_LATHE else 1.0
    return float(np.hypot(length, np.linalg.norm(values * across, axis=-1).max()))


def _shrunk(vertices: np.ndarray, rounding: float, *, has_axis: bool) -> np.ndarray:
    """Move each edge of a polygon (n, 2) inwards by `rounding`, except the one on the axis of a turned body."""
    edges = np.roll(vertices, -1, axis=0) - vertices
    inward = np.stack([-edges[:, 1], edges[:, 0]], axis=1) / np.linalg.norm(edges, axis=1, keepdims=True)
    is_axis = (np.abs(vertices[:, 0]) + np.abs(np.roll(vertices[:, 0], -1)) == 0) & has_axis
    offsets = np.einsum("ij,ij->i", inward, vertices) + np.where(is_axis, 0.0, rounding)
    corners = [
        np.linalg.solve(np.stack([inward[i - 1], inward[i]]), np.array([offsets[i - 1], offsets[i]]))
        for i in range(len(vertices))
    ]
    return np.array(corners)


def _frame_with_z(axis: np.ndarray) -> np.ndarray:
    """Make a rotation matrix whose third column is the unit vector `axis` (3)."""
    helper = np.eye(3)[np.argmin(np.abs(axis))]
    x = np.cross(helper, axis)
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(axis, x), axis], axis=1)


def _reach(row: np.ndarray, sign: float = 1.0) -> np.ndarray:
    """Return how far (3) a row reaches along sign * (x, y, z)."""
    local = sign * row[ROTATION : ROTATION + 9].reshape(3, 3)
    core = np.array([_core_reach(row, direction) for direction in local])
    return sign * row[CENTRE : CENTRE + 3] + core + row[RADIUS]


def _core_reach(row: np.ndarray, direction: np.ndarray) -> float:
    """Compute a core's support function: its points' largest projection on `direction` (3), in its own frame."""
    kind, length = int(row[KIND]), row[LENGTH]
    across = float(np.hypot(direction[0], direction[1]))
    if kind in (POINT, SEGMENT):
        return float(length * abs(direction[2]))
    if kind == CIRCLE:
        return float(length * across)
    if kind == BOX:
        return float(row[VALUES : VALUES + 3] @ np.abs(direction))
    if kind == ELLIPSOID:
        return float(np.linalg.norm(row[VALUES : VALUES + 3] * direction))
    if kind == GRID:
        return float(np.max(row[GRID_VALUES : GRID_VALUES + 3 * int(row[N_VERTICES])].reshape(-1, 3) @ direction))
    vertices = row[VALUES : VALUES + 2 * int(row[N_VERTICES])].reshape(-1, 2)
    if kind == PRISM:
        return float(np.max(vertices @ direction[:2]) + length * abs(direction[2]))
    spread = across if kind == LATHE else float(np.abs(direction[:2]).sum())
    return float(np.max(vertices @ np.array([spread, direction[2]])))
