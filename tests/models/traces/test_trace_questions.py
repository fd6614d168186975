"""Traces that a person tells: faults of a whole file and of a cell are asked about, sound ones are not."""

from collections.abc import Callable

import numpy as np
import pytest

from fast.models.question import Question
from fast.models.records import Trace
from fast.models.traces.trace_questions import ToldTrace, find_trace_questions

TOOLS, OBJECTS, REPEATS = 6, 4, 3


def pull(peak_n: float, free_mm: float, noise_n: float = 0.0, seed: int = 0) -> Trace:
    """A pull whose force rises and falls until the object is free, and some lift more."""
    lift_mm = np.linspace(0.0, free_mm + 8.0, 300)
    force_n = np.where(lift_mm < free_mm, peak_n * np.sin(np.pi * np.minimum(lift_mm / free_mm, 1.0)), 0.0)
    return Trace(lift_mm / 5.0, lift_mm, force_n + noise_n * np.random.default_rng(seed).normal(size=300))


def file_of(change: Callable[[Trace, int, int], Trace] = lambda trace, tool, obj: trace) -> list[ToldTrace]:
    """A batch of which the simulator is 20 % off; `change` makes something of the trace of a tool on an object."""
    rng = np.random.default_rng(3)
    told = []
    for tool in range(TOOLS):
        for obj in range(OBJECTS):
            peak_n, free_mm = 4.0 * np.exp(0.3 * rng.normal()) + obj, 22.0 + 6.0 * obj
            expected = pull(peak_n * np.exp(0.2 * rng.normal()), free_mm)
            for repeat in range(REPEATS):
                made = change(pull(peak_n * (1.0 + 0.03 * rng.normal()), free_mm, 0.1, repeat), tool, obj)
                told.append(ToldTrace(f"row {len(told) + 2}", f"B01T{tool}", obj, False, made, expected))
    return told


def cut(trace: Trace, lift_mm: float) -> Trace:
    kept = trace.lift_mm <= lift_mm
    return Trace(trace.time_s[kept], trace.lift_mm[kept], trace.force_n[kept])


def with_force(trace: Trace, force_n: np.ndarray) -> Trace:
    return Trace(trace.time_s, trace.lift_mm, force_n)


def exchange(trace: Trace) -> Trace:
    rising = cut(trace, float(trace.lift_mm[trace.force_n.argmax()]))
    return Trace(rising.time_s, np.maximum.accumulate(np.maximum(rising.force_n, 0.0)), rising.lift_mm)


def test_sound_traces_are_told_without_a_question() -> None:
    assert find_trace_questions(file_of()) == []


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda t, *_: with_force(t, 0.02 * t.force_n), "traces hold no force where"),
        (lambda t, *_: with_force(t, t.force_n + 2.0), "forces end at 2 N with the object free"),
        (lambda t, *_: cut(t, 9.0), "72 of 72 traces end at 8.9"),
        (lambda t, *_: exchange(t), "force and lift exchanged?"),
        (lambda t, *_: Trace(t.time_s, 0.5 * t.lift_mm, t.force_n), "objects are free at"),
    ],
    ids=["valve", "zero", "cut", "axes", "lift"],
)
def test_a_fault_of_the_whole_file_is_one_question(change: Callable[..., Trace], words: str) -> None:
    (question,) = find_trace_questions(file_of(change))
    assert words in question.sentence
    assert len(question.numbers) == TOOLS * OBJECTS * REPEATS


@pytest.mark.parametrize(
    ("change", "kind"),
    [
        (lambda t: with_force(t, 0.01 * t.force_n), "no grip"),
        (lambda t: with_force(t, np.where(t.lift_mm < 12.0, t.force_n, 0.0)), "lost early"),
        (lambda t: cut(t, 9.0), "cut off"),
    ],
    ids=["valve", "loss", "cut"],
)
def test_a_cell_whose_repeats_all_went_wrong_is_named(change: Callable[[Trace], Trace], kind: str) -> None:
    told = file_of(lambda trace, tool, obj: change(trace) if (tool, obj) == (2, 1) else trace)
    (question,) = find_trace_questions(told)
    assert question.kind == kind
    assert "B01T2 on object 1" in question.sentence
    assert {(told[n].tool, told[n].object_id) for n in question.numbers} == {("B01T2", 1)}


def change_one(told: list[ToldTrace], number: int, trace: Trace) -> list[Question]:
    return find_trace_questions([*told[:number], told[number]._replace(trace=trace), *told[number + 1 :]])


def test_one_file_under_two_names_is_asked_about() -> None:
    told = file_of()
    (question,) = change_one(told, 7, told[3].trace)
    assert (question.kind, question.numbers) == ("told twice", (7,))
    assert question.sentence == "row 9: B01T0 on object 2 has the samples of row 5, one file under two names?"


def test_a_load_cell_at_the_end_of_its_range_is_asked_about() -> None:
    told = file_of()
    force_n = told[5].trace.force_n
    (flat,) = change_one(told, 5, with_force(told[5].trace, np.minimum(force_n, 0.9 * force_n.max())))
    assert flat.sentence.startswith("row 7: B01T0 on object 1 stands at ")
    wrapped_n = np.where(force_n > 0.9 * force_n.max(), force_n - 1.8 * force_n.max(), force_n)
    (wraps,) = change_one(told, 5, with_force(told[5].trace, wrapped_n))
    assert "to as much below 0" in wraps.sentence
    coarse = [one._replace(trace=with_force(one.trace, np.round(one.trace.force_n / 0.5) * 0.5)) for one in told]
    assert [one for one in find_trace_questions(coarse) if one.kind == "saturated"] == []
