"""What the law of an effect runs along: its state, once for every effect, and the law where it is a known quantity.

The law of an effect says how much of it there is in a state: friction after so much slip, modulus after so many
repeats. Where the state is not in the data, what goes with it stands for it: the lift for the slip of a sliding point,
the force level of a grasp for its contact pressure and its closing force. An effect that is a plain number, such as a
zero that is off, has no state.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from fast.models.gap.bank.surrogate import FEATURES, N_BINS
from fast.models.gap.fit.fit import Fit
from fast.models.traces.step_features import CENTRES_MM, PEAK

_LIFT_AT_PEAK, _PEAK, _TAIL = (FEATURES.index(name) for name in ("lift_at_peak_mm", PEAK, "tail_n_mm"))
_HOUR_S = 3600.0

Reading = Callable[[Fit], np.ndarray]
# The quantity at states (k), of the effect's parameters by name and the speed of the lift in mm/s.
Law = Callable[[Mapping[str, float], np.ndarray, float], np.ndarray]


@dataclass(frozen=True)
class EffectState:
    """The state that an effect's law runs along.

    name: in words, with its unit. read: of every feature of every grasp, m x f. scale: in the state's unit; a law is
    taken to be smooth along an axis that is linear up to it and logarithmic beyond.
    """

    name: str
    read: Reading
    scale: float

    def place(self, state: np.ndarray) -> np.ndarray:
        """Where states are on the axis along which the law is smooth."""
        return np.asarray(np.log1p(state / self.scale))

    def state_at(self, place: np.ndarray) -> np.ndarray:
        """Inverse of `place`."""
        return np.asarray(self.scale * np.expm1(place))


@dataclass(frozen=True)
class Quantity:
    """A law of the catalogue as a quantity against the state: in words, its value without the effect, and the law."""

    name: str
    neutral: float
    law: Law


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


def _read_context(name: str, unit: float = 1.0) -> Reading:
    def read(fit: Fit) -> np.ndarray:
        values = np.array([getattr(context, name) for context in fit.features.surrogate.grasps.contexts]) / unit
        return np.repeat(values[:, None], len(FEATURES), axis=1)

    return read


def _read_design(name: str) -> Reading:
    def read(fit: Fit) -> np.ndarray:
        grasps = fit.features.surrogate.grasps
        # Families without the parameter have no such state: all tools stand at 0.
        values = np.array([float(getattr(design, name, 0.0)) for design in grasps.designs])[grasps.tool]
        return np.repeat(values[:, None], len(FEATURES), axis=1)

    return read


_LEVEL = EffectState("force level of the grasp, N", _read_level, 0.5)
_FORCE = EffectState("force, N", _read_force, 2.0)
_LIFT = EffectState("lift, mm", _read_lift, 1.0)
_RIBS = EffectState("ribs of the finger", _read_design("rib_count"), 5.0)
_CLOCK = EffectState("time since the batch began, h", _read_context("clock_s", _HOUR_S), 2.0)

# The state of each effect's law. Effects that are not here are plain numbers.
STATES: Mapping[str, EffectState] = {
    "wall_thickness_offset": EffectState("drawn front wall, mm", _read_design("front_thickness_mm"), 2.0),
    "rib_imperfection": _RIBS,
    "stress_relaxation": EffectState("time since the end of closing, s", _read_lift_time, 1.0),
    "mullins_softening": EffectState("repeats before", _read_context("repeat"), 2.0),
    "hyperelastic_stiffening": _LEVEL,
    "temperature_softening": _CLOCK,
    "print_anisotropy": _RIBS,
    "static_kinetic_friction": EffectState("slip, mm", _read_lift, 1.0),
    "pressure_dependent_friction": _LEVEL,
    "shear_adhesion": _LEVEL,
    "friction_wear": EffectState("grasps of the tool before", _read_context("tool_grasps"), 10.0),
    "object_edge_radius": _LEVEL,
    "finger_finger_contact": _LEVEL,
    "object_post_compliance": _FORCE,
    "base_compliance": _LEVEL,
    "force_limited_closing": _LEVEL,
    "pressure_droop": EffectState("grasps of the batch before", _read_context("batch_grasps"), 50.0),
    "lift_start_error": _LIFT,
    "lift_misalignment": _LIFT,
    "load_cell_gain": _FORCE,
    "load_cell_drift": _CLOCK,
    "load_cell_lag": _LIFT,
}


def _approach(p: Mapping[str, float], share: str, scale: str, state: np.ndarray, unit: float = 1.0) -> np.ndarray:
    """Share (1 - exp(-state / scale)): the law by which most effects with a memory set in."""
    return np.asarray(-p[share] * np.expm1(-state * unit / p[scale]))


def _start_behind(p: Mapping[str, float], lift_mm: np.ndarray, speed: float) -> np.ndarray:
    left = np.clip(1.0 - lift_mm / (speed * max(p["ramp_s"], 1e-9)), 0.0, 1.0) ** (p["ramp_power"] + 1.0)
    return np.asarray(p["backlash_mm"] + speed * p["ramp_s"] / (p["ramp_power"] + 1.0) * (1.0 - left))


# Laws that are a known quantity of their state; of the others a curve shows what they change in the force.
QUANTITIES: Mapping[str, Quantity] = {
    "static_kinetic_friction": Quantity(
        "friction over friction at rest",
        1.0,
        lambda p, slip, _: 1.0 - (1.0 - p["kinetic_ratio"]) * -np.expm1(-slip / p["slip_scale_mm"]),
    ),
    "friction_wear": Quantity(
        "friction over that of a new tool", 1.0, lambda p, m, _: 1.0 - _approach(p, "loss", "scale_grasps", m)
    ),
    "stress_relaxation": Quantity(
        "force over that without relaxation",
        1.0,
        lambda p, t, _: 1.0 - _approach(p, "relaxed_share", "time_constant_s", t),
    ),
    "mullins_softening": Quantity(
        "modulus over that of the first grasp", 1.0, lambda p, n, _: 1.0 - _approach(p, "softening", "scale_repeats", n)
    ),
    "temperature_softening": Quantity(
        "modulus over that when the batch began",
        1.0,
        lambda p, t, _: 1.0 - _approach(p, "softening", "warm_up_s", t, _HOUR_S),
    ),
    "pressure_droop": Quantity(
        "how far a jaw stays back, mm", 0.0, lambda p, m, _: _approach(p, "loss_mm", "scale_grasps", m)
    ),
    "object_post_compliance": Quantity(
        "how far the post gives way, mm", 0.0, lambda p, f, _: p["compliance_mm_per_n"] * f
    ),
    "lift_start_error": Quantity("how far the lift is behind, mm", 0.0, _start_behind),
    "lift_misalignment": Quantity(
        "how late the force is, mm of lift", 0.0, lambda p, s, _: np.full_like(s, p["shift_mm"])
    ),
    "load_cell_lag": Quantity("delay of the load cell, s", 0.0, lambda p, s, _: np.full_like(s, p["time_constant_s"])),
    "load_cell_drift": Quantity("zero of the load cell, N", 0.0, lambda p, t, _: p["drift_per_hour_n"] * t),
    "load_cell_gain": Quantity("reported over true force", 1.0, lambda p, f, _: np.full_like(f, p["gain"])),
}
