"""Measured grasps one by one, and the cross-validation folds in which they are left out: designs, objects by class."""

from dataclasses import dataclass, replace
from functools import cached_property
from hashlib import sha256

import numpy as np

from models.ids import content_id
from models.objects.catalogue import get_object
from models.records import Design, GraspContext, GraspSetup
from models.traces.step_noise import SensorNoise

N_DESIGN_FOLDS = 5
N_OBJECT_FOLDS = 6


@dataclass(frozen=True, eq=False)
class Grasps:
    """n measured grasps of t tools on o objects, in the order in which they were made.

    tools: names (t); designs: of each tool (t), the measured thicknesses where a person gave them; objects: ids (o).
    tool, obj: n, numbers into these. contexts: n. steps_n: n x 120, mean forces over steps of 0.5 mm of lift
    (`models.traces.step_features.step_means`), as measured. grasp_ids: n, of the lake.
    """

    tools: tuple[str, ...]
    designs: tuple[Design, ...]
    objects: tuple[int, ...]
    tool: np.ndarray
    obj: np.ndarray
    contexts: tuple[GraspContext, ...]
    steps_n: np.ndarray
    grasp_ids: tuple[str, ...]
    noise: SensorNoise
    setup: GraspSetup

    def select(self, rows: np.ndarray) -> "Grasps":
        """The grasps of these rows, with all tools and objects."""
        return replace(
            self,
            tool=self.tool[rows],
            obj=self.obj[rows],
            contexts=tuple(self.contexts[row] for row in rows),
            steps_n=self.steps_n[rows],
            grasp_ids=tuple(self.grasp_ids[row] for row in rows),
        )

    @property
    def content_id(self) -> str:
        """Id of what was measured: samples of every grasp, as step means, and thicknesses of every tool."""
        samples = {
            grasp_id: sha256(np.round(steps_n, 6).astype("<f8").tobytes()).hexdigest()
            for grasp_id, steps_n in zip(self.grasp_ids, self.steps_n, strict=True)
        }
        printed = {tool: design.model_dump(mode="json") for tool, design in zip(self.tools, self.designs, strict=True)}
        return content_id("M", [samples, printed])

    @cached_property
    def design_folds(self) -> np.ndarray:
        """Fold of each grasp when designs are left out, n."""
        return assign_design_folds(self, N_DESIGN_FOLDS)

    @cached_property
    def object_folds(self) -> np.ndarray:
        """Fold of each grasp when object classes are left out, n."""
        return assign_object_folds(self, N_OBJECT_FOLDS)

    @cached_property
    def is_in_first_half(self) -> np.ndarray:
        """Whether the grasp's object is in the first half of all objects, n: they tell a new tool's modulus."""
        _, place = np.unique(self.obj, return_inverse=True)
        return np.asarray(place % 2 == 0)


def assign_design_folds(grasps: Grasps, n_folds: int) -> np.ndarray:
    """Fold of each grasp by its tool, n; tools of equal designs stay together."""
    ids = [design.design_id for design in grasps.designs]
    present = sorted({ids[tool] for tool in grasps.tool})
    fold = {name: place % n_folds for place, name in enumerate(present)}
    return np.array([fold[ids[tool]] for tool in grasps.tool])


def assign_object_folds(grasps: Grasps, n_folds: int) -> np.ndarray:
    """Fold of each grasp by its object's class, n; the largest classes are spread first."""
    classes = [get_object(number).object_class for number in grasps.objects]
    names, counts = np.unique([classes[obj] for obj in np.unique(grasps.obj)], return_counts=True)
    load = np.zeros(min(n_folds, len(names)))
    fold = {}
    for place in np.argsort(-counts, kind="stable"):
        fold[str(names[place])] = int(np.argmin(load))
        load[fold[str(names[place])]] += counts[place]
    return np.array([fold[classes[obj]] for obj in grasps.obj])
