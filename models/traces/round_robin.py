"""Round robin: the same grasps in several labs, by the terms of ISO 5725-2.

Repeatability is the scatter of repeats in one lab (`repeat_sd_n`, s_r). The scatter between labs (`lab_sd_n`, s_L) is
what the means of labs differ by more than repeats explain. Reproducibility is both, s_R^2 = s_r^2 + s_L^2: what a
force measured in one lab tells of the next.
"""

from collections import defaultdict
from collections.abc import Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import scipy

from fast.models.traces.quality import Interval, mean_of_tools

MIN_ORDERED = 4  # fingers; of fewer a rank correlation says nothing


class Measurement(NamedTuple):
    """One measured grasp: `finger` is what the labs have in common, a tool that travelled or a design."""

    lab: str
    finger: str
    object_id: int
    force_n: float


@dataclass(frozen=True)
class Spread:
    """Mean force over labs and the three standard deviations, N; None: too few repeats, or none at all."""

    key: str
    n_cells: int
    mean_n: float
    repeat_sd_n: float | None
    lab_sd_n: float | None
    reproducibility_sd_n: float | None


@dataclass(frozen=True)
class LabBias:
    """How far a lab is from the mean of all labs: over fingers, in shares of the force."""

    lab: str
    n_grasps: int
    n_cells: int
    bias: Interval


@dataclass(frozen=True)
class LabPair:
    """What two labs say of the order of fingers: Spearman's rank correlation; None for fewer than `MIN_ORDERED`."""

    first: str
    second: str
    n_fingers: int
    rank_correlation: float | None


@dataclass(frozen=True)
class RoundRobin:
    """Labs side by side, over the (finger, object) that at least two of them measured.

    means_n: mean force by finger and object, and by lab, N.
    """

    labs: tuple[LabBias, ...]
    pairs: tuple[LabPair, ...]
    overall: Spread
    by_object: tuple[Spread, ...]
    by_finger: tuple[Spread, ...]
    means_n: Mapping[tuple[str, int], Mapping[str, float]]


Cell = tuple[str, int]  # (finger, object)
_Forces = Mapping[str, np.ndarray]  # by lab


def compare_labs(measurements: Iterable[Measurement]) -> RoundRobin | None:
    """Compare labs; None where no two of them measured the same finger on the same object."""
    cells = _shared_cells(measurements)
    if not cells:
        return None
    means = {cell: {lab: float(np.mean(y)) for lab, y in forces.items()} for cell, forces in cells.items()}
    names = sorted({lab for forces in cells.values() for lab in forces})
    return RoundRobin(
        labs=tuple(_bias(name, cells, means) for name in names),
        pairs=tuple(_pair(a, b, means) for place, a in enumerate(names) for b in names[place + 1 :]),
        overall=_spread("all", list(cells.values())),
        by_object=_spreads(cells, [str(object_id) for _, object_id in cells]),
        by_finger=_spreads(cells, [finger for finger, _ in cells]),
        means_n=means,
    )


def _shared_cells(measurements: Iterable[Measurement]) -> dict[Cell, dict[str, np.ndarray]]:
    found: dict[Cell, dict[str, list[float]]] = defaultdict(lambda: defaultdict(list))
    for one in measurements:
        found[one.finger, one.object_id][one.lab].append(one.force_n)
    return {
        cell: {lab: np.array(values) for lab, values in sorted(forces.items())}
        for cell, forces in sorted(found.items())
        if len(forces) > 1
    }


def _spreads(cells: Mapping[Cell, _Forces], keys: Sequence[Hashable]) -> tuple[Spread, ...]:
    groups: dict[str, list[_Forces]] = defaultdict(list)
    for key, forces in zip(keys, cells.values(), strict=True):
        groups[str(key)].append(forces)
    return tuple(_spread(key, group) for key, group in groups.items())


def _spread(key: str, cells: Sequence[_Forces]) -> Spread:
    """Pool over cells the variances of repeats and between labs: ISO 5725-2, 7.4."""
    squares = freedom = 0.0
    between, sizes, means = [], [], []
    for forces in cells:
        n = np.array([len(y) for y in forces.values()])
        lab_means = np.array([y.mean() for y in forces.values()])
        squares += sum(float(((y - y.mean()) ** 2).sum()) for y in forces.values())
        freedom += float((n - 1).sum())
        mean = float(n @ lab_means / n.sum())
        between.append(float(n @ (lab_means - mean) ** 2) / (len(n) - 1))
        sizes.append(float(n.sum() - (n**2).sum() / n.sum()) / (len(n) - 1))
        means.append(float(lab_means.mean()))
    if not freedom:
        return Spread(key, len(cells), float(np.mean(means)), None, None, None)
    repeat = squares / freedom
    lab = max(0.0, (float(np.mean(between)) - repeat) / float(np.mean(sizes)))
    return Spread(key, len(cells), float(np.mean(means)), repeat**0.5, lab**0.5, (repeat + lab) ** 0.5)


def _bias(lab: str, cells: Mapping[Cell, _Forces], means: Mapping[Cell, Mapping[str, float]]) -> LabBias:
    by_finger: dict[str, list[float]] = defaultdict(list)
    for (finger, _), forces in means.items():
        centre = float(np.mean(list(forces.values())))
        if lab in forces and centre:
            by_finger[finger].append(forces[lab] / centre - 1.0)
    shares = np.array([np.mean(values) for values in by_finger.values()])
    return LabBias(
        lab=lab,
        n_grasps=sum(len(forces[lab]) for forces in cells.values() if lab in forces),
        n_cells=sum(lab in forces for forces in cells.values()),
        bias=mean_of_tools(shares) if len(shares) else Interval(np.nan, np.nan, np.nan, 0),
    )


def _pair(first: str, second: str, means: Mapping[Cell, Mapping[str, float]]) -> LabPair:
    by_finger: dict[str, list[tuple[float, float]]] = defaultdict(list)
    for (finger, _), forces in means.items():
        if first in forces and second in forces:
            by_finger[finger].append((forces[first], forces[second]))
    n = len(by_finger)
    if n < MIN_ORDERED:
        return LabPair(first, second, n, None)
    a, b = np.array([np.mean(values, axis=0) for values in by_finger.values()]).T
    return LabPair(first, second, n, float(scipy.stats.spearmanr(a, b).statistic))
