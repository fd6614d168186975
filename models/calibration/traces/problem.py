"""What a trace-level calibration is fitted to: simulated and measured features by tool and object."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from models.errors import UsageError
from models.traces.step_features import CENTRES_MM

MIN_TOOLS = 3
NEAR_MM = 10.0  # lift over which errors of the simulator are alike: a contact moves so far along the wall
OWN_SHARE = 0.1
# What a finer mesh, another contact law and an object 0.2 mm off change in a feature, in its unit: root mean squares of
# the paired runs of `fast bench run calibration-traces`. The first millimetres have few steps, and a peak moves along
# its plateau.
NUMERICAL_SHARE = 0.02
NUMERICAL_SHARES = {"dip_n": 0.07, "lift_at_peak_mm": 0.35}
AREA_MM, MOVE_MM = 20.0, 10.0  # the unit of areas, times the amplitude of the cell, and of lifts
LEAST_AMPLITUDE = 0.05  # of the median cell's: cells without grip say nothing in per cent


@dataclass(frozen=True, eq=False)
class TraceProblem:
    """Features of t tools on o objects: g simulations each at other friction and Poisson ratio, r repeats measured.

    features: names (f). grid: g x 2, friction and Poisson ratio. simulated: t x o x g x f at `modulus_mpa`; forces
    scale with Young's modulus, lifts do not. measured: t x o x r x f. noise: t x o x f x f, covariance of the features
    of one repeat under sensor noise. Missing simulations and repeats are NaN in all their features; a cell without a
    repeat is left out. numerical: f, standard deviations of what mesh and contact law do to features, in their `unit`.
    n_averaged: t x o, how many objects a cell is the mean of.
    """

    tools: tuple[str, ...]
    objects: tuple[str, ...]
    features: tuple[str, ...]
    grid: np.ndarray
    modulus_mpa: float
    simulated: np.ndarray
    measured: np.ndarray
    noise: np.ndarray
    n_averaged: np.ndarray
    numerical: np.ndarray

    def __post_init__(self) -> None:
        """Check shapes, values and counts once, at the boundary.

        Raises:
            UsageError: shapes differ, a measured cell has no simulation, a value is infinite, or there is too little.
        """
        t, o, g, f = len(self.tools), len(self.objects), len(self.grid), len(self.features)
        wanted = {
            "grid": (g, 2),
            "simulated": (t, o, g, f),
            "measured": (t, o, self.measured.shape[2] if self.measured.ndim == 4 else -1, f),
            "noise": (t, o, f, f),
            "n_averaged": (t, o),
            "numerical": (f,),
        }
        for name, shape in wanted.items():
            found = getattr(self, name).shape
            if found != shape:
                raise UsageError(f"{name} has shape {found}; give {shape} for {t} tools, {o} objects, {f} features.")
            if np.isinf(getattr(self, name)).any():
                raise UsageError(f"{name} holds an infinite value; leave that grasp out.")
        self._check_counts()

    @property
    def is_measured(self) -> np.ndarray:
        """Cells with a measured repeat, t x o."""
        return np.isfinite(self.measured).all(axis=-1).any(axis=-1)

    @property
    def n_repeats(self) -> np.ndarray:
        """Measured repeats of a cell, t x o."""
        return np.isfinite(self.measured).all(axis=-1).sum(axis=-1)

    @property
    def is_force(self) -> np.ndarray:
        """Which features are proportional to Young's modulus, f."""
        return ~are_lifts(self.features)

    @property
    def unit(self) -> np.ndarray:
        """Units of features, f: of forces 1, of areas in mm, both times the amplitude of the cell; of lifts in mm."""
        return units_of(self.features)

    def correlation(self) -> np.ndarray:
        """Correlation of the errors that a simulator may make in features of one object, f x f."""
        return error_correlation(self.features)

    def mean_over_repeats(self) -> np.ndarray:
        """Measured features, t x o x f; 0 in cells that were not measured."""
        total = np.nansum(self.measured, axis=2)
        return np.asarray(total / np.maximum(self.n_repeats, 1)[..., None])

    def only(self, features: Sequence[str]) -> "TraceProblem":
        """The same grasps, seen through some of the features.

        Raises:
            UsageError: there is no such feature.
        """
        unknown = [name for name in features if name not in self.features]
        if unknown:
            raise UsageError(f"there is no feature `{unknown[0]}`; there are {', '.join(self.features)}.")
        columns = [self.features.index(name) for name in features]
        return replace(
            self,
            features=tuple(features),
            simulated=self.simulated[..., columns],
            measured=self.measured[..., columns],
            noise=self.noise[..., columns, :][..., columns],
            numerical=self.numerical[columns],
        )

    def mean_over_objects(self) -> "TraceProblem":
        """Means over the measured objects of each tool, as the paper's calibration sees them: one cell a tool.

        A simulation of the grid counts where all of these objects have it. Measured means are over all repeats.
        """
        is_measured = self.is_measured
        n = is_measured.sum(axis=1)
        weight = is_measured / np.maximum(n, 1)[:, None]
        noise = self.noise / np.maximum(self.n_repeats, 1)[..., None, None]
        return replace(
            self,
            objects=("all objects",),
            simulated=_weighted(weight, self.simulated)[:, None],
            measured=_weighted(weight, self.mean_over_repeats())[:, None, None],
            noise=_weighted(weight**2, noise)[:, None],
            n_averaged=n[:, None],
        )

    def take(self, tools: np.ndarray) -> "TraceProblem":
        """The problem of some of the tools (numbers or a mask)."""
        names = tuple(np.array(self.tools)[tools].tolist())
        parts = {name: getattr(self, name)[tools] for name in ("simulated", "measured", "noise", "n_averaged")}
        return replace(self, tools=names, **parts)

    def _check_counts(self) -> None:
        is_measured = self.is_measured
        n_tools = int(is_measured.any(axis=1).sum())
        if n_tools < MIN_TOOLS:
            raise UsageError(
                f"{n_tools} tools have measured traces, a calibration on traces needs at least {MIN_TOOLS}; "
                "measure more."
            )
        n_needed = n_terms(self.grid) + 1
        n_simulated = np.isfinite(self.simulated).all(axis=-1).sum(axis=-1)
        short = np.argwhere(is_measured & (n_simulated < n_needed))
        if len(short):
            t, o = short[0]
            raise UsageError(
                f"tool {self.tools[t]} on object {self.objects[o]} has {n_simulated[t, o]} simulations of the grid, "
                f"its response surface needs {n_needed}; simulate the missing ones or leave its grasps out."
            )


def numerical_shares(features: Sequence[str]) -> np.ndarray:
    """The numerical error of features as far as it is known, f, in their units."""
    return np.array([NUMERICAL_SHARES.get(name, NUMERICAL_SHARE) for name in features])


def n_terms(grid: np.ndarray) -> int:
    """Terms of the response surface that a grid carries."""
    return len(degrees(grid))


def degrees(grid: np.ndarray) -> list[tuple[int, int]]:
    """Degrees in friction and Poisson ratio of the terms: those of the grid, up to the greater one in total."""
    first, second = (len(np.unique(grid[:, column])) - 1 for column in (0, 1))
    return [(i, j) for i in range(first + 1) for j in range(second + 1) if i + j <= max(first, second)]


def are_lifts(features: Sequence[str]) -> np.ndarray:
    """Which features are lifts, not forces, f."""
    return np.array([name.endswith("_mm") and not name.endswith("_n_mm") for name in features])


def units_of(features: Sequence[str]) -> np.ndarray:
    """Units of features, f: of forces 1, of areas in mm, both times the amplitude of the cell; of lifts in mm."""
    area = np.array([AREA_MM if name.endswith("_n_mm") else 1.0 for name in features])
    return np.where(are_lifts(features), MOVE_MM, area)


def error_correlation(features: Sequence[str]) -> np.ndarray:
    """Correlation of the errors that a simulator may make in features of one object, f x f.

    Errors of forces are mostly common to the whole lift and shared by neighbouring bins (`NEAR_MM`), in equal
    parts; `OWN_SHARE` of their variance is of their own, as are those of lifts.
    """
    centres = np.array([CENTRES_MM.get(name, np.inf) for name in features])
    with np.errstate(invalid="ignore"):
        near = np.exp(-np.abs(np.subtract.outer(centres, centres)) / NEAR_MM)
    near = np.where(np.isfinite(near), near, 0.0)
    both = np.outer(~are_lifts(features), ~are_lifts(features))
    return np.where(np.eye(len(centres)) > 0, 1.0, np.where(both, 0.5 * (1.0 - OWN_SHARE) * (1.0 + near), 0.0))


def _weighted(weight: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Sums over objects, t x ..., of what has a weight; NaN elsewhere is no matter."""
    weight = weight.reshape(*weight.shape, *(1,) * (values.ndim - 2))
    return np.asarray((weight * np.where(weight > 0, values, 0.0)).sum(axis=1))
