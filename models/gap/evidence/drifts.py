"""What may change from grasp to grasp, and along which clock.

Pressure falls and comes back, a tool wears, a finger warms up. A drift says how much a quantity has changed at a time:
c ~ GP(0, size^2 k), with k a Matern kernel of order 3/2 along a clock. It need not obey any law. It is told by what
repeats of a cell differ by: mesh, contact law, prints and placements are the same in all of them.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from fast.models.gap.grasps import Grasps
from fast.models.records import GraspContext
from fast.models.simulation.effects.catalogue import CATALOGUE

_SPACING = 0.4  # of knots, in lengths
_MOST_KNOTS = 60  # of a batch
_JITTER = 1e-6


@dataclass(frozen=True)
class Clock:
    """Along what a quantity changes. is_by_batch: every batch has a drift of its own; else all tools have the same.

    words: when it changes. lengths: of drifts that are tried, in grasps.
    """

    words: str
    read: Callable[[GraspContext], float]
    lengths: tuple[float, ...]
    is_by_batch: bool = False

    def place(self, grasps: Grasps) -> tuple[np.ndarray, np.ndarray]:
        """Return which drift each grasp is on, and where, n each."""
        at = np.array([self.read(context) for context in grasps.contexts], dtype=float)
        return (find_batches(grasps) if self.is_by_batch else np.zeros(len(at), dtype=int)), at


CLOCKS: Mapping[str, Clock] = {
    "batch": Clock("over the batch", lambda c: c.batch_grasps, (30.0, 100.0, 300.0), is_by_batch=True),
    "tool": Clock("with a tool's grasps", lambda c: c.tool_grasps, (10.0, 30.0)),
    "repeat": Clock("from repeat to repeat", lambda c: c.repeat, (1.0,)),
}
# What changes, as a person would say it; with when, no longer than a cell of a printed table (60 characters).
QUANTITIES: Mapping[str, str] = {
    "closing": "as if jaws closed less or more far",
    "modulus": "as if fingers grew softer or stiffer",
    "friction": "as if friction changed",
    "zero": "as if the zero of the load cell moved",
    "height": "as if objects stood higher or lower",
    "delay": "as if the force came later or sooner",
}


def find_effect(quantity: str, clock: str) -> str:
    """Find the effect of the catalogue by which a quantity changes along a clock; empty if there is none."""
    drifts = ((name, spec.drift) for name, spec in CATALOGUE.items() if spec.drift is not None)
    return next((name for name, drift in drifts if drift.quantity == quantity and clock in drift.clocks), "")


def describe_drift(quantity: str, clock: str) -> str:
    """Describe when and how repeats of the same grasps differ, in words."""
    return f"{CLOCKS[clock].words}, {QUANTITIES[quantity]}"


def find_batches(grasps: Grasps) -> np.ndarray:
    """Find the batch of each grasp, n.

    Every batch counts its grasps anew, so a tool that begins before the last one ended is of another batch. Tools of a
    batch are measured one after the other, in the order of their numbers.
    """
    made = np.array([context.batch_grasps for context in grasps.contexts], dtype=int)
    batch, number, end = np.zeros(len(made), dtype=int), -1, np.inf
    for tool in np.unique(grasps.tool):
        own = grasps.tool == tool
        number += int(made[own].min() <= end)
        batch[own], end = number, made[own].max()
    return batch


def place_knots(at: np.ndarray, length: float) -> np.ndarray:
    """Place knots of a drift of this length between grasps at places (n)."""
    n = int(np.ceil(np.ptp(at) / (_SPACING * length))) + 1
    return np.linspace(at.min(), at.max(), min(max(n, 2), _MOST_KNOTS))


def make_basis(knots: np.ndarray, at: np.ndarray, length: float) -> np.ndarray:
    """Compute what each weight of unit variance adds to a drift at places (n), k x n."""
    length = max(length, _SPACING * float(knots[1] - knots[0]))

    def kernel(first: np.ndarray, second: np.ndarray) -> np.ndarray:
        away = np.sqrt(3.0) * np.abs(first[:, None] - second) / length
        return np.asarray((1.0 + away) * np.exp(-away))

    root = np.linalg.cholesky(kernel(knots, knots) + _JITTER * np.eye(len(knots)))
    return np.asarray(np.linalg.solve(root, kernel(knots, at)))
