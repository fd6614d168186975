"""Closed triangle meshes of the objects, for printing and viewing: of its file, or from the distance of the contact."""

import numpy as np
import trimesh
from skimage.measure import marching_cubes

from fast.models.objects.distance import distance, distance_and_normal
from fast.models.objects.primitives import bounds
from fast.models.objects.rigid import RigidObject
from fast.models.objects.shape_text import MeshShape, mesh_of_shape, read_shape

_PROJECTIONS = 3


def object_mesh(obj: RigidObject, spacing_mm: float = 1.0) -> trimesh.Trimesh:
    """Make the surface mesh in the object frame, mm: the file's, if an object came from a mesh, else `surface_of`."""
    read = None if obj.shape is None else read_shape(obj.shape)
    return mesh_of_shape(read, obj.name) if isinstance(read, MeshShape) else surface_of(obj.primitives, spacing_mm)


def surface_of(rows: np.ndarray, spacing_mm: float = 1.0) -> trimesh.Trimesh:
    """Make a watertight surface mesh of rows (n_rows, n_columns) of primitives, mm.

    Marching cubes, then vertices moved onto the surface. `spacing_mm`: of the grid; edges of triangles are about as
    long.
    """
    low, high = bounds(rows)
    # A grid off the object's flat faces, which otherwise go through grid points and give empty triangles.
    axes = [np.arange(a - 1.37 * spacing_mm, b + 2 * spacing_mm, spacing_mm) for a, b in zip(low, high, strict=True)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    values = distance(rows, grid.reshape(-1, 3)).reshape(grid.shape[:3])
    vertices, faces, _, _ = marching_cubes(values, 0.0, spacing=(spacing_mm,) * 3)
    vertices = vertices + grid[0, 0, 0]
    for _ in range(_PROJECTIONS):
        depth, normal = distance_and_normal(rows, vertices)
        vertices = vertices - depth[:, None] * normal
    return trimesh.Trimesh(vertices, faces, process=False)
