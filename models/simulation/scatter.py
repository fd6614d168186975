"""How far a simulated peak scatters between prints and mountings of one design."""

from collections.abc import Mapping
from contextlib import suppress
from typing import NamedTuple

import numpy as np

from fast.models.errors import MeshingFailed, SimulationFailed, UsageError
from fast.models.simulation.grasp import simulate_inputs
from fast.models.simulation.inputs import GraspInputs
from fast.models.simulation.slopes.parameters import find_parameters
from fast.models.simulation.tolerances import Tolerances

_SIDES = np.array([[-1.0, -1.0, 1.0], [-1.0, 1.0, -1.0], [1.0, -1.0, -1.0], [1.0, 1.0, 1.0]])


class Scatter(NamedTuple):
    """Standard deviation of the peak in N, None if nothing of it is known; missing: tolerances that it leaves out."""

    sd_n: float | None
    missing: tuple[str, ...]


def find_scatter(inputs: GraspInputs, tolerances: Tolerances) -> Scatter:
    """Find the scatter of the peak, of tolerances that are independent of each other.

    Each grasp is a copy with every tolerance one standard deviation to one side: four of three tolerances, two of one,
    in which each goes to either side equally often beside each of the others (a half of a factorial design). So their
    variance is the sum of what each tolerance adds. The derivative is no stand-in: peaks ripple with where contact
    points lie, and hang on whether a corner hooks; on two cells of twelve it gave a quarter of the scatter.
    Missing is what the family does not have, and all of it where fewer than three of the four can be simulated.
    """
    known, missing = [], []
    for name in tolerances.stated:
        try:
            find_parameters(inputs, name)
        except UsageError:
            missing.append(name)
        else:
            known.append(name)
    sides = np.unique(_SIDES[:, : len(known)], axis=0) if known else np.zeros((0, 0))
    peaks_n = []
    for row in sides:
        with suppress(MeshingFailed, SimulationFailed):
            peaks_n.append(_find_peak(_move(inputs, dict(zip(known, row, strict=True)), tolerances)))
    n, n_all = len(peaks_n), len(sides)
    if n < max(n_all - 1, 2):
        return Scatter(None, tuple(tolerances.stated))
    variance = float(np.var(peaks_n, ddof=1)) * (n_all - 1) / n_all
    return Scatter(float(np.sqrt(variance)), tuple(missing))


def _move(inputs: GraspInputs, sides: Mapping[str, float], tolerances: Tolerances) -> GraspInputs:
    """Move each tolerance of the grasp by one standard deviation to a side, -1 or 1."""
    for name, side in sides.items():
        parameter = find_parameters(inputs, name)[name]
        inputs = parameter.put(parameter.value + side * tolerances.stated[name])
    return inputs


def _find_peak(grasp: GraspInputs) -> float:
    return simulate_inputs(grasp).peak_force_n
