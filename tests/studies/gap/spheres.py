"""Which effects make a modulus depend on the size of a sphere, and which grasp tells them apart.

A group fits Young's modulus to the curve of closing and pulling, on a sphere of 28 mm and on one of 42 mm, and gets two
values. Here each effect of the catalogue acts in turn, and the modulus is fitted without it.
"""

import numpy as np

from fast.models.design.space import numbered_design
from fast.models.errors import SimulationFailed
from fast.models.objects.catalogue import get_object
from fast.models.objects.rigid import RigidObject
from fast.models.records import EffectValue, GraspSetup
from fast.models.simulation.effects.catalogue import CATALOGUE
from fast.models.simulation.grasp import simulate_grasp
from fast.models.simulation.version import SimulatorVersion
from fast.models.traces.step_features import step_means
from tests.studies.benchmarks.base import Options, Tables
from tests.studies.benchmarks.study import DEADLINE_S

DIAMETERS_MM = (28.0, 42.0)
FIRST_DESIGN, N_DESIGNS = 0, 2
USUAL = GraspSetup()
WIDER_MM = 8.0  # added to the closed gap
MOVED = 0.1  # of a ratio of 1: an effect that moves it less leaves it


def measure_spheres(options: Options) -> Tables:
    """How much smaller or larger a modulus comes out on a sphere of 42 mm than of 28 mm, under each effect."""
    designs = range(FIRST_DESIGN, FIRST_DESIGN + (options.designs or N_DESIGNS))
    wider = USUAL.model_copy(update={"closed_gap_mm": USUAL.closed_gap_mm + WIDER_MM})
    bare = {
        (design, mm, setup): _solve(design, mm, (), setup)
        for design in designs
        for mm in DIAMETERS_MM
        for setup in (USUAL, wider)
    }
    rows = []
    for name, spec in CATALOGUE.items():
        for parameters in spec.bank_runs:
            value = EffectValue(effect=name, parameters=dict(parameters))
            ratios = [_fit_ratio(design, value, USUAL, bare) for design in designs]
            row: dict[str, object] = {"effect": name, "setting": ", ".join(f"{k} {v:g}" for k, v in parameters.items())}
            row |= {"smallest": _least(ratios), "largest": _most(ratios)}
            if any(abs(one - 1.0) > MOVED for one in ratios):
                closed_less = [_fit_ratio(design, value, wider, bare) for design in designs]
                row |= {"smallest, closed less": _least(closed_less), "largest, closed less": _most(closed_less)}
            rows.append(row)
            options.tell(f"{name} {parameters}: {ratios}")
    return {"modulus on a sphere of 42 mm over that on one of 28 mm": rows}


def _fit_ratio(
    design: int, value: EffectValue, setup: GraspSetup, bare: dict[tuple[int, float, GraspSetup], np.ndarray]
) -> float:
    """Modulus fitted to the larger sphere's forces over that of the smaller one's, by the simulator without effects."""
    moduli = []
    for mm in DIAMETERS_MM:
        plain_n, force_n = bare[design, mm, setup], _solve(design, mm, (value,), setup)
        moduli.append(float(force_n @ plain_n / (plain_n @ plain_n)))
    return moduli[1] / moduli[0]


def _solve(design: int, diameter_mm: float, effects: tuple[EffectValue, ...], setup: GraspSetup) -> np.ndarray:
    """Step means of a grasp, 120; NaN where it failed."""
    version = SimulatorVersion().model_copy(update={"effects": effects})
    try:
        made = simulate_grasp(numbered_design(design), _make_sphere(diameter_mm), version, setup, deadline_s=DEADLINE_S)
    except SimulationFailed:
        return np.full(120, np.nan)
    return step_means(made.trace)


def _make_sphere(diameter_mm: float) -> RigidObject:
    return get_object(0).model_copy(update={"parameters": {"diameter_mm": diameter_mm}})


def _least(values: list[float]) -> float:
    return round(float(np.nanmin(values)), 2)


def _most(values: list[float]) -> float:
    return round(float(np.nanmax(values)), 2)
