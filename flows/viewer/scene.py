"""Meshes of fingers and objects as Rerun archetypes, in the object frame (mm, z up, x closing)."""

from collections.abc import Sequence

import numpy as np
import rerun as rr
import trimesh
from matplotlib.colors import to_rgb

from fast.flows.report.style import COMPLIANT, OBJECT, RIGID
from fast.models.design.finger import FingerBodies, finger_bodies
from fast.models.design.glyphs import is_mark
from fast.models.objects.catalogue import get_object
from fast.models.objects.surface import object_mesh
from fast.models.records import Design, GraspSetup, Trace

OBJECT_SPACING_MM = 2.0
CREASE_RAD = np.radians(35.0)  # faces that meet at more are shaded each for itself
SIDES = {"right": 1.0, "left": -1.0}


def marked_bodies(design: Design, label: str | None = None) -> FingerBodies:
    """Build a finger's bodies with its label as id mark, or with none where another lab's label cannot be a mark."""
    return finger_bodies(design, label if label is not None and is_mark(label) else None)


def build_fingers(design: Design, label: str | None = None) -> dict[str, rr.Mesh3D]:
    """Build hanging fingers, tips down, faces in the plane x = 0, by entity name (`right/compliant`, ...)."""
    bodies = marked_bodies(design, label)
    found = {}
    for side, sign in SIDES.items():
        for name, body, colour in (("compliant", bodies.compliant, COMPLIANT), ("rigid", bodies.rigid, RIGID)):
            hanging = body.copy()
            # Turned tips down by half a turn about x; the left one by another half turn about z.
            hanging.apply_transform(np.diag([sign, -sign, -1.0, 1.0]))
            found[f"{side}/{name}"] = flatten_mesh(hanging, colour)
    return found


def move_fingers(design: Design, setup: GraspSetup, trace: Trace) -> dict[str, np.ndarray]:
    """Return where the undeformed fingers are at each of the n samples of a grasp, n x 3 in mm, by side.

    The jaws are taken to close evenly until the lift starts.
    """
    closing = trace.time_s[~trace.is_lift]
    closing_s = float(closing[-1]) if closing.size else 0.0
    share = np.clip(trace.time_s / closing_s, 0.0, 1.0) if closing_s > 0 else np.ones_like(trace.time_s)
    half_gap = (setup.open_gap_mm + (setup.closed_gap_mm - setup.open_gap_mm) * share) / 2
    height = design.height_mm - setup.tip_below_mm + trace.lift_mm
    zero = np.zeros_like(height)
    return {side: np.column_stack([sign * half_gap, zero, height]) for side, sign in SIDES.items()}


def draw_object(object_id: int, place_mm: Sequence[float] = (0.0, 0.0, 0.0), colour: str | None = OBJECT) -> rr.Mesh3D:
    """Draw a test object with its bottom at a place; without a colour, another message may give it one.

    Raises:
        UsageError: the catalogue has no such object.
    """
    obj = get_object(object_id)
    mesh = object_mesh(obj, spacing_mm=OBJECT_SPACING_MM)
    if obj.shape is not None:  # which may have sharp edges; those of the 36 are rounded
        mesh = trimesh.graph.smooth_shade(mesh, angle=CREASE_RAD, facet_minarea=None)
    return rr.Mesh3D(
        vertex_positions=np.asarray(mesh.vertices) + np.array(place_mm),
        vertex_normals=np.asarray(mesh.vertex_normals),
        triangle_indices=np.asarray(mesh.faces),
        albedo_factor=None if colour is None else rgb(colour),
    )


def flatten_mesh(mesh: trimesh.Trimesh, colour: str) -> rr.Mesh3D:
    """Make a mesh with its own corners for every triangle, so that creases stay sharp."""
    corners = np.asarray(mesh.vertices)[np.asarray(mesh.faces)].reshape(-1, 3)
    return rr.Mesh3D(
        vertex_positions=corners,
        vertex_normals=np.repeat(np.asarray(mesh.face_normals), 3, axis=0),
        triangle_indices=np.arange(len(corners)).reshape(-1, 3),
        albedo_factor=rgb(colour),
    )


def rgb(colour: str) -> list[int]:
    """Return a `#rrggbb` colour as three numbers 0-255."""
    return [round(255 * part) for part in to_rgb(colour)]
