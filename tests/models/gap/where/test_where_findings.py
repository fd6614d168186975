import dataclasses

import numpy as np
import pytest

from fast.models.gap.where.locate import locate
from fast.models.gap.where.permutation_tests import run_tests
from fast.models.gap.where.residuals import compute_phase_differences, find_phase_windows
from fast.models.gap.where.strata import object_shape
from tests.models.gap.where.made_up import LIFT_MM, made_up_residuals


def _thin_ribs_on_wide(design: np.ndarray, shape: np.ndarray, _: int) -> float:
    return 1.0 - 0.15 * float(shape[0] > 40.0 and design[6] < 2.5)


def test_a_gap_of_some_tools_on_some_objects_is_said_in_words() -> None:
    where = locate(made_up_residuals(_thin_ribs_on_wide))
    lead = where.findings[0]
    assert lead.phase == "peak"
    assert "over-predicts the peak" in lead.sentence
    assert "for objects wider than 41 mm on tools with ribs under 2.5" in lead.sentence
    assert "the same in all repeats" in lead.sentence
    assert lead.share == pytest.approx(-0.14, abs=0.03)
    assert lead.ci90[0] < lead.effect_size_n < lead.ci90[1] < 0
    assert lead.q_value is not None
    assert lead.q_value <= 0.05
    assert all("ribs under" in f.stratum for f in where.findings)


def test_softening_over_repeats_is_found() -> None:
    where = locate(made_up_residuals(lambda d, s, repeat: 1.0 - 0.03 * repeat))
    assert any("falls" in f.sentence and "last repeat" in f.stratum for f in where.findings)


def test_a_late_gap_is_not_seen_before_it() -> None:
    where = locate(made_up_residuals(lambda d, s, r: 1.0 - 0.08 * (s[1] * 0.8 < LIFT_MM)))
    assert where.findings[0].phase == "slip"
    assert "nothing before that" in where.findings[0].sentence
    assert {f.phase for f in where.findings} <= {"slip", "tail"}


def test_worlds_without_a_gap_stay_silent() -> None:
    # Scatter of prints and placement, noise and other meshes are there; 5 % of such worlds may say something.
    found = [locate(made_up_residuals(n_tools=10, seed=seed)).findings for seed in range(10)]
    assert sum(len(f) > 0 for f in found) <= 2


def test_tools_are_what_counts_not_grasps() -> None:
    one = made_up_residuals(_thin_ribs_on_wide, n_tools=8)
    names = ("tool", "obj", "repeat", "order", "measured_n", "predicted_n")
    twice = dataclasses.replace(one, **{n: np.concatenate([getattr(one, n)] * 2) for n in names})
    for phase, q in run_tests(one).phases.items():
        assert run_tests(twice).phases[phase] == pytest.approx(q, abs=0.02)


def test_shuffled_designs_lose_the_place() -> None:
    world = made_up_residuals(_thin_ribs_on_wide)
    shuffled = dataclasses.replace(world, designs=world.designs[5:] + world.designs[:5])
    assert not any("ribs" in f.stratum for f in locate(shuffled).findings)


def test_a_step_is_in_one_phase_at_most_and_the_peak_is_the_difference_of_peaks() -> None:
    world = made_up_residuals()
    windows = find_phase_windows(world.predicted_n)
    assert windows.sum(axis=1).max() == 1
    assert (np.diff(windows.argmax(axis=2)[:, :4], axis=1) >= 0).all()
    late = np.roll(world.predicted_n, 2, axis=1)
    assert np.abs(compute_phase_differences(late, world.predicted_n)[:, 2]).max() < 0.3  # late, but as strong


@pytest.mark.parametrize(
    ("object_id", "family", "width_mm"),
    [
        (4, "straight sides", 30),
        (2, "a bulge", 48),
        (26, "a waist", 44.4),
        (24, "a narrow top", 44.8),
        (22, "a wide top", 45),
    ],
)
def test_objects_have_a_word_for_their_shape(object_id: int, family: str, width_mm: float) -> None:
    shape = object_shape(object_id)
    assert shape.family == family
    assert shape.width_mm == pytest.approx(width_mm, abs=1.5)
