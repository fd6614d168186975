"""The 36 test objects, fixed once: a table of data, from which shapes follow; and the way to own objects by number.

The paper (Materials and Methods, Test objects) gives the classes, the 50 mm box and a few numbers: 14 is a tube, 24 and
25 are cones, 30 to 35 have flat sides. The rest is this project's choice. Sizes are those of the sharp shape;
`rounding_mm` then takes away edges and tips.
"""

import weakref
from typing import Protocol

from fast.models.errors import UsageError
from fast.models.objects.rigid import Orientation, RigidObject
from fast.models.validation import check_whole

FIRST_OWN_ID = 1000  # numbers of own objects follow from their content, see `models.objects.own`


class ObjectSource(Protocol):
    """What knows own objects by number: a lake."""

    def find_object(self, object_id: int) -> RigidObject | None:
        """Find the own object with this number, if it is known here."""
        ...


_OWN: dict[int, RigidObject] = {}
_SOURCES: "weakref.WeakSet[ObjectSource]" = weakref.WeakSet()


def register(obj: RigidObject) -> None:
    """Have `get_object` know an own object in this process. Its number is its content's, so no two can clash."""
    _OWN[obj.object_id] = obj


def list_known() -> tuple[RigidObject, ...]:
    """List the 36, and the own objects that this process knows."""
    return (*OBJECTS, *_OWN.values())


def add_source(source: ObjectSource) -> None:
    """Have `get_object` ask a source, as long as it is in use, for own objects that this process does not know yet."""
    _SOURCES.add(source)


def find_object(object_id: int) -> RigidObject | None:
    """Find the object with this number; None where neither this process nor a lake that it has open knows it."""
    if 0 <= object_id < len(OBJECTS):
        return OBJECTS[object_id]
    if object_id in _OWN or object_id < FIRST_OWN_ID:
        return _OWN.get(object_id)
    for source in list(_SOURCES):
        found = source.find_object(object_id)
        if found is not None:
            register(found)
            return found
    return None


def get_object(object_id: int) -> RigidObject:
    """Return the object with this number.

    Raises:
        UsageError: there is no such object, or it is no number.
    """
    object_id = check_whole(object_id, "the object's number", least=None)
    found = find_object(object_id)
    if found is None and object_id >= FIRST_OWN_ID:
        raise UsageError(
            f"object {object_id} is an own object that this lake does not have; add its file with `fast objects add`."
        )
    if found is None:
        raise UsageError(f"object {object_id} does not exist; the numbers go from 0 to {len(OBJECTS) - 1}.")
    return found


def name_object(object_id: int) -> str:
    """Return the name and number of an object; the number alone where nothing has it."""
    found = find_object(object_id)
    return f"object {object_id}" if found is None else f"{found.name} ({object_id})"


_Entry = tuple[str, str, Orientation, dict[str, float]]

# Position in the list is the object's number. Recorded data refer to it: never reorder, never change a shape.
_ENTRIES: tuple[_Entry, ...] = (
    ("small sphere", "sphere", "axis z", {"diameter_mm": 30}),
    ("sphere", "sphere", "axis z", {"diameter_mm": 40}),
    ("large sphere", "sphere", "axis z", {"diameter_mm": 48}),
    ("ellipsoid", "ellipsoid", "axis z", {"size_x_mm": 36, "size_y_mm": 28, "size_z_mm": 48}),
    ("slim cylinder", "cylinder", "axis z", {"diameter_mm": 30, "length_mm": 48, "rounding_mm": 1}),
    ("wide cylinder", "cylinder", "axis z", {"diameter_mm": 44, "length_mm": 40, "rounding_mm": 1}),
    ("cylinder along y", "cylinder", "axis y", {"diameter_mm": 36, "length_mm": 48, "rounding_mm": 1}),
    ("cylinder along x", "cylinder", "axis x", {"diameter_mm": 32, "length_mm": 44, "rounding_mm": 1}),
    ("flat disc", "disc", "axis z", {"diameter_mm": 48, "length_mm": 14, "rounding_mm": 1}),
    ("upright disc", "disc", "axis y", {"diameter_mm": 46, "length_mm": 16, "rounding_mm": 1}),
    ("flat torus", "torus", "axis z", {"ring_diameter_mm": 34, "tube_diameter_mm": 14}),
    ("small flat torus", "torus", "axis z", {"ring_diameter_mm": 22, "tube_diameter_mm": 12}),
    ("upright torus", "torus", "axis y", {"ring_diameter_mm": 34, "tube_diameter_mm": 14}),
    ("spiral", "spiral", "axis z", {"coil_diameter_mm": 36, "wire_diameter_mm": 8, "pitch_mm": 14, "turns": 2.75}),
    ("tube", "tube", "axis z", {"diameter_mm": 42, "bore_mm": 28, "length_mm": 46, "rounding_mm": 1}),
    ("tube along y", "tube", "axis y", {"diameter_mm": 40, "bore_mm": 26, "length_mm": 46, "rounding_mm": 1}),
    ("diamond", "diamond", "axis z", {"width_mm": 40, "height_mm": 50, "rounding_mm": 1}),
    ("wide diamond", "diamond", "axis z", {"width_mm": 48, "height_mm": 36, "rounding_mm": 1}),
    ("turned diamond", "diamond", "turned 45 deg", {"width_mm": 35, "height_mm": 48, "rounding_mm": 1}),
    ("pyramid", "pyramid", "axis z", {"base_mm": 46, "top_mm": 0, "height_mm": 46, "rounding_mm": 1}),
    ("turned pyramid", "pyramid", "turned 45 deg", {"base_mm": 35, "top_mm": 0, "height_mm": 44, "rounding_mm": 1}),
    ("triangle", "triangle", "axis z", {"sides": 3, "apothem_mm": 13.5, "height_mm": 36, "rounding_mm": 1}),
    ("inverted pyramid", "pyramid", "upside down", {"base_mm": 46, "top_mm": 16, "height_mm": 44, "rounding_mm": 1}),
    ("jack", "jack", "axis z", {"length_mm": 48, "rod_diameter_mm": 9, "ball_diameter_mm": 14}),
    ("cone", "cone", "axis z", {"base_mm": 46, "top_mm": 0, "height_mm": 48, "rounding_mm": 1}),
    ("truncated cone", "cone", "axis z", {"base_mm": 44, "top_mm": 20, "height_mm": 44, "rounding_mm": 1}),
    ("diabolo", "diabolo", "axis z", {"end_mm": 46, "waist_mm": 18, "height_mm": 46, "rounding_mm": 1}),
    ("diabolo along y", "diabolo", "axis y", {"end_mm": 44, "waist_mm": 22, "height_mm": 48, "rounding_mm": 1}),
    (
        "hourglass",
        "hourglass",
        "axis z",
        {"end_mm": 42, "waist_mm": 26, "neck_mm": 10, "rim_mm": 5, "height_mm": 50, "rounding_mm": 1},
    ),
    (
        "wide hourglass",
        "hourglass",
        "axis z",
        {"end_mm": 48, "waist_mm": 36, "neck_mm": 14, "rim_mm": 6, "height_mm": 46, "rounding_mm": 1},
    ),
    ("cube", "cube", "axis z", {"size_x_mm": 40, "size_y_mm": 40, "size_z_mm": 40, "rounding_mm": 1}),
    ("small cube", "cube", "axis z", {"size_x_mm": 28, "size_y_mm": 28, "size_z_mm": 28, "rounding_mm": 1}),
    ("turned cube", "cube", "turned 45 deg", {"size_x_mm": 34, "size_y_mm": 34, "size_z_mm": 34, "rounding_mm": 1}),
    ("block", "prism", "axis z", {"sides": 4, "apothem_mm": 15, "height_mm": 50, "rounding_mm": 1}),
    ("hexagonal prism", "prism", "axis z", {"sides": 6, "apothem_mm": 20, "height_mm": 45, "rounding_mm": 1}),
    ("octagonal prism along y", "prism", "axis y", {"sides": 8, "apothem_mm": 19, "height_mm": 48, "rounding_mm": 1}),
)
_NOT_MIRROR_X = {"spiral", "triangle"}
_NOT_MIRROR_Y = {"spiral"}

OBJECTS: tuple[RigidObject, ...] = tuple(
    RigidObject(
        object_id=number,
        name=name,
        object_class=object_class,
        parameters=parameters,
        orientation=orientation,
        mirror_x=object_class not in _NOT_MIRROR_X,
        mirror_y=object_class not in _NOT_MIRROR_Y,
    )
    for number, (name, object_class, orientation, parameters) in enumerate(_ENTRIES)
)
