"""What a lab measures of its tools, material and cell: slips are asked about, sound numbers are not."""

import pytest

from fast.models.design.measured import shore_a_of_modulus, shore_a_of_shore_00
from fast.models.gap.ask.person import find_reading_questions
from fast.models.material import modulus_of_hardness_mpa
from tests.studies.traces.told_facts import measure_facts

N = 20
FACTS = measure_facts(N)


@pytest.mark.parametrize("planted", FACTS)
def test_planted_slips_are_asked_about_and_sound_numbers_are_not(planted: str) -> None:
    seen = [asked for asked in FACTS[planted] if asked is not None]
    assert len(seen) >= 4
    if "nothing" in planted:
        assert sum(seen) <= 0.1 * len(seen)
    else:
        assert sum(seen) >= 0.85 * len(seen)


def test_scales_of_hardness_agree_with_each_other() -> None:
    for shore_a in (20.0, 50.0, 80.0):
        assert shore_a_of_modulus(modulus_of_hardness_mpa(shore_a)) == pytest.approx(shore_a)
    assert shore_a_of_shore_00(78.0) == pytest.approx(30.0, abs=3.0)  # tables of makers give 78 to 80


def test_walls_of_tools_say_what_a_reading_should_be() -> None:
    (question,) = find_reading_questions("walls", 0.012, (0.12, 0.02))
    assert "measured walls of tools say 0.12, a decimal point? It would be 0.12 mm" in question.sentence
    assert find_reading_questions("walls", 0.012) == []
