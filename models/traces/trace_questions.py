"""What is strange in traces that a person tells, beside what the simulator expects of each tool and object.

A fault of the whole file shows in all traces alike: no force at all, forces that end before the object is free, two
channels exchanged, a zero that was not taken. A fault of a cell, a tool on an object, shows in more than half of its
repeats, and is found as `anomalies` finds those of a gantry.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from fast.models.question import Kind, Question
from fast.models.records import Trace
from fast.models.traces import flags
from fast.models.traces.anomalies import STILL_HELD_N, Labels, find_anomalies
from fast.models.traces.batch import TraceFeatures, features_of
from fast.models.traces.names import NOISE_N
from fast.models.units import spell_number

LIMIT_P = 1e-4  # of one trace; a question needs more than half of a cell's repeats
FEWEST_CELLS = 8
_MOST = 0.7  # of the traces of a file, that a cut of the whole file shows in
_NO_GRIP = 0.5  # of them, that hold no force: of a valve that sticks some let go late
_NO_FORCE = 0.12  # of the expected peak: nothing was gripped
_LEAST_EXPECTED_N = 1.5  # of a peak that would be seen
_STILL_HELD = 0.5  # of the peak, at the end: the trace was cut
_LAST = 0.03  # of the samples, that say how a trace ends
_EARLY = 0.82  # of the lift at which the object is expected to be free, in the middle: of sound files 1.02 to 1.07
_EXCHANGE_SD = 0.5  # of ln peak and of ln lift at the peak, about the simulator
_EXCHANGE_NATS = 6.0
_EVEN = 0.005  # of its range, that a lift at constant speed departs from a straight line over time
_ZERO_N = 0.4  # a force with the object free that is no noise
_ZERO_SPREAD = 0.3  # of that force, from trace to trace
_LEAST_VALUES = 50  # different forces, of which two traces with all of them are one
_LEAST_FLAT = 12  # samples in a row at the largest force
_MOST_EQUAL = (
    0.2  # of the other samples, that are as the one before: with more the channel is coarse, and tops are flat
)
_TOP = 0.9  # of the largest amount, that a channel that wraps around shows of either sign
_OF_CELLS: dict[flags.Kind, Kind] = {
    "stuck_valve": "no grip", "ejection": "lost early", "early_loss": "lost early", "negative_preload": "pressed down",
}  # fmt: skip


class ToldTrace(NamedTuple):
    """One trace of a file: where it stands, its cell, whether the object is turned, and what is expected, if known."""

    place: str
    tool: str
    object_id: int
    is_turned: bool
    trace: Trace
    expected: Trace | None = None


def find_trace_questions(told: Sequence[ToldTrace]) -> list[Question]:
    """Find questions about traces of one file, by position."""
    if not told:
        return []
    measured = features_of([one.trace for one in told])
    expected = features_of([one.expected for one in told])
    whole = _ask_of_file(told, measured, expected)
    if whole is not None:
        return [whole]
    found = [*_find_doubles(told), *_find_saturated(told), *_find_cut(told)]
    return found + _ask_of_cells(told, measured, expected, {number for one in found for number in one.numbers})


def _find_doubles(told: Sequence[ToldTrace]) -> list[Question]:
    """Find traces with the very samples of another: one file under two names. No two pulls have the same noise."""
    found, first = [], dict[bytes, int]()
    for number, one in enumerate(told):
        before = first.setdefault(one.trace.force_n.tobytes(), number)
        if before != number and len(np.unique(one.trace.force_n)) >= _LEAST_VALUES:
            sentence = f"{one.place}: {_name(one)} has the samples of {told[before].place}, one file under two names?"
            found.append(Question("told twice", sentence, (number,)))
    return found


def _find_saturated(told: Sequence[ToldTrace]) -> list[Question]:
    """Find traces that stand still at their largest force, or leap from it to the largest negative one."""
    found = []
    for number, one in enumerate(told):
        force_n, most_n = one.trace.force_n, float(one.trace.force_n.max(initial=0.0))
        is_top = np.abs(force_n) >= _TOP * float(np.abs(force_n).max(initial=0.0))
        leaps = is_top[:-1] & is_top[1:] & (force_n[:-1] > NOISE_N) & (force_n[1:] < -NOISE_N)
        flat = _longest_run(force_n == most_n) if most_n > NOISE_N else 0
        others_n = force_n[(force_n > NOISE_N) & (force_n < most_n)]
        is_fine = float((np.diff(others_n) == 0.0).mean()) < _MOST_EQUAL if len(others_n) > 1 else False
        if leaps.any():
            words = f"leaps from {spell_number(most_n, 3)} N to as much below 0, beyond what the channel can show?"
        elif flat >= _LEAST_FLAT and is_fine:
            words = f"stands at {spell_number(most_n, 3)} N over {flat} samples, the end of the load cell's range?"
        else:
            continue
        found.append(Question("saturated", f"{one.place}: {_name(one)} {words}", (number,)))
    return found


def _longest_run(is_there: np.ndarray) -> int:
    """Count the most samples in a row for which it is so."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], is_there, [False]]).astype(int)))
    return int(np.max(edges[1::2] - edges[::2], initial=0))


def _ask_of_file(told: Sequence[ToldTrace], measured: TraceFeatures, expected: TraceFeatures) -> Question | None:
    """Ask about a fault that most traces of the file show."""
    every = tuple(range(len(told)))
    peak_n, wanted_n = measured.column("peak_force_n"), expected.column("peak_force_n")
    is_seen = measured.is_usable & (wanted_n > _LEAST_EXPECTED_N)
    ends_n = np.array([_end_n(one.trace) for one in told])
    if is_seen.sum() >= 3:
        if (peak_n[is_seen] < np.maximum(_NO_FORCE * wanted_n[is_seen], NOISE_N)).mean() > _NO_GRIP:
            usual_n = spell_number(float(np.median(wanted_n[is_seen])), 3)
            text = f"{is_seen.sum()} traces hold no force where {usual_n} N are expected"
            return Question("no grip", f"{text}, a valve that stuck, or another channel?", every)
    if (question := _ask_of_axes(told, is_seen)) is not None:
        return question
    zero_n = float(np.median(ends_n))
    starts_n = np.array(
        [float(np.median(one.trace.force_n[:3])) for one in told]
    )  # a held object shows at the end alone
    spread_n = 1.4826 * float(np.median(np.abs(np.concatenate([starts_n, ends_n]) - zero_n)))
    if len(told) >= 3 and abs(zero_n) > max(_ZERO_N, spread_n / _ZERO_SPREAD):
        text = f"forces end at {spell_number(zero_n)} N with the object free, a zero that was not taken?"
        return Question("zero", f"{text} Take {spell_number(zero_n)} N off all of them", every)
    is_cut = np.array([_is_cut(one.trace, end_n) for one, end_n in zip(told, ends_n, strict=True)])
    if len(told) >= 3 and is_cut.mean() > _MOST:
        return Question("cut off", f"{is_cut.sum()} of {len(told)} traces {_say_cut(told, is_cut, ends_n)}", every)
    free_mm, wanted_mm = measured.column("separation_lift_mm"), expected.column("separation_lift_mm")
    is_freed = is_seen & np.isfinite(free_mm) & np.isfinite(wanted_mm)
    if is_freed.sum() >= 3 and np.median(free_mm[is_freed] / wanted_mm[is_freed]) < _EARLY:
        text = f"objects are free at {spell_number(np.median(free_mm[is_freed]), 3)} mm of lift"
        text += f", {spell_number(np.median(wanted_mm[is_freed]), 3)} mm are expected"
        return Question("lost early", f"{text}: lost early, a lift in another unit, or a start that was cut?", every)
    return None


def _ask_of_axes(told: Sequence[ToldTrace], is_seen: np.ndarray) -> Question | None:
    """Lift and force exchanged: what is told as force grows evenly with time, or is as large as the lift should be."""
    every = tuple(range(len(told)))
    if len(told) >= 3 and np.mean([_is_even(one.trace) for one in told]) > _MOST:
        return Question(
            "exchanged axes", "forces grow evenly with time and lifts do not: force and lift exchanged?", every
        )
    if is_seen.sum() < 3:
        return None
    told_at = np.log(np.maximum([_peak(one.trace) for one in told], 1e-3))
    wanted = np.log(np.maximum([_peak(one.expected) for one in told], 1e-3))
    part = np.flatnonzero(is_seen)
    as_told = ((told_at[part] - wanted[part]) ** 2).sum(axis=1)
    exchanged = ((told_at[part][:, ::-1] - wanted[part]) ** 2).sum(axis=1)
    gain = float(np.median(as_told - exchanged)) * min(len(part), 4) / (2 * _EXCHANGE_SD**2)
    if gain <= _EXCHANGE_NATS or np.median(exchanged) > (2 * _EXCHANGE_SD) ** 2:
        return None
    force, lift = np.exp(np.median(told_at[part], axis=0))
    wanted_n, wanted_mm = np.exp(np.median(wanted[part], axis=0))
    text = f"peaks are {spell_number(force, 3)} N at {spell_number(lift, 3)} mm, expected are "
    text += f"{spell_number(wanted_n, 3)} N at {spell_number(wanted_mm, 3)} mm"
    return Question("exchanged axes", f"{text}: force and lift exchanged?", every)


def _is_even(trace: Trace) -> bool:
    """Return whether the force is as a lift at constant speed, and the lift is not."""
    return _unevenness(trace, trace.force_n) < _EVEN < 0.5 * _unevenness(trace, trace.lift_mm)


def _unevenness(trace: Trace, channel: np.ndarray) -> float:
    """Return the scatter of a channel about a straight line over time, as a share of its range."""
    line = np.polyval(np.polyfit(trace.time_s, channel, 1), trace.time_s)
    return float(np.std(channel - line)) / max(float(np.ptp(channel)), 1e-9)


def _peak(trace: Trace | None) -> tuple[float, float]:
    """Find the largest force, N, and the lift at which it is, mm."""
    if trace is None:
        return 1.0, 1.0
    place = int(trace.force_n.argmax())
    return float(trace.force_n[place]), float(trace.lift_mm[place])


def _end_n(trace: Trace) -> float:
    n = max(round(_LAST * len(trace.force_n)), 3)
    return float(np.median(trace.force_n[-n:]))


def _is_cut(trace: Trace, end_n: float) -> bool:
    return end_n > max(STILL_HELD_N, _STILL_HELD * float(trace.force_n.max()))


def _say_cut(told: Sequence[ToldTrace], is_cut: np.ndarray, ends_n: np.ndarray) -> str:
    lift_mm = np.median([one.trace.lift_mm.max() for one, cut in zip(told, is_cut, strict=True) if cut])
    return (
        f"end at {spell_number(lift_mm, 3)} mm with {spell_number(np.median(ends_n[is_cut]), 3)} N still held, cut off?"
    )


def _find_cut(told: Sequence[ToldTrace]) -> list[Question]:
    ends_n = np.array([_end_n(one.trace) for one in told])
    is_cut = np.array([_is_cut(one.trace, end_n) for one, end_n in zip(told, ends_n, strict=True)])
    found = []
    for cell in _cells(told):
        cut = [number for number in cell if is_cut[number]]
        if 2 * len(cut) > len(cell):
            mask = np.isin(np.arange(len(told)), cut)
            sentence = f"{told[cut[0]].place}: {_name(told[cut[0]])} {_say_cut(told, mask, ends_n)}"
            found.append(Question("cut off", sentence.replace(" end at ", " ends at "), tuple(cut)))
    return found


def _ask_of_cells(
    told: Sequence[ToldTrace], measured: TraceFeatures, expected: TraceFeatures, odd: set[int]
) -> list[Question]:
    """Ask about cells of which more than half of the repeats went wrong alike."""
    part = [number for number in np.flatnonzero(measured.is_usable).tolist() if number not in odd]
    if not part:
        return []
    tools = np.unique([told[number].tool for number in part], return_inverse=True)[1]
    objects = np.array([told[number].object_id for number in part])
    labels = Labels(tools, objects, np.array([told[number].is_turned for number in part]))
    own, wanted = (TraceFeatures(f.values[part], f.profile_n[part]) for f in (measured, expected))
    wrong: dict[tuple[str, int], dict[Kind, dict[int, str]]] = {}
    for anomaly in find_anomalies(own, labels, wanted, LIMIT_P, FEWEST_CELLS):
        number = part[anomaly.place]
        if anomaly.kind in _OF_CELLS and anomaly.compared == "expected":
            cell = wrong.setdefault((told[number].tool, told[number].object_id), {})
            cell.setdefault(_OF_CELLS[anomaly.kind], {})[number] = anomaly.reason
    found = []
    for repeats in _cells(told):
        first = told[repeats[0]]
        for kind, reasons in wrong.get((first.tool, first.object_id), {}).items():
            if 2 * len(reasons) > len(repeats):
                sentence = f"{first.place}: {_name(first)}: {next(iter(reasons.values()))}"
                found.append(Question(kind, sentence, tuple(reasons)))
    return found


def _cells(told: Sequence[ToldTrace]) -> list[list[int]]:
    found: dict[tuple[str, int], list[int]] = {}
    for number, one in enumerate(told):
        found.setdefault((one.tool, one.object_id), []).append(number)
    return list(found.values())


def _name(one: ToldTrace) -> str:
    return f"{one.tool.rpartition('/')[2]} on object {one.object_id}"
