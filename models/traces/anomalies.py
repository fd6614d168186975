"""Grasps that do not look like their repeats or their peers, what is wrong with them, and how sure that is (Fig. 5g).

A grasp departs if it falls short of its repeats, or of what its tool and object lead to expect, by more than chance
explains and by more than matters. The kinds, their measures and limits are in docs/explanation/identification.md.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from fast.models.traces.batch import TraceFeatures
from fast.models.traces.departures import p_values, shortfall_to_peers, shortfall_to_repeats
from fast.models.traces.flags import KINDS, Anomaly, Compared, Kind
from fast.models.traces.names import NOISE_N, PROFILE_STEP_MM

TURNED = "turned 45 deg"  # orientation of an object that shows an edge to each finger

LIMIT_P = 3e-4  # three false alarms of a kind in 10,000 grasps at most, if the p-values are right
SUDDEN = 1.1  # a lost object is let go as much earlier as its work is done earlier; one that slips is held on to
DONE_SHARE = 0.9  # of the work: the lift by which it is done says when an object is lost, and noise moves it little
PEERS_FREEDOM = 3.0  # a tool has its own way with an object
ZERO_FREEDOM = 30.0  # a mean of noise has light tails
EJECTED_MM = 8.0  # lift within which an object that is lost was never picked up
LEAST_WORK_J = 1e-4  # whose logarithm is taken
PULLED_N = 0.3  # mean over 2 mm of lift: five standard deviations of noise, so that a free gripper does no work
HELD_ON_N = 0.15  # mean from where a loss is over to where the work is usually done; a lost object has none
LOSS_OVER = (1.15, 3.0)  # times the lift by which its work is done, and mm more: there a loss is over
STILL_HELD_N = 1.0  # a force at the end that is no drift: the trace ends before the object is free


class Measure(NamedTuple):
    """What a kind is measured by: the least shortfalls that matter, and the smallest scale of chance, of its unit.

    `least_of_peers` None: not compared with peers, whose own ways with an object would pass for faults.
    """

    unit: str
    least: float
    least_of_peers: float | None
    least_scale: float


MEASURES: dict[str, Measure] = {
    "grip": Measure("N", 0.5, 3.0, 0.05),
    "lift": Measure("mm", 3.0, 10.0, 0.3),
    "work": Measure("share", 0.1, 0.5, 0.01),
    "preload": Measure("N", 0.7, None, 0.1),
    "zero": Measure("N", 0.15, None, 0.02),
}


@dataclass(frozen=True, eq=False)
class Labels:
    """Numbers of tool and object of n grasps, and whether the object is turned about z (n each)."""

    tool: np.ndarray
    object_id: np.ndarray
    is_turned: np.ndarray


@dataclass(frozen=True, eq=False)
class Evidence:
    """One measure of n grasps: p-value, whether it is against repeats or peers, shortfall; p against repeats alone."""

    p_value: np.ndarray
    is_of_repeats: np.ndarray
    shortfall: np.ndarray
    p_of_repeats: np.ndarray

    def is_flagged(self, measure: Measure, limit_p: float) -> np.ndarray:
        """Which of the n depart by more than chance explains, and by more than matters."""
        least = np.where(self.is_of_repeats, measure.least, measure.least_of_peers or measure.least)
        return np.asarray((self.p_value < limit_p) & (self.shortfall >= least))


def find_anomalies(features: TraceFeatures, labels: Labels, limit_p: float = LIMIT_P) -> list[Anomaly]:
    """Flags on n grasps, in their order; one kind of loss at most per grasp, beside preload and drift.

    Without repeats and without three tools and objects there is nothing to compare with but the zero.
    """
    evidence = evidence_of(features, labels)
    flagged = {name: found.is_flagged(MEASURES[name], limit_p) for name, found in evidence.items()}
    is_sudden = evidence["lift"].shortfall <= SUDDEN * _shortfalls_like(
        evidence["lift"], _separation_mm(features), labels
    )
    is_held_on = labels.is_turned & (_rest_n(features, evidence["lift"].shortfall) > HELD_ON_N)
    kinds = _kinds(features, labels, flagged, is_sudden & ~is_held_on)
    found = [
        _anomaly(place, kind, measure, evidence[measure])
        for kind, (measure, is_kind) in kinds.items()
        for place in np.flatnonzero(is_kind).tolist()
    ]
    return sorted(found, key=lambda anomaly: (anomaly.place, KINDS.index(anomaly.kind)))


def evidence_of(features: TraceFeatures, labels: Labels) -> dict[str, Evidence]:
    """How far n grasps depart, by the names in `MEASURES`."""
    evidence = {name: _evidence(name, values, features, labels) for name, values in _values(features).items()}
    return {**evidence, "zero": _zero_evidence(features)}


def _values(features: TraceFeatures) -> dict[str, np.ndarray]:
    """The measures of n grasps that fall when something is wrong."""
    work_j = np.maximum(features.column("work_j"), LEAST_WORK_J)
    return {
        "grip": _grip_n(features),
        "lift": _done_mm(features.profile_n),
        "work": np.log(work_j),
        "preload": features.column("initial_force_n"),
    }


def _grip_n(features: TraceFeatures) -> np.ndarray:
    """Largest force, of either sign, that shows that the gripper closed, before 2 mm of lift."""
    shown = [features.column(name) for name in ("initial_force_n", "closing_lowest_n")]
    return np.asarray(np.max(np.abs([*shown, features.profile_n[:, 0]]), axis=0))


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
    """Mean force (n) from where a loss would be over to where the work is usually done; 0 where that is not later."""
    middle_mm = PROFILE_STEP_MM * (np.arange(features.profile_n.shape[1]) + 0.5)
    done_mm = _done_mm(features.profile_n)
    begin_mm, end_mm = LOSS_OVER[0] * done_mm + LOSS_OVER[1], done_mm + shortfall_mm
    is_within = (middle_mm >= begin_mm[:, None]) & (middle_mm <= end_mm[:, None])
    return np.asarray((features.profile_n * is_within).sum(axis=1) / np.maximum(is_within.sum(axis=1), 1))


def _evidence(name: str, values: np.ndarray, features: TraceFeatures, labels: Labels) -> Evidence:
    """The stronger of both comparisons, paid for with a factor of two."""
    of_repeats, of_peers = _shortfalls(values, labels)
    level = np.abs(values) if name in ("grip", "preload") else features.column("peak_force_n")
    least_scale = MEASURES[name].least_scale
    p_repeats = np.nan_to_num(p_values(of_repeats, level, least_scale), nan=1.0)
    if MEASURES[name].least_of_peers is None:
        return Evidence(p_repeats, np.ones(len(values), dtype=bool), np.nan_to_num(of_repeats), p_repeats)
    p_peers = np.nan_to_num(p_values(of_peers, level, least_scale, PEERS_FREEDOM), nan=1.0)
    is_of_repeats = p_repeats <= p_peers
    shortfall = np.where(is_of_repeats, of_repeats, of_peers)
    if name == "work":  # from a difference of logarithms
        shortfall = -np.expm1(-shortfall)
    p = np.minimum(2.0 * np.minimum(p_repeats, p_peers), 1.0)
    return Evidence(p, is_of_repeats, np.nan_to_num(shortfall), p_repeats)


def _shortfalls(values: np.ndarray, labels: Labels) -> tuple[np.ndarray, np.ndarray]:
    """Against repeats and against peers (n each)."""
    group = labels.tool * (int(labels.object_id.max()) + 1) + labels.object_id
    return shortfall_to_repeats(values, group), shortfall_to_peers(values, labels.tool, labels.object_id)


def _zero_evidence(features: TraceFeatures) -> Evidence:
    """How far the force at the end of the lift is from zero, where it should be."""
    rest_n = features.column("end_force_n").copy()
    rest_n[np.abs(rest_n) > STILL_HELD_N] = np.nan
    no_level, least = np.zeros(len(rest_n)), MEASURES["zero"].least_scale
    p = np.fmin(*(p_values(sign * rest_n, no_level, least, ZERO_FREEDOM) for sign in (1.0, -1.0)))
    p = np.minimum(np.nan_to_num(2.0 * p, nan=1.0), 1.0)
    return Evidence(p, np.zeros(len(rest_n), dtype=bool), np.nan_to_num(np.abs(rest_n)), p)


def _separation_mm(features: TraceFeatures) -> np.ndarray:
    return np.nan_to_num(features.column("separation_lift_mm"), nan=0.0)


def _shortfalls_like(evidence: Evidence, values: np.ndarray, labels: Labels) -> np.ndarray:
    """Shortfalls (n) of other values, against the repeats or the peers that the evidence is against."""
    return np.nan_to_num(np.where(evidence.is_of_repeats, *_shortfalls(values, labels)))


def _kinds(
    features: TraceFeatures, labels: Labels, flagged: dict[str, np.ndarray], is_sudden: np.ndarray
) -> dict[Kind, tuple[str, np.ndarray]]:
    """Which grasps are of each kind, and the measure that says so; a drift or an earlier loss explains later ones."""
    has_no_grip = flagged["grip"] & (_grip_n(features) < NOISE_N)
    is_explained = has_no_grip | flagged["zero"]
    is_lost = flagged["lift"] & is_sudden & ~is_explained
    is_slip = flagged["work"] & labels.is_turned & ~is_lost & ~is_explained
    is_ejected = is_lost & (_done_mm(features.profile_n) < EJECTED_MM)
    presses = flagged["preload"] & (features.column("initial_force_n") < -NOISE_N)
    return {
        "stuck_valve": ("grip", has_no_grip),
        "ejection": ("lift", is_ejected),
        "early_loss": ("lift", is_lost & ~is_ejected),
        "torsional_slip": ("work", is_slip),
        "negative_preload": ("preload", presses),
        "drifting_cell": ("zero", flagged["zero"]),
    }


_SENTENCES: dict[Kind, str] = {
    "stuck_valve": "no force shows that the gripper closed: {value:.1f} N less than {others}",
    "ejection": "the object is lost at the start of the lift, {value:.0f} mm earlier than {others}",
    "early_loss": "the object is lost {value:.0f} mm of lift earlier than {others}",
    "torsional_slip": "the fingers slip off the edge of a turned object: {value:.0%} less work than {others}",
    "negative_preload": "the fingers press the object down {value:.1f} N harder than {others}",
    "drifting_cell": "the gripper hangs free at the end of the lift and reads {value:.2f} N",
}
_OTHERS: dict[Compared, str] = {"repeats": "in its repeats", "peers": "expected of this tool and object", "zero": ""}


def _anomaly(place: int, kind: Kind, measure: str, evidence: Evidence) -> Anomaly:
    compared: Compared = "repeats" if evidence.is_of_repeats[place] else "peers"
    if measure == "zero":
        compared = "zero"
    value = float(evidence.shortfall[place])
    reason = _SENTENCES[kind].format(value=value, others=_OTHERS[compared])
    return Anomaly(place, kind, float(evidence.p_value[place]), compared, value, reason)
