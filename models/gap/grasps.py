"""Measured grasps one by one, and the cells that they make: tools on what they closed on."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from hashlib import sha256
from typing import Any, NamedTuple, TypeVar

import numpy as np

from fast.models.ids import content_id
from fast.models.records import Design, GraspContext, GraspSetup, Placement
from fast.models.traces.step_noise import SensorNoise

_T = TypeVar("_T")
_USUAL = GraspSetup()


class Target(NamedTuple):
    """What a tool closes on: an object where it sits, by a stroke; `setup` has the timing of the base setup.

    Grasps of a tool on one target are one simulation, whatever their speeds and dwell (`GraspSetup.timed_as`).
    """

    object_id: int
    setup: GraspSetup
    placement: Placement = Placement()

    @property
    def key(self) -> "Target":
        """The target without its timing: equal for targets with equal finite elements."""
        return self._replace(setup=self.setup.timed_as(GraspSetup()))


@dataclass(frozen=True, eq=False)
class Cells:
    """Designs (t) and targets (k) to simulate; is_wanted: t x k, which of them together."""

    designs: tuple[Design, ...]
    targets: tuple[Target, ...]
    is_wanted: np.ndarray

    @staticmethod
    def full(designs: Sequence[Design], objects: Sequence[int], setup: GraspSetup) -> "Cells":
        """Pair every design with every object by one setup."""
        targets = tuple(Target(object_id, setup) for object_id in objects)
        return Cells(tuple(designs), targets, np.ones((len(designs), len(targets)), dtype=bool))


@dataclass(frozen=True, eq=False)
class Grasps:
    """n measured grasps of t tools on o objects, in the order in which they were made."""

    tools: tuple[str, ...]
    """t, names."""
    designs: tuple[Design, ...]
    """t, of the tools, with the measured thicknesses where a person gave them."""
    objects: tuple[int, ...]
    """o, ids."""
    tool: np.ndarray
    """n, numbers into `tools`."""
    obj: np.ndarray
    """n, numbers into `objects`."""
    contexts: tuple[GraspContext, ...]
    """n, what came before each."""
    steps_n: np.ndarray
    """n x 120, mean forces over steps of 0.5 mm of lift (`models.traces.step_features.step_means`), as measured."""
    grasp_ids: tuple[str, ...]
    """n, of the lake."""
    noise: SensorNoise
    """Of the load cell."""
    setups: tuple[GraspSetup, ...]
    """Distinct ones, the base setup first."""
    setup: np.ndarray
    """n, numbers into `setups`."""
    placements: tuple[Placement, ...]
    """Distinct ones as asked for, the nominal one first."""
    placement: np.ndarray
    """n, numbers into `placements`."""

    @property
    def base_setup(self) -> GraspSetup:
        """The setup of ordinary grasps."""
        return self.setups[0]

    @property
    def lift_speed_mm_per_s(self) -> np.ndarray:
        """Speed of the lift of each grasp, n."""
        return np.array([setup.lift_speed_mm_per_s for setup in self.setups])[self.setup]

    @property
    def target(self) -> list[Target]:
        """What each grasp closes on, n."""
        stroke = [setup.timed_as(self.base_setup) for setup in self.setups]
        numbers = zip(self.obj, self.setup, self.placement, strict=True)
        return [Target(self.objects[obj], stroke[at], self.placements[placed]) for obj, at, placed in numbers]

    @property
    def cells(self) -> Cells:
        """Every tool on every object by the base setup, and each on what else it closed on."""
        usual = Cells.full(self.designs, self.objects, self.base_setup)
        target = self.target
        others = list(dict.fromkeys(one for one in target if one not in usual.targets))
        is_wanted = np.zeros((len(self.tools), len(others)), dtype=bool)
        for tool, one in zip(self.tool, target, strict=True):
            if one in others:
                is_wanted[tool, others.index(one)] = True
        return Cells(self.designs, (*usual.targets, *others), np.hstack([usual.is_wanted, is_wanted]))

    def select(self, rows: np.ndarray) -> "Grasps":
        """Return the grasps of these rows, with all tools and objects."""
        return replace(
            self,
            tool=self.tool[rows],
            obj=self.obj[rows],
            contexts=tuple(self.contexts[row] for row in rows),
            steps_n=self.steps_n[rows],
            setup=self.setup[rows],
            placement=self.placement[rows],
            grasp_ids=tuple(self.grasp_ids[row] for row in rows),
        )

    @property
    def content_id(self) -> str:
        """Id of what was measured: samples and setup of every grasp, as step means, and thicknesses of every tool."""
        samples = {
            grasp_id: sha256(np.round(steps_n, 6).astype("<f8").tobytes()).hexdigest()
            for grasp_id, steps_n in zip(self.grasp_ids, self.steps_n, strict=True)
        }
        printed = {tool: design.model_dump(mode="json") for tool, design in zip(self.tools, self.designs, strict=True)}
        unusual = {
            self.grasp_ids[row]: [
                self.setups[self.setup[row]].setup_id,
                self.placements[self.placement[row]].model_dump(),
            ]
            for row in np.flatnonzero((self.setup > 0) | (self.placement > 0))
        }
        return content_id("M", [samples, printed, *([unusual] if unusual else [])])


def of_one_setup(n: int, setup: GraspSetup = _USUAL) -> dict[str, Any]:
    """Return fields of `Grasps` that were all made in one way, with the object at its place."""
    nothing = np.zeros(n, dtype=int)
    return {"setups": (setup,), "setup": nothing, "placements": (Placement(),), "placement": nothing}


def number_distinct(values: Sequence[_T], first: _T) -> tuple[tuple[_T, ...], np.ndarray]:
    """List distinct values in order, `first` before all, and the number of each value (n) into them."""
    distinct = tuple(dict.fromkeys([first, *values]))
    return distinct, np.array([distinct.index(value) for value in values], dtype=int)
