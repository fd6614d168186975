"""Grasps that do not look like their repeats or their peers, what is wrong with them, and how sure that is (Fig. 5g).

A grasp departs if it falls short of its repeats, or of what its tool and object lead to expect, by more than chance
explains and by more than matters. The kinds, their measures and limits are in docs/identification.md.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal, NamedTuple, get_args

import numpy as np

from models.features.batch import TraceFeatures
from models.features.departures import p_values, shortfall_to_peers, shortfall_to_repeats
from models.features.names import NOISE_N, PROFILE_STEP_MM

Kind = Literal["stuck_valve", "ejection", "early_loss", "torsional_slip", "negative_preload", "drifting_cell"]
KINDS: tuple[Kind, ...] = get_args(Kind)
Compared = Literal["repeats", "peers", "zero"]

LIMIT_P = 3e-4  # three false alarms of a kind in 10,000 grasps at most, if the p-values are right
DONE_SHARE = 0.9  # of the work: the lift by which it is done says when an object is lost, and noise moves it little
EJECTED_MM = 8.0  # lift within which an object that is lost was never picked up
PULLED_N = 0.3  # mean over 2 mm of lift: five standard deviations of noise, so that a free gripper does no work
STILL_HELD_N = 1.0  # a force at the end that is no drift: the trace ends before the object is free


class Measure(NamedTuple):
    """What a kind is measured by: its least shortfall that matters, and the smallest scale of chance, of its unit."""

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


class Anomaly(NamedTuple):
    """A flag on grasp number `place`: its p-value, the shortfall behind it (of the measure's unit), and why."""

    place: int
    kind: Kind
    p_value: float
    compared: Compared
    shortfall: float
    reason: str


@dataclass(frozen=True, eq=False)
class Labels:
    """Which tool and object (numbers, n) each of n grasps was made with; repeats share both. `is_turned`: see reason."""

    tool: np.ndarray
    object_id: np.ndarray
    is_turned: np.ndarray


@dataclass(frozen=True, eq=False)
class Evidence:
    """One measure of n grasps: p-value, what it was compared with (index into `Compared`), and the shortfall."""

    p_value: np.ndarray
    is_of_repeats: np.ndarray
    shortfall: np.ndarray

    def is_flagged(self, measure: Measure, limit_p: float) -> np.ndarray:
        """Which of the n depart by more than chance explains, and by more than matters."""
        return (self.p_value < limit_p) & (self.shortfall >= measure.least)


def find_anomalies(features: TraceFeatures, labels: Labels, limit_p: float = LIMIT_P) -> list[Anomaly]:
    """Flags on n grasps, in their order; one kind of loss at most per grasp, beside preload and drift.

    Without repeats and without three tools and objects there is nothing to compare with but the zero.
    """
    evidence = {name: _evidence(name, values, features, labels) for name, values in _values(features).items()}
    evidence["zero"] = _zero_evidence(features)
    flagged = {name: found.is_flagged(MEASURES[name], limit_p) for name, found in evidence.items()}
    kinds = _kinds(features, labels, flagged)
    found = [
        _anomaly(place, kind, measure, evidence[measure])
        for kind, (measure, is_kind) in kinds.items()
        for place in np.flatnonzero(is_kind).tolist()
    ]
    return sorted(found, key=lambda anomaly: (anomaly.place, KINDS.index(anomaly.kind)))


def _values(features: TraceFeatures) -> dict[str, np.ndarray]:
    """The measures of n grasps that fall when something is wrong."""
    work_j, peak_n = np.maximum(features.column("work_j"), 1e-4), features.column("peak_force_n")
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


def _evidence(name: str, values: np.ndarray, features: TraceFeatures, labels: Labels) -> Evidence:
    """The stronger of both comparisons, paid for with a factor of two."""
    group = labels.tool * (int(labels.object_id.max()) + 1) + labels.object_id
    of_repeats = shortfall_to_repeats(values, group)
    of_peers = shortfall_to_peers(values, labels.tool, labels.object_id)
    level = np.abs(values) if name in ("grip", "preload") else features.column("peak_force_n")
    p_repeats, p_peers = (
        np.nan_to_num(p_values(shortfalls, level, MEASURES[name].least_scale), nan=1.0)
        for shortfalls in (of_repeats, of_peers)
    )
    is_of_repeats = p_repeats <= p_peers
    shortfall = np.where(is_of_repeats, of_repeats, of_peers)
    if name == "work":  # from a difference of logarithms
        shortfall = -np.expm1(-shortfall)
    return Evidence(np.minimum(2.0 * np.minimum(p_repeats, p_peers), 1.0), is_of_repeats, np.nan_to_num(shortfall))


def _zero_evidence(features: TraceFeatures) -> Evidence:
    """How far the force at the end of the lift is from zero, where it should be."""
    rest_n = np.abs(features.column("end_force_n"))
    rest_n[rest_n > STILL_HELD_N] = np.nan
    p = np.nan_to_num(2.0 * p_values(rest_n, np.zeros(len(rest_n)), MEASURES["zero"].least_scale), nan=1.0)
    return Evidence(np.minimum(p, 1.0), np.zeros(len(rest_n), dtype=bool), np.nan_to_num(rest_n))


def _kinds(
    features: TraceFeatures, labels: Labels, flagged: dict[str, np.ndarray]
) -> dict[Kind, tuple[str, np.ndarray]]:
    """Which grasps are of each kind, and the measure that says so. Of the losses the earlier explains the later ones."""
    has_no_grip = flagged["grip"] & (_grip_n(features) < NOISE_N)
    lift_mm = _done_mm(features.profile_n)
    is_lost = flagged["lift"] & ~has_no_grip
    is_slip = flagged["work"] & ~has_no_grip & ~is_lost & labels.is_turned
    presses = flagged["preload"] & (features.column("initial_force_n") < -NOISE_N)
    return {
        "stuck_valve": ("grip", has_no_grip),
        "ejection": ("lift", is_lost & (lift_mm < EJECTED_MM)),
        "early_loss": ("lift", is_lost & (lift_mm >= EJECTED_MM)),
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


def count_by_kind(found: list[Anomaly]) -> Iterator[tuple[Kind, int]]:
    """Flags of each kind, in the order of `KINDS`."""
    for kind in KINDS:
        yield kind, sum(anomaly.kind == kind for anomaly in found)
