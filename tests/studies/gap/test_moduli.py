"""What the how-to says of a modulus that depends on the object."""

from fast.flows.challenge.hidden.panel_file import PANEL, read_small
from tests.studies.gap.moduli import list_ratios

MOVING = {"static_kinetic_friction", "pressure_dependent_friction", "force_limited_closing"}


def test_friction_and_jaws_that_stall_make_a_modulus_depend_on_the_object_and_little_else_does() -> None:
    rows = list_ratios(read_small(PANEL)[1])
    names = {row["effect"] for row in rows}
    typical = {name: min(row["median"] for row in rows if row["effect"] == name) for name in names}
    assert len(typical) == 11
    assert {name for name, ratio in typical.items() if ratio < 0.75} == MOVING
    assert min(ratio for name, ratio in typical.items() if name not in MOVING) > 0.95
