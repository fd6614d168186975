"""The few values of friction and Poisson ratio at which every measured (design, object) is simulated."""

from dataclasses import dataclass

import numpy as np

from fast.models.errors import UsageError

GRID_MODULUS_MPA = 10.0  # of the simulations to make; others count too, since forces are proportional to it


@dataclass(frozen=True)
class ThetaGrid:
    """Chebyshev points in friction and Poisson ratio; Young's modulus is a factor and needs none.

    Twelve simulations of a cell carry a response surface that is cubic in friction and quadratic in Poisson ratio.
    The friction range holds 98 % of Table 3's prior; the upper Poisson ratio is short of 0.5, where the simulator's
    elements lock. `is_cross`: only the points with friction or Poisson ratio in the middle, for a small range.
    """

    friction: tuple[float, float] = (0.2, 1.4)
    poisson_ratio: tuple[float, float] = (0.2, 0.49)
    n_friction: int = 4
    n_poisson_ratio: int = 3
    is_cross: bool = False

    def __post_init__(self) -> None:
        """Check ranges and counts.

        Raises:
            UsageError: a range is empty or beyond the simulator's, or there are fewer than three points in it.
        """
        limits = (("friction", self.friction, 0.0, 2.0), ("poisson_ratio", self.poisson_ratio, 0.0, 0.499))
        for name, (low, high), lowest, highest in limits:
            if not lowest <= low < high <= highest:
                raise UsageError(
                    f"the grid's {name} is {low:g} to {high:g}; give an increasing range in {lowest:g} to {highest:g}."
                )
        for name, n in (("friction", self.n_friction), ("poisson_ratio", self.n_poisson_ratio)):
            if n < 3:
                raise UsageError(f"the grid has {n} values of {name}; its response surface needs at least 3.")

    @property
    def points(self) -> list[tuple[float, float]]:
        """(friction, Poisson ratio) of every simulation, rounded so that ids of simulator versions are short."""
        frictions = _chebyshev(*self.friction, self.n_friction)
        ratios = _chebyshev(*self.poisson_ratio, self.n_poisson_ratio)
        middle = self.middle
        every = [(friction, ratio) for friction in frictions for ratio in ratios]
        return [(x, y) for x, y in every if not self.is_cross or x == middle[0] or y == middle[1]]

    @property
    def middle(self) -> tuple[float, float]:
        """(friction, Poisson ratio) of the simulation in the middle."""
        frictions = _chebyshev(*self.friction, self.n_friction)
        ratios = _chebyshev(*self.poisson_ratio, self.n_poisson_ratio)
        return frictions[len(frictions) // 2], ratios[len(ratios) // 2]


def _chebyshev(low: float, high: float, n: int) -> list[float]:
    """Return the Chebyshev-Lobatto points, ends included, since the posterior may reach them."""
    nodes = -np.cos(np.pi * np.arange(n) / (n - 1))
    return [float(value) for value in np.round(0.5 * (low + high) + 0.5 * (high - low) * nodes, 4)]
