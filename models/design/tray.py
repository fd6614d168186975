"""A batch on the printer's build plate: where every finger lies, and the files to print."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import cast

import numpy as np
import trimesh

from fast.models.design.finger import FingerBodies, finger_bodies
from fast.models.design.three_mf import BaseMaterial, add_materials
from fast.models.errors import UsageError
from fast.models.records import Design

FINGERS_PER_TOOL = 2
BED_MM = (490.0, 390.0)  # build plate of the paper's printer, Stratasys J850
# Of the bodies of a finger, by the end of their names; colours as the paper printed them, black on white.
MATERIALS = {
    "compliant": BaseMaterial("compliant (soft fingers)", "#303030FF"),
    "rigid": BaseMaterial("rigid (mounting bases)", "#F0F0F0FF"),
}
GAP_MM = 6.0  # between fingers, for support removal


@dataclass(frozen=True)
class PrintItem:
    """A tool to print: its label (`B07T8`) and design."""

    label: str
    design: Design


@dataclass(frozen=True)
class PlacedFinger:
    """A finger lying on its side: its lower left corner on the plate and its extent there, mm."""

    label: str
    design: Design
    x_mm: float
    y_mm: float
    length_mm: float
    height_mm: float


def tray_layout(items: Sequence[PrintItem], bed_mm: tuple[float, float] = BED_MM) -> list[PlacedFinger]:
    """Place two fingers per tool in rows from the front left, `GAP_MM` apart.

    Raises:
        UsageError: the batch does not fit on the plate.
    """
    placed: list[PlacedFinger] = []
    x, y, row_height = GAP_MM, GAP_MM, 0.0
    for item in items:
        for _ in range(FINGERS_PER_TOOL):
            length, height = item.design.length_mm, item.design.height_mm
            if x + length + GAP_MM > bed_mm[0]:
                x, y, row_height = GAP_MM, y + row_height + GAP_MM, 0.0
            if y + height + GAP_MM > bed_mm[1] or length + 2 * GAP_MM > bed_mm[0]:
                raise UsageError(
                    f"{len(items)} tools do not fit on a build plate of {bed_mm[0]:g} x {bed_mm[1]:g} mm "
                    f"(full after {len(placed)} fingers); print smaller batches or give a larger plate."
                )
            placed.append(PlacedFinger(item.label, item.design, x, y, length, height))
            x, row_height = x + length + GAP_MM, max(row_height, height)
    return placed


def tray_files(items: Sequence[PrintItem], bed_mm: tuple[float, float] = BED_MM) -> dict[str, bytes]:
    """Files to print: per tool one STL per body, and `tray.3mf` with every finger in its place.

    Raises:
        UsageError: the batch does not fit on the plate.
    """
    layout = tray_layout(items, bed_mm)
    bodies = {item.label: finger_bodies(item.design, item.label) for item in items}
    files: dict[str, bytes] = {}
    for label, finger in bodies.items():
        files[f"{label}_compliant.stl"] = _stl(finger.compliant)
        files[f"{label}_rigid.stl"] = _stl(finger.rigid)
    packed = cast(bytes, _tray_scene(layout, bodies).export(file_type="3mf"))
    files["tray.3mf"] = add_materials(packed, MATERIALS)
    return files


def _stl(body: trimesh.Trimesh) -> bytes:
    return cast(bytes, body.export(file_type="stl"))  # binary STL


def _tray_scene(layout: Sequence[PlacedFinger], bodies: dict[str, FingerBodies]) -> trimesh.Scene:
    scene = trimesh.Scene()
    for number, place in enumerate(layout):
        finger = bodies[place.label]
        for material, body in (("compliant", finger.compliant), ("rigid", finger.rigid)):
            name = f"{place.label}{'ab'[number % FINGERS_PER_TOOL]}_{material}"
            scene.add_geometry(body, node_name=name, geom_name=name, transform=lying(place))
    return scene


def lying(place: PlacedFinger) -> np.ndarray:
    """Finger frame (x, y, z) to plate: x stays, z lies along the plate's y, the width points up."""
    half = place.design.width_mm / 2
    return np.array([[1, 0, 0, place.x_mm], [0, 0, 1, place.y_mm], [0, -1, 0, half], [0, 0, 0, 1]], dtype=float)
