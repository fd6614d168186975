"""Slips of the pen are asked about, sound numbers are not."""

import numpy as np
import pytest

from fast.models.traces.questions import UNITS_N, Told, find_questions

TOOLS, OBJECTS, REPEATS = 6, 4, 3


def campaign(seed: int, knows_simulator: bool = True, n_repeats: int = REPEATS) -> list[Told]:
    """Forces of a made-up batch, and what a simulator that is 20 % off expects of them."""
    rng = np.random.default_rng(seed)
    tool, obj = rng.normal(0, 0.5, TOOLS), rng.normal(0, 0.6, OBJECTS)
    off = rng.normal(0, 0.35)
    told = []
    for t in range(TOOLS):
        for o in range(OBJECTS):
            level = 2.0 + tool[t] + obj[o] + rng.normal(0, 0.15)
            expected = np.exp(level + off + rng.normal(0, 0.2)) if knows_simulator else None
            for r in range(n_repeats):
                force = round(float(np.exp(level + rng.normal(0, 0.05))), 2)
                told.append(Told(f"row {len(told) + 2}", f"B01T{t}", o, r, force, expected))
    return told


def change(told: list[Told], numbers, force) -> list[Told]:
    changed = list(told)
    for number in numbers:
        changed[number] = told[number]._replace(force_n=force(told[number]))
    return changed


def swap(told: list[Told], a: str, b: str) -> list[Told]:
    of = {(one.tool, one.object_id, one.repeat): one.force_n for one in told}
    other = {a: b, b: a}
    return [one._replace(force_n=of[other.get(one.tool, one.tool), one.object_id, one.repeat]) for one in told]


@pytest.mark.parametrize("n_repeats", [1, 2, 3])
@pytest.mark.parametrize("knows_simulator", [True, False])
def test_sound_files_are_told_without_a_question(knows_simulator, n_repeats):
    asked = [bool(find_questions(campaign(seed, knows_simulator, n_repeats))) for seed in range(40)]
    assert sum(asked) <= 4  # 1 in 10


@pytest.mark.parametrize("factor", [10.0, 0.1, 100.0])
def test_a_decimal_point_is_found_with_what_it_would_be(factor):
    found = 0
    for seed in range(40):
        told = campaign(seed, knows_simulator=False)
        number = seed % len(told)
        slipped = change(told, [number], lambda one: round(one.force_n * factor, 4))
        questions = [q for q in find_questions(slipped) if q.kind == "decimal point" and q.numbers == (number,)]
        found += bool(questions) and f"would be {told[number].force_n:g} N" in questions[0].sentence
    assert found >= 36


@pytest.mark.parametrize("knows_simulator", [True, False])
@pytest.mark.parametrize("n_repeats", [1, 2])
@pytest.mark.parametrize("factor", [10.0, 0.1, 100.0])
def test_a_decimal_point_is_found_without_three_repeats(factor, n_repeats, knows_simulator):
    found = 0
    for seed in range(40):
        told = campaign(seed, knows_simulator, n_repeats)
        number = seed % len(told)
        slipped = change(told, [number], lambda one: round(one.force_n * factor, 4))
        questions = [q for q in find_questions(slipped) if q.kind == "decimal point" and q.numbers == (number,)]
        found += bool(questions) and f"would be {told[number].force_n:g} N" in questions[0].sentence
    assert found >= 36


def test_of_two_repeats_of_which_nothing_else_is_known_both_are_asked_about():
    (question,) = find_questions([Told("row 2", "B01T0", 1, 0, 9.0), Told("row 3", "B01T0", 1, 1, 90.0)])
    assert question.numbers == (0, 1)
    assert question.sentence == "row 2: 9 N, and row 3, its repeat, 90 N; which is it?"
    assert find_questions([Told("row 2", "B01T0", 1, 0, 9.0), Told("row 3", "B01T0", 1, 1, 4.0)]) == []


@pytest.mark.parametrize("unit", ["kgf", "gf", "kN", "mN"])
def test_another_unit_is_found_by_what_the_simulator_expects(unit):
    found = 0
    for seed in range(40):
        told = campaign(seed)
        slipped = change(told, range(len(told)), lambda one: one.force_n / UNITS_N[unit])
        found += any(q.kind == "unit" and f"{unit}?" in q.sentence for q in find_questions(slipped))
    assert found >= 36


def test_copied_numbers_and_a_gauge_that_sticks_are_found():
    for seed in range(40):
        told = campaign(seed, knows_simulator=False)
        start = seed % 40
        stuck = change(told, range(start, start + 12), lambda one: 8.0)
        (question,) = [q for q in find_questions(stuck) if q.kind == "copied"]
        assert set(range(start, start + 12)) <= set(question.numbers)


def test_equal_numbers_of_a_coarse_gauge_are_seldom_a_question():
    coarse = [change(t, range(len(t)), lambda one: max(round(one.force_n), 1.0)) for t in map(campaign, range(40))]
    assert sum(any(q.kind == "copied" for q in find_questions(told)) for told in coarse) <= 4  # 1 in 10


def test_a_tool_that_is_told_twice_is_found():
    told = campaign(3, knows_simulator=False)
    twice = [one._replace(force_n=told[i - 12].force_n) if one.tool == "B01T1" else one for i, one in enumerate(told)]
    assert [q.sentence for q in find_questions(twice) if q.kind == "told twice"] == [
        "B01T1 has the numbers of B01T0, one told twice?"
    ]


def test_exchanged_tools_are_found_where_their_forces_differ_by_four_times_the_scatter():
    found, n = 0, 0
    for seed in range(60):
        told = campaign(seed)
        level = {t: np.mean([np.log(o.force_n) for o in told if o.tool == t]) for t in {o.tool for o in told}}
        first, last = min(level, key=level.__getitem__), max(level, key=level.__getitem__)
        if level[last] - level[first] < 4 * 0.25:  # scatter of a cell about its expectation, in ln force
            continue
        n += 1
        questions = [q for q in find_questions(swap(told, first, last)) if q.kind == "exchanged tools"]
        found += any(first in q.sentence and last in q.sentence for q in questions)
    assert n >= 20
    assert found >= 0.9 * n


@pytest.mark.parametrize("n_repeats", [2, 3])
def test_a_zero_beside_repeats_that_held_is_asked_about(n_repeats):
    told = campaign(4, n_repeats=n_repeats)
    (question,) = find_questions(change(told, [n_repeats], lambda one: 0.0))
    assert question.numbers == (n_repeats,)
    assert question.sentence.startswith(f"row {n_repeats + 2}: 0 N beside {told[n_repeats + 1].force_n:g} N")


def test_a_finger_that_never_holds_or_hardly_is_no_question():
    told = campaign(4)
    assert find_questions(change(told, range(12), lambda one: 0.0)) == []
    coarse = change(told, range(len(told)), lambda one: float(round(one.force_n)))
    assert find_questions(change(coarse, range(3), lambda one: one.repeat % 2)) == []  # 0 and 1 N in steps of 1 N


def test_an_early_loss_is_no_slip_of_the_pen():
    told = campaign(5, knows_simulator=False)
    assert find_questions(change(told, [7], lambda one: one.force_n * 0.45)) == []
    (question,) = find_questions(change(told, [7], lambda one: one.force_n * 0.25))
    assert question.kind == "outlier"
