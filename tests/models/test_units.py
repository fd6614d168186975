"""How numbers are spelt for people."""

import pytest

from fast.models.units import spell_chance, spell_minutes, spell_number, spell_share


@pytest.mark.parametrize(
    ("value", "digits", "text"),
    [
        (127.4, 2, "130"), (99.6, 2, "100"), (1234.0, 3, "1230"), (9.96, 2, "10"), (0.0312, 2, "0.031"),
        (-250.0, 2, "\u2212250"), (0.0, 2, "0"), (-0.0, 2, "0"), (12.34, 3, "12.3"),
    ],
)  # fmt: skip
def test_a_large_number_has_no_exponent(value: float, digits: int, text: str) -> None:
    assert spell_number(value, digits) == text


@pytest.mark.parametrize(
    ("chance", "text"), [(0.0, "less than 1 %"), (1.0, "more than 99 %"), (0.006, "1 %"), (0.42, "42 %")]
)
def test_a_rehearsed_chance_is_never_sure(chance: float, text: str) -> None:
    assert spell_chance(chance) == text


@pytest.mark.parametrize(("minutes", "text"), [(0.2, "1 min"), (6.53, "7 min"), (6.5, "7 min"), (6.44, "6 min")])
def test_minutes_are_the_same_of_a_number_and_of_what_findings_keep_of_it(minutes: float, text: str) -> None:
    assert spell_minutes(minutes) == spell_minutes(round(minutes, 1)) == text


def test_nothing_has_no_sign() -> None:
    assert (spell_share(-0.001), spell_share(-0.02)) == ("0 %", "-2 %")
