"""Shaded pictures of triangle meshes by a small z-buffer rasteriser.

matplotlib sorts whole triangles by depth, which is wrong for long thin ones such as the walls of a finger; a
z-buffer is right for every pixel and needs no display.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numba
import numpy as np
import trimesh
from matplotlib.colors import to_rgb
from scipy import ndimage

from flows.report.style import OBJECT
from models.objects.catalogue import get_object
from models.objects.surface import object_mesh

LIGHT = np.array([0.22, -0.58, 0.78])  # towards the light, in view coordinates (right, down, towards the eye)
OBJECT_SPACING_MM = 1.5
OBJECT_PX = 96
EDGE_DEPTH_MM = 1.2
EDGE_ANGLE_COS = 0.82  # neighbouring pixels whose normals differ by more than 35 degrees get an edge line


@dataclass(frozen=True)
class Body:
    """A mesh and the colour it is drawn in."""

    mesh: trimesh.Trimesh
    colour: str


def render(
    bodies: Sequence[Body], azimuth_deg: float, elevation_deg: float, height_px: int, width_px: int | None = None
) -> np.ndarray:
    """Orthographic picture of the bodies, as RGBA float32, height x width x 4, background transparent.

    `azimuth_deg` turns the eye about z from the -y direction, `elevation_deg` lifts it. The bodies fill
    the picture up to a margin of 3 %. Drawn at three times the size and averaged down against jagged edges.
    """
    scale = 3
    rotation = _view_rotation(np.radians(azimuth_deg), np.radians(elevation_deg))
    points = [np.asarray(body.mesh.vertices) @ rotation.T for body in bodies]
    low = np.min([p.min(axis=0) for p in points], axis=0)
    high = np.max([p.max(axis=0) for p in points], axis=0)
    extent = np.maximum(high - low, 1e-6)
    rows = height_px * scale
    columns = (width_px or int(np.ceil(height_px * extent[0] / extent[1]))) * scale
    px_per_mm = 0.94 * min(rows / extent[1], columns / extent[0])
    depth = np.full((rows, columns), -np.inf)
    normal = np.zeros((rows, columns, 3))
    colour = np.zeros((rows, columns, 3))
    middle = np.array([columns / 2, rows / 2, 0.0]) - px_per_mm * (low + high) / 2 * np.array([1, 1, 0])
    for body, view in zip(bodies, points, strict=True):
        corners = view[np.asarray(body.mesh.faces)]
        # View coordinates are left-handed (down, not up), hence the order of the product.
        normals = np.cross(corners[:, 2] - corners[:, 0], corners[:, 1] - corners[:, 0])
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
        screen = corners * np.array([px_per_mm, px_per_mm, 1.0]) + middle
        _rasterise(screen, normals, np.array(to_rgb(body.colour)), depth, normal, colour)
    return _average_down(_shade(depth, normal, colour), scale)


@lru_cache(maxsize=64)
def object_picture(object_id: int) -> np.ndarray:
    """Small RGBA picture of a test object, square.

    Raises:
        UsageError: the catalogue has no such object.
    """
    mesh = object_mesh(get_object(object_id), spacing_mm=OBJECT_SPACING_MM)
    return render([Body(mesh, OBJECT)], azimuth_deg=28.0, elevation_deg=24.0, height_px=OBJECT_PX, width_px=OBJECT_PX)


def _view_rotation(azimuth: float, elevation: float) -> np.ndarray:
    """Rows: picture right, picture down, towards the eye; for an eye at azimuth from -y, lifted by elevation."""
    eye = np.array([np.sin(azimuth) * np.cos(elevation), -np.cos(azimuth) * np.cos(elevation), np.sin(elevation)])
    right = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
    return np.array([right, -np.cross(eye, right), eye])


@numba.njit(cache=True)
def _rasterise(
    screen: np.ndarray, normals: np.ndarray, rgb: np.ndarray, depth: np.ndarray, normal: np.ndarray, colour: np.ndarray
) -> None:  # pragma: no cover - compiled
    """Draw triangles (m, 3, 3: column, row, depth) into the three buffers; larger depth is nearer."""
    rows, columns = depth.shape
    for index in range(screen.shape[0]):
        a, b, c = screen[index, 0], screen[index, 1], screen[index, 2]
        area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
        if abs(area) < 1e-9:
            continue
        first_row = max(0, int(np.floor(min(a[1], b[1], c[1]))))
        last_row = min(rows - 1, int(np.ceil(max(a[1], b[1], c[1]))))
        first_column = max(0, int(np.floor(min(a[0], b[0], c[0]))))
        last_column = min(columns - 1, int(np.ceil(max(a[0], b[0], c[0]))))
        for row in range(first_row, last_row + 1):
            y = row + 0.5
            for column in range(first_column, last_column + 1):
                x = column + 0.5
                u = ((x - a[0]) * (c[1] - a[1]) - (y - a[1]) * (c[0] - a[0])) / area
                v = ((b[0] - a[0]) * (y - a[1]) - (b[1] - a[1]) * (x - a[0])) / area
                if u < 0.0 or v < 0.0 or u + v > 1.0:
                    continue
                z = a[2] + u * (b[2] - a[2]) + v * (c[2] - a[2])
                if z > depth[row, column]:
                    depth[row, column] = z
                    normal[row, column] = normals[index]
                    colour[row, column] = rgb


def _shade(depth: np.ndarray, normal: np.ndarray, colour: np.ndarray) -> np.ndarray:
    """Lambert light with a strong ambient part, darkened along silhouettes and creases; RGBA."""
    light = LIGHT / np.linalg.norm(LIGHT)
    brightness = 0.60 + 0.50 * np.clip(normal @ light, 0.0, 1.0)
    covered = np.isfinite(depth)
    filled = np.where(covered, depth, depth[covered].min() - 100.0 if covered.any() else 0.0)
    edge = np.zeros(depth.shape, dtype=bool)
    edge[:-1, :] |= _edge_between(filled[:-1, :], filled[1:, :], normal[:-1, :], normal[1:, :])
    edge[:, :-1] |= _edge_between(filled[:, :-1], filled[:, 1:], normal[:, :-1], normal[:, 1:])
    shaded = np.clip(colour * brightness[..., None], 0.0, 1.0)
    shaded[ndimage.binary_dilation(edge) & covered] *= 0.4
    return np.dstack([shaded * covered[..., None], covered.astype(float)])


def _edge_between(depth_a: np.ndarray, depth_b: np.ndarray, normal_a: np.ndarray, normal_b: np.ndarray) -> np.ndarray:
    """Mask of neighbouring pixels separated by a jump in depth or by a crease."""
    return (np.abs(depth_a - depth_b) > EDGE_DEPTH_MM) | ((normal_a * normal_b).sum(axis=2) < EDGE_ANGLE_COS)


def _average_down(image: np.ndarray, scale: int) -> np.ndarray:
    """Mean of scale x scale blocks, colours unmixed from the transparent background."""
    rows, columns = image.shape[0] // scale, image.shape[1] // scale
    mean = image.reshape(rows, scale, columns, scale, 4).mean(axis=(1, 3))
    alpha = mean[..., 3:]
    mean[..., :3] = np.divide(mean[..., :3], alpha, out=np.zeros_like(mean[..., :3]), where=alpha > 0)
    return np.asarray(np.clip(mean, 0.0, 1.0), dtype=np.float32)
