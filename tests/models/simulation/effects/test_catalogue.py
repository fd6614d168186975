"""Which effects are forms of one law."""

import pytest

from fast.models.simulation.effects.catalogue import CATALOGUE, is_one_curve


@pytest.mark.parametrize(
    ("first", "second", "is_one"),
    [
        ("pressure_dependent_friction", "shear_adhesion", True),
        ("pressure_dependent_friction", "pressure_dependent_friction", False),  # itself
        ("load_cell_offset", "tool_weight", False),  # neither has a law along a state
        ("static_kinetic_friction", "tool_weight", False),
        ("static_kinetic_friction", "pressure_dependent_friction", False),  # along slip, along pressure
    ],
)
def test_two_effects_are_one_curve_or_not(first: str, second: str, is_one: bool) -> None:
    assert is_one_curve(first, second) is is_one
    assert is_one_curve(second, first) is is_one


def test_effects_of_one_curve_have_the_same_state_and_quantity() -> None:
    pairs = [(a, b) for a in CATALOGUE for b in CATALOGUE if is_one_curve(a, b)]
    assert pairs
    for first, second in pairs:
        assert (CATALOGUE[first].state, CATALOGUE[first].quantity) == (
            CATALOGUE[second].state,
            CATALOGUE[second].quantity,
        )
        assert CATALOGUE[first].state
