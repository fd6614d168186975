"""Residuals: what is left when theta has been calibrated again, grasp by grasp and by the parts of a lift.

A part is a phase: dip, rise, peak, slip, tail. Closing is not in the steps of a trace. Windows are those of the
simulated trace, so that a measured trace that is late shows as too much or too little force in a part. Intervals are of
what tools and objects share: they are left out one by one, never single grasps.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.special import stdtrit

from fast.models.errors import UsageError
from fast.models.gap.bank.surrogate import Surrogate
from fast.models.gap.where.strata import list_tool_features, make_object_table, make_tool_table, number_families
from fast.models.records import Design
from fast.models.traces.step_features import DIP_MM, NEAR_PEAK, STEP_MM

PHASES = ("dip", "rise", "peak", "slip", "tail")
WORDS = {
    "dip": "the first 3 mm of lift",
    "rise": "the rise to the peak",
    "peak": "the peak",
    "slip": "the slip after the peak",
    "tail": "the last millimetres",
}
AT = {
    "dip": "in the first 3 mm of lift",
    "rise": "on the way to the peak",
    "peak": "at the peak",
    "slip": "in the slip after the peak",
    "tail": "in the last millimetres",
}
_TAIL_MM = 10.0  # beyond the end of slipping
_GONE = 0.1  # of the peak: less holds nothing any more
_SMOOTH = 3  # steps of a running mean, so that noise does not make peaks
_LEAST_AMPLITUDE = 0.25  # of the median cell's: grasps without grip say nothing in per cent
MIN_TOOLS = 5  # sign flips of five tools give 32 patterns: nothing is seen with fewer
MIN_OBJECTS = 4
_UPPER = 0.95  # share below the upper end of an interval


@dataclass(frozen=True, eq=False)
class Residuals:
    """n measured grasps of t tools on o objects with what the recalibrated simulator predicts for each."""

    tools: tuple[str, ...]
    """t, names."""
    designs: tuple[Design, ...]
    """t, of the tools."""
    objects: tuple[int, ...]
    """o, ids."""
    tool: np.ndarray
    """n, numbers into `tools`."""
    obj: np.ndarray
    """n, numbers into `objects`."""
    repeat: np.ndarray
    """n, grasps of this tool on this object before."""
    order: np.ndarray
    """n, grasps of this tool before."""
    measured_n: np.ndarray
    """n x steps."""
    predicted_n: np.ndarray
    """n x steps."""
    numerical_n: np.ndarray
    """n x v x steps, what v numerical variants change at this theta; NaN where a simulation failed."""

    def __post_init__(self) -> None:
        """Check shapes and numbers.

        Raises:
            UsageError: arrays differ in length, a value is not finite, or there are too few tools or objects.
        """
        lengths = {len(getattr(self, name)) for name in ("tool", "obj", "repeat", "order", "measured_n", "predicted_n")}
        if len(lengths) != 1 or self.measured_n.shape != self.predicted_n.shape:
            raise UsageError(f"residuals have {sorted(lengths)} rows; give the same grasps to every argument.")
        if not (np.isfinite(self.measured_n).all() and np.isfinite(self.predicted_n).all()):
            raise UsageError("a trace or its prediction holds a value that is not finite; leave that grasp out.")
        n_tools, n_objects = len(np.unique(self.tool)), len(np.unique(self.obj))
        if n_tools < MIN_TOOLS or n_objects < MIN_OBJECTS:
            raise UsageError(
                f"{n_tools} tools on {n_objects} objects are left to look for a gap in, which takes {MIN_TOOLS} tools "
                f"and {MIN_OBJECTS} objects at least; measure more."
            )

    @staticmethod
    def of(surrogate: Surrogate, predicted_n: np.ndarray, young_modulus_mpa: float) -> "Residuals":
        """Compute residuals of a surrogate's grasps; predicted_n: n x steps, at this modulus of the material."""
        grasps, bank = surrogate.grasps, surrogate.bank
        scale = young_modulus_mpa / bank.centre.young_modulus_mpa
        return Residuals(
            tools=grasps.tools,
            designs=grasps.designs,
            objects=grasps.objects,
            tool=grasps.tool,
            obj=grasps.obj,
            repeat=np.array([context.repeat for context in grasps.contexts]),
            order=np.array([context.tool_grasps for context in grasps.contexts], dtype=float),
            measured_n=grasps.steps_n,
            predicted_n=predicted_n,
            numerical_n=scale
            * (bank.numerical_steps_n - bank.centre_steps_n[:, :, None])[grasps.tool, surrogate.column],
        )

    @cached_property
    def tool_features(self) -> tuple[str, ...]:
        """Names of the design parameters that all tools have."""
        return list_tool_features(self.designs)

    @cached_property
    def tool_table(self) -> np.ndarray:
        """Design parameters of the tools, t x as many as `tool_features`."""
        return make_tool_table(self.designs, self.tool_features)

    @cached_property
    def object_table(self) -> np.ndarray:
        """Make a table of width, height and, as 0 or 1, the family of the objects, o x 7."""
        return make_object_table(self.objects)

    @cached_property
    def family(self) -> np.ndarray:
        """Number of the family of each object, o."""
        return number_families(self.objects)

    @cached_property
    def phases_n(self) -> np.ndarray:
        """Missing force by phase, n x 5, in N; NaN where the prediction does not have the phase."""
        return compute_phase_differences(self.measured_n, self.predicted_n)

    @cached_property
    def amplitude_n(self) -> np.ndarray:
        """Predicted peak of each grasp, n, in N; not less than a quarter of the usual one."""
        return amplitudes(self.predicted_n)

    @cached_property
    def relative(self) -> np.ndarray:
        """Missing force by phase over the predicted peak, n x 5."""
        return np.asarray(self.phases_n / self.amplitude_n[:, None])

    @cached_property
    def peak_n(self) -> np.ndarray:
        """Measured peaks, n, in N."""
        return peaks(self.measured_n)

    @cached_property
    def numerical_relative(self) -> np.ndarray:
        """The same for what numerical variants change, v x n x 5.

        Where no variant was simulated the change is taken as zero.
        """
        v = self.numerical_n.shape[1]
        changes = np.nan_to_num(self.numerical_n)
        return np.stack(
            [
                compute_phase_differences(self.predicted_n + changes[:, i], self.predicted_n)
                / self.amplitude_n[:, None]
                for i in range(v)
            ]
            or [np.zeros((len(self.tool), len(PHASES)))]
        )


def compute_phase_differences(measured_n: np.ndarray, predicted_n: np.ndarray) -> np.ndarray:
    """Compute measured minus predicted force by phase, n x 5, in N: means over windows, of the peak the two peaks.

    measured_n, predicted_n: n x steps. NaN where the predicted trace does not have a phase.
    """
    windows = find_phase_windows(predicted_n)
    counts = windows.sum(axis=2)
    total = np.einsum("ns,nps->np", measured_n - predicted_n, windows.astype(float))
    means = np.where(counts > 0, total / np.maximum(counts, 1), np.nan)
    means[:, PHASES.index("peak")] = peaks(measured_n) - peaks(predicted_n)
    return np.asarray(means)


def find_phase_windows(predicted_n: np.ndarray) -> np.ndarray:
    """Find which steps belong to a phase, n x 5 x steps; a step belongs to one at most."""
    n, n_steps = predicted_n.shape
    smoothed = smooth(predicted_n)
    peak = smoothed.max(axis=1, keepdims=True)
    step = np.arange(n_steps)
    first, last = _ends(smoothed >= peak - (1.0 - NEAR_PEAK) * np.abs(peak))
    _, held = _ends(smoothed >= _GONE * peak)
    start = round(DIP_MM / STEP_MM)
    end = np.minimum(held + round(_TAIL_MM / STEP_MM), n_steps - 1)
    bounds = np.stack([np.zeros(n), np.full(n, start), np.maximum(first, start), np.maximum(last + 1, start),
                       np.maximum(held + 1, start), end + 1], axis=1)  # fmt: skip
    bounds = np.maximum.accumulate(bounds, axis=1)
    return np.asarray((step >= bounds[:, :-1, None]) & (step < bounds[:, 1:, None]))


def peaks(steps_n: np.ndarray) -> np.ndarray:
    """Find the peak force of traces (n x steps), n, in N: of a running mean over 1.5 mm."""
    return np.asarray(smooth(steps_n).max(axis=1))


def amplitudes(predicted_n: np.ndarray) -> np.ndarray:
    """Return what a grasp's forces are compared with, n, in N: its predicted peak, at least a quarter of the usual."""
    peak = np.abs(smooth(predicted_n)).max(axis=1)
    return np.asarray(np.maximum(peak, max(_LEAST_AMPLITUDE * float(np.median(peak)), 1e-9)))


def smooth(steps_n: np.ndarray) -> np.ndarray:
    """Compute the running mean over three steps, n x steps; fewer at the ends."""
    padded = np.pad(steps_n, ((0, 0), (1, 1)), mode="edge")
    return np.asarray(sum(padded[:, i : i + steps_n.shape[1]] for i in range(_SMOOTH)) / _SMOOTH)


def _ends(is_in: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Find the first and last step of a mask, n each."""
    return is_in.argmax(axis=1), is_in.shape[1] - 1 - is_in[:, ::-1].argmax(axis=1)


def jackknife(
    statistic: Callable[[np.ndarray], np.ndarray], tool: np.ndarray, obj: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Compute a statistic (k) of a mask of grasps (n) and the ends of its 90 % interval, k each.

    Tools and objects are left out one by one and both variances added: too wide rather than too narrow. Student's t
    with as many degrees of freedom as there are tools or objects, whichever is fewer, less one.
    """
    value = statistic(np.ones(len(tool), dtype=bool))
    variance, fewest = np.zeros_like(value), np.inf
    for cluster in (tool, obj):
        names = np.unique(cluster)
        if len(names) < 2:
            continue
        left = np.stack([statistic(cluster != name) for name in names])
        left = left[np.isfinite(left).all(axis=1)]
        if len(left) > 1:
            variance = variance + (len(left) - 1) / len(left) * ((left - left.mean(axis=0)) ** 2).sum(axis=0)
            fewest = min(fewest, len(left) - 1)
    half = stdtrit(max(fewest, 1) if np.isfinite(fewest) else 1, _UPPER) * np.sqrt(variance)
    return value, value - half, value + half
