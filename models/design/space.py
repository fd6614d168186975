"""Design spaces: the parameters of a family with their ranges, as points of a unit cube.

A campaign may narrow the ranges of its family and add linear limits. The module's functions without a space are those
of the paper: fin rays over their whole ranges.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from typing import Any, Literal, get_args, get_origin

import numpy as np
from pydantic import Field

from fast.models.design.fin_ray import FinRay
from fast.models.errors import UsageError
from fast.models.records import Design, Record
from fast.models.units import unit_of
from fast.models.validation import check_type, check_whole, closest

SEQUENCE_SEED = 2026
_MAX_DRAWS = 200  # times the points that are asked for: limits that leave less room are a slip of the pen
_DECIMALS = 5  # of a continuous parameter: 0.01 um
_UNIT_ROUNDING = 1e-9  # by which a coordinate may leave the unit cube
_ROUNDING = 1e-4  # by which rounded parameters may leave a limit


class LinearLimit(Record):
    """A limit on a weighted sum of parameters, such as both walls together at most 5.2 mm."""

    of: dict[str, float] = Field(min_length=1, description="parameter and its weight in the sum")
    at_most: float | None = None
    at_least: float | None = None


@dataclass(frozen=True, eq=False)
class DesignSpace:
    """The designs of a family that may be made. `lower`, `upper` (d): ranges; whole numbers and places of choices too.

    `n_levels` (d): how many values a parameter has, 0 for a continuous one. `tied`: columns that are equal.
    """

    family: type[Design]
    lower: np.ndarray
    upper: np.ndarray
    n_levels: tuple[int, ...]
    limits: tuple[LinearLimit, ...] = ()
    tied: tuple[tuple[int, ...], ...] = ()

    @classmethod
    def of(
        cls,
        family: type[Design],
        ranges: Mapping[str, tuple[float, float]] = {},
        limits: Sequence[LinearLimit] = (),
        equal: Sequence[Sequence[str]] = (),
    ) -> "DesignSpace":
        """Make a family's space, narrowed to `ranges` and by `limits`; parameters of each of `equal` have one value.

        Raises:
            UsageError: a parameter is unknown, a range leaves that of the family or is empty, or parameters cannot be
                equal.
        """
        names = list(family.model_fields)
        for name in [*ranges, *(name for limit in limits for name in limit.of), *(n for group in equal for n in group)]:
            if name not in names:
                raise UsageError(f"the family `{family.family}` has no parameter `{name}`; {closest(name, names)}")
            if name in ranges and _choices(family, name):
                raise UsageError(f"`{name}` is a choice and has no range; take it out of the ranges.")
        low, high, all_levels = zip(*(_range(family, name, ranges.get(name)) for name in names), strict=True)
        levels = list(all_levels)
        lower, upper = np.array(low), np.array(high)
        tied = tuple(tuple(names.index(name) for name in group) for group in equal)
        for group, columns in zip(equal, tied, strict=True):
            _check_equal(family, group, [levels[column] for column in columns])
            ends = lower[list(columns)].max(), upper[list(columns)].min()
            if ends[0] > ends[1]:
                raise UsageError(
                    f"{' and '.join(group)} have no value in common, so they cannot be equal; widen a range."
                )
            lower[list(columns)], upper[list(columns)] = ends
            levels = [int(ends[1] - ends[0]) + 1 if n and i in columns else n for i, n in enumerate(levels)]
        return cls(family, lower, upper, tuple(levels), tuple(limits), tied)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the d parameters, in order."""
        return tuple(self.family.model_fields)

    @property
    def n_dims(self) -> int:
        """Number of parameters d."""
        return len(self.n_levels)

    @cached_property
    def stepped(self) -> tuple[int, ...]:
        """Columns of the parameters with levels: whole numbers and choices."""
        return tuple(column for column, n in enumerate(self.n_levels) if n)

    @cached_property
    def walls(self) -> tuple[int, ...]:
        """Columns of the thicknesses of walls and ribs."""
        return tuple(column for column, name in enumerate(self.names) if name.endswith("_thickness_mm"))

    def to_unit(self, designs: Sequence[Design]) -> np.ndarray:
        """Return designs as points of the unit cube, n x d; k levels are equally spaced from 0 to 1.

        Raises:
            UsageError: this is no list of designs.
        """
        if not isinstance(designs, Iterable) or isinstance(designs, Design) or getattr(designs, "ndim", 1) == 0:
            raise UsageError(f"designs are of type {type(designs).__name__}; give a list of designs.")
        designs = list(designs)
        for design in designs:
            check_type(design, Design, "a design")
        values = np.array([self._values(design) for design in designs], dtype=float).reshape(-1, self.n_dims)
        return (values - self.lower) / self._span

    def from_unit(self, points: np.ndarray) -> list[Design]:
        """Undo `to_unit` for an n x d array; levels are rounded to the nearest, the rest to 0.01 um.

        Raises:
            UsageError: points have another number of columns, or one is not finite.
        """
        given = np.asarray(points, dtype=float)
        if given.shape[-1:] != (self.n_dims,):
            raise UsageError(
                f"points have the shape {given.shape}, the last axis must be the {self.n_dims} parameters "
                f"{', '.join(self.names)}; change it."
            )
        if not np.isfinite(given).all():
            raise UsageError("points have values that are not finite numbers; leave these points out.")
        values = self.lower + given * (self.upper - self.lower)
        values = np.clip(np.round(values, _DECIMALS), self.lower, self.upper)
        return [self._design(row) for row in values.reshape(-1, self.n_dims)]

    def snap(self, points: np.ndarray) -> np.ndarray:
        """Move stepped parameters of unit-cube points to their nearest level and tied ones to the first, n x d."""
        snapped = np.array(points, dtype=float)
        for column in self.stepped:
            steps = max(self.n_levels[column] - 1, 1)
            snapped[..., column] = np.round(snapped[..., column] * steps) / steps
        return self._tie(snapped)

    def draw_level(self, column: int, n: int, rng: np.random.Generator) -> np.ndarray:
        """Draw n random levels of a stepped parameter, in the unit cube."""
        levels = self.n_levels[column]
        return rng.integers(0, levels, n) / max(levels - 1, 1)

    def random_unit(self, n: int, rng: np.random.Generator) -> np.ndarray:
        """Draw uniform points of the space in the unit cube, n x d; every level is equally likely.

        Raises:
            UsageError: the limits leave (nearly) no room, or `n` or `rng` is something else.
        """
        check_type(rng, np.random.Generator, "rng", "a numpy.random.Generator, such as numpy.random.default_rng(1)")
        n = check_whole(n, "n")
        points = self._draw(n, rng)
        if not self.limits:
            return points
        kept = points[self.keeps_limits(points)]
        for _ in range(_MAX_DRAWS):
            if len(kept) >= n:
                return kept[:n]
            points = self._draw(n, rng)
            kept = np.concatenate([kept, points[self.keeps_limits(points)]])
        raise UsageError(
            f"only {len(kept)} of {(_MAX_DRAWS + 1) * n} random designs keep the limits of the design space, {n} are "
            "needed; relax design.limits."
        )

    def random_designs(self, n: int, rng: np.random.Generator) -> list[Design]:
        """Draw uniform random designs, the paper's initial batch."""
        return self.from_unit(self.random_unit(n, rng))

    def with_all_levels(self, points: np.ndarray) -> np.ndarray:
        """Give each of n points with each level of each stepped parameter in turn, n x k x d; k is 0 without such."""
        variants = []
        for column in self.stepped:
            levels = self.n_levels[column]
            repeated = np.repeat(points[:, None, :], levels, axis=1)
            repeated[:, :, column] = np.arange(levels) / max(levels - 1, 1)
            variants.append(repeated)
        return self._tie(np.concatenate([np.zeros((len(points), 0, self.n_dims)), *variants], axis=1))

    def keeps_limits(self, points: np.ndarray) -> np.ndarray:
        """Return the mask (n) of unit-cube points (n, d) that keep the linear limits."""
        values = self.lower + np.asarray(points, dtype=float) * (self.upper - self.lower)
        kept = np.ones(len(values), dtype=bool)
        for limit in self.limits:
            weights = np.array([limit.of.get(name, 0.0) for name in self.names])
            total = values @ weights
            if limit.at_most is not None:
                kept &= total <= limit.at_most + _ROUNDING
            if limit.at_least is not None:
                kept &= total >= limit.at_least - _ROUNDING
        return kept

    @cached_property
    def _choices(self) -> list[tuple[Any, ...]]:
        return [_choices(self.family, name) for name in self.names]

    @cached_property
    def _span(self) -> np.ndarray:
        return np.where(self.upper > self.lower, self.upper - self.lower, 1.0)

    def _draw(self, n: int, rng: np.random.Generator) -> np.ndarray:
        points = rng.random((n, self.n_dims))
        for column in self.stepped:
            points[:, column] = self.draw_level(column, n, rng)
        return self._tie(points)

    def _tie(self, points: np.ndarray) -> np.ndarray:
        """Tie the points' tied parameters to the value of the first of them; changed in place."""
        for first, *others in self.tied:
            points[..., others] = points[..., [first]]
        return points

    def _values(self, design: Design) -> list[float]:
        """Return the design's parameters as numbers: a choice as its place.

        Raises:
            UsageError: it is no design, or of another family.
        """
        if not isinstance(design, Design):
            raise UsageError(
                f"a design is of type {type(design).__name__}, it must be a fast.Design; give a list of them."
            )
        if type(design) is not self.family:
            raise UsageError(
                f"design {design.design_id} is of the family `{design.family}`, these are of `{self.family.family}`."
            )
        values: list[float] = []
        for name, choices in zip(self.names, self._choices, strict=True):
            value = getattr(design, name)
            values.append(float(choices.index(value) if choices else value))
        return values

    def _design(self, row: np.ndarray) -> Design:
        values: dict[str, Any] = dict(zip(self.names, row.tolist(), strict=True))
        for column in self.stepped:
            place, choices = round(row[column]), self._choices[column]
            values[self.names[column]] = choices[place] if choices else place
        return self.family(**values)


def _check_equal(family: type[Design], group: Sequence[str], n_levels: Sequence[int]) -> None:
    """See that parameters can have one value.

    Raises:
        UsageError: fewer than two, a choice, or another unit.
    """
    units = {unit_of(name) for name in group}
    is_stepped = {n > 0 for n in n_levels}
    if len(set(group)) < 2 or any(_choices(family, name) for name in group) or len(units) > 1 or len(is_stepped) > 1:
        raise UsageError(
            f"{', '.join(group)} cannot be equal; name two or more different parameters of one unit, none a choice."
        )


def _choices(family: type[Design], name: str) -> tuple[Any, ...]:
    """Return the values of a parameter that is a choice; none for a number."""
    annotation = family.model_fields[name].annotation
    return get_args(annotation) if get_origin(annotation) is Literal else ()


def _range(family: type[Design], name: str, asked: tuple[float, float] | None) -> tuple[float, float, int]:
    """Lower and upper end of a parameter, and its number of levels (0: continuous).

    Raises:
        UsageError: the family gives it no range, or the one that is asked for is no part of it.
    """
    if choices := _choices(family, name):
        return 0.0, float(len(choices) - 1), len(choices)
    field = family.model_fields[name]
    ends = [next((float(getattr(m, kind)) for m in field.metadata if hasattr(m, kind)), None) for kind in ("ge", "le")]
    low, high = ends
    if low is None or high is None:
        raise UsageError(f"parameter `{name}` of the family `{family.family}` has no `ge` and `le`; give it both.")
    if asked is not None:
        unit = f" {unit_of(name)}" if unit_of(name) else ""
        if not low <= asked[0] <= asked[1] <= high:
            raise UsageError(
                f"the range of `{name}` is {asked[0]:g} to {asked[1]:g}{unit}; it must ascend within {low:g} to "
                f"{high:g}{unit}, the range of the family `{family.family}`."
            )
        low, high = map(float, asked)
    if field.annotation is int:
        low, high = float(np.ceil(low)), float(np.floor(high))
        if low > high:
            raise UsageError(f"the range of `{name}` has no whole number; widen it.")
        return low, high, int(high - low) + 1
    return low, high, 0


def space_of(designs: Sequence[Design]) -> DesignSpace:
    """Return the whole space of the family that all these designs are of; without designs that of fin rays.

    Raises:
        UsageError: they are of several families.
    """
    families = {type(design) for design in designs} or {FinRay}
    if len(families) > 1:
        names = ", ".join(sorted(family.family for family in families))
        raise UsageError(f"these designs are of several families ({names}); choose a campaign of one family.")
    return _whole_space(families.pop())


@cache
def _whole_space(family: type[Design]) -> DesignSpace:
    return DesignSpace.of(family)


# The space of the paper.
FIN_RAYS = space_of([])
PARAMETERS = FIN_RAYS.names
LOWER, UPPER = FIN_RAYS.lower, FIN_RAYS.upper
RIB_COUNT_COLUMN = PARAMETERS.index("rib_count")
N_RIB_LEVELS = FIN_RAYS.n_levels[RIB_COUNT_COLUMN]
to_unit, snap = FIN_RAYS.to_unit, FIN_RAYS.snap
random_unit, random_designs = FIN_RAYS.random_unit, FIN_RAYS.random_designs

# Table 1 of the paper: B07T8, 29.68 N mean pull-off force.
BEST_PUBLISHED = FinRay(
    length_mm=30.83,
    width_mm=33.01,
    height_mm=96.96,
    tip_length_mm=24.78,
    front_thickness_mm=2.61,
    back_thickness_mm=2.89,
    rib_thickness_mm=2.81,
    rib_count=5,
    rib_angle_deg=3.63,
)


def from_unit(points: np.ndarray) -> list[Design]:
    """Undo `to_unit` for an n x 9 array; a rib count is rounded to the nearest, the rest to 0.01 um.

    Raises:
        UsageError: points have another number of columns, or a value is no number, not finite or not from 0 to 1.
    """
    try:
        given = np.asarray(points, dtype=float)
    except (TypeError, ValueError) as error:
        raise UsageError(f"points are no array of numbers ({error}); change them.") from error
    outside = given[np.abs(given - 0.5) > 0.5 + _UNIT_ROUNDING]
    if outside.size and np.isfinite(given).all():
        raise UsageError(
            f"points have the value {outside[0]:g}, each must be from 0 to 1, the range of its parameter; `to_unit` "
            "makes such points of designs."
        )
    return FIN_RAYS.from_unit(given)


def numbered_design(number: int) -> Design:
    """Return design `number` (from 0) of one fixed sequence of random designs, for benchmarks and their repetition."""
    return random_designs(1, np.random.default_rng([SEQUENCE_SEED, number]))[0]
