"""Parts of which a person builds an object in a file: each is one primitive, with its sizes, place and turn."""

from typing import Annotated, Literal

import numpy as np
from pydantic import Field, model_validator

from fast.models.objects import primitives
from fast.models.objects.primitives import MAX_VERTICES
from fast.models.records import Record

Size = Annotated[float, Field(gt=0, le=200)]
Place = Annotated[float, Field(ge=-200, le=200)]
Vector = tuple[Place, Place, Place]
Angle = Annotated[float, Field(ge=-360, le=360)]
Turn = tuple[Angle, Angle, Angle]
Outline = Annotated[tuple[tuple[Place, Place], ...], Field(min_length=3, max_length=MAX_VERTICES)]
Rounding = Annotated[float, Field(ge=0, le=50)]


class _Part(Record):
    """What every part has: `at_mm` is where its middle is, `turn_deg` turns it about x, then y, then z, first."""

    at_mm: Vector = (0.0, 0.0, 0.0)
    turn_deg: Turn = (0.0, 0.0, 0.0)

    def make_row(self) -> np.ndarray:
        """Make the row of the part in its own frame."""
        raise NotImplementedError

    @property
    def rows(self) -> np.ndarray:
        """Row (1, N_COLUMNS) of the part where it is."""
        return primitives.moved(
            primitives.rotated(self.make_row()[None], turn_matrix(self.turn_deg)), np.array(self.at_mm)
        )


class Sphere(_Part):
    """A ball."""

    shape: Literal["sphere"]
    diameter_mm: Size

    def make_row(self) -> np.ndarray:
        """See `_Part`."""
        return primitives.sphere(self.diameter_mm / 2)


class Capsule(_Part):
    """A round rod along z with ball ends; `length_mm` is from end to end."""

    shape: Literal["capsule"]
    diameter_mm: Size
    length_mm: Size

    @model_validator(mode="after")
    def _check_length(self) -> "Capsule":
        if self.length_mm <= self.diameter_mm:
            raise ValueError(
                f"a capsule is longer than its diameter of {self.diameter_mm:g} mm, length_mm is {self.length_mm:g}; "
                "make it longer or take a sphere"
            )
        return self

    def make_row(self) -> np.ndarray:
        """See `_Part`."""
        half = np.array([0.0, 0.0, (self.length_mm - self.diameter_mm) / 2])
        return primitives.capsule(-half, half, self.diameter_mm / 2)


class Torus(_Part):
    """A ring about z; `ring_diameter_mm` is that of the tube's centre line."""

    shape: Literal["torus"]
    ring_diameter_mm: Size
    tube_diameter_mm: Size

    def make_row(self) -> np.ndarray:
        """See `_Part`."""
        return primitives.torus(self.ring_diameter_mm / 2, self.tube_diameter_mm / 2)


class Box(_Part):
    """A box with edges of the radius `rounding_mm`."""

    shape: Literal["box"]
    size_x_mm: Size
    size_y_mm: Size
    size_z_mm: Size
    rounding_mm: Rounding = 1.0

    @model_validator(mode="after")
    def _check_rounding(self) -> "Box":
        _check_fits(self.rounding_mm, min(self.size_x_mm, self.size_y_mm, self.size_z_mm))
        return self

    def make_row(self) -> np.ndarray:
        """See `_Part`."""
        return primitives.box(self.size_x_mm, self.size_y_mm, self.size_z_mm, self.rounding_mm)


class Ellipsoid(_Part):
    """An ellipsoid, from its three diameters."""

    shape: Literal["ellipsoid"]
    size_x_mm: Size
    size_y_mm: Size
    size_z_mm: Size

    def make_row(self) -> np.ndarray:
        """See `_Part`."""
        return primitives.ellipsoid(self.size_x_mm, self.size_y_mm, self.size_z_mm)


class Cylinder(_Part):
    """A round cylinder along z; with `bore_mm`, a tube."""

    shape: Literal["cylinder"]
    diameter_mm: Size
    length_mm: Size
    bore_mm: Annotated[float, Field(ge=0, le=200)] = 0.0
    rounding_mm: Rounding = 1.0

    @model_validator(mode="after")
    def _check_wall(self) -> "Cylinder":
        if self.bore_mm >= self.diameter_mm:
            raise ValueError(
                f"bore_mm is {self.bore_mm:g}, diameter_mm {self.diameter_mm:g}; a bore is smaller than what it is in"
            )
        across = (self.diameter_mm - self.bore_mm) / 2 if self.bore_mm > 0 else self.diameter_mm
        _check_fits(self.rounding_mm, min(across, self.length_mm))
        return self

    def make_row(self) -> np.ndarray:
        """See `_Part`."""
        bore, radius, half = self.bore_mm / 2, self.diameter_mm / 2, self.length_mm / 2
        return primitives.lathe([(bore, -half), (radius, -half), (radius, half), (bore, half)], self.rounding_mm)


class _Outlined(_Part):
    """A part with an outline: 3 to 8 corners in mm, anticlockwise."""

    outline_mm: Outline
    rounding_mm: Rounding = 1.0

    @model_validator(mode="after")
    def _check_outline(self) -> "_Outlined":
        points = np.array(self.outline_mm)
        after = np.roll(points, -1, axis=0)
        if (np.linalg.norm(after - points, axis=1) == 0.0).any():
            raise ValueError("outline_mm names one corner twice; leave one of them out")
        if _area(points) <= 0.0:
            raise ValueError("outline_mm goes clockwise or has no area; give its corners anticlockwise")
        return self


class Lathe(_Outlined):
    """A body turned about z; corners are (radius, z), radius 0 on the axis."""

    shape: Literal["lathe"]

    @model_validator(mode="after")
    def _check_side(self) -> "Lathe":
        _check_half_plane(self.outline_mm)
        _check_row(self)
        return self

    def make_row(self) -> np.ndarray:
        """See `_Part`."""
        return primitives.lathe(self.outline_mm, self.rounding_mm)


class SquareLathe(_Outlined):
    """A body with square cross-sections; corners are (half side, z), half side 0 on the axis."""

    shape: Literal["square_lathe"]

    @model_validator(mode="after")
    def _check_side(self) -> "SquareLathe":
        _check_half_plane(self.outline_mm)
        _check_row(self)
        return self

    def make_row(self) -> np.ndarray:
        """See `_Part`."""
        return primitives.square_lathe(self.outline_mm, self.rounding_mm)


class Prism(_Outlined):
    """A prism along z; corners are (x, y)."""

    shape: Literal["prism"]
    height_mm: Size

    @model_validator(mode="after")
    def _check_size(self) -> "Prism":
        _check_fits(self.rounding_mm, self.height_mm)
        _check_row(self)
        return self

    def make_row(self) -> np.ndarray:
        """See `_Part`."""
        return primitives.prism(self.outline_mm, self.height_mm, self.rounding_mm)


Part = Annotated[
    Sphere | Capsule | Torus | Box | Ellipsoid | Cylinder | Lathe | SquareLathe | Prism, Field(discriminator="shape")
]


def turn_matrix(turn_deg: Turn) -> np.ndarray:
    """Make the rotation matrix (3, 3) of turns about the fixed axes x, then y, then z, each counter-clockwise."""
    matrix = np.eye(3)
    for axis, angle_deg in enumerate(turn_deg):
        order = np.roll(np.eye(3), 2 - axis, axis=0)  # takes the axis to z, and the others after it
        matrix = order.T @ primitives.turn_about_z(angle_deg) @ order @ matrix
    return matrix


def _check_fits(rounding_mm: float, smallest_mm: float) -> None:
    if 2 * rounding_mm >= smallest_mm:
        raise ValueError(
            f"rounding_mm is {rounding_mm:g}, its smallest size {smallest_mm:g} mm leaves room for less than "
            f"{smallest_mm / 2:g} mm; make it smaller"
        )


def _check_half_plane(outline_mm: Outline) -> None:
    if min(corner[0] for corner in outline_mm) < 0.0:
        raise ValueError("outline_mm has a corner beyond the axis; its first numbers are 0 or more")


def _check_row(part: _Outlined) -> None:
    """Raise ValueError where the edges, moved inwards by the rounding, cross each other."""
    try:
        row = part.make_row()
    except np.linalg.LinAlgError as error:
        raise ValueError("outline_mm has a corner on the way between its neighbours; leave it out") from error
    core = row[primitives.VALUES : primitives.VALUES + 2 * len(part.outline_mm)].reshape(-1, 2)
    before = np.array(part.outline_mm)
    along = np.einsum("ij,ij->i", np.roll(core, -1, axis=0) - core, np.roll(before, -1, axis=0) - before)
    if not np.isfinite(core).all() or (along <= 0.0).any():
        raise ValueError(f"rounding_mm is {part.rounding_mm:g}, which is more than its edges leave room for; lower it")


def _area(points: np.ndarray) -> float:
    after = np.roll(points, -1, axis=0)
    return float(np.sum(points[:, 0] * after[:, 1] - after[:, 0] * points[:, 1])) / 2
