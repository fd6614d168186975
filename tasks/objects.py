"""Own objects from files: a mesh, or a TOML file that says how a mesh stands or of which parts an object is made."""

import io
import logging
import re
import unicodedata
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import trimesh
from pydantic import Field, model_validator

from fast.lake.store import Lake
from fast.lake.tables.campaign import ObjectRow
from fast.models.errors import ConfigError, UsageError
from fast.models.objects.catalogue import FIRST_OWN_ID, OBJECTS, get_object, register
from fast.models.objects.distance import distance_and_normal
from fast.models.objects.own import MOST_LETTERS, object_of_mesh, object_of_parts
from fast.models.objects.parts import Part, Turn
from fast.models.objects.rigid import RigidObject
from fast.models.objects.shape_text import MeshShape, PartsShape, mesh_of_shape, read_shape
from fast.models.objects.surface import object_mesh
from fast.models.records import Record
from fast.models.validation import closest, load_record, parse_toml

MESH_FORMATS = (".stl", ".obj", ".3mf", ".ply")
_SOLID_FORMATS = (".step", ".stp", ".iges", ".igs")  # of CAD programs, which export meshes as well
SUFFIXES = (*MESH_FORMATS, ".toml")
_MOST_BYTES = 50_000_000
_MOST_CROSSED = 100_000  # triangles: three seconds
_CROSSED_SHARE = 1e-4  # of a volume; rounding makes 1e-8
_CROSSING = (
    "faces of one body cross, and the simulator takes those inside of it for surface, so forces may be off; make it "
    "one solid in the program that made it"
)
_SHARP_DEG = 50.0  # a chamfer of 45 deg is 3 % off at most
_ROUNDED_EDGES = (
    "it came to this lake when meshes had their sharp edges rounded, so simulated forces may be up to 30 % off, mostly "
    "too low; use its file with a new lake"
)
_LEAST_WALL_MM, _WALL_STEP_MM = 2.0, 0.25  # fingers sink in by up to a millimetre, then the other side pulls them on
_WALL_SHARE = 0.01  # of the surface
_N_WALL_POINTS = 4000
_WALL_TURN = np.cos(np.radians(30.0))  # between the two sides of a wall; more is a wedge
_ROUNDING_MM = 0.05  # of distances
logger = logging.getLogger(__name__)


class ObjectFile(Record):
    """A TOML file of an own object: `mesh` with how it stands, or `parts`."""

    name: str | None = Field(default=None, description="default: the name of the file")
    mesh: str | None = Field(default=None, description="path of an .stl, .obj, .3mf or .ply file, relative to this one")
    scale: float = Field(default=1.0, gt=0, le=1e6, description="of the mesh, whose numbers are mm")
    turn_deg: Turn = Field(default=(0.0, 0.0, 0.0), description="of the mesh about x, then y, then z")
    parts: tuple[Part, ...] = Field(default=(), max_length=50)

    @model_validator(mode="after")
    def _check_kind(self) -> "ObjectFile":
        if (self.mesh is None) == (not self.parts):
            raise ValueError("it needs either `mesh` or `parts`; add one of them")
        if self.parts and (self.scale != 1.0 or self.turn_deg != (0.0, 0.0, 0.0)):
            raise ValueError("`scale` and `turn_deg` are of a mesh; give each part its own sizes and `turn_deg`")
        return self


def read_object(path: Path) -> RigidObject:
    """Read the own object of a file, known to this process from now on.

    Raises:
        ConfigError: the file is missing, cannot be read, or is no object that the bench can hold.
    """
    _refuse_solid(path)
    if path.suffix.lower() not in SUFFIXES:
        raise ConfigError(f"object file `{path}` is of no known kind; give one that ends in {', '.join(SUFFIXES)}.")
    if path.suffix.lower() in MESH_FORMATS:
        obj = object_of_mesh(_name_of(path), _read_mesh(path), str(path))
    else:
        obj = _read_description(path)
    register(obj)
    return obj


def read_objects(paths: Sequence[Path]) -> list[RigidObject]:
    """Read own objects of several files.

    Raises:
        ConfigError: as `read_object`, or two files hold the same object or have the same name.
    """
    found: list[RigidObject] = []
    for path in paths:
        obj = read_object(path)
        for other, other_path in zip(found, paths, strict=False):
            if obj.object_id == other.object_id:
                raise ConfigError(f"object files `{other_path}` and `{path}` hold the same object; leave one out.")
        check_names([obj], found)
        found.append(obj)
    return found


def check_names(new: Sequence[RigidObject], known: Sequence[RigidObject]) -> None:
    """Refuse a name that another object has.

    Raises:
        ConfigError: with the name.
    """
    by_name = {obj.name.casefold(): obj.object_id for obj in known}
    for obj in new:
        if by_name.get(obj.name.casefold(), obj.object_id) != obj.object_id:
            raise ConfigError(f"another object is called `{obj.name}`; give this one another `name` in its .toml file.")


def _read_description(path: Path) -> RigidObject:
    try:
        text = _read_bytes(path).decode("utf-8-sig")  # editors of Windows write the mark
    except UnicodeDecodeError as error:
        raise ConfigError(f"object file `{path}` is not a text file; give a TOML file.") from error
    told = load_record(ObjectFile, parse_toml(text, f"object file `{path}`"), str(path))
    name = _name_of(path) if told.name is None else told.name
    if told.mesh is None:
        return object_of_parts(name, told.parts, str(path))
    mesh_path = path.parent / told.mesh
    _refuse_solid(mesh_path)
    if mesh_path.suffix.lower() not in MESH_FORMATS:
        raise ConfigError(f"{path}: `mesh` is {told.mesh!r}, it must end in {', '.join(MESH_FORMATS)}; change it.")
    return object_of_mesh(name, _read_mesh(mesh_path), str(mesh_path), scale=told.scale, turn_deg=told.turn_deg)


def _refuse_solid(path: Path) -> None:
    if path.suffix.lower() in _SOLID_FORMATS:
        raise ConfigError(
            f"object file `{path}` is a solid of a CAD program, here are read meshes; export it there as 3MF, or as "
            "STL or OBJ in mm."
        )


def _read_mesh(path: Path) -> trimesh.Trimesh:
    """Read the mesh of a file in mm, equal corners of its triangles made one."""
    data, kind = _read_bytes(path), path.suffix.lower().removeprefix(".")
    logging.getLogger("trimesh").setLevel(logging.ERROR)
    try:
        scene = trimesh.load_scene(io.BytesIO(data), file_type=kind)
        if kind == "3mf" and scene.units is not None:  # the other formats have no unit
            scene = scene.convert_units("mm")
        mesh = scene.to_mesh()
    except Exception as error:
        raise ConfigError(f"mesh `{path}` cannot be read as {kind.upper()} ({error}); export it again.") from error
    if len(mesh.faces) == 0:
        raise ConfigError(f"mesh `{path}` has no triangles that can be read as {kind.upper()}; export it again.")
    mesh.merge_vertices(merge_tex=True, merge_norm=True)
    if _crosses_itself(mesh):
        logger.warning("mesh `%s`: %s.", path, _CROSSING)
    return mesh


def _crosses_itself(mesh: trimesh.Trimesh) -> bool:
    """Return whether a body's own faces cross: with itself it then makes another volume. Skip large meshes."""
    if len(mesh.faces) > _MOST_CROSSED:
        return False
    with np.errstate(invalid="ignore", divide="ignore"):  # what has no volume has no centre
        bodies = [body for body in mesh.split(only_watertight=True) if body.is_volume]
    for body in bodies:
        again = trimesh.boolean.union([body, body], engine="manifold")
        if abs(again.volume - body.volume) > _CROSSED_SHARE * body.volume:
            return True
    return False


def _name_of(path: Path) -> str:
    """Name an object after its file: what a name cannot hold becomes `-`, and it begins with a letter."""
    plain = unicodedata.normalize("NFKD", path.stem).encode("ascii", "ignore").decode()
    name = re.sub(r"[^A-Za-z0-9 _-]+", "-", plain).strip("- ")
    return (name if name[:1].isalpha() else f"object {name}".strip())[:MOST_LETTERS]


def _read_bytes(path: Path) -> bytes:
    try:
        if path.stat().st_size > _MOST_BYTES:
            size = path.stat().st_size / 1e6
            raise ConfigError(f"object file `{path}` has {size:.0f} MB, at most {_MOST_BYTES / 1e6:.0f} are read.")
        return path.read_bytes()
    except FileNotFoundError as error:
        raise ConfigError(f"object file `{path}` does not exist; give the path of an existing file.") from error
    except OSError as error:
        raise ConfigError(f"object file `{path}` cannot be read ({error.strerror}); check the path.") from error


def find_object(text: str, lake: Path | str) -> RigidObject:
    """Find the object that a person named: by number, by name (of the 36 or an own one of the lake), or by its file.

    A warning says of an own object with thin walls, or with edges rounded by an earlier version, that its forces may be
    off.

    Raises:
        UsageError: nothing is called so, or the file cannot be used.
    """
    found = _find(text, lake)
    warn_of_shape(found)
    return found


def warn_of_shape(obj: RigidObject) -> None:
    """Log that simulated forces on an own object may be off: it has thin walls, or edges that were rounded."""
    if obj.shape is None:
        return
    _warn_of_edges(obj, read_shape(obj.shape))
    wall_mm = _find_thin_wall_mm(obj)
    if wall_mm is not None:
        logger.warning(
            "%s: it has walls thinner than %g mm; fingers may go through walls below %g mm, and simulated forces be "
            "many times too high or too low; fill it where no finger reaches.",
            obj.name,
            wall_mm,
            _LEAST_WALL_MM,
        )


def _find_thin_wall_mm(obj: RigidObject) -> float | None:
    """Find a thickness that walls on a hundredth of the surface do not have; None where they have enough."""
    mesh = object_mesh(obj)
    points, faces = trimesh.sample.sample_surface(mesh, _N_WALL_POINTS, seed=0)
    inward = -mesh.face_normals[faces]
    for wall_mm in np.arange(_WALL_STEP_MM, _LEAST_WALL_MM + _WALL_STEP_MM / 2, _WALL_STEP_MM):
        outside_mm, normal = distance_and_normal(obj.primitives, points + wall_mm * inward)
        is_through = (outside_mm > _ROUNDING_MM) & ((normal * inward).sum(axis=1) > _WALL_TURN)
        if is_through.mean() > _WALL_SHARE:
            return float(wall_mm)
    return None


def _warn_of_edges(obj: RigidObject, read: MeshShape | PartsShape) -> None:
    """Log it of a mesh of an earlier version whose edges are rounded where they stick out."""
    if not isinstance(read, MeshShape) or read.edges == "sharp":
        return
    mesh = mesh_of_shape(read)
    is_sharp = mesh.face_adjacency_convex & (mesh.face_adjacency_angles > np.radians(_SHARP_DEG))
    begin, end = np.moveaxis(mesh.vertices[mesh.face_adjacency_edges[is_sharp]], 1, 0)
    if np.linalg.norm(end - begin, axis=1).sum() > mesh.extents.max():
        logger.warning("%s: %s.", obj.name, _ROUNDED_EDGES)


def _find(text: str, lake: Path | str) -> RigidObject:
    if text.lstrip("-").isdecimal():
        return _by_number(int(text), lake)
    if Path(text).suffix.lower() in (*SUFFIXES, *_SOLID_FORMATS):
        return read_object(Path(text))
    word = text.casefold().replace("-", " ")
    own = own_objects(lake)
    by_name = {obj.name.casefold().replace("-", " "): obj for obj in (*own, *OBJECTS)}
    if word not in by_name:
        raise UsageError(f"no object is called `{text}`; {closest(word, list(by_name))}")
    return by_name[word]


def own_objects(lake: Path | str) -> list[RigidObject]:
    """List the own objects of a lake, by name, known to this process from now on; none where there is no lake."""
    if not Lake.exists(lake):
        return []
    found = Lake.open(lake)
    rows = [row for row in found.records(ObjectRow) if row.shape is not None]
    objects = [obj for row in rows if (obj := row.own_object) is not None]
    found.close()
    for obj in objects:
        register(obj)
    return sorted(objects, key=lambda obj: obj.name.casefold())


def _by_number(object_id: int, lake: Path | str) -> RigidObject:
    if object_id >= FIRST_OWN_ID:
        own_objects(lake)
    return get_object(object_id)
