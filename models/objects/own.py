"""Own objects: from parts or a closed mesh to a `RigidObject`, with a number that follows from its content."""

import base64
import hashlib
import io
import re
import zlib
from collections.abc import Sequence

import numpy as np
import trimesh

from fast.models.errors import ConfigError
from fast.models.ids import canonical_json
from fast.models.objects.bodies import check_one_piece, check_parts_touch
from fast.models.objects.catalogue import FIRST_OWN_ID, OBJECTS
from fast.models.objects.distance import distance
from fast.models.objects.grid import SAME_MM, looks_round, surface_points
from fast.models.objects.parts import Part, Turn, turn_matrix
from fast.models.objects.primitives import bounds
from fast.models.objects.rigid import RigidObject
from fast.models.objects.shape_text import (
    MeshShape,
    PartsShape,
    check_mesh,
    measure_mesh,
    mesh_of_shape,
    place_parts,
    read_shape,
    unpack_mesh,
)
from fast.models.objects.surface import surface_of

OWN_CLASS = "own"
LEAST_SIZE_MM, MOST_HEIGHT_MM = 3.0, 50.0
MOST_WIDTH_MM = (64.0, 100.0)  # x: jaws that are 70 mm open pass; y: the fingers keep clear of the next place
_LAST_ID = 2**31 - 1
MOST_LETTERS = 40
_NAME = re.compile(f"[A-Za-z][A-Za-z0-9 _-]{{0,{MOST_LETTERS - 1}}}")
_MIRRORS = (np.array([-1.0, 1.0, 1.0]), np.array([1.0, -1.0, 1.0]))


def object_of_parts(name: str, parts: Sequence[Part], source: str) -> RigidObject:
    """Make the object that is the union of `parts`; `source` names where they came from in messages.

    Raises:
        ConfigError: the name or the size cannot be used, or parts do not touch.
    """
    shape = PartsShape(parts=tuple(parts))
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
    """Make the object of a watertight mesh in mm: scaled, turned, stood on the mount with its footprint centred.

    Raises:
        ConfigError: the mesh is not closed, has no volume, too many triangles, bodies that do not touch or cannot be
            made one solid, or name or size cannot be used.
    """
    stood = _stand(check_mesh(mesh, source), scale, turn_deg)
    _check_size(np.ptp(stood.bounds, axis=0), source)  # before a grid is made for it
    check_one_piece(stood, source)
    packed = base64.b64encode(zlib.compress(trimesh.exchange.stl.export_stl(stood), 9)).decode()
    return _of_placed_mesh(name, MeshShape(is_round=False, edges="sharp", bodies="joined", stl=packed), source)


def object_of_shape(name: str, shape: str, source: str) -> RigidObject:
    """Make the object of a shape's text that another lake wrote; its number is worked out again from the content.

    Raises:
        ConfigError: the text is no shape, or no object that the bench can hold.
    """
    try:
        read = read_shape(shape)
        if isinstance(read, PartsShape):
            return _of_parts(name, read, source)
        mesh = trimesh.load_mesh(io.BytesIO(unpack_mesh(read)), file_type="stl")
    except (ValueError, zlib.error, RecursionError) as error:
        raise ConfigError(f"{source}: the shape of `{name}` cannot be read; export it again.") from error
    _check_size(np.ptp(check_mesh(mesh, source).bounds, axis=0), source)
    return _of_placed_mesh(name, read, source)


def own_id(content: bytes) -> int:
    """Number an own object: from its content, above those of the 36, small enough for any integer column."""
    number = int.from_bytes(hashlib.sha256(content).digest()[:8], "big")
    return FIRST_OWN_ID + number % (_LAST_ID - FIRST_OWN_ID)


def _of_parts(name: str, shape: PartsShape, source: str) -> RigidObject:
    _check_name(name, source)
    rows = place_parts(shape.parts)
    points = np.asarray(surface_of(rows).vertices)
    has_mirrors = [bool(np.abs(distance(rows, points * signs)).max() <= SAME_MM) for signs in _MIRRORS]
    low, high = bounds(rows)
    return _object(name, shape, canonical_json(shape.model_dump()).encode(), high - low, has_mirrors, source)


def _of_placed_mesh(name: str, shape: MeshShape, source: str) -> RigidObject:
    """Make the object of a mesh in the object frame; whether it is round is found out here."""
    _check_name(name, source)  # before a grid is made for it
    mesh = mesh_of_shape(shape, source)
    mesh_grid = measure_mesh(shape.model_copy(update={"is_round": False}))
    points = surface_points(mesh)
    found = shape.model_copy(update={"is_round": looks_round(mesh_grid, points)})
    has_mirrors = [mesh_grid.has_on_surface(points * signs) for signs in _MIRRORS]
    return _object(name, found, unpack_mesh(shape), np.ptp(mesh.bounds, axis=0), has_mirrors, source)


def _object(
    name: str,
    shape: MeshShape | PartsShape,
    content: bytes,
    size_mm: np.ndarray,
    has_mirrors: Sequence[bool],
    source: str,
) -> RigidObject:
    """Make the object; `content` decides its number, `has_mirrors` are those in the planes x = 0 and y = 0."""
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
            f"{MOST_LETTERS} letters, digits, spaces, `_` or `-`, and is none of the 36; rename the file, or set "
            "`name` in a .toml file."
        )


def _stand(mesh: trimesh.Trimesh, scale: float, turn_deg: Turn) -> trimesh.Trimesh:
    """Return the mesh scaled, turned, its footprint centred, on z = 0, with the numbers of a binary STL."""
    turned = np.asarray(mesh.vertices) @ (scale * turn_matrix(turn_deg)).T
    low, high = turned.min(axis=0), turned.max(axis=0)
    at = turned - np.array([(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, low[2]])
    return trimesh.Trimesh(at.astype(np.float32), mesh.faces, process=False)


def _check_size(size_mm: np.ndarray, source: str) -> None:
    """Raise ConfigError for an object that the bench has no room for, or that is too small to be held."""
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
                "it up (in a .toml file `scale = 1000` for a mesh in metres, 25.4 for one in inches)."
            )
