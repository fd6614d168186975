"""G2: ribs that are not straight, so that they buckle early."""

from dataclasses import dataclass

import numpy as np

from models.design.profile import BASE_HEIGHT_MM, cavity_share, rib_centres
from models.records import Design
from models.simulation.effects.base import Effect
from models.simulation.effects.spec import EffectSpec, amplitude

_FADE_MM = 2.0  # over which the bow fades out beside a rib, and towards base and tip


@dataclass(frozen=True)
class RibImperfection(Effect):
    """Every rib is bowed by w0 sin(pi s), s from 0 at the front wall to 1 at the back wall, with `bow_mm` w0.

    Which way each rib is bowed is drawn from the design, so a tool always has the same bows. A straight rib stays
    straight until it bifurcates (Euler load 3 to 13 N for 30 x 2 mm, notes/gap.md G2); a bowed one gives way from
    the start, as printed ones do. Ribs of a closed finger are bent by their walls anyway, so half a millimetre of bow
    changes the peak by 2 % at most.
    """

    bow_mm: float

    def modify_section(self, points: np.ndarray, design: Design) -> np.ndarray:
        """Points (n, 2) of the section where they are really printed, mm."""
        if self.bow_mm == 0.0:
            return points
        angle = np.radians(design.rib_angle_deg)
        across = np.array([-np.sin(angle), np.cos(angle)])
        centres = rib_centres(design)
        signs = np.random.default_rng(int(design.design_id[1:], 16)).choice([-1.0, 1.0], len(centres))
        beside_mm = np.abs((points[:, None] - centres) @ across)
        nearest = np.argmin(beside_mm, axis=1)
        outside_mm = beside_mm.min(axis=1) - 0.5 * design.rib_thickness_mm
        top_mm = design.height_mm - design.tip_length_mm
        height_mm = points[:, 1]
        inside_mm = np.minimum(height_mm - BASE_HEIGHT_MM, top_mm - height_mm)
        fade = np.clip(1.0 - outside_mm / _FADE_MM, 0.0, 1.0) * np.clip(inside_mm / _FADE_MM, 0.0, 1.0)
        bow_mm = self.bow_mm * signs[nearest] * fade * np.sin(np.pi * cavity_share(points, design))
        return np.asarray(points + bow_mm[:, None] * across)


SPEC = EffectSpec(
    effect="rib_imperfection",
    title="Ribs are bowed and buckle early",
    code="G2",
    layer="geometry",
    kind=RibImperfection,
    formula="middle line of a rib: bow_mm sin(pi s), s from wall to wall, its sign drawn per rib",
    source="imperfect column: Timoshenko & Gere 1961, chapter 1",
    cost="F",
    parameters=(amplitude("bow_mm", 0.0, 0.5, (0.1, 0.1)),),
    confusable_with=("force_limited_closing", "base_compliance", "hyperelastic_stiffening"),
)
