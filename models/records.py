"""Frozen records that travel between the layers. Units are in the names (mm, N, MPa, s)."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from fast.models.errors import UsageError
from fast.models.ids import content_id
from fast.models.show import draw_force, force_svg, html_table, load_pandas
from fast.models.validation import describe_faults

if TYPE_CHECKING:
    import pandas
    from matplotlib.axes import Axes
    from pydantic._internal._model_construction import ModelMetaclass as _Told
    from shapely.geometry import Polygon
else:

    class _Told(type(BaseModel)):
        """Says in a sentence of ours what is wrong with values that a person wrote in Python."""

        def __call__(cls, *args, **values):
            try:
                return super().__call__(*args, **values)
            except ValidationError as error:
                raise UsageError(f"{cls.__name__}: {describe_faults(cls, error)}") from error


BENCH_FAULT = "bench_fault"  # how a measured grasp ended that the bench could not go on with; says nothing of the tool


class Record(BaseModel):
    """Base of all records: immutable, unknown keys are errors, values are checked on entry."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, defer_build=True)


class GivenRecord(Record, metaclass=_Told):
    """Base of the records that people make in Python.

    Raises:
        UsageError: a value cannot be used; one sentence a fault, with value, limit, unit and what to do.
    """


class Design(GivenRecord):
    """A finger of some family: its parameters, and the section that they draw.

    A family is a subclass (`docs/how-to/add-a-family.md`). A parameter is a number with limits `ge` and `le`
    (continuous as a float, in steps of one as an int) or a `Literal` of choices. Three parameters every family has:
    the mounting base, the rig and the tray of a print need them.
    """

    family: ClassVar[str] = ""

    length_mm: float
    width_mm: float
    height_mm: float

    @property
    def design_id(self) -> str:
        """Id derived from family and parameters, `D` and 12 hex digits."""
        return content_id("D", self.content)

    @property
    def content(self) -> dict[str, Any]:
        """Family and parameters as JSON data; of the paper's fin ray the parameters alone."""
        return {"family": self.family, **self.model_dump()}

    @property
    def tip_height_mm(self) -> float:
        """How much of the finger counts as its tip, from the apex down; its twist is watched."""
        return 0.2 * self.height_mm

    def draw_section(self, fillet_mm: float = 0.5, arc_segments: int = 4) -> "Polygon":
        """Draw the compliant body in the (x, z) plane, mm, its voids as holes; extruded over the width.

        x = 0 is the front wall, which touches the object; the other points lie at x > 0. z runs from the top of the
        rigid base (`models.design.fin_ray.BASE_HEIGHT_MM`) to the apex (`height_mm`). Inner corners may carry fillets
        of radius `fillet_mm`, drawn with `arc_segments` per quarter circle.
        """
        raise NotImplementedError(f"the family {type(self).__name__} has no `draw_section`")

    def list_voids(self) -> "list[Polygon]":
        """List the voids above the base drawn with sharp corners, mm: what a printer fills with support."""
        from shapely.geometry import Polygon

        return [Polygon(ring) for ring in self.draw_section(0.0).interiors]

    def measure_section_mm2(self) -> float:
        """Measure the area of the section as drawn with sharp corners."""
        return float(self.draw_section(0.0).area)

    def scale_modulus(self, points: np.ndarray) -> np.ndarray | float:
        """Compute a factor (n) on Young's modulus at points (n, 2) of the section, x and z in mm: a second material."""
        return 1.0


class Theta(GivenRecord):
    """Calibration parameters of the simulator, with the ranges of the paper."""

    young_modulus_mpa: float = Field(default=11.5, ge=0.5, le=200)
    """Young's modulus of the printed material."""
    friction: float = Field(default=0.56, ge=0, le=2)
    """Coulomb's coefficient."""
    poisson_ratio: float = Field(default=0.45, ge=0, lt=0.5)
    """Poisson's ratio of the printed material."""


class GraspSetup(GivenRecord):
    """How a grasp is made; the paper states neither stroke nor tip height, both matter."""

    open_gap_mm: float = Field(default=70, ge=20, le=200)
    """Between front faces before closing."""
    closed_gap_mm: float = Field(default=16, ge=-20, le=150)
    """Between undeformed front faces after closing."""
    tip_below_mm: float = Field(default=5, ge=-40, le=30)
    """Tips below the object's bottom."""
    close_speed_mm_per_s: float = Field(default=20, gt=0, le=200)
    """Of the jaws."""
    lift_speed_mm_per_s: float = Field(default=5, gt=0, le=100)
    """Of the head."""
    max_lift_mm: float = Field(default=80, gt=0, le=120)
    """Where a lift ends at the latest."""
    dwell_s: float = Field(default=0, ge=0, le=600, description="extra wait between closing and lift")
    supply_pressure_psi: float | None = Field(
        default=None, ge=5, le=60, description="of the gripper's air; none: as the bench has it"
    )

    @property
    def setup_id(self) -> str:
        """Id derived from the numbers, the same however they are written (16 or 16.0).

        Fields that the first setups did not have count where they are not at their default.
        """
        numbers = self.model_dump()
        for name in _LATER_SETUP_FIELDS:
            if numbers[name] == type(self).model_fields[name].default:
                del numbers[name]
        return content_id("G", {name: int(x) if float(x).is_integer() else x for name, x in numbers.items()})

    def check_stroke(self) -> None:
        """Refuse a stroke of nothing.

        Raises:
            UsageError: the jaws would open as they close.
        """
        if self.closed_gap_mm >= self.open_gap_mm:
            raise UsageError(
                f"closed_gap_mm {self.closed_gap_mm:g} is not below open_gap_mm {self.open_gap_mm:g} mm, so the jaws "
                "would not close; ask for a smaller closed gap."
            )

    def timed_as(self, other: "GraspSetup") -> "GraspSetup":
        """Return this stroke with the speeds, dwell and air of another setup.

        The simulator is quasi-static: setups that are equal then have the same finite elements, at other times.
        """
        return self.model_copy(update={name: getattr(other, name) for name in _TIMING})


_LATER_SETUP_FIELDS = ("dwell_s", "supply_pressure_psi")
_TIMING = ("close_speed_mm_per_s", "lift_speed_mm_per_s", "dwell_s", "supply_pressure_psi")


class EffectValue(GivenRecord):
    """One effect of the catalogue, switched on with these parameter values."""

    effect: str
    parameters: dict[str, float] = Field(default_factory=dict)

    def __hash__(self) -> int:
        """Hash the content, so that simulator versions with effects can be keys."""
        return hash((self.effect, frozenset(self.parameters.items())))


class Placement(GivenRecord):
    """Where the object sits between the fingers, against its nominal place: asked for, or by scatter of mounting.

    The object is turned about its vertical axis by `yaw_deg` (counter-clockwise seen from above), then shifted. Each
    finger is turned about its own long axis by `roll_deg` (the tool sits askew in its changer; both fingers turn the
    same way seen from above).
    """

    offset_x_mm: float = 0.0
    offset_y_mm: float = 0.0
    offset_z_mm: float = 0.0
    yaw_deg: float = 0.0
    roll_deg: float = 0.0


def find_setup_id(setup: GraspSetup, placement: Placement) -> str:
    """Find the id of a setup with a placement that was asked for; at the nominal placement that of the setup."""
    if placement == Placement():
        return setup.setup_id
    return content_id("G", [setup.setup_id, {name: float(x) for name, x in placement.model_dump().items()}])


class GraspRequest(Record):
    """A grasp that is asked for: which tool, on what, how, and what for.

    `placement` is where the object shall sit between the fingers; the scatter of mounting comes on top of it.
    `repeat` counts the grasps of a tool on an object at one setup and placement. `request_id` names the request in the
    lake (table `grasp_requests`); empty for one that nobody wrote down.
    """

    tool_id: str
    object_id: int = Field(ge=0, description="0 to 35, or the number of an own object")
    repeat: int = Field(default=0, ge=0)
    setup: GraspSetup = GraspSetup()
    placement: Placement = Placement()
    purpose: str = ""
    request_id: str = ""


class GraspContext(Record):
    """What came before a grasp, for effects with a memory; all zero: the first grasp of a new tool in a new batch."""

    repeat: int = Field(default=0, ge=0, description="grasps of this tool on this object before")
    tool_grasps: int = Field(default=0, ge=0, description="grasps of this tool before")
    batch_grasps: int = Field(default=0, ge=0, description="grasps of all tools of the batch before")
    clock_s: float = Field(default=0.0, ge=0, description="time since the batch began")


@dataclass(frozen=True)
class Trace:
    """Samples of one grasp, in order: time from the start of closing, lift, force on the load cell.

    `force_n` > 0 when the object pulls the gripper down; total of both fingers. Equal lengths n.
    """

    time_s: np.ndarray
    lift_mm: np.ndarray
    force_n: np.ndarray

    def __post_init__(self) -> None:
        """Make arrays of what was given, and check that the three channels belong together.

        Raises:
            UsageError: they do not, or are no numbers.
        """
        for name in ("time_s", "lift_mm", "force_n"):
            try:
                object.__setattr__(self, name, np.asarray(getattr(self, name), dtype=float))
            except (TypeError, ValueError) as error:
                raise UsageError(f"trace: `{name}` is no list of numbers ({error}); change it.") from error
        if not self.time_s.shape == self.lift_mm.shape == self.force_n.shape or self.time_s.ndim != 1:
            raise UsageError(
                f"trace channels differ in shape: {self.time_s.shape}, {self.lift_mm.shape}, {self.force_n.shape}; "
                "give three lists of as many numbers."
            )

    def __repr__(self) -> str:
        return f"Trace({len(self.time_s)} samples, lift_mm to {self.lift_mm.max(initial=0):.1f})"

    @property
    def is_lift(self) -> np.ndarray:
        """Mask of the samples of the lift: from the last sample at zero lift onwards."""
        moved = np.flatnonzero(self.lift_mm > 0)
        start = max(int(moved[0]) - 1, 0) if moved.size else len(self.lift_mm)
        return np.arange(len(self.lift_mm)) >= start

    def to_pandas(self) -> "pandas.DataFrame":
        """Return the samples as n rows: `time_s`, `lift_mm`, `force_n`.

        Raises:
            MissingDependencyError: pandas is not installed.
        """
        channels = {"time_s": self.time_s, "lift_mm": self.lift_mm, "force_n": self.force_n}
        return load_pandas().DataFrame(channels)

    def plot(self, axes: "Axes | None" = None) -> "Axes":
        """Draw force over lift, into new axes of pyplot if none are given, and return the axes."""
        if axes is None:
            from matplotlib import pyplot

            axes = pyplot.subplots()[1]
        draw_force(axes, self.lift_mm[self.is_lift], self.force_n[self.is_lift])
        return axes

    def _repr_html_(self) -> str:
        return force_svg(self.lift_mm[self.is_lift], self.force_n[self.is_lift])


@dataclass(frozen=True)
class Slope:
    """Derivative of a simulated trace by one parameter.

    `unit` is that of the slope, such as `N/mm`. `force_n` (n) per unit of the parameter at the samples of the trace,
    NaN where it is not known: past both the lift to which slopes are good and the peak. `peak_n` of the peak pull-off
    force. `usual`: by how much the parameter changes between prints, grasps or designs. `step`: over how much to either
    side a finite difference was taken; None for the derivative itself.
    """

    unit: str
    force_n: np.ndarray
    peak_n: float
    usual: float
    step: float | None = None


@dataclass(frozen=True)
class Slopes:
    """Slopes of a simulated trace by parameters, good up to `trusted_mm` of lift: 1 mm before the force first jumps.

    `by` has them by name of the parameter, `lost` says why one has none.
    """

    trusted_mm: float
    by: dict[str, Slope]
    lost: dict[str, str]


@dataclass(frozen=True)
class GraspSimulation:
    """Result of one simulated grasp, both fingers."""

    trace: Trace
    """Force over time and lift."""
    peak_force_n: float
    """Largest force during the lift."""
    contact_force_n: float
    """Closing-direction force on one side at the end of closing, the paper's proxy."""
    work_j: float
    """Area under force over lift."""
    n_steps: int
    """Of closing and lift."""
    n_newton: int
    """Newton iterations in all."""
    n_dof: int
    """Degrees of freedom of a finger."""
    cpu_s: float
    """In all."""
    n_factorisations: int = 0
    """Of the stiffness."""
    setup_cpu_s: float = 0.0
    """Part of `cpu_s` before the first step."""
    mesh_id: str = ""
    """Of the mesh's content: not every mesher makes the same one twice."""
    flag: str = ""
    """Why the numbers are not converged as others are, in one word; empty if they are."""
    twist_deg: float = 0.0
    """Largest twist of a tip about its finger's long axis; 0 where half a finger was enough."""
    pressure_kpa: float | None = None
    """Largest pressure of a finger on the object, mean over the 10 mm2 that are pressed most."""
    ribs_touch: bool = False
    """Ribs or walls came to press on each other inside a finger."""
    slopes: Slopes | None = None
    """By the parameters that were asked for."""

    def plot(self, axes: "Axes | None" = None) -> "Axes":
        """Draw force over lift; see `Trace.plot`."""
        return self.trace.plot(axes)

    def _repr_html_(self) -> str:
        rows = [
            ("peak pull-off force", f"{self.peak_force_n:.2f} N"),
            ("contact force", f"{self.contact_force_n:.2f} N"),
            ("work", f"{1e3 * self.work_j:.1f} mJ"),
            *([("flag", self.flag)] if self.flag else []),
        ]
        return html_table(("simulated grasp", ""), rows) + self.trace._repr_html_()
