"""Grasps that do not look like their repeats or their peers, what is wrong with them, and how sure that is (Fig. 5g).

A grasp departs if it falls short of its repeats, or of what is expected of its tool and object, by more than chance
explains and by more than matters. The kinds, their measures and limits are in docs/explanation/identification.md.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.special import stdtr, stdtrit

from fast.models.traces.against_expected import Short, grip_n, hold_against
from fast.models.traces.batch import TraceFeatures
from fast.models.traces.expected import LEAST_CELLS
from fast.models.traces.flags import KINDS, Anomaly, Compared, Kind
from fast.models.traces.names import NOISE_N, PROFILE_STEP_MM
from fast.models.units import spell_share

TURNED = "turned 45 deg"  # orientation of an object that shows an edge to each finger

LIMIT_P = 3e-4  # three false alarms of a kind in 10,000 grasps at most, if the p-values are right
SUDDEN = 1.1  # a lost object is let go as much earlier as its work is done earlier; one that slips is held on to
DONE_SHARE = 0.9  # of the work: the lift by which it is done says when an object is lost, and noise moves it little
ZERO_FREEDOM = 30.0  # a mean of noise has light tails
EJECTED_MM = 8.0  # lift within which an object that is lost was never picked up
LEAST_WORK_J = 1e-4  # whose logarithm is taken
PULLED_N = 0.3  # mean over 2 mm of lift: five standard deviations of noise, so that a free gripper does no work
HELD_ON_N = 0.15  # mean from where a loss is over to where the work is usually done; a lost object has none
LOSS_OVER = (1.15, 3.0)  # times the lift by which its work is done, and mm more: there a loss is over
STILL_HELD_N = 1.0  # a force at the end that is no drift: the trace ends before the object is free
_BIN = 60  # departures that a scale is estimated from
_MOST_BINS = 8
_TAIL = 0.05  # of all departures are excesses as far out as the one that the scale is taken from
FREEDOM = 5.0  # degrees of freedom; chosen on grasps of the virtual bench with nothing wrong


class Measure(NamedTuple):
    """What a kind is measured by: the least shortfall that matters, and the smallest scale of chance, of its unit."""

    unit: str
    least: float
    least_scale: float


MEASURES: dict[str, Measure] = {
    "grip": Measure("N", 0.5, 0.05),
    "lift": Measure("mm", 3.0, 0.3),
    "work": Measure("share", 0.1, 0.01),
    "preload": Measure("N", 0.7, 0.1),
    "zero": Measure("N", 0.15, 0.02),
}
# The least shortfalls of what is expected that matter: of ln(force + 0.5 N), and of a push in N.
LEAST_OF_EXPECTED = {"grip": 0.4, "late": 0.3, "press": 0.7}


@dataclass(frozen=True, eq=False)
class Labels:
    """Numbers of tool and object of n grasps, and whether the object is turned about z (n each)."""

    tool: np.ndarray
    object_id: np.ndarray
    is_turned: np.ndarray


@dataclass(frozen=True, eq=False)
class Evidence:
    """One measure of n grasps: p-value and shortfall, and what it was compared with."""

    p_value: np.ndarray
    shortfall: np.ndarray
    compared: Compared

    def is_flagged(self, least: float, limit_p: float) -> np.ndarray:
        """Return which of the n depart by more than chance explains, and by more than matters."""
        return np.asarray((self.p_value < limit_p) & (self.shortfall >= least))


_Found = dict[Kind, tuple[str, Evidence, np.ndarray]]  # the measure that says so, and which grasps


def find_anomalies(
    features: TraceFeatures,
    labels: Labels,
    simulated: TraceFeatures | None = None,
    limit_p: float = LIMIT_P,
    fewest: int = LEAST_CELLS,
) -> list[Anomaly]:
    """Find flags on n grasps, in their order; one kind of loss at most per grasp, beside preload and drift.

    `simulated`: of the same tools and objects, n rows, NaN where there is none; None: of none. Without repeats, and
    with fewer than `fewest` tools on objects, there is nothing to compare with but the zero.
    """
    of_repeats = evidence_of(features, labels)
    kinds = _kinds_by_repeats(features, labels, of_repeats, limit_p)
    if simulated is None:
        simulated = TraceFeatures(np.full_like(features.values, np.nan), np.zeros_like(features.profile_n))
    shorts = hold_against(features, simulated, labels.tool, labels.object_id, fewest)
    expected = _kinds_by_expectation(features, labels, shorts, of_repeats["zero"], limit_p)
    found: dict[tuple[int, Kind], Anomaly] = {}
    for part in (kinds, expected):
        for kind, (measure, evidence, is_kind) in part.items():
            for place in np.flatnonzero(is_kind).tolist():
                anomaly = _anomaly(place, kind, measure, evidence)
                others = {key[1] for key in found if key[0] == place}
                if kind not in others and not (kind in _LOSSES and others & _LOSSES):  # repeats come first
                    found[place, kind] = anomaly
    return sorted(found.values(), key=lambda anomaly: (anomaly.place, KINDS.index(anomaly.kind)))


_LOSSES: frozenset[Kind] = frozenset({"stuck_valve", "ejection", "early_loss", "torsional_slip"})


def evidence_of(features: TraceFeatures, labels: Labels) -> dict[str, Evidence]:
    """Measure how far n grasps depart from their repeats, and their end from zero, by the names in `MEASURES`."""
    evidence = {name: _evidence(name, values, features, labels) for name, values in _values(features).items()}
    return {**evidence, "zero": _zero_evidence(features)}


def _values(features: TraceFeatures) -> dict[str, np.ndarray]:
    """Return the measures of n grasps that fall when something is wrong."""
    work_j = np.maximum(features.column("work_j"), LEAST_WORK_J)
    return {
        "grip": grip_n(features),
        "lift": _done_mm(features.profile_n),
        "work": np.log(work_j),
        "preload": features.column("initial_force_n"),
    }


def _done_mm(profile_n: np.ndarray) -> np.ndarray:
    """Lift (n) by which `DONE_SHARE` of the work of forces above `PULLED_N` is done, from profiles; 0 without any."""
    pulled = np.where(profile_n > PULLED_N, profile_n, 0.0)
    done = np.column_stack([np.zeros(len(pulled)), pulled.cumsum(axis=1)])
    wanted = DONE_SHARE * done[:, -1]
    after = np.maximum((done < wanted[:, None]).sum(axis=1), 1)
    rows = np.arange(len(pulled))
    before_n, in_step_n = done[rows, after - 1], np.maximum(pulled[rows, after - 1], 1e-9)
    return np.asarray(PROFILE_STEP_MM * (after - 1 + np.clip((wanted - before_n) / in_step_n, 0.0, 1.0)))


def _rest_n(features: TraceFeatures, shortfall_mm: np.ndarray) -> np.ndarray:
    """Average the force (n) from where a loss would be over to where work is usually done; 0 if that is not later."""
    middle_mm = PROFILE_STEP_MM * (np.arange(features.profile_n.shape[1]) + 0.5)
    done_mm = _done_mm(features.profile_n)
    begin_mm, end_mm = LOSS_OVER[0] * done_mm + LOSS_OVER[1], done_mm + shortfall_mm
    is_within = (middle_mm >= begin_mm[:, None]) & (middle_mm <= end_mm[:, None])
    return np.asarray((features.profile_n * is_within).sum(axis=1) / np.maximum(is_within.sum(axis=1), 1))


def _evidence(name: str, values: np.ndarray, features: TraceFeatures, labels: Labels) -> Evidence:
    shortfall = _to_repeats(values, labels)
    level = np.abs(values) if name in ("grip", "preload") else features.column("peak_force_n")
    # Times two, since a grasp is held against what is expected as well.
    p = np.minimum(2.0 * np.nan_to_num(p_values(shortfall, level, MEASURES[name].least_scale), nan=0.5), 1.0)
    if name == "work":  # from a difference of logarithms
        shortfall = -np.expm1(-shortfall)
    return Evidence(p, np.nan_to_num(shortfall), "repeats")


def _to_repeats(values: np.ndarray, labels: Labels) -> np.ndarray:
    return shortfall_to_repeats(values, labels.tool * (int(labels.object_id.max()) + 1) + labels.object_id)


def _zero_evidence(features: TraceFeatures) -> Evidence:
    """Return how far the force at the end of the lift is from zero, where it should be."""
    rest_n = features.column("end_force_n").copy()
    rest_n[np.abs(rest_n) > STILL_HELD_N] = np.nan
    no_level, least = np.zeros(len(rest_n)), MEASURES["zero"].least_scale
    p = np.fmin(*(p_values(sign * rest_n, no_level, least, ZERO_FREEDOM) for sign in (1.0, -1.0)))
    p = np.minimum(np.nan_to_num(2.0 * p, nan=1.0), 1.0)
    return Evidence(p, np.nan_to_num(np.abs(rest_n)), "zero")


def _separation_mm(features: TraceFeatures) -> np.ndarray:
    return np.nan_to_num(features.column("separation_lift_mm"), nan=0.0)


def _kinds_by_repeats(features: TraceFeatures, labels: Labels, evidence: dict[str, Evidence], limit_p: float) -> _Found:
    """Find which grasps are of each kind beside their repeats; a drift or an earlier loss explains later ones."""
    flagged = {name: found.is_flagged(MEASURES[name].least, limit_p) for name, found in evidence.items()}
    let_go_mm = np.nan_to_num(_to_repeats(_separation_mm(features), labels))
    is_sudden = evidence["lift"].shortfall <= SUDDEN * let_go_mm
    is_held_on = labels.is_turned & (_rest_n(features, evidence["lift"].shortfall) > HELD_ON_N)
    has_no_grip = flagged["grip"] & (grip_n(features) < NOISE_N)
    is_explained = has_no_grip | flagged["zero"]
    is_lost = flagged["lift"] & is_sudden & ~is_held_on & ~is_explained
    is_slip = flagged["work"] & labels.is_turned & ~is_lost & ~is_explained
    is_ejected = is_lost & (_done_mm(features.profile_n) < EJECTED_MM)
    presses = flagged["preload"] & (features.column("initial_force_n") < -NOISE_N)
    return {
        "stuck_valve": ("grip", evidence["grip"], has_no_grip),
        "ejection": ("lift", evidence["lift"], is_ejected),
        "early_loss": ("lift", evidence["lift"], is_lost & ~is_ejected),
        "torsional_slip": ("work", evidence["work"], is_slip),
        "negative_preload": ("preload", evidence["preload"], presses),
        "drifting_cell": ("zero", evidence["zero"], flagged["zero"]),
    }


def _kinds_by_expectation(
    features: TraceFeatures, labels: Labels, shorts: dict[str, Short], zero: Evidence, limit_p: float
) -> _Found:
    """Find the same beside what is expected of the tool on the object."""
    evidence = {name: Evidence(short.p_value, short.shortfall, "expected") for name, short in shorts.items()}
    flagged = {name: found.is_flagged(LEAST_OF_EXPECTED[name], limit_p) for name, found in evidence.items()}
    has_no_grip = flagged["grip"] & (grip_n(features) < NOISE_N)
    is_drift = zero.is_flagged(MEASURES["zero"].least, limit_p)
    is_short = flagged["late"] & ~has_no_grip & ~is_drift
    is_held_on = shorts["late"].measured_n > HELD_ON_N
    is_lost = is_short & ~is_held_on
    is_ejected = is_lost & (_done_mm(features.profile_n) < EJECTED_MM)
    presses = flagged["press"] & (features.column("initial_force_n") < -NOISE_N) & ~has_no_grip
    return {
        "stuck_valve": ("grip", evidence["grip"], has_no_grip),
        "ejection": ("late", evidence["late"], is_ejected),
        "early_loss": ("late", evidence["late"], is_lost & ~is_ejected),
        "torsional_slip": ("late", evidence["late"], is_short & is_held_on & labels.is_turned),
        "negative_preload": ("press", evidence["press"], presses),
    }


_SENTENCES: dict[Kind, str] = {
    "stuck_valve": "no force shows that the gripper closed: {value:.1f} N less than {others}",
    "ejection": "the object is lost at the start of the lift, {value:.0f} mm earlier than {others}",
    "early_loss": "the object is lost {value:.0f} mm of lift earlier than {others}",
    "torsional_slip": "the fingers slip off the edge of a turned object: {percent} less work than {others}",
    "negative_preload": "the fingers press the object down {value:.1f} N harder than {others}",
    "drifting_cell": "the gripper hangs free at the end of the lift and reads {value:.2f} N",
}
_OTHERS = "in its repeats"
_BESIDE_EXPECTED: dict[Kind, str] = {
    "stuck_valve": "no force shows that the gripper closed, {percent} less than expected of this tool and object",
    "ejection": "the object is lost at the start of the lift, where this tool and object are expected to hold it",
    "early_loss": "the object is lost where this tool and object are expected to hold it",
    "torsional_slip": "the fingers slip off the edge of a turned object: {percent} less force late in the lift than "
    "expected of this tool and object",
    "negative_preload": "the fingers press the object down {value:.1f} N harder than expected of this tool and object",
}


def _anomaly(place: int, kind: Kind, measure: str, evidence: Evidence) -> Anomaly:
    value, p = float(evidence.shortfall[place]), float(evidence.p_value[place])
    if evidence.compared == "expected":
        share = -float(np.expm1(-value))
        value = value if measure == "press" else share
        reason = _BESIDE_EXPECTED[kind].format(value=value, percent=spell_share(share))
    else:
        reason = _SENTENCES[kind].format(value=value, percent=spell_share(value), others=_OTHERS)
    return Anomaly(place, kind, p, evidence.compared, value, reason)


def shortfall_to_repeats(values: np.ndarray, group: np.ndarray) -> np.ndarray:
    """Return how much less each of n values is than the nearest of its repeats, of the same `group`; NaN: it has none.

    The nearest, so that of three repeats the odd one departs and the other two do not.
    """
    order = np.argsort(group, kind="stable")
    edges = np.flatnonzero(np.diff(group[order])) + 1
    found = np.full(len(values), np.nan)
    for places in np.split(order, edges):
        if len(places) < 2:
            continue
        gaps = values[places][None, :] - values[places][:, None]
        np.fill_diagonal(gaps, np.inf)
        found[places] = gaps[np.arange(len(places)), np.abs(gaps).argmin(axis=1)]
    return found


def p_values(shortfalls: np.ndarray, level: np.ndarray, least_scale: float, freedom: float = FREEDOM) -> np.ndarray:
    """Return the probability (n) that a shortfall as large, or larger, comes by chance; NaN where there is none.

    Chance is as likely to give an excess, and nothing that goes wrong does: the excesses among the n say how far chance
    goes. Over their scale, which may depend on `level`, shortfalls are taken to follow a t-distribution.

    Args:
        shortfalls: n, of one unit; positive is suspicious.
        level: n, what their scale may depend on, such as the force.
        least_scale: of the shortfalls' unit; what is smaller is not told apart.
        freedom: degrees of freedom of the t-distribution; fewer, heavier tails.
    """
    found, is_known = np.full(len(shortfalls), np.nan), np.isfinite(shortfalls)
    if is_known.sum() < _BIN:
        return found
    scale = _scale(shortfalls[is_known], level[is_known], freedom)
    found[is_known] = stdtr(freedom, -shortfalls[is_known] / np.maximum(scale, least_scale))
    return found


def _scale(shortfalls: np.ndarray, level: np.ndarray, freedom: float) -> np.ndarray:
    """Scale at each of n: of the excesses in its bin of like level, linear between the middles of bins."""
    n_bins = int(np.clip(len(shortfalls) // _BIN, 1, _MOST_BINS))
    parts = np.array_split(np.argsort(level, kind="stable"), n_bins)
    middles = np.array([np.median(level[part]) for part in parts])
    far = stdtrit(freedom, 1.0 - _TAIL)
    scales = np.array([np.quantile(-np.minimum(shortfalls[part], 0.0), 1.0 - _TAIL) / far for part in parts])
    return np.interp(level, middles, scales)
