"""Which effects make a fitted modulus depend on the object: what one finger on two objects can tell, from the bank.

A modulus is fitted to the forces of each object alone, by the simulator without the effect. Effects that change all
objects alike are a modulus to these data; the others leave a ratio that no modulus explains.
"""

from collections.abc import Sequence

import numpy as np

from fast.flows.challenge.hidden.panel_file import PANEL, read_small
from fast.models.design.space import BEST_PUBLISHED
from fast.models.gap.bank.bank import Bank
from fast.models.objects.catalogue import get_object
from fast.models.records import EffectValue, GraspSetup
from fast.models.simulation.grasp import simulate_grasp
from fast.models.simulation.version import SimulatorVersion
from tests.studies.benchmarks.base import Options, Rows, Tables

SMALLER, LARGER = 0, 1  # spheres of 30 and 40 mm
CLOSED_MM, LESS_FAR_MM = 16.0, 30.0
LIFT_MM = np.linspace(0.0, 12.0, 121)
START = slice(1, 8)  # of `LIFT_MM`: 0.1 to 0.7 mm
# What moves the ratio by a quarter, in two settings each.
MOVERS = (
    EffectValue(effect="force_limited_closing", parameters={"max_force_n": 2.5}),
    EffectValue(effect="force_limited_closing", parameters={"max_force_n": 6.0}),
    EffectValue(effect="pressure_dependent_friction", parameters={"exponent": 0.33, "reference_mpa": 0.02}),
    EffectValue(effect="pressure_dependent_friction", parameters={"exponent": 0.33, "reference_mpa": 0.05}),
    EffectValue(effect="static_kinetic_friction", parameters={"kinetic_ratio": 0.5, "slip_scale_mm": 0.5}),
    EffectValue(effect="static_kinetic_friction", parameters={"kinetic_ratio": 0.5, "slip_scale_mm": 2.0}),
)


def measure_moduli(options: Options) -> Tables:
    """By how much fitted moduli of two objects differ under each simulated effect, over pairs of objects.

    And for two spheres, what tells those effects apart: the start of the lift, and a gentler grasp of the larger one.
    """
    _, bank = read_small(options.panel or PANEL)
    return {
        "smaller over larger modulus of two objects": list_ratios(bank),
        "modulus of the larger over that of the smaller sphere": list_deciding(),
    }


def list_deciding(movers: Sequence[EffectValue] = MOVERS) -> Rows:
    """Of each effect the ratio of two moduli: whole lift, its first 0.7 mm, larger sphere closed 14 mm less far."""
    cells = ((SMALLER, CLOSED_MM), (LARGER, CLOSED_MM), (LARGER, LESS_FAR_MM))
    bare_n = [_lift(*cell) for cell in cells]
    rows: Rows = []
    for mover in movers:
        found_n = [_lift(*cell, mover) for cell in cells]
        whole = [float(_fit_moduli(bare, found)) for bare, found in zip(bare_n, found_n, strict=True)]
        start = [float(_fit_moduli(bare[START], found[START])) for bare, found in zip(bare_n, found_n, strict=True)]
        setting = ", ".join(f"{key} {value:g}" for key, value in mover.parameters.items())
        rows.append(
            {
                "effect": mover.effect,
                "setting": setting,
                "whole lift": round(whole[1] / whole[0], 2),
                "first 0.7 mm": round(start[1] / start[0], 2),
                "closed 14 mm less far": round(whole[2] / whole[0], 2),
            }
        )
    return rows


def _lift(object_id: int, closed_gap_mm: float, *effects: EffectValue) -> np.ndarray:
    """Force in N at each of `LIFT_MM`, of the best published finger."""
    setup = GraspSetup(closed_gap_mm=closed_gap_mm)
    trace = simulate_grasp(BEST_PUBLISHED, get_object(object_id), SimulatorVersion(effects=effects), setup).trace
    return np.interp(LIFT_MM, trace.lift_mm, trace.force_n)


def list_ratios(bank: Bank) -> Rows:
    """Of each effect at each size, the median and the least ratio of two moduli, over pairs of objects."""
    rows: Rows = []
    for name, runs in bank.effects.items():
        for place, parameters in enumerate(runs.parameters):
            moduli = _fit_moduli(bank.centre_steps_n, runs.steps_n[:, :, place])
            first, second = np.triu_indices(moduli.shape[1], k=1)
            ratios = moduli[:, first] / moduli[:, second]
            smaller = np.nanmedian(np.minimum(ratios, 1.0 / ratios), axis=0)
            setting = ", ".join(f"{key} {value:g}" for key, value in parameters.items())
            row = {"median": round(float(np.median(smaller)), 2), "least": round(float(smaller.min()), 2)}
            rows.append({"effect": name, "setting": setting} | row)
    return rows


def _fit_moduli(bare_n: np.ndarray, with_it_n: np.ndarray) -> np.ndarray:
    """Moduli of each tool on each object (t x o) over that of the bank, by least squares of the lift (t x o x 120)."""
    return np.asarray((with_it_n * bare_n).sum(axis=-1) / (bare_n**2).sum(axis=-1))
