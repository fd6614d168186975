"""The head with a tool as a few triangles, for scenes with many tools: fingers as wedges without their ribs."""

import numpy as np
import trimesh

from models.records import Design, GraspSetup

HEAD_MM = (110.0, 60.0, 24.0)
_FACES = ((0, 2, 1), (3, 4, 5), (0, 1, 4), (0, 4, 3), (1, 2, 5), (1, 5, 4), (2, 0, 3), (2, 3, 5))


def head_and_wedges(design: Design) -> list[tuple[str, trimesh.Trimesh]]:
    """Head, right and left finger by name, mm: z = 0 at the tips' ends, the middle of the gripper in x = y = 0.

    The fingers stand at half of their way between open and closed.
    """
    setup = GraspSetup()
    gap = 0.25 * (setup.open_gap_mm + setup.closed_gap_mm)
    head = trimesh.creation.box(HEAD_MM)
    head.apply_translation([0.0, 0.0, design.height_mm + HEAD_MM[2] / 2])
    return [("head", head), *((side, _wedge(design, sign, gap)) for side, sign in (("right", 1.0), ("left", -1.0)))]


def _wedge(design: Design, sign: float, gap_mm: float) -> trimesh.Trimesh:
    """A finger as a prism over the triangle of front face, base and back, tip down."""
    profile = np.array([[gap_mm, 0.0], [gap_mm, design.height_mm], [gap_mm + design.length_mm, design.height_mm]])
    half = design.width_mm / 2
    corners = np.array([[sign * x, y, z] for y in (-half, half) for x, z in profile])
    wedge = trimesh.Trimesh(corners, np.array(_FACES), process=False)
    wedge.fix_normals()
    return wedge
