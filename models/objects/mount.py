"""An object on its mount, as one body to print: a foot on the sheet, a post, and the object on it."""

from contextlib import suppress

import trimesh

from fast.models.errors import ConfigError, UsageError
from fast.models.objects.bodies import join_bodies
from fast.models.objects.rigid import RigidObject
from fast.models.objects.surface import object_mesh, surface_of

MOUNT_HEIGHT_MM = 33.0  # as in `hardware.parts.layout.BenchLayout`, from the sheet to the object's bottom
POST_DIAMETER_MM = 12.0  # fingers that close to 16 mm pass below the object
FOOT_MM = (40.0, 40.0, 3.0)  # tips that hang 30 mm below the object stay above it
_OVERLAP_MM = 1.0  # of the post and the object
_SPACING_MM = 0.5


def printable_mesh(obj: RigidObject, mount_height_mm: float = MOUNT_HEIGHT_MM) -> trimesh.Trimesh:
    """Make the watertight mesh of an object on its mount, mm; z = 0 is the sheet.

    Raises:
        UsageError: there is no material over the post to stand on, or the object would be printed in pieces.
    """
    body = unmounted_mesh(obj)
    if (n_pieces := _count_pieces(body)) > 1:
        raise UsageError(
            f"{obj.name} would be printed in {n_pieces} pieces, which do not quite touch; let them overlap by "
            f"{_SPACING_MM:g} mm in the file of the object."
        )
    body.apply_translation([0.0, 0.0, mount_height_mm])
    length = mount_height_mm + _OVERLAP_MM
    post = trimesh.creation.cylinder(POST_DIAMETER_MM / 2, length, sections=64)
    post.apply_translation([0.0, 0.0, length / 2])
    foot = trimesh.creation.box(FOOT_MM)
    foot.apply_translation([0.0, 0.0, FOOT_MM[2] / 2])
    whole = trimesh.boolean.union([body, post, foot], engine="manifold")
    if _count_pieces(whole) != 1:
        raise UsageError(
            f"{obj.name} has no material over the middle of its footprint, where the post of {POST_DIAMETER_MM:g} mm "
            "would hold it; give it a floor, or print the object alone."
        )
    return whole


def unmounted_mesh(obj: RigidObject) -> trimesh.Trimesh:
    """Make a watertight mesh of an object alone, mm; z = 0: its bottom. Bodies that overlap are one, cavities stay."""
    with suppress(ConfigError):
        mesh = join_bodies(object_mesh(obj, _SPACING_MM), obj.name)
        if mesh.is_volume:
            return mesh
    return surface_of(obj.primitives, _SPACING_MM)  # what is no clean solid is printed as the simulator sees it


def _count_pieces(mesh: trimesh.Trimesh) -> int:
    """Count the bodies of a mesh that hang together; a closed cavity is none."""
    return len([body for body in mesh.split(only_watertight=False) if body.volume > 0.0])
