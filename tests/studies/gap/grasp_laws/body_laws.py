"""Laws of the finger and its jaw that a truth may hide, each another than the catalogue's of the same physics."""

from typing import ClassVar

import numpy as np

from fast.flows.challenge.hidden.lab_laws import tool_draws
from fast.hardware.virtual.world.hidden import DirectionalDilation
from fast.models.design.fin_ray import cavity_share, take_fin_ray
from fast.models.records import Design, GraspSetup
from fast.models.simulation.effects.base import Effect
from tests.studies.gap.grasp_laws.parts import find_ribs


class ScatteredStiffening(Effect):
    """Strain stiffening whose `stiffening` differs from tool to tool by 25 % sd, as cure does.

    The solver has one stiffening energy, so the law itself is the catalogue's (M3); only its scatter is not.
    """

    def __init__(self, stiffening: float, tool_seed: int) -> None:
        self.stiffening = stiffening * float(1.0 + 0.25 * tool_draws(tool_seed, 0x3, 1)[0])

    def strain_stiffening(self) -> float:
        """Coefficient of the quadratic energy."""
        return max(self.stiffening, 0.0)


class LayeredModulus(Effect):
    """Printed layers: a strand at an angle a to the layers has the modulus (1 + `excess` cos^2 a) of one across.

    Ribs lie at the design's rib angle, walls and tip stand across the layers; the change fades over the ends of a rib
    (M7: the catalogue gives all ribs one factor).
    """

    fade = 0.15

    def __init__(self, excess: float) -> None:
        self.excess = excess

    def stiffness_factor(self, points: np.ndarray, design: Design) -> np.ndarray:
        """Factor (n) on the modulus of elements at `points` (n, 2) of the section, mm."""
        design = take_fin_ray(design, "the hidden law of ribs")
        share = cavity_share(points, design)
        inside = np.clip(np.minimum(share, 1.0 - share) / self.fade, 0.0, 1.0)
        is_below_tip = points[:, 1] < design.height_mm - design.tip_length_mm
        along = np.cos(np.radians(design.rib_angle_deg)) ** 2
        return np.asarray(1.0 + self.excess * along * inside * is_below_tip)


class WavyRibs(Effect):
    """Ribs that left the printer wavy: two half waves of sizes drawn for every rib, `bow_mm` sd (G2).

    The catalogue bows every rib by the same one half wave.
    """

    def __init__(self, bow_mm: float, tool_seed: int) -> None:
        self.bow_mm = bow_mm
        self.tool_seed = tool_seed

    def modify_section(self, points: np.ndarray, design: Design) -> np.ndarray:
        """Points (n, 2) of the section as printed, mm."""
        if self.bow_mm == 0.0:
            return points
        design = take_fin_ray(design, "the hidden law of wavy ribs")
        rib, near, across = find_ribs(points, design)
        waves = tool_draws(self.tool_seed, 0x62, 2 * design.rib_count).reshape(-1, 2)
        phase = np.pi * cavity_share(points, design)
        shape = 0.9 * waves[rib, 0] * np.sin(phase) + 0.4 * waves[rib, 1] * np.sin(2.0 * phase)
        return np.asarray(points + (self.bow_mm * near * shape)[:, None] * across)


class SlackMount(Effect):
    """A mount with play: the finger stays behind by a slack and then by C N (G5: the catalogue has no slack).

    `compliance_mm_per_n` C; the slack is `slack_share` mm of every 0.01 mm/N of it.
    """

    scales_with_modulus: ClassVar[bool] = False
    slack_share = 0.1

    def __init__(self, compliance_mm_per_n: float) -> None:
        self.compliance_mm_per_n = compliance_mm_per_n

    def modify_setup(self, setup: GraspSetup, design: Design) -> GraspSetup:
        """The gap to which the fingers close without any force."""
        slack_mm = self.slack_share * self.compliance_mm_per_n / 0.01
        return setup.model_copy(update={"closed_gap_mm": setup.closed_gap_mm + 2.0 * slack_mm})

    def base_compliance_mm_per_n(self) -> float:
        """How far a finger's base stays behind per force."""
        return self.compliance_mm_per_n


class WiderClosing(Effect):
    """Jaws that stop `wider_mm` early each: what a lower pressure does (A3), and nothing else."""

    def __init__(self, wider_mm: float) -> None:
        self.wider_mm = wider_mm

    def modify_setup(self, setup: GraspSetup, design: Design) -> GraspSetup:
        """The setup with the wider gap."""
        return setup.model_copy(update={"closed_gap_mm": setup.closed_gap_mm + 2.0 * self.wider_mm})


class OtherMaterialLaw(Effect):
    """A finger that is weaker in compression than in tension: St. Venant-Kirchhoff instead of neo-Hookean.

    No catalogue lists it. The law is a setting of the solver, which `truth` makes for this class.
    """


class WeakFinger(DirectionalDilation):
    """Walls of one of the two fingers thinner by `thinner_mm`. No catalogue lists fingers that differ.

    Fingers touch an object that does not move, so each pulls as one of two like it: `truth` takes
    the mean of a grasp with this effect and one without.
    """

    def __init__(self, thinner_mm: float, tool_seed: int) -> None:
        super().__init__(-thinner_mm, tool_seed)
