"""The bench that a campaign works on, as it stands: sheet and mounts of the objects, and where to look from."""

from collections.abc import Sequence

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from flows.report.style import FAINT, MUTED
from flows.viewer.scene import rgb
from flows.viewer.stream import eye_around
from hardware.cell.layout import BenchLayout

HEAD_ROOM_MM = 210.0  # a gripper at the end of its lift
ROUND_MM = 75.0  # about an object: half of the pitch
_MOUNT_MM = 22.0
_SHEET_MM = 6.0
_FROM = (-0.1, -0.8, 0.62)  # direction from the objects to the eye


def send_bench(stream: rr.RecordingStream, layout: BenchLayout, objects: Sequence[int]) -> None:
    """The sheet under these objects and a mount for each; nothing where no object is known."""
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


def bench_eye(layout: BenchLayout, objects: Sequence[int]) -> rrb.EyeControls3D:
    """An eye in front of the bench from which all these objects, and a gripper over them, are seen."""
    low, high = _extent(layout, objects or range(layout.n_columns**2))
    return eye_around([*low, 0.0], [*high, HEAD_ROOM_MM], _FROM)


def _extent(layout: BenchLayout, objects: Sequence[int]) -> tuple[np.ndarray, np.ndarray]:
    """Least and largest x and y (mm) of the ground around these objects."""
    places = np.array([layout.object_xy_mm(number) for number in objects])
    return places.min(axis=0) - ROUND_MM, places.max(axis=0) + ROUND_MM
