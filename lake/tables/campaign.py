"""Row records of the lake: one frozen class per table, the only place where a column is typed.

The first column of a table is its id. Units are in the names (mm, N, MPa, s, J). `lake.tables.schema` derives
the Parquet schemas, `lake.store` adds the columns of `lake.provenance` to every row.
"""

import json
from collections.abc import Mapping, Sequence
from datetime import datetime
from typing import Any, ClassVar, Literal, Self

from pydantic import BaseModel, Field, model_validator

from fast.lake.tables.features import AnomalyFlagRow, TraceFeaturesRow
from fast.lake.tables.inference import CalibrationRow, EffectRow, GapFindingRow, PosteriorDrawsRow
from fast.lake.tables.material import MaterialRow
from fast.lake.tables.requests import GraspRequestRow, read_placement
from fast.lake.tables.row import Channel, Row, Status
from fast.models.design.fin_ray import FinRay
from fast.models.design.space import PARAMETERS
from fast.models.ids import canonical_json, content_id, id_in_lab
from fast.models.objects.rigid import RigidObject
from fast.models.records import Design, Placement, Trace
from fast.models.simulation.version import SimulatorVersion


class CampaignRow(Row):
    """One optimisation and the config it runs with."""

    table: ClassVar[str] = "campaigns"
    campaign_id: str
    name: str
    config_toml: str


class DesignRow(Row):
    """The parameters of a finger; ranges are those of its family (`models.design.fin_ray.FinRay` for a fin ray).

    Every family has the three outer sizes. The other columns of the nine are those of fin rays, and of other families
    that have a parameter of the same name.
    """

    table: ClassVar[str] = "designs"
    design_id: str
    """Of its parameters."""
    length_mm: float
    """Depth at the base, closing direction."""
    width_mm: float
    """Across the closing direction."""
    height_mm: float
    """Base to apex."""
    tip_length_mm: float | None = None
    """Solid tip, from the apex."""
    front_thickness_mm: float | None = None
    """Wall that touches the object."""
    back_thickness_mm: float | None = None
    """Slanted wall."""
    rib_thickness_mm: float | None = None
    """Of every rib."""
    rib_count: int | None = None
    """Between the walls."""
    rib_angle_deg: float | None = None
    """From the horizontal."""
    family: str | None = Field(default=None, description="design family; none: fin ray")
    parameters_json: str | None = Field(default=None, description="all parameters, of families but the fin ray")

    @classmethod
    def of(cls, design: Design, design_id: str | None = None) -> Self:
        """Make the row of a design; `design_id` only where another lab named it."""
        values = design.model_dump()
        columns = {name: value for name, value in values.items() if name in PARAMETERS}
        if type(design) is not FinRay:
            columns |= {"family": design.family, "parameters_json": canonical_json(values)}
        return cls(design_id=design_id or design.design_id, **columns)

    @property
    def design(self) -> Design:
        """The design of this row, checked against the ranges.

        Raises:
            UsageError: its family is unknown here.
        """
        return design_of_columns(self.model_dump())


def design_of_columns(columns: Mapping[str, Any]) -> Design:
    """Make a design from the columns of `designs`.

    Raises:
        UsageError: its family is unknown here.
    """
    family = columns.get("family")
    if family is None:
        return FinRay.model_validate({name: columns[name] for name in PARAMETERS})
    from fast.models.design.families import read_design

    return read_design(family, json.loads(columns["parameters_json"]), f"design {columns['design_id']}")


class ObjectRow(Row):
    """One of the 36 test objects, or an own object with all of its shape."""

    table: ClassVar[str] = "objects"
    object_id: int
    """0 to 35 of the paper's, from 1000 of one's own."""
    name: str
    """As it is told."""
    object_class: str
    """Of the catalogue."""
    orientation: str
    """Where its axis points."""
    parameters_json: str
    """Sizes of its class, mm."""
    size_x_mm: float | None = None
    """Along the closing direction."""
    size_y_mm: float | None = None
    """Across it."""
    height_mm: float | None = None
    """Along z."""
    mirror_x: bool | None = None
    """Its own mirror image in the plane x = 0."""
    mirror_y: bool | None = None
    """The same in the plane y = 0."""
    shape: str | None = Field(default=None, description="of an own object, see `models.objects.own`")

    @classmethod
    def of(cls, obj: RigidObject) -> Self:
        """Make the row of an object."""
        size_x_mm, size_y_mm, height_mm = obj.size_mm
        return cls(
            object_id=obj.object_id,
            name=obj.name,
            object_class=obj.object_class,
            orientation=obj.orientation,
            parameters_json=canonical_json(obj.parameters),
            size_x_mm=size_x_mm,
            size_y_mm=size_y_mm,
            height_mm=height_mm,
            mirror_x=obj.mirror_x,
            mirror_y=obj.mirror_y,
            shape=obj.shape,
        )

    @property
    def own_object(self) -> RigidObject | None:
        """The own object of this row; None for the 36, which the program itself defines."""
        if self.shape is None:
            return None
        return RigidObject(
            object_id=self.object_id,
            name=self.name,
            object_class=self.object_class,
            parameters={},
            orientation="axis z",
            mirror_x=bool(self.mirror_x),
            mirror_y=bool(self.mirror_y),
            shape=self.shape,
        )


class BatchRow(Row):
    """A set of tools printed and measured together; `batch_id` is `<campaign_id>/B01`."""

    table: ClassVar[str] = "batches"
    batch_id: str
    campaign_id: str
    batch: int
    kind: Literal["random", "guided", "imported"]
    n_tools: int

    @staticmethod
    def make_id(campaign_id: str, batch: int) -> str:
        """Make `<campaign_id>/B01` of batch 1."""
        return f"{campaign_id}/B{batch:02d}"


class ProposalRow(Row):
    """A design that the scientist asked for, and what was known when it did."""

    table: ClassVar[str] = "proposals"
    proposal_id: str
    """Of campaign, batch, slot and index."""
    campaign_id: str
    """That asked."""
    batch: int | None = None
    """Of tools, from 1."""
    slot: int | None = None
    """Of the rack; empty of a simulation."""
    index: int
    """Place among those of its kind."""
    fidelity: Literal["sim", "real"]
    """What is to be done with it."""
    design_id: str
    """What was asked for."""
    acquisition: str
    """The rule that chose it."""
    acquisition_value: float | None = None
    """Of that rule."""
    n_real: int
    """Measured designs that were known then."""
    n_sim: int
    """Simulated designs that were known then."""
    n_pending: int
    """Designs that were under way then."""
    name: str | None = Field(default=None, description="of a design of one's own, as its file says")


class ToolRow(Row):
    """What was really mounted in a slot; `tool_id` is `<campaign_id>/B01T0`."""

    table: ClassVar[str] = "tools"
    tool_id: str
    """`<campaign_id>/B01T0`."""
    campaign_id: str
    """That it is of."""
    batch: int
    """From 1."""
    slot: int = Field(ge=0, le=9)
    """Of its batch."""
    design_id: str
    """What it was printed from."""
    status: Literal["printed", "rejected"]
    """Whether it can be measured."""
    reason: str = ""
    """Why it was rejected."""
    operator: str = ""
    """Who said so."""
    material_lot: str = ""
    """What it was printed with."""
    rack_slot: int | None = None
    """Where it hangs, if not in its slot."""
    measured_front_thickness_mm: float | None = None
    """Of the print."""
    measured_back_thickness_mm: float | None = None
    """Of the print."""
    measured_rib_thickness_mm: float | None = None
    """Of the print."""
    hardness_shore_a: float | None = None
    """Of the print."""
    confirmed_by: Literal["person", "auto"]
    """auto: nobody was asked."""
    recipe: str | None = Field(default=None, description="name of how it was printed; empty: nobody said")
    recipe_json: str | None = Field(default=None, description="all of the recipe, see `models.design.recipe`")
    sure: str | None = Field(default=None, description="what was strange in what was measured of it, and is so")

    @staticmethod
    def make_id(campaign_id: str, batch: int, slot: int) -> str:
        """Make `<campaign_id>/B01T0` of batch 1, slot 0."""
        return f"{campaign_id}/B{batch:02d}T{slot}"


class SimulatorVersionRow(Row):
    """A simulator version, so that every simulated number names what it came from.

    Of an imported simulation (tier `imported`) only theta is known, if that; `version` is then an error.
    """

    table: ClassVar[str] = "simulator_versions"
    version_id: str
    version_json: str
    young_modulus_mpa: float | None = None
    friction: float | None = None
    poisson_ratio: float | None = None
    tier: str
    effects_json: str

    @classmethod
    def of(cls, version: SimulatorVersion) -> Self:
        """Make the row of a simulator version."""
        return cls(
            version_id=version.version_id,
            version_json=canonical_json(version.model_dump()),
            tier=version.tier,
            effects_json=canonical_json([effect.model_dump() for effect in version.effects]),
            **version.theta.model_dump(),
        )

    @property
    def version(self) -> SimulatorVersion:
        """The simulator version of this row."""
        return SimulatorVersion.model_validate_json(self.version_json)


class SimulationRow(Row):
    """Scalars of one simulated grasp (design x object); a failed one says why."""

    table: ClassVar[str] = "simulations"
    simulation_id: str
    """Of design, object, version and setup."""
    design_id: str
    """What was simulated."""
    object_id: int
    """What it met."""
    version_id: str
    """The simulator."""
    setup_id: str
    """How it was grasped."""
    setup_json: str
    """All of the setup."""
    status: Status
    """Whether there is a result."""
    reason: str = ""
    """Why there is none."""
    peak_force_n: float | None = None
    """Largest force during the lift."""
    contact_force_n: float | None = None
    """Between fingers and object at the end of closing."""
    work_j: float | None = None
    """Area under the force over the lift."""
    n_dof: int | None = None
    """Degrees of freedom."""
    n_newton: int | None = None
    """Iterations."""
    cpu_s: float = 0.0
    """For everything."""
    details_json: str = "{}"
    """What else is kept with it."""
    branch: int | None = Field(default=None, description="0 in rows of version 0.2 that were searched for another")
    branch_share: float | None = Field(default=None, description="of placements, in those rows")
    flag: str | None = Field(default=None, description="why the numbers are not converged as others are")
    pressure_kpa: float | None = Field(
        default=None, description="largest pressure on the object, mean over 10 mm2; empty: not recorded then"
    )
    offset_x_mm: float | None = Field(default=None, description="of the object between the fingers; empty: 0")
    offset_y_mm: float | None = Field(default=None, description="of the object between the fingers; empty: 0")
    yaw_deg: float | None = Field(default=None, description="of the object between the fingers; empty: 0")

    @staticmethod
    def make_id(design_id: str, object_id: int, version_id: str, setup_id: str) -> str:
        """Make an id from what decides the result."""
        return content_id("S", [design_id, object_id, version_id, setup_id])


class _SampleColumns(Row):
    time_s: Channel
    lift_mm: Channel
    force_n: Channel

    @model_validator(mode="after")
    def _equal_lengths(self) -> Self:
        lengths = len(self.time_s), len(self.lift_mm), len(self.force_n)
        if len(set(lengths)) > 1:
            raise ValueError(f"trace channels differ in length: time_s, lift_mm, force_n have {lengths} samples")
        return self

    @property
    def trace(self) -> Trace:
        """The samples as a trace."""
        return Trace(time_s=self.time_s, lift_mm=self.lift_mm, force_n=self.force_n)

    @classmethod
    def id_column(cls) -> str:
        """Return the first field after the inherited channels."""
        return next(name for name in cls.model_fields if name not in _SampleColumns.model_fields)

    @classmethod
    def of(cls, row_id: str, trace: Trace) -> Self:
        """Make the row of a trace."""
        return cls(**{cls.id_column(): row_id}, time_s=trace.time_s, lift_mm=trace.lift_mm, force_n=trace.force_n)


class SimTraceRow(_SampleColumns):
    """Samples of one simulated grasp."""

    table: ClassVar[str] = "sim_traces"
    simulation_id: str


class GraspRow(Row):
    """Scalars of one measured grasp (tool, object, repeat, attempt); a failed one says why."""

    table: ClassVar[str] = "grasps"
    grasp_id: str
    """Of tool, object, repeat and attempt."""
    campaign_id: str
    """That it is of."""
    tool_id: str
    """What grasped."""
    batch: int | None = None
    """Of the tool."""
    slot: int | None = None
    """Of the tool."""
    design_id: str
    """What the tool was printed from."""
    object_id: int
    """What was grasped."""
    repeat: int
    """Counts the grasps of the tool on the object."""
    attempt: int = 0
    """Counts the tries at this grasp."""
    order: int | None = None
    """Place in its campaign."""
    fidelity: Literal["real"] = "real"
    """Always real."""
    status: Status
    """Whether it counts."""
    reason: str = ""
    """Why it failed."""
    started_at: datetime | None = None
    """When."""
    peak_force_n: float | None = None
    """Largest force during the lift."""
    work_j: float | None = None
    """Area under the force over the lift."""
    initial_force_n: float | None = None
    """Reading just before the lift."""
    tare_force_n: float | None = None
    """Gross force of the free gripper that was taken as zero."""
    setup_id: str
    """How it was made, and where the object sat."""
    setup_json: str
    """All of the setup."""
    bench: str = Field(description="virtual, real (this program drives it), or the name of a foreign bench")
    world_hash: str | None = None
    """Of a virtual bench."""
    details_json: str = "{}"
    """What else is kept with it."""
    offset_x_mm: float | None = Field(
        default=None, description="asked for, of the object between the fingers; empty: 0"
    )
    offset_y_mm: float | None = Field(
        default=None, description="asked for, of the object between the fingers; empty: 0"
    )
    yaw_deg: float | None = Field(default=None, description="asked for, of the object between the fingers; empty: 0")
    request_id: str | None = Field(default=None, description="of `grasp_requests`; empty: an ordinary grasp")
    software: str | None = Field(default=None, description="program that recorded an imported grasp, as told")
    lab: str | None = Field(default=None, description="who measured it; empty: a lab that gave itself no name")

    @property
    def placement(self) -> Placement:
        """The placement that was asked for."""
        return read_placement(self.__dict__)

    @staticmethod
    def make_id(
        tool_id: str, object_id: int, repeat: int, attempt: int = 0, request_id: str = "", lab: str | None = None
    ) -> str:
        """Make an id from which grasp it is, so that redoing it duplicates nothing; the lab's name stands in front."""
        asked = [request_id] if request_id else []
        return id_in_lab(content_id("K", [tool_id, object_id, repeat, attempt, *asked]), lab)


class TraceRow(_SampleColumns):
    """Samples of one measured grasp, as the instrument gave them."""

    table: ClassVar[str] = "traces"
    grasp_id: str


class FitRow(Row):
    """Hyperparameters and health of the surrogate when tools or simulations were decided (`purpose`).

    `is_log`: forces are modelled as ln(1 + force / 1 N), and standard deviations and means are of these. `n_sim` 0: the
    simulations were left aside, since measured designs are predicted better without; errors are those with them.
    `n_prior` 0 says the same of designs that prior campaigns measured.
    """

    table: ClassVar[str] = "fits"
    fit_id: str
    """Of what was decided with it."""
    campaign_id: str
    """That it is of."""
    batch: int
    """That was chosen."""
    n_real: int
    """Measured designs."""
    n_sim: int
    """Simulated designs; 0: left aside, since measured ones are predicted better without."""
    rho: float
    """Scale from simulation to measurement."""
    noise_sd_n: float
    """Of measurements."""
    log_posterior: float
    """Of the hyperparameters."""
    loo_rmse_n: float | None = None
    """Error of measured designs left out."""
    lengthscales_h: tuple[float, ...]
    """Of the simulated outcome, by dimension."""
    lengthscales_e: tuple[float, ...]
    """Of the discrepancy, by dimension."""
    sd_h: float
    """Of the simulated outcome."""
    sd_e: float
    """Of the discrepancy."""
    seed: int
    """Of the starts."""
    purpose: Literal["tools", "simulations"] | None = None
    """What was decided with it."""
    nugget_n: float | None = None
    """Of simulations."""
    mean_sim_n: float | None = None
    """By which simulations are centred."""
    mean_real_n: float | None = None
    """By which measurements are centred."""
    loo_coverage_90: float | None = None
    """Share of designs left out inside their 90 % interval."""
    loo_q2: float | None = None
    """Share of their variance that is predicted."""
    sim_loo_rmse_n: float | None = None
    """The same of simulated designs."""
    sim_loo_coverage_90: float | None = None
    """The same of simulated designs."""
    sim_loo_q2: float | None = None
    """The same of simulated designs."""
    shared_variance: float | None = None
    """Share of the measured outcome's prior variance that comes through the simulator."""
    measured_only_loo_rmse_n: float | None = None
    """Error of a surrogate of the measurements alone."""
    n_outliers: int | None = None
    """Measured designs far from their prediction."""
    is_log: bool | None = None
    """Forces are modelled as ln(1 + force / 1 N), and standard deviations and means are of these."""
    outcome: str | None = Field(default=None, description="what was fitted; empty: mean peak force")
    n_prior: int | None = None
    """Designs of prior campaigns; 0: left aside."""
    priors_json: str | None = Field(default=None, description="correlation, gain and mean of each prior campaign")
    without_prior_loo_rmse_n: float | None = None
    """Error of a surrogate without them."""


class EventRow(Row):
    """Something worth keeping that is not a measurement: pause, fault, confirmation, or a record of a decision."""

    table: ClassVar[str] = "events"
    event_id: str
    campaign_id: str
    kind: str
    message: str
    payload_json: str = "{}"

    @classmethod
    def of(
        cls,
        key: Sequence[object],
        kind: str,
        message: str,
        payload: BaseModel | Mapping[str, object],
        campaign: str | None,
    ) -> Self:
        """Make a record that is kept under a key: written again it takes the place of the one before."""
        values = payload.model_dump(mode="json") if isinstance(payload, BaseModel) else payload
        return cls(
            event_id=cls.make_id(*key),
            campaign_id=campaign or "",
            kind=kind,
            message=message,
            payload_json=canonical_json(values),
        )

    @property
    def payload(self) -> dict[str, Any]:
        """The record that `of` has kept."""
        return dict(json.loads(self.payload_json))

    @staticmethod
    def make_id(*key: object) -> str:
        """Make the id of the record under a key."""
        return content_id("E", list(key))


class FlowRunRow(Row):
    """One process's run of a flow: written when it starts, again with the same id when it ends.

    A run that was killed stays `running` until the next run of the flow finds it, and calls it `died`.
    """

    table: ClassVar[str] = "flow_runs"
    flow_run_id: str = Field(description="id of the run in Prefect")
    flow: str
    """Its name."""
    name: str
    """Of the run."""
    campaign_id: str | None = None
    """That it ran."""
    status: Literal["running", "completed", "interrupted", "failed", "died"]
    """How it stands."""
    reason: str = ""
    """Why it ended so."""
    started_at: datetime
    """When."""
    ended_at: datetime | None = None
    """When; empty while it runs."""
    host: str
    """Of its process."""
    process_id: int
    """On that host."""


# Samples are written before the scalars that announce them: a crash in between leaves a trace without
# a grasp, which redoing the grasp replaces, never a grasp without its trace.
TABLES: tuple[type[Row], ...] = (
    TraceRow,
    SimTraceRow,
    PosteriorDrawsRow,
    CampaignRow,
    ObjectRow,
    MaterialRow,
    DesignRow,
    EffectRow,
    SimulatorVersionRow,
    BatchRow,
    ProposalRow,
    ToolRow,
    SimulationRow,
    GraspRequestRow,
    GraspRow,
    TraceFeaturesRow,
    AnomalyFlagRow,
    FitRow,
    CalibrationRow,
    GapFindingRow,
    EventRow,
    FlowRunRow,
)
TABLE_BY_NAME: Mapping[str, type[Row]] = {row_type.table: row_type for row_type in TABLES}
