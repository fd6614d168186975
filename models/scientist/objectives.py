"""What a campaign may want of a finger: outcomes that are measured or simulated, and what follows from the design.

A measured outcome is one number of a tool, from its forces or its work on the objects; more of it is better. A
simulated outcome, the contact pressure, is one that a bench does not see; less of it is better. What is known of a
design, such as its mass, needs no model; less of it is better.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from fast.models.design.printability import estimate_mass_g
from fast.models.records import Design
from fast.models.scientist.surrogate.imputation import fill_objects

# Which quantile over the objects counts; a tool holds a tenth of the objects with less than its `low_peak_n`.
_QUANTILES = {"worst": 0.0, "low": 0.1, "largest": 1.0}


@dataclass(frozen=True)
class Outcome:
    """An outcome: the column of grasps and simulations it is made of, and how objects are put together.

    is_simulated: simulations alone have it. is_of_copies: it is what most prints of a drawing reach, not the one print
    that was measured (`models.scientist.copies`).
    """

    name: str
    column: Literal["peak_force_n", "work_j", "pressure_kpa"]
    how: Literal["mean", "worst", "low", "largest"]
    about: str
    is_simulated: bool = False
    is_of_copies: bool = False

    @property
    def is_of_one_object(self) -> bool:
        """Whether single objects decide it, and not their mean."""
        return self.how != "mean"

    def over_objects(self, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the outcome of each design, and the extra variance that its missing objects cause.

        values: n designs x n_objects, NaN where missing; no design may miss all. Missing values are predicted from the
        other objects (`surrogate.imputation`). Where one of the objects decides, it may be one that is missing, so the
        largest of their variances counts.
        """
        filled = fill_objects(values)
        variance = filled.mean_variance if self.how == "mean" else filled.variance.max(axis=1)
        return self.of_all(filled.values), variance

    def of_all(self, values: np.ndarray) -> np.ndarray:
        """Return the outcome of values on all objects, n x n_objects (x any) to n (x any)."""
        return np.asarray(
            values.mean(axis=1) if self.how == "mean" else np.quantile(values, _QUANTILES[self.how], axis=1)
        )


OUTCOMES: Mapping[str, Outcome] = {
    one.name: one
    for one in (
        Outcome("mean_peak_n", "peak_force_n", "mean", "mean peak force over the objects, N"),
        Outcome("worst_peak_n", "peak_force_n", "worst", "peak force on the object that is held worst, N"),
        Outcome("low_peak_n", "peak_force_n", "low", "peak force that nine of ten objects exceed, N"),
        Outcome(
            "robust_peak_n",
            "peak_force_n",
            "mean",
            "mean peak force that nine of ten prints of the drawing exceed, N",
            is_of_copies=True,
        ),
        Outcome("mean_work_j", "work_j", "mean", "mean work of pulling an object out, J"),
        Outcome(
            "pressure_kpa", "pressure_kpa", "largest", "largest simulated pressure on an object, kPa", is_simulated=True
        ),
    )
}
MEAN_PEAK = OUTCOMES["mean_peak_n"]
KNOWN: Mapping[str, str] = {"mass_g": "mass of one printed finger, g"}
NAMES = (*OUTCOMES, *KNOWN)
MEASURED = tuple(name for name, outcome in OUTCOMES.items() if not outcome.is_simulated)
LESS_IS_BETTER = tuple(name for name in NAMES if name not in MEASURED)


def known_of(name: str, design: Design) -> float:
    """Return what follows from the design alone; the only one is its mass."""
    assert name == "mass_g"
    return estimate_mass_g(design)
