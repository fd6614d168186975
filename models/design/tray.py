"""A batch on the printer's build plate: where every finger lies, and the files to print."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, cast

import numpy as np
import trimesh

from fast.models.design.finger import FingerBodies, finger_bodies
from fast.models.design.recipe import Recipe
from fast.models.design.three_mf import BaseMaterial, Part, write_3mf
from fast.models.errors import UsageError
from fast.models.records import Design

FINGERS_PER_TOOL = 2
BED_MM = (490.0, 390.0)  # build plate of the paper's printer, Stratasys J850
# Of the bodies of a finger where no recipe says it, by the end of their names.
MATERIALS = {
    "compliant": BaseMaterial("compliant (soft fingers)", "#303030"),
    "rigid": BaseMaterial("rigid (mounting bases)", "#F0F0F0"),
}
GAP_MM = 6.0  # between fingers, for support removal


@dataclass(frozen=True)
class PrintItem:
    """A tool to print: its label (`B07T8`) and design."""

    label: str
    design: Design


@dataclass(frozen=True)
class PlacedFinger:
    """A finger lying on its side: its lower left corner on its plate (from 0) and its extent there, mm."""

    label: str
    design: Design
    x_mm: float
    y_mm: float
    length_mm: float
    height_mm: float
    plate: int = 0


def tray_layout(items: Sequence[PrintItem], bed_mm: tuple[float, float] = BED_MM) -> list[PlacedFinger]:
    """Place two fingers per tool in rows from the front left, `GAP_MM` apart, on as many plates as it takes.

    Raises:
        UsageError: a finger is larger than the plate.
    """
    placed: list[PlacedFinger] = []
    end = _End()
    for item in items:
        check_bed(item.design.length_mm, item.design.height_mm, bed_mm, item.label)
        pair, after = _place_pair(item, end, bed_mm)
        if pair[0].plate == end.plate < pair[-1].plate:  # the fingers of a tool stay together where a plate holds both
            pair, after = _place_pair(item, _End(plate=end.plate + 1), bed_mm)
        placed, end = placed + pair, after
    return placed


class _End(NamedTuple):
    """Where the next finger may lie, mm, how high its row is so far, and on which plate."""

    x_mm: float = GAP_MM
    y_mm: float = GAP_MM
    row_mm: float = 0.0
    plate: int = 0


def _place_pair(item: PrintItem, end: _End, bed_mm: tuple[float, float]) -> tuple[list[PlacedFinger], _End]:
    """Place the fingers of a tool from `end` on, and tell where the next tool begins."""
    length, height, pair = item.design.length_mm, item.design.height_mm, []
    for _ in range(FINGERS_PER_TOOL):
        if end.x_mm + length + GAP_MM > bed_mm[0]:
            end = _End(GAP_MM, end.y_mm + end.row_mm + GAP_MM, 0.0, end.plate)
        if end.y_mm + height + GAP_MM > bed_mm[1]:
            end = _End(plate=end.plate + 1)
        pair.append(PlacedFinger(item.label, item.design, end.x_mm, end.y_mm, length, height, end.plate))
        end = end._replace(x_mm=end.x_mm + length + GAP_MM, row_mm=max(end.row_mm, height))
    return pair, end


def check_bed(length_mm: float, height_mm: float, bed_mm: tuple[float, float], what: str) -> None:
    """Refuse a finger that is larger than the build plate.

    Raises:
        UsageError: with its sizes.
    """
    needed = length_mm + 2 * GAP_MM, height_mm + 2 * GAP_MM
    if needed[0] > bed_mm[0] or needed[1] > bed_mm[1]:
        raise UsageError(
            f"a finger of {what} needs {needed[0]:g} x {needed[1]:g} mm of a build plate, its margin of {GAP_MM:g} mm "
            f"included; the plate has {bed_mm[0]:g} x {bed_mm[1]:g} mm: give a larger one (print.bed_mm)."
        )


def name_trays(layout: Sequence[PlacedFinger]) -> list[str]:
    """Name the plate files of a batch: `tray.3mf`, or `tray-1.3mf` and so on where it takes several."""
    n_plates = 1 + max(place.plate for place in layout)
    return ["tray.3mf"] if n_plates == 1 else [f"tray-{number}.3mf" for number in range(1, n_plates + 1)]


def tray_files(items: Sequence[PrintItem], recipe: Recipe | None = None) -> dict[str, bytes]:
    """Make the files to print: per tool one STL per body, per plate a 3MF file with every finger in its place.

    Raises:
        UsageError: a finger is larger than the build plate.
    """
    layout = tray_layout(items, bed_of(recipe))
    bodies = {item.label: finger_bodies(item.design, item.label) for item in items}
    files: dict[str, bytes] = {}
    for label, finger in bodies.items():
        files[f"{label}_compliant.stl"] = _stl(finger.compliant)
        files[f"{label}_rigid.stl"] = _stl(finger.rigid)
    materials = MATERIALS if recipe is None else _materials_of(recipe)
    for plate, name in enumerate(name_trays(layout)):
        parts = [
            Part(f"{place.label}{'ab'[number % FINGERS_PER_TOOL]}", _bodies_of(bodies[place.label]), lying(place))
            for number, place in enumerate(layout)
            if place.plate == plate
        ]
        files[name] = write_3mf(parts, materials)
    return files


def bed_of(recipe: Recipe | None) -> tuple[float, float]:
    """Return the build plate of a recipe; without one that of the paper's printer."""
    return BED_MM if recipe is None else recipe.bed_mm


def _materials_of(recipe: Recipe) -> dict[str, BaseMaterial]:
    bodies = {"compliant": recipe.compliant, "rigid": recipe.rigid}
    return {key: BaseMaterial(f"{body.material} ({key})", body.colour) for key, body in bodies.items()}


def _bodies_of(finger: FingerBodies) -> dict[str, trimesh.Trimesh]:
    return {"compliant": finger.compliant, "rigid": finger.rigid}


def _stl(body: trimesh.Trimesh) -> bytes:
    return cast(bytes, body.export(file_type="stl"))  # binary STL


def lying(place: PlacedFinger) -> np.ndarray:
    """Turn the finger frame (x, y, z) to the plate: x stays, z lies along the plate's y, the width points up."""
    half = place.design.width_mm / 2
    return np.array([[1, 0, 0, place.x_mm], [0, 0, 1, place.y_mm], [0, -1, 0, half], [0, 0, 0, 1]], dtype=float)
