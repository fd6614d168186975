"""The bench that a campaign works on: sheet and mounts of the objects, the head with a tool, and where to look from."""

from collections.abc import Sequence

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
import trimesh

from fast.flows.report.style import FAINT, MUTED
from fast.flows.viewer.scene import rgb
from fast.flows.viewer.stream import fit_eye
from fast.hardware.parts.layout import BenchLayout
from fast.models.records import Design, GraspSetup

HEAD_ROOM_MM = 210.0  # a gripper at the end of its lift
ROUND_MM = 75.0  # about an object: half of the pitch
_MOUNT_MM = 22.0
_SHEET_MM = 6.0
HEAD_MM = (110.0, 60.0, 24.0)
_FROM = (-0.1, -0.8, 0.62)  # direction from the objects to the eye


def send_bench(stream: rr.RecordingStream, layout: BenchLayout, objects: Sequence[int]) -> None:
    """Send the sheet under these objects and a mount for each; nothing where no object is known."""
    if not objects:
        return
    low, high = _extent(layout, objects)
    middle, size = [*(low + high) / 2, -_SHEET_MM / 2], [*(high - low), _SHEET_MM]
    sheet = rr.Boxes3D(centers=[middle], sizes=[size], colors=rgb(FAINT), fill_mode="solid")
    stream.log("cell/sheet", sheet, static=True)
    height = layout.mount_height_mm
    centers = [[*layout.object_xy_mm(number), height / 2] for number in objects]
    sizes = [[_MOUNT_MM, _MOUNT_MM, height]] * len(centers)
    mounts = rr.Boxes3D(centers=centers, sizes=sizes, colors=rgb(MUTED), fill_mode="solid")
    stream.log("cell/mounts", mounts, static=True)


def place_bench_eye(layout: BenchLayout, objects: Sequence[int]) -> rrb.EyeControls3D:
    """Place an eye in front of the bench from which all these objects, and a gripper over them, are seen."""
    low, high = _extent(layout, objects or range(layout.n_columns**2))
    return fit_eye([*low, 0.0], [*high, HEAD_ROOM_MM], _FROM)


def build_head(design: Design) -> list[tuple[str, trimesh.Trimesh]]:
    """Build head, right and left finger as a few triangles, by name, mm: z = 0 at the tips, gripper around x = y = 0.

    The fingers, prisms without ribs so that many tools stay small, stand at half of their way between open and closed.
    """
    setup = GraspSetup()
    gap = 0.25 * (setup.open_gap_mm + setup.closed_gap_mm)
    head = trimesh.creation.box(HEAD_MM)
    head.apply_translation([0.0, 0.0, design.height_mm + HEAD_MM[2] / 2])
    return [("head", head), *((side, _prism(design, sign, gap)) for side, sign in (("right", 1.0), ("left", -1.0)))]


def _prism(design: Design, sign: float, gap_mm: float) -> trimesh.Trimesh:
    """Build a finger as a prism over the triangle of front face, base and back, tip down."""
    profile = np.array([[gap_mm, 0.0], [gap_mm, design.height_mm], [gap_mm + design.length_mm, design.height_mm]])
    half = design.width_mm / 2
    corners = np.array([[sign * x, y, z] for y in (-half, half) for x, z in profile])
    return trimesh.convex.convex_hull(corners)


def _extent(layout: BenchLayout, objects: Sequence[int]) -> tuple[np.ndarray, np.ndarray]:
    """Compute the least and largest x and y (mm) of the ground around these objects."""
    places = np.array([layout.object_xy_mm(number) for number in objects])
    return places.min(axis=0) - ROUND_MM, places.max(axis=0) + ROUND_MM
