"""What gap discovery works on: measured grasps one by one, and the bank of simulations around them."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from models.records import Design, GraspContext, GraspSetup, Theta
from models.traces.step_noise import SensorNoise


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


@dataclass(frozen=True, eq=False)
class Field:
    """An effect in the bank: a amplitudes at the centre. steps_n: t x o x a x 120; NaN where a simulation failed."""

    effect: str
    parameters: tuple[Mapping[str, float], ...]
    steps_n: np.ndarray


@dataclass(frozen=True, eq=False)
class Bank:
    """Simulations of t tools' designs on o objects, as step means (120); forces at `centre.young_modulus_mpa`.

    NaN where a simulation failed. grid: g x 2, friction and Poisson ratio. grid_steps_n: t x o x g x 120;
    grid_lead_n: t x o x g x 12, the same before the lift, see `sensing.lead_means`. centre_steps_n: t x o x 120.
    numerical_steps_n: t x o x v x 120, the centre on other meshes. wider_mm: w, how much earlier the jaws stop;
    wider_steps_n: t x o x w x 120. fields: effects of cost C and F by name. failed_share: of all simulations of the
    bank.
    """

    centre: Theta
    grid: np.ndarray
    grid_steps_n: np.ndarray
    grid_lead_n: np.ndarray
    centre_steps_n: np.ndarray
    numerical_steps_n: np.ndarray
    wider_mm: np.ndarray
    wider_steps_n: np.ndarray
    fields: Mapping[str, Field]
    failed_share: float = 0.0


@dataclass(frozen=True, eq=False)
class GapProblem:
    """Grasps and the bank of the same tools and objects.

    held_out_tools (t) and held_out_objects (o): masks, frozen before anything is looked at; a grasp that touches
    either is never used before SHOW.
    """

    grasps: Grasps
    bank: Bank
    held_out_tools: np.ndarray
    held_out_objects: np.ndarray

    @property
    def is_held_out(self) -> np.ndarray:
        """Which grasps are kept for SHOW, n."""
        return np.asarray(self.held_out_tools[self.grasps.tool] | self.held_out_objects[self.grasps.obj])
