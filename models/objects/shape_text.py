"""The shape of an own object as text, by which a lake or a worker process has all of it after its file is gone.

It is JSON of its parts, or of a mesh that stands in the object frame (a binary STL, packed).
"""

import base64
import io
import zlib
from collections.abc import Sequence
from functools import lru_cache
from typing import Literal

import numpy as np
import trimesh
from pydantic import TypeAdapter

from fast.models.errors import ConfigError
from fast.models.objects.bodies import join_bodies
from fast.models.objects.grid import MeshGrid
from fast.models.objects.parts import Part
from fast.models.objects.primitives import bounds, moved
from fast.models.records import Record

MOST_TRIANGLES = 200_000
GRIDS_KEPT = 36  # up to 30 MB each, 7 as a rule


class MeshShape(Record):
    """A mesh in the object frame: `stl` is base64 of a zlib stream of a binary STL in mm.

    `edges`: sharp ones are exact (`models.objects.edges`), or rounded; `bodies`: those that overlap are joined to one
    solid, or crossing, with their faces inside of it. Rounded and crossing they were by the first versions, of whose
    lakes such objects are: what was simulated with them stays comparable.
    """

    kind: Literal["mesh"] = "mesh"
    is_round: bool
    edges: Literal["rounded", "sharp"] = "rounded"
    bodies: Literal["crossing", "joined"] = "crossing"
    stl: str


class PartsShape(Record):
    """A union of parts, before it is stood on the mount."""

    kind: Literal["parts"] = "parts"
    parts: tuple[Part, ...]


@lru_cache(maxsize=GRIDS_KEPT)
def shape_rows(shape: str) -> np.ndarray:
    """Return rows of primitives, in the object frame, of a shape's text; kept by each process, so never changed."""
    read = read_shape(shape)
    if isinstance(read, PartsShape):
        rows = place_parts(read.parts)
    else:
        grid = measure_mesh(read.model_copy(update={"is_round": False}))
        rows = grid.row(is_round=read.is_round, has_edges=read.edges == "sharp")
    rows.flags.writeable = False
    return rows


@lru_cache(maxsize=1)
def measure_mesh(shape: MeshShape) -> MeshGrid:
    """Make a mesh's grid in the object frame; an object that is made needs it, and so do its rows right after."""
    return MeshGrid.of(mesh_of_shape(shape))


def place_parts(parts: Sequence[Part]) -> np.ndarray:
    """Place the rows of the union of parts, footprint centred, on z = 0."""
    rows = np.concatenate([part.rows for part in parts])
    low, high = bounds(rows)
    return moved(rows, -np.array([(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, low[2]]))


def read_shape(shape: str) -> MeshShape | PartsShape:
    """Read the shape that a text says.

    Raises:
        ValueError: it says none.
    """
    found: MeshShape | PartsShape = TypeAdapter(MeshShape | PartsShape).validate_json(shape)
    return found


def mesh_of_shape(shape: MeshShape, source: str = "a mesh") -> trimesh.Trimesh:
    """Make the mesh of a shape, in the object frame.

    Raises:
        ValueError, zlib.error: it is no mesh.
        ConfigError: its bodies cannot be joined.
    """
    mesh = trimesh.load_mesh(io.BytesIO(unpack_mesh(shape)), file_type="stl")
    return join_bodies(mesh, source) if shape.bodies == "joined" else mesh


def unpack_mesh(shape: MeshShape) -> bytes:
    """Unpack the binary STL of a shape.

    Raises:
        ValueError, zlib.error: it is none, or larger than any that is taken.
    """
    packed, most = zlib.decompressobj(), 84 + 50 * MOST_TRIANGLES
    stl = packed.decompress(base64.b64decode(shape.stl, validate=True), most)
    if not packed.eof:
        raise ValueError("larger than any mesh that is taken, or cut off")
    return stl


def check_mesh(mesh: trimesh.Trimesh, source: str) -> trimesh.Trimesh:
    """Check the mesh and return it, its triangles turned the same way.

    Raises:
        ConfigError: it is not closed, has no volume or too many triangles.
    """
    n_triangles = len(mesh.faces)
    if n_triangles == 0:
        raise ConfigError(f"{source}: it has no triangles; export the object as a mesh.")
    if n_triangles > MOST_TRIANGLES:
        raise ConfigError(
            f"{source}: it has {n_triangles} triangles, at most {MOST_TRIANGLES} are taken; export it coarser."
        )
    if not np.isfinite(mesh.vertices).all():
        raise ConfigError(f"{source}: a corner of it is not a finite number; export the mesh again.")
    a, b, c = mesh.faces.T
    turned = mesh.copy()
    turned.update_faces((a != b) & (b != c) & (c != a))
    _, n_faces = np.unique(turned.edges_sorted, axis=0, return_counts=True)
    if n_open := int((n_faces % 2).sum()):
        raise ConfigError(
            f"{source}: the mesh is not watertight, {n_open} of its {len(n_faces)} edges do not join two triangles; "
            "close it in the program that made it."
        )
    with np.errstate(invalid="ignore", divide="ignore"):  # a mesh without volume has no centre
        if not turned.is_winding_consistent or turned.volume < 0.0:
            turned.fix_normals()
    if not abs(turned.volume) > 1e-9 * float(np.prod(np.maximum(np.ptp(turned.bounds, axis=0), 1e-9))):
        raise ConfigError(f"{source}: the mesh has no volume; export a solid.")
    return turned
