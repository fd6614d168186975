"""Latin hypercube over the nine design parameters and theta, which the calibration learns the simulator from."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
import scipy
from pydantic import Field

from fast.models.calibration.means.problem import THETA, THETA_LOWER, THETA_UPPER, friction_at
from fast.models.design.space import N_RIB_LEVELS, PARAMETERS, RIB_COUNT_COLUMN, from_unit
from fast.models.ids import content_id
from fast.models.records import Design, Record, Theta

_POISSON_LIMIT = 0.4995  # the elements take nothing nearer to 0.5
_DIGITS = 6  # significant digits of theta, so that its id survives being written and read


class HypercubePlan(Record):
    """Which points are simulated. The paper: 1,469 points, Young's modulus and friction uniform."""

    n: int = Field(ge=1, le=100_000, description="number of points")
    spread: Literal["log-uniform", "uniform"] = Field(
        default="log-uniform",
        description="how Young's modulus is spread over 2 to 200 MPa and friction over 0.02 to 2: evenly in ln E and "
        "ln(friction + 0.3), or as in the paper",
    )
    seed: int = Field(default=0, ge=0)

    @property
    def plan_id(self) -> str:
        """Id derived from the content; the rows of the simulations name it as their config."""
        return content_id("H", {"hypercube": self.model_dump()})


@dataclass(frozen=True)
class HypercubePoint:
    """One simulated design with a theta of its own."""

    design: Design
    theta: Theta


def draw_hypercube(plan: HypercubePlan) -> list[HypercubePoint]:
    """Draw the points of a plan, the same whenever it is asked for.

    Theta spans the ranges of the paper (E 2 to 200 MPa, friction 0.02 to 2, Poisson ratio 0.2 to 0.5). Each of the 12
    columns is stratified: one point in each n-th of its range, the rib count as evenly as whole numbers allow.
    """
    rng = np.random.default_rng([plan.seed, plan.n])
    unit = scipy.stats.qmc.LatinHypercube(d=len(PARAMETERS) + len(THETA), rng=rng).random(plan.n)
    x, theta = unit[:, : len(PARAMETERS)], unit[:, len(PARAMETERS) :]
    # Equal parts of the range for each of the ten counts; rounding would give the first and last half as much.
    levels = np.minimum(np.floor(x[:, RIB_COUNT_COLUMN] * N_RIB_LEVELS), N_RIB_LEVELS - 1)
    x[:, RIB_COUNT_COLUMN] = levels / (N_RIB_LEVELS - 1)
    values = THETA_LOWER + theta * (THETA_UPPER - THETA_LOWER)
    if plan.spread == "log-uniform":
        values[:, 0] = THETA_LOWER[0] * (THETA_UPPER[0] / THETA_LOWER[0]) ** theta[:, 0]
        values[:, 1] = friction_at(theta[:, 1])
    values[:, 2] = np.minimum(values[:, 2], _POISSON_LIMIT)
    return [HypercubePoint(design, _theta(row)) for design, row in zip(from_unit(x), values, strict=True)]


def _theta(values: np.ndarray) -> Theta:
    return Theta(**{name: float(f"{value:.{_DIGITS}g}") for name, value in zip(THETA, values, strict=True)})
