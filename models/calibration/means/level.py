"""Passes between the summits of a ridge: a density is levelled along friction until chains can cross them.

Where E is a factor, friction is hardly known and the emulator's errors make hills along the ridge of E and friction,
often several nats apart, which NUTS does not cross. Chains run on the density with a share of its profile over friction
taken off; the importance weights put it back (umbrella sampling; Torrie and Valleau 1977).
"""

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.interpolate import PchipInterpolator

from models.calibration.inference.optimise import LogDensity, climb

_N_GRID = 40
_COUNTS = 7.0  # nats below the highest summit at which another one still matters
_PASS = 2.0  # nats that chains may have to climb down to a pass
_FRICTION = -2  # place of ln friction in the vector of psi


@dataclass(frozen=True, eq=False)
class Level:
    """What is taken off a log density: `profile`, of ln friction, between the ends of its grid."""

    profile: PchipInterpolator

    def __call__(self, psi: np.ndarray) -> float:
        """Nats taken off at a vector of psi (n_psi)."""
        return float(self.profile(self._inside(psi)))

    def slope(self, psi: np.ndarray) -> float:
        """Its slope by ln friction."""
        inside = self._inside(psi)
        return float(self.profile(inside, 1)) if inside == psi[_FRICTION] else 0.0

    def _inside(self, psi: np.ndarray) -> float:
        return float(np.clip(psi[_FRICTION], self.profile.x[0], self.profile.x[-1]))


def level_of(log_density: LogDensity, mode: np.ndarray, ends: tuple[float, float]) -> Level | None:
    """What to take off a density of psi (n_psi), from its profile over ln friction between `ends`.

    None where there is one summit, or the passes between them are low enough.
    """
    grid = np.linspace(*ends, _N_GRID)
    share, floor = share_taken_off(values := profile(log_density, mode, grid))
    if share == 0.0:
        return None
    return Level(PchipInterpolator(grid, share * (np.maximum(values, floor) - values.max())))


def profile(log_density: LogDensity, mode: np.ndarray, grid: np.ndarray) -> np.ndarray:
    """Largest log density at each ln friction of a grid (n), found outwards from the mode (n_psi), n."""
    values = np.empty(len(grid))
    first = int(np.argmin(np.abs(grid - mode[_FRICTION])))
    for places in (range(first, len(grid)), range(first, -1, -1)):
        rest = np.delete(mode, len(mode) + _FRICTION)
        for place in places:
            best = climb(_held(log_density, float(grid[place])), [rest])[0]
            values[place], rest = best.value, best.vector
    return values


def share_taken_off(values: np.ndarray) -> tuple[float, float]:
    """Share of a profile (n) that leaves passes of `_PASS`, and the height of the lowest pass, below which it stays."""
    inner = np.concatenate([[-np.inf], values, [-np.inf]])
    summits = np.flatnonzero((values > inner[:-2]) & (values >= inner[2:]) & (values > values.max() - _COUNTS))
    deepest, floor = 0.0, float(values.max())
    for one, other in combinations(summits, 2):
        lowest = float(values[one : other + 1].min())
        deepest = max(deepest, float(min(values[one], values[other])) - lowest)
        floor = min(floor, lowest)
    return (1.0 - _PASS / deepest if deepest > _PASS else 0.0), floor


def _held(log_density: LogDensity, log_friction: float) -> LogDensity:
    """The density with ln friction held, over the rest of psi (n_psi - 1)."""

    def density(rest: np.ndarray) -> tuple[float, np.ndarray]:
        place = len(rest) + 1 + _FRICTION
        value, gradient = log_density(np.insert(rest, place, log_friction))
        return value, np.delete(gradient, place)

    return density
