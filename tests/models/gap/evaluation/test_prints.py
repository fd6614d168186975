"""Factors of held-out prints: what the other objects of a tool say, shrunk, and never what is judged."""

import dataclasses

import numpy as np
import pytest

from fast.models.gap.evaluation.evaluate import measure_change
from fast.models.gap.evaluation.held_out import HeldOut, PrintFactors
from fast.models.gap.fit.recalibrate import TOOL_SD
from tests.synthetic.gap import GapTruth, made_up_gap

STIFFER = np.array([0.95, 1.0, 1.03, 0.98, 1.06, 1.0, 0.97, 1.04])


@pytest.fixture(scope="module")
def held_out() -> HeldOut:
    """Held-out grasps of new tools alone."""
    found = made_up_gap(8, 9, 3, GapTruth(), held_out=(4, 2)).held_out
    data = made_up_gap(8, 9, 3, GapTruth(), held_out=(4, 2))
    rows = np.flatnonzero(data.held_out_tools[found.grasps.tool])
    return HeldOut.of(data, GapTruth().theta, rows)


def simulate(held_out: HeldOut, cell_sd: float = 0.0) -> tuple[HeldOut, np.ndarray]:
    """Grasps of prints that are stiffer by `STIFFER`, cells that scatter, and what a simulator says of them."""
    simulated_n = np.abs(held_out.measured_n) + 0.1
    scatter = np.exp(cell_sd * np.random.default_rng(1).standard_normal(held_out.cell.max() + 1))[held_out.cell]
    measured_n = simulated_n * (STIFFER[held_out.tool] * scatter)[:, None]
    return dataclasses.replace(held_out, measured_n=measured_n), simulated_n


def test_a_print_is_as_stiff_as_its_other_objects_say(held_out: HeldOut) -> None:
    """Cells that agree leave the prior little to say; those that scatter, more."""
    clean, simulated_n = simulate(held_out)
    found = PrintFactors.of(clean, simulated_n)
    assert found.factor == pytest.approx(STIFFER[held_out.tool], abs=0.002)
    assert found.sd.max() < 0.2 * TOOL_SD
    wide, simulated_n = simulate(held_out, cell_sd=0.08)
    found = PrintFactors.of(wide, simulated_n)
    assert 0.2 * TOOL_SD < found.sd.max() < TOOL_SD
    assert np.abs(np.log(found.factor)).max() < 3.0 * TOOL_SD


def test_the_grasp_that_is_judged_has_no_say(held_out: HeldOut) -> None:
    """What a grasp was measured to be changes the factors of the others, and not its own."""
    clean, simulated_n = simulate(held_out)
    is_one = (clean.tool == clean.tool[0]) & (clean.obj == clean.obj[0])
    changed = np.where(is_one[:, None], 1.1 * clean.measured_n, clean.measured_n)
    before = PrintFactors.of(clean, simulated_n).factor
    after = PrintFactors.of(dataclasses.replace(clean, measured_n=changed), simulated_n).factor
    same_tool = clean.tool == clean.tool[0]
    # The scatter of the cells, which all share, is larger; a mean of the same others is shrunk more.
    assert np.abs(np.log(after[is_one])) == pytest.approx(np.abs(np.log(before[is_one])), rel=0.1)
    assert (np.log(after / before)[same_tool & ~is_one] > 0.004).all()


def test_a_tool_on_one_object_is_a_print_like_any(held_out: HeldOut) -> None:
    """Nothing is known of it."""
    one = held_out.obj == held_out.obj[0]
    alone = dataclasses.replace(
        held_out, tool=held_out.tool[one], obj=held_out.obj[one], measured_n=held_out.measured_n[one]
    )
    found = PrintFactors.of(alone, 2.0 * alone.measured_n)
    assert found.factor == pytest.approx(1.0)
    assert found.sd == pytest.approx(TOOL_SD)


def test_prints_hide_no_gain(held_out: HeldOut) -> None:
    """A simulator that is right but for the prints is better than a wrong one, and the prints are no error of it."""
    clean, simulated_n = simulate(held_out)
    steps = np.linspace(0.0, 1.0, simulated_n.shape[1])
    wrong = simulated_n * (1.0 + 0.04 * np.sin(9.0 * steps + held_out.obj[:, None]))
    change = measure_change(clean, wrong, simulated_n)
    assert change.is_gain
    assert change.after_n < 0.1 * change.before_n
