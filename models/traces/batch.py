"""Features of many traces in one compiled pass, with names and checks around it."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fast.models.errors import UsageError
from fast.models.records import Trace
from fast.models.traces.kernel import features_of_flat
from fast.models.traces.names import FEATURES


@dataclass(frozen=True, eq=False)
class TraceFeatures:
    """Features of n traces in the order and the units of `FEATURES`: what a trace does not show is NaN.

    `values`: n x len(FEATURES). `profile_n`: n x N_PROFILE mean forces over steps of lift, zero beyond the trace.
    """

    values: np.ndarray
    profile_n: np.ndarray

    @property
    def is_usable(self) -> np.ndarray:
        """Which traces lift by `names.MIN_LIFT_MM` or more (n); the others have no features."""
        return ~np.isnan(self.values[:, 0])

    def column(self, name: str) -> np.ndarray:
        """Return one feature of all traces (n)."""
        return np.asarray(self.values[:, FEATURES.index(name)])

    def row(self, place: int) -> dict[str, float | None]:
        """Return the features of one trace by name; None where it does not show one."""
        values = self.values[place].tolist()
        return {name: None if value != value else value for name, value in zip(FEATURES, values, strict=True)}


def features_of_samples(lift_mm: np.ndarray, force_n: np.ndarray, offsets: np.ndarray) -> TraceFeatures:
    """Find features of traces laid end to end: trace i is samples `offsets[i]` to `offsets[i + 1]`, as in Arrow lists.

    Raises:
        UsageError: there is no trace, or the offsets do not fit the samples.
    """
    if len(offsets) < 2:
        raise UsageError("no trace was given, and features need one at least; measure or import grasps first.")
    steps = np.diff(offsets)
    if len(lift_mm) != len(force_n) or offsets[0] < 0 or (steps < 0).any() or offsets[-1] > len(lift_mm):
        raise UsageError(
            f"offsets {offsets[0]} to {offsets[-1]} do not divide {len(lift_mm)} lifts and {len(force_n)} forces into "
            "traces; give n + 1 growing places for n traces."
        )
    # The kernel would be compiled once more for what is read-only.
    channels = (np.require(channel, np.float64, ["C", "W", "E"]) for channel in (lift_mm, force_n))
    return TraceFeatures(*features_of_flat(*channels, np.ascontiguousarray(offsets, dtype=np.int64)))


def features_of(traces: Sequence[Trace | None]) -> TraceFeatures:
    """Compute the features of n traces; what has no trace has none.

    Raises:
        UsageError: nothing was given.
    """
    nothing = np.zeros(0)
    lifts = [nothing if trace is None else trace.lift_mm for trace in traces]
    forces = [nothing if trace is None else trace.force_n for trace in traces]
    offsets = np.cumsum([0, *map(len, lifts)])
    return features_of_samples(np.concatenate([nothing, *lifts]), np.concatenate([nothing, *forces]), offsets)
