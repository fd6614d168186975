"""Experiments that tell hidden effects apart which ordinary grasps confuse (notes of the gap workflow).

Each turns one knob of the bench and leaves the rest alone:

| kind | turns | tells apart |
|---|---|---|
| `dwell` | wait between closing and lift | relaxation of the material from friction that falls with slip |
| `lift_speed` | speed of the lift | rate dependence and sensor lag from compliance of the mount |
| `supply_pressure` | gripper's supply | jaws that stall from soft mounts and buckling ribs |
| `closed_empty` | no object | fingers that touch each other, cross-talk, weight and drag of the tool |
| `dead_weight` | a known mass on the open gripper | gain and lag of the load cell from modulus and friction |
| `reference` | nothing: the same object every n grasps | softening, wear and drift over the batch |

None of them is an ordinary grasp: results carry the run, and go to a table of their own.
"""

import random
from collections.abc import Sequence
from typing import Annotated, Literal

from pydantic import Field, model_validator

from fast.models.design.fin_ray import FinRay
from fast.models.records import GraspRequest, GraspSetup, Record

DiagnosticKind = Literal["dwell", "lift_speed", "supply_pressure", "closed_empty", "dead_weight", "reference"]
Cell = tuple[int, int]  # (object id, repeat)

NO_OBJECT = -1
_WITHOUT_OBJECT = ("closed_empty", "dead_weight")
_Dwell = Annotated[float, Field(ge=0, le=600)]
_LiftSpeed = Annotated[float, Field(gt=0, le=50)]
_Pressure = Annotated[float, Field(ge=5, le=60)]
_Mass = Annotated[float, Field(gt=0, le=15)]


class DiagnosticRun(Record):
    """One run of a diagnostic experiment; a knob that is None stays as in ordinary grasps.

    `repeat` counts the runs of one setting, or of the reference grasp on a tool.
    """

    kind: DiagnosticKind
    object_id: int = Field(default=NO_OBJECT, ge=NO_OBJECT)
    repeat: int = Field(default=0, ge=0)
    dwell_s: _Dwell | None = None
    lift_speed_mm_per_s: _LiftSpeed | None = None
    supply_pressure_psi: _Pressure | None = None
    mass_kg: _Mass | None = None

    @model_validator(mode="after")
    def _check_object(self) -> "DiagnosticRun":
        if (self.object_id == NO_OBJECT) != (self.kind in _WITHOUT_OBJECT):
            needs = "no object" if self.kind in _WITHOUT_OBJECT else "an object"
            raise ValueError(f"a {self.kind} run needs {needs}, object_id is {self.object_id}; change it")
        if (self.mass_kg is not None) != (self.kind == "dead_weight"):
            raise ValueError(f"a {self.kind} run has mass_kg {self.mass_kg}; only a dead weight has a mass")
        return self

    @property
    def parameters(self) -> dict[str, float]:
        """The knobs that were turned, with their values."""
        names = ("dwell_s", "lift_speed_mm_per_s", "supply_pressure_psi", "mass_kg")
        values = {name: getattr(self, name) for name in names}
        return {name: value for name, value in values.items() if value is not None}

    def setup_of(self, setup: GraspSetup) -> GraspSetup:
        """The setup of this run, from that of ordinary grasps."""
        knobs = {name: value for name, value in self.parameters.items() if name in GraspSetup.model_fields}
        return setup.model_copy(update=knobs)

    def text(self) -> str:
        """`dwell, dwell_s 10, tube (14), repeat 0`."""
        from fast.models.objects.catalogue import name_object  # only those who print it need the objects

        knobs = [f"{name} {value:g}" for name, value in self.parameters.items()]
        target = [name_object(self.object_id)] if self.object_id != NO_OBJECT else []
        return ", ".join([self.kind.replace("_", " "), *knobs, *target, f"repeat {self.repeat}"])


# Of a plan: an ordinary grasp, a diagnostic run, or a grasp that is asked for with its own setup and placement.
Item = Cell | DiagnosticRun | GraspRequest


class ReferenceTool(Record):
    """Fingers that stay in one slot of the rack from batch to batch and make the reference grasps."""

    slot: int = Field(ge=0, le=9, description="slot of the rack where it hangs; no tool of a batch may hang there")
    design: FinRay


class DiagnosticPlan(Record):
    """Which diagnostic experiments are made with a tool; the section `[diagnostics]` of a config.

    An empty list leaves an experiment out. A batch makes reference grasps, and the whole protocol with one tool, only
    where `reference_every` and `protocol_slot` ask for it.
    """

    objects: tuple[Annotated[int, Field(ge=0)], ...] = Field(
        default=(2, 14, 24), description="objects of dwell, lift speed and pressure runs"
    )
    repeats: int = Field(default=2, ge=1, le=20, description="runs of each setting")
    dwell_s: tuple[_Dwell, ...] = (0.0, 2.0, 10.0, 30.0)
    lift_speeds_mm_per_s: tuple[_LiftSpeed, ...] = (1.0, 5.0, 20.0)
    supply_pressures_psi: tuple[_Pressure, ...] = (20.0, 30.0, 40.0)
    closed_empty: int = Field(default=3, ge=0, le=50, description="runs without an object")
    dead_weights_kg: tuple[_Mass, ...] = Field(default=(), description="masses that a person hangs on the gripper")
    reference_every: int = Field(default=0, ge=0, description="ordinary grasps between reference grasps; 0 is none")
    reference_object: int = Field(default=14, ge=0)
    reference_tool: ReferenceTool | None = Field(
        default=None, description="makes the reference grasps; none: each tool makes them itself"
    )
    protocol_slot: int | None = Field(
        default=None, ge=0, le=9, description="slot whose tool makes all experiments after its grasps, in every batch"
    )

    @model_validator(mode="after")
    def _check_reference(self) -> "DiagnosticPlan":
        if self.reference_tool is not None and not self.reference_every:
            raise ValueError("reference_tool makes no grasp while reference_every is 0; say after how many grasps")
        return self

    @property
    def is_made(self) -> bool:
        """Whether a batch makes any of the experiments."""
        return bool(self.reference_every) or self.protocol_slot is not None

    @property
    def objects_of_batch(self) -> set[int]:
        """Objects of the experiments that a batch makes."""
        runs = self.runs(0) if self.protocol_slot is not None else []
        runs += [self.reference(0)] if self.reference_every else []
        return {run.object_id for run in runs} - {NO_OBJECT}

    def runs(self, seed: int) -> list[DiagnosticRun]:
        """The experiments in order: weights up and down first (a person stands by), empty, then all others shuffled.

        Shuffled, because what changes with the number of grasps must not look like the effect of a knob.
        """
        weights = [*self.dead_weights_kg, *reversed(self.dead_weights_kg)]
        first = [
            DiagnosticRun(kind="dead_weight", mass_kg=mass, repeat=i // max(len(self.dead_weights_kg), 1))
            for i, mass in enumerate(weights)
        ]
        empty = [DiagnosticRun(kind="closed_empty", repeat=repeat) for repeat in range(self.closed_empty)]
        turned = [run for repeat in range(self.repeats) for obj in self.objects for run in self._turned(obj, repeat)]
        random.Random(seed).shuffle(turned)
        return [*first, *empty, *turned]

    def with_references(self, cells: Sequence[Cell], n_before: int = 0) -> list[Item]:
        """An ordinary plan with a reference grasp before it and after every `reference_every` of its grasps.

        As it is where a tool of its own makes the reference grasps.

        `n_before`: ordinary grasps the tool has made already, so that a resumed plan keeps the same places.
        """
        every = self.reference_every if self.reference_tool is None else 0
        items: list[Item] = []
        for number, cell in enumerate(cells, n_before):
            if every and number % every == 0:
                items.append(self.reference(number // every))
            items.append(cell)
        return items

    def reference(self, repeat: int) -> DiagnosticRun:
        """The reference grasp for the n-th time."""
        return DiagnosticRun(kind="reference", object_id=self.reference_object, repeat=repeat)

    def _turned(self, object_id: int, repeat: int) -> list[DiagnosticRun]:
        where = {"object_id": object_id, "repeat": repeat}
        return [
            *(DiagnosticRun(kind="dwell", dwell_s=value, **where) for value in self.dwell_s),
            *(
                DiagnosticRun(kind="lift_speed", lift_speed_mm_per_s=value, **where)
                for value in self.lift_speeds_mm_per_s
            ),
            *(
                DiagnosticRun(kind="supply_pressure", supply_pressure_psi=value, **where)
                for value in self.supply_pressures_psi
            ),
        ]
