"""Where measured grasps are in the state of an effect, along which its law runs (`models.simulation.effects`)."""

import numpy as np

from fast.models.gap.bank.surrogate import FEATURES, N_BINS
from fast.models.gap.fit.fit import Fit
from fast.models.simulation.effects.states import State
from fast.models.traces.step_features import CENTRES_MM, PEAK

_LIFT_AT_PEAK, _PEAK, _TAIL = (FEATURES.index(name) for name in ("lift_at_peak_mm", PEAK, "tail_n_mm"))


def read_state(fit: Fit, state: State) -> np.ndarray:
    """The state at every feature of every grasp of a fit, m x f."""
    if not callable(state.read):
        along = {"lift": _read_lift, "held": _read_lift_time, "force": _read_force, "level": _read_level}
        return along[state.read](fit)
    grasps = fit.features.surrogate.grasps
    rows = zip(grasps.tool, grasps.setup, grasps.contexts, strict=True)
    values = np.array([state.read(grasps.designs[tool], grasps.setups[at], context) for tool, at, context in rows])
    return np.repeat(values[:, None], len(FEATURES), axis=1)


def _read_lift(fit: Fit) -> np.ndarray:
    """Lift that a feature is about, mm."""
    lift_mm = np.tile([CENTRES_MM.get(name, 0.0) for name in FEATURES], (len(fit.raw), 1))
    lift_mm[:, [_LIFT_AT_PEAK, _PEAK]] = np.clip(fit.modelled[:, [_LIFT_AT_PEAK]], 0.0, None)
    return lift_mm


def _read_lift_time(fit: Fit) -> np.ndarray:
    """Time of a feature since the end of closing, s."""
    grasps = fit.features.surrogate.grasps
    dwell_s = np.array([setup.dwell_s for setup in grasps.setups])[grasps.setup]
    return np.asarray(_read_lift(fit) / grasps.lift_speed_mm_per_s[:, None] + dwell_s[:, None])


def _read_level(fit: Fit) -> np.ndarray:
    """Root mean square force of a grasp over the bins of its lift, N."""
    level_n = np.sqrt((fit.modelled[:, :N_BINS] ** 2).mean(axis=1))
    return np.repeat(level_n[:, None], len(FEATURES), axis=1)


def _read_force(fit: Fit) -> np.ndarray:
    """Size of the force where a feature is taken, N; of lengths and areas that of the peak."""
    force_n = np.abs(fit.modelled)
    force_n[:, [_LIFT_AT_PEAK, _TAIL]] = force_n[:, [_PEAK]]
    return force_n
