"""Geometry effects: what is printed instead of what was drawn."""

from dataclasses import dataclass

import numpy as np
import shapely
from shapely import affinity
from shapely.geometry import Polygon, box

from fast.models.design.fin_ray import BASE_HEIGHT_MM, cavity_share, rib_centres, take_fin_ray
from fast.models.records import Design
from fast.models.simulation.effects.base import Effect
from fast.models.simulation.effects.spec import FINGER, EffectSpec, Measurement, amplitude
from fast.models.simulation.effects.states import RIBS, State, of_design

_FADE_MM = 2.0  # over which the bow fades out beside a rib, and towards base and tip


@dataclass(frozen=True)
class WallThicknessOffset(Effect):
    """Every printed wall and rib is thicker than drawn by `offset_mm` (negative: thinner).

    The profile grows by half the offset on all sides. It is then moved so that the front wall stays the plane
    x = 0, and cut or continued at the base and the tip plane, so stroke and height keep their meaning.
    """

    offset_mm: float

    def modify_profile(self, profile: Polygon, design: Design) -> Polygon:
        """Return the profile (x, z in mm) that is really printed."""
        if self.offset_mm == 0.0:
            return profile
        x_min, z_min, x_max, z_max = profile.bounds
        window = box(x_min - 1.0, z_min, x_max + 1.0, z_max)
        half = 0.5 * self.offset_mm
        if half > 0.0:
            printed = profile.buffer(half, join_style="mitre")
        else:
            # Growing the empty space inside the window thins the walls and leaves the cut ends in place.
            printed = profile.difference(window.difference(profile).buffer(-half, join_style="mitre"))
        moved = affinity.translate(printed, xoff=half).intersection(window)
        return max(shapely.get_parts(moved), key=lambda part: part.area)


WALL_THICKNESS_OFFSET = EffectSpec(
    effect="wall_thickness_offset",
    title="Printed walls are thicker than drawn",
    code="G1",
    layer="geometry",
    kind=WallThicknessOffset,
    formula="every wall and rib is thicker by offset_mm",
    source="tolerance of material jetting, +-0.1 mm",
    cost="F",
    parameters=(amplitude("offset_mm", -0.3, 0.3, (0.05, 0.08)),),
    state=State("drawn front wall, mm", of_design("front_thickness_mm"), 2.0),
    bank_runs=({"offset_mm": -0.1}, {"offset_mm": 0.1}, {"offset_mm": 0.2}),
    family=FINGER,
    experiment="calliper and scale on three fingers: wall thickness to 0.02 mm",
    measurement=Measurement(
        kind="walls",
        words="measure both walls and the ribs of three fingers with callipers, and take the mean of what is more than "
        "drawn; or measure those of every tool, and say them with `fast print measured`",
        label="Walls, more than drawn, mm",
        parameter="offset_mm",
        sd=0.03,
        minutes=6.0,
        values=(-1.0, 1.0),
    ),
    confusable_with=("load_cell_gain", "print_anisotropy", "batch_ageing"),
)


@dataclass(frozen=True)
class RibImperfection(Effect):
    """Every rib is bowed by w0 sin(pi s), s from 0 at the front wall to 1 at the back wall, with `bow_mm` w0.

    Which way each rib is bowed is drawn from the design, so a tool always has the same bows. A straight rib stays
    straight until it bifurcates (Euler load 3 to 13 N for 30 x 2 mm); a bowed one gives way from
    the start, as printed ones do. Ribs of a closed finger are bent by their walls anyway, so half a millimetre of bow
    changes the peak by 2 % at most.
    """

    bow_mm: float

    def modify_section(self, points: np.ndarray, design: Design) -> np.ndarray:
        """Return points (n, 2) of the section where they are really printed, mm."""
        if self.bow_mm == 0.0:
            return points
        fin_ray = take_fin_ray(design, "the effect `rib_imperfection`")
        angle = np.radians(fin_ray.rib_angle_deg)
        across = np.array([-np.sin(angle), np.cos(angle)])
        centres = rib_centres(fin_ray)
        signs = np.random.default_rng(int(design.design_id[1:], 16)).choice([-1.0, 1.0], len(centres))
        beside_mm = np.abs((points[:, None] - centres) @ across)
        nearest = np.argmin(beside_mm, axis=1)
        outside_mm = beside_mm.min(axis=1) - 0.5 * fin_ray.rib_thickness_mm
        top_mm = design.height_mm - fin_ray.tip_length_mm
        height_mm = points[:, 1]
        inside_mm = np.minimum(height_mm - BASE_HEIGHT_MM, top_mm - height_mm)
        fade = np.clip(1.0 - outside_mm / _FADE_MM, 0.0, 1.0) * np.clip(inside_mm / _FADE_MM, 0.0, 1.0)
        bow_mm = self.bow_mm * signs[nearest] * fade * np.sin(np.pi * cavity_share(points, fin_ray))
        return np.asarray(points + bow_mm[:, None] * across)


RIB_IMPERFECTION = EffectSpec(
    effect="rib_imperfection",
    title="Ribs are bowed and buckle early",
    code="G2",
    layer="geometry",
    kind=RibImperfection,
    formula="middle line of a rib: bow_mm sin(pi s), s from wall to wall, its sign drawn per rib",
    source="imperfect column: Timoshenko & Gere 1961, chapter 1",
    cost="F",
    needs_fin_ray=True,
    parameters=(amplitude("bow_mm", 0.0, 0.5, (0.1, 0.1)),),
    state=RIBS,
    bank_runs=({"bow_mm": 0.15}, {"bow_mm": 0.4}),
    family=FINGER,
    measurement=Measurement(
        kind="photograph",
        words="photograph three fingers from the side with a scale, and measure by how much the ribs are bowed",
        label="Bow of the ribs, mm",
        parameter="bow_mm",
        sd=0.1,
        minutes=8.0,
        values=(0.0, 3.0),
    ),
    confusable_with=("force_limited_closing", "base_compliance", "hyperelastic_stiffening"),
)


SPECS = (
    WALL_THICKNESS_OFFSET,
    RIB_IMPERFECTION,
)
