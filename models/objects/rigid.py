"""A rigid object that is grasped: what it is called, and its shape as rows of primitives."""

from functools import cached_property
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, model_validator

from fast.models.objects.primitives import bounds, is_round, moved, rotated
from fast.models.objects.shapes import SHAPES
from fast.models.records import GivenRecord
from fast.models.validation import closest

Orientation = Literal["axis z", "axis x", "axis y", "turned 45 deg", "upside down"]

_HALF = np.sqrt(0.5)
_ROTATIONS: dict[str, np.ndarray] = {
    "axis z": np.eye(3),
    "axis x": np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]]),
    "axis y": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]]),
    "turned 45 deg": np.array([[_HALF, -_HALF, 0.0], [_HALF, _HALF, 0.0], [0.0, 0.0, 1.0]]),
    "upside down": np.diag([1.0, -1.0, -1.0]),
}


class RigidObject(GivenRecord):
    """A rigid object on its mount, in the object frame: footprint centred in x and y, resting on z = 0."""

    object_id: int
    """0 to 35 of the paper's, from 1000 of one's own."""
    name: str
    """As it is told."""
    object_class: str
    """Of the catalogue."""
    parameters: dict[str, Annotated[float, Field(ge=0)]]
    """Sizes of its class, mm."""
    orientation: Orientation
    """Where the shape's own axis points, or how it is turned about z."""
    mirror_x: bool
    """The shape is its own mirror image in the plane x = 0."""
    mirror_y: bool
    """The same in the plane y = 0."""
    shape: str | None = None
    """Of an own object, its text as of `models.objects.shape_text`; None for the 36, which have class and sizes."""

    @model_validator(mode="after")
    def _check_class(self) -> "RigidObject":
        if self.shape is None:
            if self.object_class not in SHAPES:
                raise ValueError(
                    f"unknown `object_class` `{self.object_class}`; {closest(self.object_class, [*SHAPES])}"
                )
            try:
                SHAPES[self.object_class](self.parameters)
            except KeyError as missing:
                raise ValueError(
                    f"`parameters` of the class {self.object_class} need `{missing.args[0]}`; add it"
                ) from missing
        return self

    @property
    def primitives(self) -> np.ndarray:
        """The shape as rows (n_rows, N_COLUMNS) for `models.objects.distance`, in the object frame, mm."""
        if self.shape is not None:
            from fast.models.objects.shape_text import shape_rows  # compiles; the 36 do without

            return shape_rows(self.shape)
        rows = rotated(SHAPES[self.object_class](self.parameters), _ROTATIONS[self.orientation])
        low, high = bounds(rows)
        return moved(rows, -np.array([(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, low[2]]))

    @cached_property
    def size_mm(self) -> tuple[float, float, float]:
        """Footprint in x and y, and height: of the box round the object, in mm."""
        low, high = bounds(self.primitives)
        return float(high[0] - low[0]), float(high[1] - low[1]), float(high[2])

    @property
    def height_mm(self) -> float:
        """Top of the object over its mount, in mm."""
        return self.size_mm[2]

    @cached_property
    def is_round(self) -> bool:
        """True for a body of revolution about its vertical axis, which looks the same after any turn about it."""
        return is_round(self.primitives)
