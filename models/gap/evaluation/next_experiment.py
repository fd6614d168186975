"""What to measure next: the experiment that separates a set of effects, and what no pull-off data tell apart.

Two effects i and j that change force by r_i and r_j under a setting are told apart by D = (r_i - r_j)^2 / (2 sd^2) a
comparison, sd its scatter. The setting with the largest sum of P_i P_j D_ij over its cost is asked for (Box and Hill
1967).

A setting of the bench is compared with the usual one on the same tool and object, in turn, so that print, placement and
theta cancel. `Setting.respond` says by how much an effect, at its fitted parameters, then changes the force, relative
to the peak: from its law in closed form, for a usual grasp. A setting that leaves an effect alone, or for which its law
has no closed form, answers 0. The numbers are good for choosing an experiment, not for judging its result.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from models.gap.findings import Confound, NextExperiment
from models.simulation.effects.catalogue import CATALOGUE

Parameters = Mapping[str, float]
Response = Callable[[Parameters], float]

ENOUGH = 3.0  # nats: odds of 20 to 1
FEWEST = 3  # comparisons: another tool and another object should agree
MOST = 200
HARDLY_VISIBLE = 0.1  # of a signature left once theta and tools are fitted again
_OF = {
    "young_modulus_mpa": "Young's modulus",
    "friction": "friction, as long as all lifts have one speed",
    "tool_modulus": "the modulus of each tool",
}
_EXPERIMENTS = {
    "load_cell_gain": "hang a dead weight of 1 kg on the load cell: force that the cell reads, without a gripper",
    "velocity_strengthening_friction": "lift at 1 and at 20 mm/s, one tool on one straight-sided object",
    "batch_ageing": "test a tool of an old batch again, or pull a tensile bar of each batch",
    "wall_thickness_offset": "calliper and scale on three fingers: wall thickness to 0.02 mm",
    "print_anisotropy": "tensile bars printed in two orientations",
    "temperature_softening": "log the temperature, and grasp a reference object with a reference tool every 36 grasps",
    "mullins_softening": "rest for an hour and grasp the first object again",
    "base_compliance": "push against a jaw without a finger, 20 N, and read how far it gives way",
}
_ANYWHERE = "a second lift speed, a second closed gap and a dead weight on the load cell"
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


def choose_next_experiment(
    effects: Sequence[str],
    parameters: Mapping[str, Mapping[str, float]] | None = None,
    probabilities: Mapping[str, float] | None = None,
    settings: Sequence[Setting] = SETTINGS,
) -> NextExperiment | None:
    """What to measure so that a confusable set of effects falls apart; None if no setting of the bench does it.

    parameters: fitted values by effect (prior medians where missing). probabilities: of the effects (equal if missing).
    """
    names = [name for name in effects if name in CATALOGUE]
    if len(names) < 2:
        return None
    responses = {s.name: {n: s.respond(n, _whole(n, (parameters or {}).get(n, {}))) for n in names} for s in settings}
    weights = {n: (probabilities or {}).get(n, 1.0 / len(names)) for n in names}
    best = max(settings, key=lambda s: _gain(responses[s.name], weights, s.sd) / s.cost)
    separated, n_comparisons = _separate(responses[best.name], best.sd)
    if not separated:
        return None
    n_grasps = best.n_grasps * n_comparisons
    return NextExperiment(
        setting=best.name,
        separates=separated,
        n_grasps=n_grasps,
        sentence=_sentence(best, responses[best.name], separated, n_grasps),
    )


def find_confounds(visible: Mapping[str, float] | None = None) -> tuple[Confound, ...]:
    """Declared aliases of the catalogue, and effects of which theta and tools swallow all but a tenth in these data.

    visible: by effect, the share of its signature that is left once theta and tools are fitted again.
    """
    declared = [
        Confound(effect=name, of=_OF[spec.alias_of], experiment=_EXPERIMENTS.get(name, _ANYWHERE))
        for name, spec in CATALOGUE.items()
        if spec.alias_of is not None
    ]
    names = {confound.effect for confound in declared}
    hidden = [
        Confound(
            effect=name,
            of=f"theta and tools, which take up {100 * (1 - share):.0f} % of it in these data",
            experiment=_EXPERIMENTS.get(name, _ANYWHERE),
        )
        for name, share in (visible or {}).items()
        if share < HARDLY_VISIBLE and name in CATALOGUE and name not in names
    ]
    return (*declared, *hidden)


def _gain(responses: Mapping[str, float], weights: Mapping[str, float], sd: float) -> float:
    pairs = combinations(responses, 2)
    # Odds beyond a few nats are worth nothing more.
    return sum(weights[i] * weights[j] * min(_nats(responses[i], responses[j], sd), ENOUGH) for i, j in pairs)


def _nats(a: float, b: float, sd: float) -> float:
    return float((a - b) ** 2 / (2.0 * sd**2))


def _separate(responses: Mapping[str, float], sd: float) -> tuple[tuple[str, ...], int]:
    """Effects that fall apart within `MOST` comparisons, and how many that takes."""
    needed = {
        pair: int(np.ceil(ENOUGH / max(_nats(responses[pair[0]], responses[pair[1]], sd), 1e-9)))
        for pair in combinations(responses, 2)
    }
    possible = {pair: n for pair, n in needed.items() if n <= MOST}
    if not possible:
        return (), 0
    names = tuple(n for n in responses if any(n in pair for pair in possible))
    return names, max(FEWEST, *possible.values())


def _sentence(setting: Setting, responses: Mapping[str, float], separated: Sequence[str], n_grasps: int) -> str:
    changes = ", ".join(f"{_title(n)} {100 * responses[n]:+.0f} %" for n in separated)
    unit = f"about {n_grasps} grasps, on {FEWEST} tools or objects" if n_grasps else "no grasps"
    words = setting.words[0].upper() + setting.words[1:]
    return f"{words}: {unit}. What each then changes: {changes}."


def _title(effect: str) -> str:
    return effect.replace("_", " ")


def _whole(effect: str, parameters: Mapping[str, float]) -> dict[str, float]:
    medians = {p.name: p.prior_median for p in CATALOGUE[effect].parameters}
    return medians | dict(parameters)
