"""Things that go wrong in a grasp, done to its true trace: what the study `anomalies` plants and looks for."""

from collections.abc import Callable

import numpy as np

from fast.hardware.virtual.world.state import DRIFT_N_PER_S
from fast.models.records import Trace
from fast.models.traces import peak_force_n
from fast.models.traces.anomalies import EJECTED_MM
from fast.models.traces.flags import Kind

SLIP_MM = 3.0  # lift over which a torsional slip falls by a factor of e
PRELOAD_MM = 3.0  # lift over which an object pressed down comes up again
NO_FORCE = 0.02  # of the peak: below it nothing is held


def _drift(true: Trace, rng: np.random.Generator) -> np.ndarray:
    """The zero creeps from the tare on, up or down, by the rate of the world's fault `zero_drift` or up to 4 times."""
    rate_n_per_s = DRIFT_N_PER_S * rng.uniform(1.0, 4.0) * rng.choice([-1.0, 1.0])
    return np.asarray(true.force_n + rate_n_per_s * true.time_s)


def _early_loss(true: Trace, rng: np.random.Generator) -> np.ndarray:
    """As the world's fault `object_slips`: from one lift on there is no force."""
    lost_mm = max(EJECTED_MM + 1.0, rng.uniform(0.3, 0.75) * _held_mm(true))
    return np.where(true.lift_mm < lost_mm, true.force_n, 0.0)


def _ejection(true: Trace, rng: np.random.Generator) -> np.ndarray:
    """The same within the first 6 mm of lift."""
    return np.where(true.lift_mm < rng.uniform(0.5, 6.0), true.force_n, 0.0)


def _torsional_slip(true: Trace, rng: np.random.Generator) -> np.ndarray:
    """The fingers twist off an edge: from one lift on the force falls to a share of what it would be."""
    begin_mm, share = rng.uniform(0.1, 0.6) * _held_mm(true), rng.uniform(0.1, 0.4)
    left = share + (1.0 - share) * np.exp(-np.maximum(true.lift_mm - begin_mm, 0.0) / SLIP_MM)
    return np.asarray(true.force_n * left)


def _stuck_valve(true: Trace, rng: np.random.Generator) -> np.ndarray:
    """As the world's fault `grip_valve_stuck`, no force; of one in three the valve lets go after 3 to 15 mm of lift."""
    closes_mm = rng.uniform(3.0, 15.0) if rng.random() < 1 / 3 else np.inf
    return np.where(true.lift_mm < closes_mm, 0.0, true.force_n)


def _negative_preload(true: Trace, rng: np.random.Generator) -> np.ndarray:
    """From the middle of the closing on the object is pressed down, by 1 to 6 N at the start of the lift."""
    rest_s = true.time_s[true.is_lift][0]
    grown = np.clip(2.0 * true.time_s / rest_s - 1.0, 0.0, 1.0)
    extra_n = max(float(true.force_n[true.is_lift][0]), 0.0) + rng.uniform(1.0, 6.0)
    return np.asarray(true.force_n - extra_n * grown * np.exp(-true.lift_mm / PRELOAD_MM))


def _held_mm(true: Trace) -> float:
    """Last lift at which the object is held."""
    held = true.is_lift & (true.force_n > NO_FORCE * peak_force_n(true))
    return float(true.lift_mm[held].max(initial=0.0))


PLANTS: dict[Kind, Callable[[Trace, np.random.Generator], np.ndarray]] = {
    "stuck_valve": _stuck_valve,
    "ejection": _ejection,
    "early_loss": _early_loss,
    "torsional_slip": _torsional_slip,
    "negative_preload": _negative_preload,
    "drifting_cell": _drift,
}
