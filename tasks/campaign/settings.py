"""The sections of a campaign config: schedule, objects, simulator, scientist, execution."""

import random
from collections.abc import Collection, Iterable
from typing import Annotated, Any, Literal

from pydantic import Field, ValidationInfo, field_validator, model_validator

from fast.hardware.parts.layout import N_OBJECTS, N_SLOTS, BenchLayout
from fast.models.design.families import find_family
from fast.models.design.printability import PrintingRules
from fast.models.design.reference import REFERENCES
from fast.models.design.space import FIN_RAYS, DesignSpace, LinearLimit
from fast.models.own_code import OWN, is_own
from fast.models.records import EffectValue, Record, Theta
from fast.models.scientist.insights.rules import MARGIN, SIMPLER
from fast.models.scientist.objectives import LESS_IS_BETTER, MEAN_PEAK, MEASURED, NAMES
from fast.models.simulation.version import MeshSettings, SimulatorVersion
from fast.models.validation import closest
from fast.tasks.simulation.engine import check_engine


class ObjectPlan(Record):
    """Which objects a tool is measured on, and how often."""

    ids: Literal["all"] | tuple[int, ...] = "all"
    """Objects that every tool and simulated design meets: numbers from 0 to 35, each once."""
    files: tuple[str, ...] = Field(default=(), description="own objects: paths, relative to the config")
    places: tuple[int, ...] = Field(default=(), description="where those of `files` stand; none: free ones in order")
    file_ids: dict[str, int] = Field(default={}, description="numbers of `files`; written by the program, not by you")
    repeats: int = Field(default=3, ge=1, le=20)
    """Grasps of a tool on an object."""
    order: Literal["fixed", "random"] = Field(
        default="random", description="the shortest way for every tool, or drawn for each tool"
    )
    repeats_order: Literal["together", "interleaved"] = Field(
        default="together", description="an object's repeats one after the other, or one pass over all objects each"
    )

    @field_validator("ids", mode="before")
    @classmethod
    def _check_kind(cls, ids: Any) -> Any:
        if ids != "all" and not isinstance(ids, list | tuple):
            raise ValueError('it must be "all" or a list of object ids; change it')
        return ids

    @field_validator("ids")
    @classmethod
    def _check_ids(cls, ids: Literal["all"] | tuple[int, ...]) -> Literal["all"] | tuple[int, ...]:
        if ids == "all":
            return ids
        for object_id in ids:
            if not 0 <= object_id < N_OBJECTS:
                raise ValueError(f"object {object_id} does not exist, ids are 0 to {N_OBJECTS - 1}; change it")
        if len(set(ids)) != len(ids):
            raise ValueError("object ids must be given once each")
        return ids

    @model_validator(mode="after")
    def _check_files(self) -> "ObjectPlan":
        if not self.files:
            if self.ids == () or self.places:
                raise ValueError("`ids` is empty or `places` is set without `files`; name one object at least")
            return self
        if self.ids == "all":
            raise ValueError(
                f"the {N_OBJECTS} of the paper take all {N_OBJECTS} places of the bench; beside `files`, set `ids` to "
                "those that stay (`ids = []` for none)"
            )
        if len(set(self.files)) != len(self.files):
            raise ValueError("`files` names one file twice; leave one of them out")
        n_objects = len(self.files) + len(self.ids)
        if n_objects > N_OBJECTS:
            raise ValueError(f"{n_objects} objects are named, the bench has {N_OBJECTS} places; name fewer")
        taken = [*self.ids, *self.places]
        are_apart = len(set(taken)) == len(taken) and set(taken) <= set(range(N_OBJECTS))
        if self.places and (len(self.places) != len(self.files) or not are_apart):
            raise ValueError(
                f"`places` must give each of the {len(self.files)} files a place of its own, 0 to {N_OBJECTS - 1}, "
                "that no object of `ids` has; change it"
            )
        return self

    @property
    def own_ids(self) -> tuple[int, ...]:
        """Numbers of the own objects, in the order of `files`."""
        return tuple(self.file_ids[name] for name in self.files)

    @property
    def own_places(self) -> tuple[tuple[int, int], ...]:
        """Own objects, each with the number of the place where it stands."""
        free = (place for place in range(N_OBJECTS) if place not in self.ids)
        return tuple(zip(self.own_ids, self.places or free, strict=False))

    def stand_on(self, layout: BenchLayout) -> BenchLayout:
        """Return a layout with the own objects on their places."""
        return layout.model_copy(update={"own_objects": (*layout.own_objects, *self.own_places)})

    @property
    def object_ids(self) -> tuple[int, ...]:
        """The objects as a tuple of ids."""
        return tuple(range(N_OBJECTS)) if self.ids == "all" else (*self.ids, *self.own_ids)

    @property
    def n_grasps(self) -> int:
        """Grasps of one tool."""
        return self.n_grasps_without(())

    def n_grasps_without(self, left_out: Collection[int]) -> int:
        """Count the grasps of one tool where these objects are left out."""
        return sum(object_id not in left_out for object_id in self.object_ids) * self.repeats

    def list_grasps(self, seed: int) -> list[tuple[int, int]]:
        """Return (object id, repeat) in the order of measurement.

        A fixed order aliases the object with the number of grasps a tool has made; a random one, drawn from `seed`
        (for each pass, when interleaved), breaks that and costs travel (`fast gantry plan`).
        """
        if self.repeats_order == "together":
            return [(object_id, repeat) for object_id in self._pass(seed) for repeat in range(self.repeats)]
        return [(object_id, repeat) for repeat in range(self.repeats) for object_id in self._pass(seed + repeat)]

    def _pass(self, seed: int) -> list[int]:
        if self.order == "fixed":
            from fast.hardware.parts.route import shortest_tour

            return list(shortest_tour(self.object_ids, self.stand_on(BenchLayout())))
        objects = list(self.object_ids)
        random.Random(seed).shuffle(objects)
        return objects


RULES = ("mes", "random")  # how designs can be chosen
LOG = "log"
SURROGATES = ("bi-fidelity", LOG)  # what predicts the force of a design


class SimulatorSettings(Record):
    """The simulator that the scientist consults (the world's own physics is set in the world file)."""

    theta: Theta = Theta()
    mesh: MeshSettings = MeshSettings()
    effects: tuple[EffectValue, ...] = ()
    """`[[simulator.effects]]` tables with `effect` and `parameters`."""
    tier: Literal["production", "reference"] = "production"
    """Which mesh and steps."""
    simulate_tools: bool = Field(
        default=True, description="also simulate every printed design: the pairs that show where simulation is wrong"
    )
    grasp_deadline_s: float = Field(default=120, gt=0, description="wall time after which one grasp has failed")

    @property
    def version(self) -> SimulatorVersion:
        """The simulator version that these settings describe."""
        return SimulatorVersion(theta=self.theta, mesh=self.mesh, effects=self.effects, tier=self.tier)


class DesignSettings(Record):
    """Which fingers may be made: a family, narrower ranges, limits on sums of parameters, and which are equal."""

    family: str = Field(default="fin-ray", description="`fin-ray`, `graded-fin-ray`, `free-form` or `module:Class`")
    ranges: dict[str, tuple[float, float]] = Field(
        default_factory=dict, description="lowest and highest value of a parameter, within the family's range"
    )
    limits: tuple[LinearLimit, ...] = Field(default=(), description="on weighted sums of parameters")
    equal: tuple[tuple[str, ...], ...] = Field(default=(), description="parameters that have one value, by group")

    @property
    def space(self) -> DesignSpace:
        """The designs that may be made.

        Raises:
            UsageError: the family, a parameter or a range does not exist.
        """
        if self == DesignSettings():
            return FIN_RAYS
        return DesignSpace.of(find_family(self.family), self.ranges, self.limits, self.equal)


class ScientistSettings(Record):
    """How designs are proposed."""

    surrogate: str = Field(
        default="bi-fidelity",
        description="what predicts forces: the paper's model, the same of their logarithms, or `module:function`",
    )
    acquisition: str = Field(default="mes", description="how tools to print are chosen")
    simulation_acquisition: str = Field(default="mes", description="how designs to simulate are chosen")
    best_predicted: int = Field(
        default=0,
        ge=0,
        le=10,
        description="tools of a batch with the largest predicted force; others teach most",
    )
    constraint: str | None = Field(
        default=None, description="`module:function` of one's own that says whether a design may be made"
    )
    objectives: tuple[str, ...] = Field(
        default=(MEAN_PEAK.name,),
        min_length=1,
        max_length=2,
        description="what tools are chosen for: one outcome, or two, of which the front is looked for",
    )
    at_least: dict[str, float] = Field(default={}, description="measured outcomes that a tool must reach")
    at_most: dict[str, float] = Field(
        default={}, description="what is simulated or known of a design and must not be exceeded"
    )
    prior_campaigns: tuple[str, ...] = Field(
        default=(),
        max_length=8,
        description="campaigns of the lake whose measured tools the surrogate learns from, each as a task of its own",
    )
    manufacturable: bool = Field(default=False, description="propose only what keeps the rules of `printing`")
    printing: PrintingRules = PrintingRules()
    """What a tool must keep to be printed."""

    @field_validator("acquisition", "simulation_acquisition", "surrogate", "constraint")
    @classmethod
    def _check_function(cls, name: str | None, info: ValidationInfo) -> str | None:
        known = {"surrogate": SURROGATES, "constraint": ()}.get(info.field_name or "", RULES)
        if name is not None and name not in known and not is_own(name):
            raise ValueError(f"it must be {_alternatives((*known, OWN))}; change it")
        return name

    @model_validator(mode="after")
    def _check_objectives(self) -> "ScientistSettings":
        for name in self.objectives:
            if name not in NAMES:
                raise ValueError(f"objectives has `{name}`; {closest(name, list(NAMES))}")
        if not set(self.objectives) & set(MEASURED):
            raise ValueError(f"objectives has no measured outcome; add one of {', '.join(MEASURED)}")
        if len(set(self.objectives)) < len(self.objectives):
            raise ValueError("objectives has one name twice; remove one")
        for table, limits, known in (("at_least", self.at_least, MEASURED), ("at_most", self.at_most, LESS_IS_BETTER)):
            for name in limits:
                if name not in known:
                    raise ValueError(f"{table} has `{name}`; {closest(name, list(known))}")
        if self.has_criteria and (self.acquisition != "mes" or is_own(self.surrogate) or self.best_predicted):
            raise ValueError(
                "objectives and limits have a rule of their own; leave acquisition, surrogate of your own and "
                "best_predicted out"
            )
        return self

    @property
    def wanted(self) -> set[str]:
        """Names of the objectives and of what has a limit."""
        return {*self.objectives, *self.at_least, *self.at_most}

    @property
    def has_criteria(self) -> bool:
        """Whether tools are chosen for anything but the largest mean peak force."""
        return self.objectives != (MEAN_PEAK.name,) or bool(self.at_least or self.at_most)

    @property
    def own_functions(self) -> list[str]:
        """Functions of one's own that are named here, as `module:function`."""
        names = (self.surrogate, self.acquisition, self.simulation_acquisition, self.constraint)
        return [name for name in names if name is not None and is_own(name)]


class Schedule(Record):
    """How many tools and simulations, in which order (the paper: 30 + 50, then 8 x (10 with 100))."""

    initial_tools: int = Field(default=30, ge=2, le=1000)
    """Random designs that are printed first."""
    tools_per_batch: int = Field(default=10, ge=1, le=10, description="the rack has ten tool heads")
    guided_batches: int = Field(default=8, ge=0, le=1000)
    """Batches that are proposed from the surrogate; may be changed later."""
    initial_simulations: int = Field(default=50, ge=0, le=100_000)
    """Random designs that are simulated during the initial batches."""
    simulations_per_batch: int = Field(default=100, ge=0, le=100_000)
    """Designs that are proposed and simulated during each guided batch."""
    reference_tools: Annotated[int, Field(ge=0, le=9)] | tuple[str, ...] = Field(
        default=0, description="measured tools that each later batch measures again: how many of the best, or which"
    )

    reference: str | None = Field(
        default=None, description="reference finger that is printed as the first tool of the first batch: `fin-ray`"
    )

    alike: tuple[str, ...] = Field(
        default=(), description="parameters that have one value in all tools of a batch: one thickness for a tray"
    )
    simpler: tuple[str, ...] = Field(
        default=(),
        description="simpler fingers, as good as the best, that each guided batch prints where there is one: "
        + ", ".join(f"`{name}`" for name in SIMPLER)
        + "; may be changed later",
    )
    stop: Literal["advice", "by itself", "never"] = Field(
        default="advice",
        description="whether another batch is worth it: said after each, acted on after two that say no, or not said",
    )
    stop_margin: float = Field(
        default=MARGIN, gt=0, le=1, description="by which share a batch must beat the best to be worth it"
    )

    @field_validator("reference")
    @classmethod
    def _check_reference(cls, name: str | None) -> str | None:
        if name is not None and name not in REFERENCES:
            raise ValueError(f"there is no reference finger `{name}`; {closest(name, list(REFERENCES))}")
        return name

    @field_validator("simpler")
    @classmethod
    def _check_names_of_simpler(cls, names: tuple[str, ...]) -> tuple[str, ...]:
        for name in names:
            if name not in SIMPLER:
                raise ValueError(f"a finger is not simpler by `{name}`; {closest(name, list(SIMPLER))}")
        if len(set(names)) < len(names):
            raise ValueError("a name stands twice; give each once")
        return names

    @model_validator(mode="after")
    def _check_simpler(self) -> "Schedule":
        if self.simpler and self.alike:
            raise ValueError("simpler fingers have values of their own, tools of a batch are `alike`; leave one out")
        if len(self.simpler) >= self.tools_per_batch and self.simpler:
            raise ValueError(
                f"simpler fingers take {len(self.simpler)} of the {self.tools_per_batch} tools of a batch, and one at "
                "least must be left to the scientist; name fewer, or raise tools_per_batch"
            )
        return self

    @model_validator(mode="after")
    def _check_references(self) -> "Schedule":
        if self.n_references + self.tools_per_batch > N_SLOTS:
            raise ValueError(
                f"the rack has {N_SLOTS} slots, {self.tools_per_batch} tools of a batch and {self.n_references} "
                "reference tools need more; lower tools_per_batch or reference_tools"
            )
        return self

    @property
    def n_references(self) -> int:
        """Measured tools that hang beside those of a later batch."""
        return self.reference_tools if isinstance(self.reference_tools, int) else len(self.reference_tools)

    @property
    def n_initial_batches(self) -> int:
        """Trays needed for the initial random tools."""
        return -(-self.initial_tools // self.tools_per_batch)

    @property
    def n_stages(self) -> int:
        """The initial stage and one stage per guided batch."""
        return 1 + self.guided_batches

    def batches_of(self, stage: int) -> list[int]:
        """Return the batch numbers (from 1) printed and measured in a stage (from 0)."""
        first = self.n_initial_batches
        return list(range(1, first + 1)) if stage == 0 else [first + stage]

    def tools_of(self, batch: int) -> int:
        """Return how many tools a batch holds; the last initial tray may be partly filled."""
        if batch != self.n_initial_batches:
            return self.tools_per_batch
        return self.initial_tools - (self.n_initial_batches - 1) * self.tools_per_batch

    def simulations_of(self, stage: int) -> int:
        """Return how many designs are simulated while the tools of a stage are printed and measured."""
        return self.initial_simulations if stage == 0 else self.simulations_per_batch


class GapSettings(Record):
    """Whether a campaign looks for what its simulator misses, and asks its bench where it cannot tell."""

    active: bool = Field(default=False, description="search after every batch, and make the grasps that would tell")
    budget_share: float = Field(
        default=0.05, ge=0, le=0.5, description="grasps that may be asked for, of those that were measured"
    )


class NightSettings(Record):
    """What happens between two batches when the simulator has changed: designs are simulated again, best first."""

    active: bool = Field(
        default=False, description="take the newest accepted simulator version for each batch, and simulate with it"
    )
    max_designs: int = Field(
        default=2000, ge=0, le=100_000, description="simulated with a new version before the batch is chosen; 0: none"
    )
    max_hours: float = Field(
        default=4.0, gt=0, le=1000, description="how long that may take; no design is begun after it"
    )


class Execution(Record):
    """How the work is spread over this machine; changes no result."""

    simulation_workers: int = Field(default=2, ge=1, le=256)
    """Processes that simulate."""
    engine: str = Field(
        default="local",
        description='what simulates: "local" processes, "dask://127.0.0.1:8786", "dask+tls://HOST:8786"',
    )
    physics_workers: int = Field(default=1, ge=1, le=64, description="processes behind a virtual bench")
    print_poll_s: float = Field(default=5.0, gt=0, le=3600)
    """Between looks whether a person has confirmed a batch."""
    print_reminder_h: float = Field(
        default=4.0, ge=0, le=1000, description="hours between reminders of a batch to be printed; 0: none"
    )
    notify: tuple[Literal["needs_you", "done", "stopped", "gap"], ...] = Field(
        default=("needs_you", "done", "stopped", "gap"), description="what is sent to the addresses in FAST_NOTIFY"
    )
    notify_virtual: bool = Field(default=False, description="also of campaigns on a virtual bench")
    max_grasp_attempts: int = Field(default=2, ge=1, le=10)
    """Failures after which a grasp is given up."""
    position_check_tools: int = Field(
        default=0, ge=0, le=10, description="tools between checks of the gantry for lost steps; 0: after a batch only"
    )
    again_grasps: int = Field(
        default=6,
        ge=0,
        le=360,
        description="grasps of a batch that the gantry makes again where they look wrong; 0: none",
    )

    @field_validator("engine")
    @classmethod
    def _check_engine(cls, engine: str) -> str:
        return check_engine(engine)


def _alternatives(names: Iterable[str]) -> str:
    return " or ".join(f'"{name}"' for name in names)
