"""Shaded pictures of triangle meshes, without a display: matplotlib fills polygons from the farthest to the nearest.

Large triangles are cut first, since their order is that of their middles; edges and outlines are thin polygons among
them. Antialiasing is off while polygons are filled (it would let hidden ones shine through the seams); the picture is
drawn larger and averaged down instead.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
import trimesh
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import PolyCollection
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure

from fast.flows.report.style import OBJECT
from fast.models.objects.catalogue import get_object
from fast.models.objects.rigid import RigidObject
from fast.models.objects.surface import object_mesh

LIGHT = np.array([0.22, 0.58, 0.78])  # towards the light, in view coordinates (right, up, towards the eye)
LARGEST_EDGE_MM = 3.0
OBJECT_SPACING_MM = 1.5
OBJECT_PX = 96
OBJECTS_PER_ROW = 6
OVERSAMPLING = 3
EDGE_PX = 1.0
EDGE_ANGLE_RAD = np.radians(35.0)  # faces that meet at more get a line between them
EDGE_NEARER_MM = 1.0  # so that the triangles beside a line do not cover it
DPI = 100


@dataclass(frozen=True)
class Body:
    """A mesh and the colour it is drawn in."""

    mesh: trimesh.Trimesh
    colour: str


def render(
    bodies: Sequence[Body], azimuth_deg: float, elevation_deg: float, height_px: int, width_px: int | None = None
) -> np.ndarray:
    """Draw an orthographic picture of the bodies: RGBA float32, height x width x 4, background transparent.

    `azimuth_deg` turns the eye about z from the -y direction, `elevation_deg` lifts it. The bodies fill the picture
    up to a margin of 3 %.
    """
    view = _view_rotation(np.radians(azimuth_deg), np.radians(elevation_deg))
    seen = [_look_at(body.mesh, view) for body in bodies]
    low, high = (bound([m.bounds for m in seen], axis=(0, 1))[:2] for bound in (np.min, np.max))
    extent = np.maximum(high - low, 1e-6)
    size_px = np.array([width_px or np.ceil(height_px * extent[0] / extent[1]), height_px])
    mm_per_px = 1.0 / (0.94 * (size_px / extent).min())
    parts = [part for mesh, b in zip(seen, bodies, strict=True) for part in _polygons(mesh, b.colour, mm_per_px)]
    corners, colours, depths = (np.concatenate(values) for values in zip(*parts, strict=True))
    order = np.argsort(depths, kind="stable")
    figure = Figure(figsize=tuple(OVERSAMPLING * size_px / DPI), dpi=DPI, facecolor="none")
    canvas = FigureCanvasAgg(figure)
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.axis("off")
    quads: Any = corners[order]  # an array is a third faster than a list, which the stubs want
    axes.add_collection(PolyCollection(quads, facecolors=colours[order], linewidths=0, antialiased=False))
    left, bottom = (low + high - mm_per_px * size_px) / 2
    axes.set(xlim=(left, left + mm_per_px * size_px[0]), ylim=(bottom, bottom + mm_per_px * size_px[1]))
    canvas.draw()
    return _average_down(np.asarray(canvas.buffer_rgba()) / 255.0)


@lru_cache(maxsize=64)
def object_picture(object_id: int) -> np.ndarray:
    """Draw a small RGBA picture of a test object, square.

    Raises:
        UsageError: the catalogue has no such object.
    """
    mesh = object_mesh(get_object(object_id), spacing_mm=OBJECT_SPACING_MM)
    return render([Body(mesh, OBJECT)], azimuth_deg=28.0, elevation_deg=24.0, height_px=OBJECT_PX, width_px=OBJECT_PX)


def draw_objects(objects: Sequence[RigidObject]) -> Figure:
    """Draw pictures of objects side by side, with name, number and size."""
    n_columns = min(len(objects), OBJECTS_PER_ROW)
    n_lines = -(-len(objects) // n_columns)
    figure = Figure(figsize=(2.4 * n_columns, 2.7 * n_lines), dpi=DPI, layout="constrained")
    grid = figure.subplots(n_lines, n_columns, squeeze=False).ravel()
    for axes in grid:
        axes.axis("off")
    for axes, obj in zip(grid, objects, strict=False):
        bodies = [Body(object_mesh(obj), OBJECT)]
        axes.imshow(render(bodies, azimuth_deg=28.0, elevation_deg=24.0, height_px=240, width_px=240))
        size = " x ".join(f"{mm:.3g}" for mm in obj.size_mm)
        axes.set_title(f"{obj.name} ({obj.object_id})\n{size} mm", fontsize=8)
    return figure


def _view_rotation(azimuth: float, elevation: float) -> np.ndarray:
    """Return rows: picture right, picture up, towards the eye; for an eye at azimuth from -y, lifted by elevation."""
    eye = np.array([np.sin(azimuth) * np.cos(elevation), -np.cos(azimuth) * np.cos(elevation), np.sin(elevation)])
    right = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
    return np.array([right, np.cross(eye, right), eye])


def _look_at(mesh: trimesh.Trimesh, view: np.ndarray) -> trimesh.Trimesh:
    """Return the mesh in view coordinates, its large triangles cut."""
    vertices, faces = trimesh.remesh.subdivide_to_size(mesh.vertices @ view.T, mesh.faces, LARGEST_EDGE_MM)
    return trimesh.Trimesh(vertices, faces)  # which merges the corners that triangles share


_Polygons = tuple[np.ndarray, np.ndarray, np.ndarray]  # corners (n, 4, 2) mm, colours (n, 3), depths (n) mm


def _polygons(mesh: trimesh.Trimesh, colour: str, mm_per_px: float) -> list[_Polygons]:
    """Return the triangles of a mesh in view coordinates that face the eye, and the lines between them."""
    is_facing = mesh.face_normals[:, 2] > 1e-6
    brightness = 0.60 + 0.50 * np.clip(mesh.face_normals[is_facing] @ (LIGHT / np.linalg.norm(LIGHT)), 0.0, 1.0)
    rgb = np.array(to_rgb(colour))
    corners = mesh.triangles[is_facing]
    triangles = (corners[:, [0, 1, 2, 2], :2], np.clip(brightness[:, None] * rgb, 0, 1), corners[:, :, 2].mean(axis=1))
    sides = is_facing[mesh.face_adjacency]
    is_line = (sides[:, 0] != sides[:, 1]) | (sides.all(axis=1) & (mesh.face_adjacency_angles > EDGE_ANGLE_RAD))
    start, end = mesh.vertices[mesh.face_adjacency_edges[is_line]].transpose(1, 0, 2)
    along = (end - start)[:, :2]
    along *= 0.5 * EDGE_PX * mm_per_px / np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-9)
    aside = along[:, ::-1] * (1.0, -1.0)
    first, last = start[:, :2] - along, end[:, :2] + along
    quads = np.stack([first + aside, first - aside, last - aside, last + aside], axis=1)
    depth = 0.5 * (start + end)[:, 2] + EDGE_NEARER_MM
    return [triangles, (quads, np.tile(0.4 * rgb, (len(start), 1)), depth)]


def _average_down(image: np.ndarray) -> np.ndarray:
    """Compute the mean of blocks of pixels, colours unmixed from the transparent background."""
    rows, columns = image.shape[0] // OVERSAMPLING, image.shape[1] // OVERSAMPLING
    image[..., :3] *= image[..., 3:]
    mean = image.reshape(rows, OVERSAMPLING, columns, OVERSAMPLING, 4).mean(axis=(1, 3))
    alpha = mean[..., 3:]
    mean[..., :3] = np.divide(mean[..., :3], alpha, out=np.zeros_like(mean[..., :3]), where=alpha > 0)
    return np.asarray(np.clip(mean, 0.0, 1.0), dtype=np.float32)
