"""What a bench can be asked for: setups and placements of grasps beyond it are refused before anything moves."""

from pydantic import Field

from fast.models.errors import UsageError
from fast.models.records import GraspSetup, Placement, Record
from fast.models.units import unit_of

Range = tuple[float, float]


class BenchLimits(Record):
    """Lowest and highest value of each thing that a grasp can set; equal ends are an axis that the bench has not.

    Heights and the length of the lift follow from the Z axis (`BenchLayout.grasp_z_mm`). Offsets are those of the
    object between the fingers, which the gantry makes; it has no axis for yaw.
    """

    open_gap_mm: Range = (20.0, 200.0)
    """Between front faces before closing."""
    closed_gap_mm: Range = (-20.0, 150.0)
    """Between undeformed front faces after closing."""
    close_speed_mm_per_s: Range = (1.0, 200.0)
    """Of the jaws."""
    lift_speed_mm_per_s: Range = Field(default=(0.1, 50.0), description="the Z axis goes 3000 mm/min")
    dwell_s: Range = Field(default=(0.0, 120.0), description="the gripper holds its air behind a check valve")
    supply_pressure_psi: Range = (5.0, 60.0)
    """Of the gripper's air."""
    offset_x_mm: Range = (-10.0, 10.0)
    """Along the closing direction."""
    offset_y_mm: Range = (-10.0, 10.0)
    """Along the fingers' width."""
    yaw_deg: Range = (0.0, 0.0)
    """About the vertical axis."""

    def check(self, setup: GraspSetup, placement: Placement = Placement()) -> None:  # noqa: B008 - frozen record
        """Refuse what this bench cannot do.

        Raises:
            UsageError: a value is beyond its limits, or the jaws would open as they close.
        """
        for name, (low, high) in self:
            value = getattr(setup if name in GraspSetup.model_fields else placement, name)
            if value is not None and not low <= value <= high:
                raise UsageError(_write_refusal(name, value, low, high))
        for name in ("offset_z_mm", "roll_deg"):
            if value := getattr(placement, name):
                raise UsageError(_write_refusal(name, value, 0.0, 0.0))
        setup.check_stroke()

    def can_make(self, setup: GraspSetup, placement: Placement = Placement()) -> bool:  # noqa: B008 - frozen record
        """Return whether `check` lets it pass."""
        try:
            self.check(setup, placement)
        except UsageError:
            return False
        return True


def _write_refusal(name: str, value: float, low: float, high: float) -> str:
    unit = unit_of(name) or ""
    if low == high:
        return f"{name} {value:g} {unit} was asked for, but this bench has no axis for it; leave it at {low:g} {unit}."
    return (
        f"{name} {value:g} {unit} was asked for, this bench has {low:g} to {high:g} {unit}; ask for a value within, or "
        "correct the limits in the bench's file."
    )
