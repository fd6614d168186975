"""Where things are on the bench, in the gantry's workspace (x, y on the sheet, z up; 0 to 1500, 1500, 180 mm).

Height of the head: `z_mm` = 0 is the lowest place of the Z axis. The base of the fingers (top of the compliant body's
frame of the grasp) then hangs `head_offset_mm` above the sheet, so base above sheet = z + 60. An object's bottom is
`mount_height_mm` = 33 above the sheet, tips are `height_mm` below the base:

    tip in the object frame = z + 60 - height - 33,    so z = 33 + height - tip_below - 60 for a grasp.

A 120 mm finger grasps at z = 88 and ends an 80 mm lift at 168; a 90 mm finger grasps at z = 58.
"""

from pydantic import Field

from fast.hardware.parts.limits import BenchLimits
from fast.models.errors import UsageError
from fast.models.records import Design, GraspSetup, Placement, Record

N_OBJECTS = 36
N_SLOTS = 10


class BenchLayout(Record):
    """Object grid, tool dock and head geometry; the defaults are the paper's 6 x 6 at 150 mm, centred.

    The places are numbered as the 36 objects that stand there; an own object takes one of them.
    """

    workspace_mm: tuple[float, float, float] = (1500.0, 1500.0, 180.0)
    """Travel in x, y, z."""
    n_places: int = Field(default=N_OBJECTS, ge=1, le=N_OBJECTS, description="of objects in the grid")
    n_columns: int = Field(default=6, ge=1, le=N_OBJECTS)
    """Of the grid of objects."""
    object_pitch_mm: float = Field(default=150.0, gt=60)
    """Between the middles of objects."""
    mount_height_mm: float = 33.0
    """Of the objects' bottom above the sheet."""
    object_height_mm: float = Field(default=50.0, gt=0, description="of the tallest object")
    head_offset_mm: float = Field(default=60.0, description="base of the fingers above the sheet at z = 0")
    clearance_mm: float = Field(default=10.0, gt=0, description="tips over the tallest object while travelling")
    free_xy_mm: tuple[float, float] = Field(default=(150.0, 600.0), description="place without an object")
    n_slots: int = Field(default=N_SLOTS, ge=1, le=N_SLOTS, description="of the dock; the PLC has ten inputs for them")
    dock_first_x_mm: float = 165.0
    """Of slot 0."""
    dock_pitch_mm: float = Field(default=130.0, gt=60)
    """Between slots."""
    dock_y_mm: float = 1420.0
    """Of all slots."""
    dock_z_mm: float = Field(default=90.0, description="the longest finger hangs 30 mm above the sheet")
    top_z_mm: float = Field(default=175.0, description="travel height to and from the dock")
    limits: BenchLimits = BenchLimits()
    """What a grasp can set."""
    own_objects: tuple[tuple[int, int], ...] = Field(
        default=(), description="own objects, each with the number of its place"
    )

    def has_place(self, object_id: int) -> bool:
        """Return whether it is said where this object stands, and no own object has taken its place."""
        places = dict(self.own_objects)
        is_taken = object_id not in places and object_id in places.values()
        return 0 <= places.get(object_id, object_id) < self.n_places and not is_taken

    def place_of(self, object_id: int) -> int:
        """Return the number of the place where an object stands.

        Raises:
            UsageError: no such object, or an own object stands on its place.
        """
        place = dict(self.own_objects).get(object_id, object_id)
        if not self.has_place(object_id):
            placed = [own for own, taken in self.own_objects if taken == object_id]
            if placed:
                raise UsageError(
                    f"Object {object_id} is not on the bench, own object {placed[0]} stands on its place; give that "
                    "one another of `objects.places`, or do without the other."
                )
            raise UsageError(
                f"Object {object_id} has no place on the bench; use an id from 0 to {self.n_places - 1}, or say where "
                "an own object stands."
            )
        return place

    def object_xy_mm(self, object_id: int) -> tuple[float, float]:
        """Return the centre of an object: row by row from the front left.

        Raises:
            UsageError: no such object.
        """
        row, column = divmod(self.place_of(object_id), self.n_columns)
        n_rows = -(-self.n_places // self.n_columns)
        x = self.workspace_mm[0] / 2 + (column - (self.n_columns - 1) / 2) * self.object_pitch_mm
        y = self.workspace_mm[1] / 2 + (row - (n_rows - 1) / 2) * self.object_pitch_mm
        return x, y

    def grasp_xy_mm(self, object_id: int, placement: Placement) -> tuple[float, float]:
        """Return the place of the head for a grasp: the object then sits off the middle of the fingers as asked.

        Raises:
            UsageError: no such object, or its place lies outside the workspace.
        """
        x, y = self.object_xy_mm(object_id)
        return self._inside(f"Object {object_id}", x - placement.offset_x_mm, y - placement.offset_y_mm)

    def dock_xy_mm(self, slot: int) -> tuple[float, float]:
        """Return the place of a dock slot.

        Raises:
            UsageError: no such slot, or it lies outside the workspace.
        """
        if not 0 <= slot < self.n_slots:
            raise UsageError(f"Tool slot {slot} does not exist; use a slot from 0 to {self.n_slots - 1}.")
        return self._inside(f"Tool slot {slot}", self.dock_first_x_mm + slot * self.dock_pitch_mm, self.dock_y_mm)

    def _inside(self, what: str, x_mm: float, y_mm: float) -> tuple[float, float]:
        most_x_mm, most_y_mm, _ = self.workspace_mm
        if not (0 <= x_mm <= most_x_mm and 0 <= y_mm <= most_y_mm):
            raise UsageError(
                f"{what} stands at x {x_mm:g}, y {y_mm:g} mm, the workspace ends at {most_x_mm:g}, {most_y_mm:g} mm; "
                "correct [layout] of the bench file."
            )
        return x_mm, y_mm

    def travel_z_mm(self, design: Design) -> float:
        """Return the height at which the tips of a design clear every object."""
        over_objects = self.mount_height_mm + self.object_height_mm + self.clearance_mm
        return min(over_objects + design.height_mm - self.head_offset_mm, self.top_z_mm)

    def grasp_z_mm(self, design: Design, setup: GraspSetup) -> float:
        """Return the height at which the tips are `tip_below_mm` under the object's bottom.

        Raises:
            UsageError: the grasp or the end of its longest lift lies outside the Z travel.
        """
        z_mm = self.mount_height_mm + design.height_mm - setup.tip_below_mm - self.head_offset_mm
        top_mm = self.workspace_mm[2]
        if z_mm < 0 or z_mm + setup.max_lift_mm > top_mm:
            raise UsageError(
                f"A grasp with tips {setup.tip_below_mm:g} mm below the object and a lift of {setup.max_lift_mm:g} mm "
                f"needs z from {z_mm:.1f} to {z_mm + setup.max_lift_mm:.1f} mm, the axis has 0 to {top_mm:g} mm; "
                "change tip_below_mm or max_lift_mm."
            )
        return z_mm

    def tip_below_mm(self, design: Design, z_mm: float) -> float:
        """Return how far the tips are under the objects' bottoms, head at `z_mm`; inverse of `grasp_z_mm`."""
        return self.mount_height_mm + design.height_mm - self.head_offset_mm - z_mm

    def object_at(self, x_mm: float, y_mm: float, within_mm: float = 15.0) -> int | None:
        """Find the object centred within `within_mm` of the head in x and y, or None; as far as a grasp is offset."""
        own = {place: object_id for object_id, place in self.own_objects}
        for place in range(self.n_places):
            object_id = own.get(place, place)
            x, y = self.object_xy_mm(object_id)
            if abs(x - x_mm) <= within_mm and abs(y - y_mm) <= within_mm:
                return object_id
        return None

    def dock_at(self, x_mm: float, y_mm: float, z_mm: float, within_mm: float = 1.0) -> int | None:
        """Find the dock slot in which the head sits, or None."""
        if z_mm > self.dock_z_mm + within_mm or abs(y_mm - self.dock_y_mm) > within_mm:
            return None
        slot = round((x_mm - self.dock_first_x_mm) / self.dock_pitch_mm)
        is_there = abs(x_mm - self.dock_first_x_mm - slot * self.dock_pitch_mm) <= within_mm
        return slot if is_there and 0 <= slot < self.n_slots else None
