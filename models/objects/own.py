"""Own objects: from parts or a closed mesh to a `RigidObject`, with a number that follows from its content.

Its shape is kept as text, JSON of its parts or of a mesh that stands in the object frame (a binary STL, packed), so
that a lake or a worker process has all of it after the file is gone.
"""

import base64
import hashlib
import io
import re
import zlib
from collections.abc import Sequence
from functools import lru_cache
from typing import Literal

import numpy as np
import trimesh
from pydantic import TypeAdapter

from fast.models.errors import ConfigError
from fast.models.ids import canonical_json
from fast.models.objects.bodies import check_one_piece, check_parts_touch
from fast.models.objects.catalogue import FIRST_OWN_ID, OBJECTS, RigidObject
from fast.models.objects.distance import distance
from fast.models.objects.grid import SAME_MM, MeshGrid, looks_round, surface_points
from fast.models.objects.parts import Part, Turn, turn_matrix
from fast.models.objects.primitives import bounds, moved
from fast.models.objects.surface import surface_of
from fast.models.records import Record

OWN_CLASS = "own"
LEAST_SIZE_MM, MOST_HEIGHT_MM = 3.0, 50.0
MOST_WIDTH_MM = (64.0, 100.0)  # x: jaws that are 70 mm open pass; y: the fingers keep clear of the next place
MOST_TRIANGLES = 200_000
GRIDS_KEPT = 36  # up to 10 MB each
_LAST_ID = 2**31 - 1
MOST_LETTERS = 40
_NAME = re.compile(f"[A-Za-z][A-Za-z0-9 _-]{{0,{MOST_LETTERS - 1}}}")
_MIRRORS = (np.array([-1.0, 1.0, 1.0]), np.array([1.0, -1.0, 1.0]))


class _MeshShape(Record):
    """A mesh in the object frame: `stl` is base64 of a zlib stream of a binary STL in mm."""

    kind: Literal["mesh"] = "mesh"
    is_round: bool
    stl: str


class _PartsShape(Record):
    """A union of parts, before it is stood on the mount."""

    kind: Literal["parts"] = "parts"
    parts: tuple[Part, ...]


def object_of_parts(name: str, parts: Sequence[Part], source: str) -> RigidObject:
    """The object that is the union of `parts`; `source` names where they came from in messages.

    Raises:
        ConfigError: the name or the size cannot be used, or parts do not touch.
    """
    shape = _PartsShape(parts=tuple(parts))
    obj = _of_parts(name, shape, source)
    check_parts_touch([part.rows for part in shape.parts], source)
    return obj


def object_of_mesh(
    name: str,
    mesh: trimesh.Trimesh,
    source: str,
    *,
    scale: float = 1.0,
    turn_deg: Turn = (0.0, 0.0, 0.0),
) -> RigidObject:
    """The object of a watertight mesh in mm: scaled, turned, and stood on the mount with its footprint centred.

    Raises:
        ConfigError: the mesh is not closed, has no volume, too many triangles or bodies that do not touch, or name or
            size cannot be used.
    """
    stood = _stand(_checked(mesh, source), scale, turn_deg)
    _check_size(np.ptp(stood.bounds, axis=0), source)  # before a grid is made for it
    check_one_piece(stood, source)
    return _of_placed_mesh(name, stood, trimesh.exchange.stl.export_stl(stood), source)


def object_of_shape(name: str, shape: str, source: str) -> RigidObject:
    """The object of a shape's text that another lake wrote; its number is worked out again from the content.

    Raises:
        ConfigError: the text is no shape, or no object that the bench can hold.
    """
    try:
        read = _read(shape)
        if isinstance(read, _PartsShape):
            return _of_parts(name, read, source)
        stl = _unpack(read)
        mesh = trimesh.load_mesh(io.BytesIO(stl), file_type="stl")
    except (ValueError, zlib.error, RecursionError) as error:
        raise ConfigError(f"{source}: the shape of `{name}` cannot be read; export it again.") from error
    _check_size(np.ptp(_checked(mesh, source).bounds, axis=0), source)
    return _of_placed_mesh(name, mesh, stl, source)


@lru_cache(maxsize=GRIDS_KEPT)
def shape_rows(shape: str) -> np.ndarray:
    """Rows of primitives, in the object frame, of the text of a shape; kept by each process, so never changed."""
    read = _read(shape)
    if isinstance(read, _PartsShape):
        rows = _place_parts(read.parts)
    else:
        rows = MeshGrid.of(_mesh_of(read)).row(is_round=read.is_round)
    rows.flags.writeable = False
    return rows


def mesh_of(obj: RigidObject) -> trimesh.Trimesh | None:
    """The mesh, in the object frame, from which an own object was made; None where it was not made from one."""
    if obj.shape is None:
        return None
    read = _read(obj.shape)
    return _mesh_of(read) if isinstance(read, _MeshShape) else None


def own_id(content: bytes) -> int:
    """Number of an own object: from its content, above those of the 36, and small enough for any integer column."""
    number = int.from_bytes(hashlib.sha256(content).digest()[:8], "big")
    return FIRST_OWN_ID + number % (_LAST_ID - FIRST_OWN_ID)


def _of_parts(name: str, shape: _PartsShape, source: str) -> RigidObject:
    _check_name(name, source)
    rows = _place_parts(shape.parts)
    points = np.asarray(surface_of(rows).vertices)
    has_mirrors = [bool(np.abs(distance(rows, points * signs)).max() <= SAME_MM) for signs in _MIRRORS]
    low, high = bounds(rows)
    return _object(name, shape, canonical_json(shape.model_dump()).encode(), high - low, has_mirrors, source)


def _of_placed_mesh(name: str, mesh: trimesh.Trimesh, stl: bytes, source: str) -> RigidObject:
    """The object of a mesh in the object frame, and of the same as a binary STL."""
    _check_name(name, source)  # before a grid is made for it
    mesh_grid, points = MeshGrid.of(mesh), surface_points(mesh)
    packed = base64.b64encode(zlib.compress(stl, 9)).decode()
    shape = _MeshShape(is_round=looks_round(mesh_grid, points), stl=packed)
    has_mirrors = [mesh_grid.has_on_surface(points * signs) for signs in _MIRRORS]
    return _object(name, shape, stl, np.ptp(mesh.bounds, axis=0), has_mirrors, source)


def _object(
    name: str,
    shape: _MeshShape | _PartsShape,
    content: bytes,
    size_mm: np.ndarray,
    has_mirrors: Sequence[bool],
    source: str,
) -> RigidObject:
    """The object; `content` decides its number, `has_mirrors` are those in the planes x = 0 and y = 0."""
    _check_size(size_mm, source)
    return RigidObject(
        object_id=own_id(content),
        name=name,
        object_class=OWN_CLASS,
        parameters={},
        orientation="axis z",
        mirror_x=has_mirrors[0],
        mirror_y=has_mirrors[1],
        shape=shape.model_dump_json(),
    )


def _check_name(name: str, source: str) -> None:
    if not _NAME.fullmatch(name) or name.casefold() in {obj.name for obj in OBJECTS}:
        raise ConfigError(
            f"{source}: `{name}` cannot be the name of an own object; it begins with a letter, has at most "
            f"{MOST_LETTERS} letters, digits, spaces, `_` or `-`, and is none of the 36; set `name` in its .toml file."
        )


def _place_parts(parts: Sequence[Part]) -> np.ndarray:
    """Rows of the union of parts, footprint centred, on z = 0."""
    rows = np.concatenate([part.rows for part in parts])
    low, high = bounds(rows)
    return moved(rows, -np.array([(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, low[2]]))


def _read(shape: str) -> _MeshShape | _PartsShape:
    found: _MeshShape | _PartsShape = TypeAdapter(_MeshShape | _PartsShape).validate_json(shape)
    return found


def _mesh_of(shape: _MeshShape) -> trimesh.Trimesh:
    return trimesh.load_mesh(io.BytesIO(_unpack(shape)), file_type="stl")


def _unpack(shape: _MeshShape) -> bytes:
    """The binary STL of a shape.

    Raises:
        ValueError, zlib.error: it is none, or larger than any that is taken.
    """
    packed, most = zlib.decompressobj(), 84 + 50 * MOST_TRIANGLES
    stl = packed.decompress(base64.b64decode(shape.stl, validate=True), most)
    if not packed.eof:
        raise ValueError("larger than any mesh that is taken, or cut off")
    return stl


def _checked(mesh: trimesh.Trimesh, source: str) -> trimesh.Trimesh:
    """The mesh, its triangles turned the same way."""
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


def _stand(mesh: trimesh.Trimesh, scale: float, turn_deg: Turn) -> trimesh.Trimesh:
    """The mesh scaled, turned, its footprint centred, on z = 0, with the numbers of a binary STL."""
    turned = np.asarray(mesh.vertices) @ (scale * turn_matrix(turn_deg)).T
    low, high = turned.min(axis=0), turned.max(axis=0)
    at = turned - np.array([(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, low[2]])
    return trimesh.Trimesh(at.astype(np.float32), mesh.faces, process=False)


def _check_size(size_mm: np.ndarray, source: str) -> None:
    """Raises ConfigError for an object that the bench has no room for, or that is too small to be held."""
    limits = zip(("wide in x", "wide in y", "high"), size_mm, (*MOST_WIDTH_MM, MOST_HEIGHT_MM), strict=True)
    for how, size, most in limits:
        if size > most:
            raise ConfigError(
                f"{source}: the object is {size:.1f} mm {how}, a place of the bench takes at most {most:g} mm; "
                f"scale it down (by {most / size:.3g} or less) or turn it."
            )
        if size < LEAST_SIZE_MM:
            raise ConfigError(
                f"{source}: the object is {size:.3g} mm {how}, the fingers need {LEAST_SIZE_MM:g} mm at least; scale "
                "it up (`scale = 1000` for a mesh in metres, 25.4 for one in inches)."
            )
