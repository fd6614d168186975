"""What a misplaced object changes in a grasp, and what such a grasp costs: along each axis, turned, and all at once."""

from collections.abc import Mapping

import numpy as np

from fast.models.design.space import numbered_design
from fast.models.errors import SimulationFailed
from fast.models.objects.catalogue import get_object
from fast.models.records import GraspSimulation, Placement
from fast.models.simulation.grasp import simulate_grasp
from tests.studies.benchmarks.accuracy import ACCURACY_OBJECTS, FIRST_DESIGN
from tests.studies.benchmarks.base import Options, Tables
from tests.studies.benchmarks.study import DEADLINE_S
from tests.studies.simulation.material_law import rms_difference_n

N_DESIGNS = 2
OFFSET_MM, TURN_DEG = 0.3, 1.5  # of an object that a person sets down with care
NOMINAL = Placement()
PLACEMENTS: Mapping[str, Placement] = {
    "x, closing direction": Placement(offset_x_mm=OFFSET_MM),
    "y, along the fingers' width": Placement(offset_y_mm=OFFSET_MM),
    "z, higher": Placement(offset_z_mm=OFFSET_MM),
    "turned about z": Placement(yaw_deg=TURN_DEG),
    "x, y and turned": Placement(offset_x_mm=OFFSET_MM, offset_y_mm=-OFFSET_MM, yaw_deg=-TURN_DEG),
}


def measure_placement(options: Options) -> Tables:
    """What 0.3 mm and 1.5 degrees of a misplaced object change in the trace, and how much longer a grasp takes."""
    objects = options.objects or ACCURACY_OBJECTS
    cases = [
        (design, obj)
        for design in range(FIRST_DESIGN, FIRST_DESIGN + (options.designs or N_DESIGNS))
        for obj in objects
    ]
    _solve(cases[0], NOMINAL)  # compiles
    nominal = {case: _solve(case, NOMINAL) for case in cases}
    rows = []
    for name, placement in PLACEMENTS.items():
        moved = {case: _solve(case, placement) for case in cases}
        pairs = [(one, moved[case]) for case, one in nominal.items()]
        both = [(one, other) for one, other in pairs if one is not None and other is not None]
        changes = [100.0 * rms_difference_n(one.trace, other.trace) / one.peak_force_n for one, other in both]
        longer = [other.cpu_s / one.cpu_s for one, other in both]
        row: dict[str, object] = {"object": name, "grasps": len(both), "failed": len(pairs) - len(both)}
        if both:
            row |= {"median_percent": float(np.median(changes)), "worst_percent": max(changes)}
            row |= {"median_cost_ratio": float(np.median(longer))}
        rows.append(row)
        options.tell(f"{name}: {len(both)} of {len(pairs)} grasps")
    return {"trace over the lift, in per cent of the peak": rows}


def _solve(case: tuple[int, int], placement: Placement) -> GraspSimulation | None:
    """A grasp of a design (number) on an object, or None where it failed."""
    design, obj = case
    try:
        return simulate_grasp(numbered_design(design), get_object(obj), placement=placement, deadline_s=DEADLINE_S)
    except SimulationFailed:
        return None
