"""How far a simulated peak scatters between prints and mountings of one design."""

from typing import NamedTuple

import numpy as np

from fast.models.errors import MeshingFailed, SimulationFailed, UsageError
from fast.models.simulation.grasp import simulate_grasp
from fast.models.simulation.inputs import GraspInputs
from fast.models.simulation.slopes.parameters import find_parameters
from fast.models.simulation.tolerances import Tolerances


class Scatter(NamedTuple):
    """Standard deviation of the peak in N, None if nothing of it is known; missing: tolerances that it leaves out."""

    sd_n: float | None
    missing: tuple[str, ...]


def find_scatter(inputs: GraspInputs, tolerances: Tolerances) -> Scatter:
    """Scatter of the peak, of tolerances that are independent of each other.

    Two grasps of each, one standard deviation to either side. The derivative is no stand-in: peaks ripple with where
    contact points lie, and hang on whether a corner hooks; on two cells of twelve it gave a quarter of the scatter.
    Missing is what cannot be simulated, or what the family does not have.
    """
    changes_n, missing = [], []
    for name, sd in tolerances.stated.items():
        try:
            parameter = find_parameters(inputs, name)[name]
            low_n, high_n = (_find_peak(parameter.put(parameter.value + side * sd)) for side in (-1.0, 1.0))
        except (UsageError, MeshingFailed, SimulationFailed):
            missing.append(name)
        else:
            changes_n.append(0.5 * (high_n - low_n))
    return Scatter(float(np.linalg.norm(changes_n)) if changes_n else None, tuple(missing))


def _find_peak(grasp: GraspInputs) -> float:
    return simulate_grasp(
        grasp.design,
        grasp.obj,
        grasp.version,
        grasp.setup,
        placement=grasp.placement,
        context=grasp.context,
        effects=grasp.effects,
    ).peak_force_n
