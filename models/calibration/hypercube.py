"""Latin hypercubes over design and theta, and over theta at given designs, which the calibration learns from."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from pydantic import Field
from scipy.stats import qmc

from models.calibration.problem import THETA, THETA_LOWER, THETA_UPPER
from models.design_space import N_RIB_LEVELS, PARAMETERS, RIB_COUNT_COLUMN, from_unit
from models.ids import content_id, seed_from
from models.records import Design, Record, Theta

_POISSON_LIMIT = 0.4995  # the elements take nothing nearer to 0.5
_DIGITS = 6  # significant digits of theta, so that its id survives being written and read


class HypercubePlan(Record):
    """Which points are simulated. The paper: 1,469 points, Young's modulus uniform."""

    n: int = Field(ge=1, le=100_000, description="number of points")
    modulus: Literal["log-uniform", "uniform"] = Field(
        default="log-uniform", description="how Young's modulus is spread over 2 to 200 MPa"
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


def hypercube(plan: HypercubePlan) -> list[HypercubePoint]:
    """The points of a plan, the same whenever it is asked for.

    Theta spans the ranges of the paper (E 2 to 200 MPa, friction 0.02 to 2, Poisson ratio 0.2 to 0.5). Each of the 12
    columns is stratified: one point in each n-th of its range, the rib count as evenly as whole numbers allow.
    """
    rng = np.random.default_rng([plan.seed, plan.n])
    unit = qmc.LatinHypercube(d=len(PARAMETERS) + len(THETA), rng=rng).random(plan.n)
    x, theta = unit[:, : len(PARAMETERS)], unit[:, len(PARAMETERS) :]
    # Equal parts of the range for each of the ten counts; rounding would give the first and last half as much.
    levels = np.minimum(np.floor(x[:, RIB_COUNT_COLUMN] * N_RIB_LEVELS), N_RIB_LEVELS - 1)
    x[:, RIB_COUNT_COLUMN] = levels / (N_RIB_LEVELS - 1)
    thetas = _thetas(theta, plan.modulus)
    return [HypercubePoint(design, value) for design, value in zip(from_unit(x), thetas, strict=True)]


def points_at(designs: Iterable[Design], n: int, seed: int) -> list[HypercubePoint]:
    """Each design at n thetas in a Latin hypercube of its own, ln E, friction and Poisson ratio in their ranges.

    The points of a design do not depend on the other designs: measuring more of them only adds points.
    """
    points = []
    for design in dict.fromkeys(designs):
        rng = np.random.default_rng(seed_from("points at", seed, n, design.design_id))
        unit = qmc.LatinHypercube(d=len(THETA), rng=rng).random(n)
        points += [HypercubePoint(design, theta) for theta in _thetas(unit, "log-uniform")]
    return points


def _thetas(unit: np.ndarray, modulus: Literal["log-uniform", "uniform"]) -> list[Theta]:
    """Thetas of rows of the unit cube, n x 3."""
    values = THETA_LOWER + unit * (THETA_UPPER - THETA_LOWER)
    if modulus == "log-uniform":
        values[:, 0] = THETA_LOWER[0] * (THETA_UPPER[0] / THETA_LOWER[0]) ** unit[:, 0]
    values[:, 2] = np.minimum(values[:, 2], _POISSON_LIMIT)
    return [_theta(row) for row in values]


def _theta(values: np.ndarray) -> Theta:
    return Theta(**{name: float(f"{value:.{_DIGITS}g}") for name, value in zip(THETA, values, strict=True)})
