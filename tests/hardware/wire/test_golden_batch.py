"""The wire log of a whole batch is what it was: gantry, PLC and weight transmitter, to the byte."""

from tests.hardware.wire.golden_batch import COMMAND, FILE, find_difference, fold, say_batch


def test_a_batch_says_what_it_said():
    kept = FILE.read_text(encoding="ascii").splitlines()
    assert {line.split()[0] for line in kept} == {"gantry", "plc", "load-cell"}
    difference = find_difference(kept, say_batch())
    assert not difference, f"{difference}\nIf that is meant: `{COMMAND}`, and the reason in the commit."


def test_the_first_difference_is_told_with_what_came_before():
    kept = ["a -> 1", "b -> 2", "c -> 3", "d -> 4", "e -> 5"]
    assert find_difference(kept, list(kept)) == ""
    assert find_difference(kept, [*kept[:4], "x -> 5"]).splitlines() == [
        "exchange 5 of 5 differs (- kept, + said now):",
        "     2   b -> 2",
        "     3   c -> 3",
        "     4   d -> 4",
        "     5 - e -> 5",
        "     5 + x -> 5",
    ]
    assert "     3 + (nothing more)" in find_difference(kept, kept[:2])
    assert "     6 - (nothing more)" in find_difference(kept, [*kept, "f -> 6"])


def test_lines_in_a_row_are_folded():
    assert list(fold(["a", "a", "b", "a"])) == ["a x2", "b", "a"]
