"""What is left of the measured force once everything that is known is in the simulator: in words, with sizes.

The words are rules on measured numbers. They look where in the lift force is left, and say nothing that is smaller than
`LEAST_N` or on whose sign tools and objects do not agree. What it goes with, the tests of `where` say.
"""

from dataclasses import dataclass

import numpy as np

from fast.models.gap.findings import Rest
from fast.models.gap.where.residuals import AT, PHASES, Residuals, jackknife, smooth
from fast.models.traces.step_features import N_STEPS, STEP_MM
from fast.models.units import spell_number

LEAST_N = 0.05  # less is not told
_EMPTY = 0.02  # of the simulated peak: less is no grip any more
_AFTER_MM = 4.0  # beyond the last grip, so that a trace that is late does not count as force without an object
_FEWEST_FREE_MM = 5.0  # of lift without an object, in which a slope can be seen
_LEAST_SLOPE = 0.2  # of the force that stays, over the lift in which it was seen
_LIFT_MM = STEP_MM * (np.arange(N_STEPS) + 0.5)


def describe_rest(residuals: Residuals) -> Rest:
    """Describe the mean force that is left over the lift, in words and with a 90 % band over tools and objects.

    residuals: of the fit that knows all that was named, of the grasps to learn from.
    """
    gap_n = residuals.measured_n - residuals.predicted_n
    mean_n, low_n, high_n = _mean_with_band(gap_n, residuals)
    told = _find_tail(residuals) or _find_largest_phase(residuals)
    return Rest(
        sentence=told or _describe_patternless(gap_n, mean_n),
        lift_mm=tuple(_LIFT_MM.tolist()),
        force_n=tuple(mean_n.tolist()),
        low_n=tuple(low_n.tolist()),
        high_n=tuple(high_n.tolist()),
        has_sign=told is not None,
    )


def _find_tail(residuals: Residuals) -> str | None:
    """Find the force that stays after the object has left the simulated fingers; None if none stays."""
    is_free = _find_free_steps(residuals.predicted_n)
    gap_n = residuals.measured_n - residuals.predicted_n
    counts = is_free.sum(axis=1)
    is_seen = counts >= _FEWEST_FREE_MM / STEP_MM
    if not _has_enough(residuals, is_seen):
        return None
    force_n = np.where(is_seen, (gap_n * is_free).sum(axis=1) / np.maximum(counts, 1), np.nan)
    size = _Size.of(force_n, residuals)
    if not size.is_told:
        return None
    return _describe_tail(residuals, gap_n, is_free & is_seen[:, None], size)


@dataclass(frozen=True)
class _Size:
    """A mean over grasps in N with its 90 % interval over tools and objects."""

    value: float
    low: float
    high: float

    @staticmethod
    def of(values: np.ndarray, residuals: Residuals) -> "_Size":
        is_there = np.isfinite(values)
        rows = values[is_there]
        found = jackknife(lambda mask: _mean(rows[mask]), residuals.tool[is_there], residuals.obj[is_there])
        return _Size(*(float(part[0]) for part in found))

    @property
    def is_told(self) -> bool:
        return abs(self.value) >= LEAST_N and self.low * self.high > 0

    @property
    def words(self) -> str:
        """The size and its interval, without sign."""
        low, high = sorted((abs(self.low), abs(self.high)))
        return f"{spell_number(abs(self.value))} N [{spell_number(low)}, {spell_number(high)}]"


def _mean(rows: np.ndarray) -> np.ndarray:
    return np.array([rows.mean() if len(rows) else np.nan])


def _mean_with_band(gap_n: np.ndarray, residuals: Residuals) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Compute the mean over the grasps and its 90 % band over tools and objects, steps each."""

    def mean(mask: np.ndarray) -> np.ndarray:
        return np.asarray(gap_n[mask].mean(axis=0) if mask.any() else np.full(gap_n.shape[1], np.nan))

    return jackknife(mean, residuals.tool, residuals.obj)


def _has_enough(residuals: Residuals, is_seen: np.ndarray) -> bool:
    """Return whether grasps of at least three tools and objects are among the chosen: fewer have no interval."""
    return all(len(np.unique(group[is_seen])) >= 3 for group in (residuals.tool, residuals.obj))


def _find_free_steps(predicted_n: np.ndarray) -> np.ndarray:
    """Find the steps after the object has left the simulated fingers, n x steps."""
    simulated_n = np.abs(smooth(predicted_n))
    is_held = simulated_n >= _EMPTY * simulated_n.max(axis=1, keepdims=True)
    last = predicted_n.shape[1] - 1 - is_held[:, ::-1].argmax(axis=1)
    return np.asarray(np.arange(predicted_n.shape[1]) > last[:, None] + round(_AFTER_MM / STEP_MM))


def _describe_tail(residuals: Residuals, gap_n: np.ndarray, is_free: np.ndarray, size: _Size) -> str:
    """Describe what stays at the middle of the lifts without an object, and whether it grows with lift."""
    chosen = is_free.any(axis=1)
    weights = is_free[chosen].astype(float)
    rows_n = gap_n[chosen]
    middle_mm = float((weights * _LIFT_MM).sum() / weights.sum())

    def slope(mask: np.ndarray) -> np.ndarray:
        w, y = weights[mask], rows_n[mask]
        if not mask.any():
            return np.full(1, np.nan)
        x = (_LIFT_MM - (w @ _LIFT_MM / w.sum(axis=1))[:, None]) * w
        return np.array([(x * y).sum() / max(float((x * _LIFT_MM).sum()), 1e-12)])

    found = jackknife(slope, residuals.tool[chosen], residuals.obj[chosen])
    value, low, high = (float(part[0]) for part in found)
    # The mean over grasps lies at the middle of what each has seen: moved to one lift, all speak of the same place.
    own_mm = weights @ _LIFT_MM / weights.sum(axis=1)
    at_middle_n = size.value + value * (middle_mm - float(own_mm.mean()))
    noun = "pull" if at_middle_n > 0 else "push"
    head = f"A {noun} stays after the object has gone: {spell_number(abs(at_middle_n))} N at {middle_mm:.0f} mm of lift"
    span_mm = float(np.ptp(_LIFT_MM[is_free.any(axis=0)]))
    if low * high <= 0 or abs(value) * span_mm < max(_LEAST_SLOPE * abs(at_middle_n), LEAST_N):
        return f"{head}, about the same at all lifts."
    verb = "grows" if value * at_middle_n > 0 else "falls"
    return f"{head}, and {verb} by {spell_number(abs(value))} N per mm."


def _find_largest_phase(residuals: Residuals) -> str | None:
    """Find the phase of largest mean force, of those where tools and objects agree on a sign; None without any."""
    found: list[tuple[_Size, str]] = []
    for place, phase in enumerate(PHASES):
        is_there = np.isfinite(residuals.phases_n[:, place])
        if _has_enough(residuals, is_there):
            found.append((_Size.of(residuals.phases_n[:, place], residuals), phase))
    told = [pair for pair in found if pair[0].is_told]
    if not told:
        return None
    size, phase = max(told, key=lambda pair: abs(pair[0].value))
    words = "more" if size.value > 0 else "less"
    others = [f"{AT[other]} {_sign(of.value)}{spell_number(abs(of.value))} N" for of, other in told if other != phase]
    also = f" ({'; '.join(others)})" if others else ""
    return f"The difference is largest {AT[phase]}: {size.words} {words} than simulated{also}."


def _sign(value: float) -> str:
    return "+" if value > 0 else "\u2212"


def _describe_patternless(gap_n: np.ndarray, mean_n: np.ndarray) -> str:
    rms_n = float(np.sqrt(np.mean(gap_n**2)))
    at = int(np.abs(mean_n).argmax())
    return (
        f"What is left is {spell_number(rms_n)} N (root mean square) and has no sign on which tools and objects "
        f"agree; its mean is at most {spell_number(abs(mean_n[at]))} N, at {_LIFT_MM[at]:.0f} mm of lift."
    )
