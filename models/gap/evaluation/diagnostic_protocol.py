"""The diagnostic protocol: settings of the bench under which effects that look alike stop doing so.

A setting is compared with the usual one on the same tool and object, in turn, so that print, placement and theta
cancel. `respond` says by how much an effect, at its fitted parameters, then changes the force, relative to the peak:
from its law in closed form, for a usual grasp. A setting that leaves an effect alone, or for which its law has no
closed form, answers 0. The numbers are good for choosing an experiment, not for judging its result.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

Parameters = Mapping[str, float]
Response = Callable[[Parameters], float]

# A usual grasp: half a second before the lift, four seconds to the peak at 5 mm/s, 15 N at the peak, 60 N of closing.
_TO_PEAK_S, _SPEED_MM_PER_S, _PEAK_N, _CLOSING_N = 4.0, 5.0, 15.0, 60.0
_WIDTH_MM = 12.0  # of a peak over lift: how much of it a shift takes
_DEPTH_MM = 24.0  # by how much both jaws press an object of 40 mm
_HOUR_S = 3600.0


@dataclass(frozen=True)
class Setting:
    """One setting. `cost`: of a comparison, in grasps' worth of time, more where a person has to come.

    `sd`: of a comparison, relative to the peak. `n_grasps`: of a comparison; 0 where nothing is grasped.
    """

    name: str
    words: str
    cost: float
    sd: float
    responses: Mapping[str, Response]
    n_grasps: int = 2

    def respond(self, effect: str, parameters: Parameters) -> float:
        """Change of force under the setting, relative to the peak."""
        response = self.responses.get(effect)
        return 0.0 if response is None else float(response(parameters))


def _dwell(seconds: float) -> Response:
    """M1: what relaxes during the wait, F(t) = F [1 - g (1 - exp(-t / tau))]."""

    def change(p: Parameters) -> float:
        g, tau = p["relaxed_share"], p["time_constant_s"]
        return -g * (np.exp(-_TO_PEAK_S / tau) - np.exp(-(_TO_PEAK_S + seconds) / tau))

    return change


def _speed(mm_per_s: float) -> dict[str, Response]:
    """A lag of tau moves the trace by tau v; relaxation has more or less time; friction follows the speed."""
    ratio = mm_per_s / _SPEED_MM_PER_S

    def lag(p: Parameters) -> float:
        return -p["time_constant_s"] * (mm_per_s - _SPEED_MM_PER_S) / _WIDTH_MM

    def relaxation(p: Parameters) -> float:
        g, tau = p["relaxed_share"], p["time_constant_s"]
        return g * (np.exp(-_TO_PEAK_S / ratio / tau) - np.exp(-_TO_PEAK_S / tau))

    def friction(p: Parameters) -> float:
        b, v0 = p["rate_sensitivity"], p.get("reference_speed_mm_per_s", 1.0)
        return b * (np.log1p(mm_per_s / v0) - np.log1p(_SPEED_MM_PER_S / v0))

    def start(p: Parameters) -> float:
        return -0.5 * p.get("ramp_s", 0.0) * (mm_per_s - _SPEED_MM_PER_S) / _WIDTH_MM

    return {
        "load_cell_lag": lag,
        "stress_relaxation": relaxation,
        "velocity_strengthening_friction": friction,
        "lift_start_error": start,
    }


def _pressure(ratio: float) -> dict[str, Response]:
    """A1: jaws that stall close with force in proportion to the supply; jaws that reach their stop do not care."""

    def stalled(p: Parameters) -> float:
        limit = p["max_force_n"]
        return min(ratio * limit, _CLOSING_N) / min(limit, _CLOSING_N) - 1.0

    return {"force_limited_closing": stalled}


def _gap(ratio: float) -> dict[str, Response]:
    """Closing less by `ratio`: force falls with it, but for adhesion, stalled jaws, and friction that goes as p^-k."""
    return {
        "pressure_dependent_friction": lambda p: ratio ** (1.0 - p["exponent"]) - ratio,
        "shear_adhesion": lambda p: (1.0 - ratio) * min(p["shear_strength_mpa"] * 300.0 / _PEAK_N, 1.0),
        "force_limited_closing": lambda p: (1.0 - ratio) * float(p["max_force_n"] < _CLOSING_N),
    }


def _rested(p: Parameters) -> float:
    return p["softening"] * (1.0 - np.exp(-2.0 / p["scale_repeats"]))


_BASELINE = {
    "load_cell_offset": lambda p: p["offset_n"] / _PEAK_N,
    "tool_weight": lambda p: 0.5 * p["share"] / _PEAK_N,
    "load_cell_drift": lambda p: p["drift_per_hour_n"] / _PEAK_N,
}
_REPEATED = 0.015  # two grasps of one tool on one object, one after the other, to be compared

SETTINGS: tuple[Setting, ...] = (
    Setting("dwell", "wait 30 s between closing and lift, and 0 s, in turn", 3.0, _REPEATED,
            {"stress_relaxation": _dwell(30.0)}),
    Setting("slow lift", "lift at 1 mm/s and at 5 mm/s, in turn", 3.0, _REPEATED, _speed(1.0)),
    Setting("fast lift", "lift at 20 mm/s and at 5 mm/s, in turn", 2.0, _REPEATED, _speed(20.0)),
    Setting("low supply", "close with 20 psi and with 30 psi, in turn", 2.0, _REPEATED, _pressure(2.0 / 3.0)),
    Setting("high supply", "close with 40 psi and with 30 psi, in turn", 2.0, _REPEATED, _pressure(4.0 / 3.0)),
    Setting("wider gap", "close to 22 mm and to 16 mm, in turn", 2.0, _REPEATED, _gap(0.75)),
    Setting("closed empty", "close and lift without an object", 1.0, 0.003, _BASELINE, 1),
    Setting("dead weight", "hang 1 kg on the load cell and cut the string", 8.0, 0.002,
            {"load_cell_gain": lambda p: p["gain"] - 1.0, "load_cell_offset": _BASELINE["load_cell_offset"],
             "load_cell_lag": lambda p: p["time_constant_s"]}, 0),
    Setting("rest", "grasp the first object again, before and after a rest of an hour", 6.0, _REPEATED,
            {"mullins_softening": _rested,
             "temperature_softening": lambda p: p["softening"] * np.exp(-_HOUR_S / p["warm_up_s"]),
             "load_cell_drift": lambda p: p["drift_per_hour_n"] / _PEAK_N}),
    Setting("reference grasp", "grasp one object with a new reference tool every 36 grasps", 4.0, _REPEATED,
            {"temperature_softening": lambda p: -p["softening"],
             "pressure_droop": lambda p: -2.0 * p["loss_mm"] / _DEPTH_MM,
             "load_cell_drift": lambda p: p["drift_per_hour_n"] / _PEAK_N}),
    Setting("callipers", "measure the walls of three fingers with callipers", 4.0, 0.03,
            {"wall_thickness_offset": lambda p: 3.0 * p["offset_mm"] / 2.5}, 0),  # stiffness goes with thickness^3
)  # fmt: skip
