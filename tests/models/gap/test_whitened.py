"""Errors of a cell: what the height of the object changes, from simulations where there are any."""

from dataclasses import replace

import numpy as np
import pytest

from fast.models.gap.bank.bank import DEEPER_MM, Bank
from fast.models.gap.fit import whitened_features
from fast.models.gap.fit.whitened_features import PLACED_MM, SHIFT_MM, UNPLACED_SHIFT_MM, whiten_features
from tests.synthetic.gap import made_up_gap

DATA = made_up_gap(3, 2, 0, n_repeats=2)
AT = (np.array([0, 2]), np.array([1, 0]))
STEPS_N = DATA.bank.centre_steps_n[AT]


def find_scatter(bank: Bank) -> np.ndarray:
    """Covariance of heights of two cells, at the centre's own forces."""
    amplitude = whitened_features.find_amplitude(whitened_features.features_of_steps(STEPS_N))
    return whitened_features._placed_scatter(bank, AT, STEPS_N, amplitude)


def test_heights_scatter_features_as_the_simulations_of_placements_say() -> None:
    features = whitened_features.features_of_steps
    expected = SHIFT_MM**2 * np.array([np.outer(row, row) for row in whitened_features._slopes(STEPS_N)])
    for cell, (tool, obj) in enumerate(zip(*AT, strict=True)):
        for place, deeper_mm in enumerate(DEEPER_MM):
            changed = features(DATA.bank.placed_steps_n[tool, obj, place]) - features(STEPS_N[cell])
            by_one_sd = changed / abs(deeper_mm) * PLACED_MM
            expected[cell] += np.outer(by_one_sd, by_one_sd) / len(DEEPER_MM)
    np.testing.assert_allclose(find_scatter(DATA.bank), expected, rtol=1e-9, atol=1e-12)


def test_a_cell_without_simulations_of_placements_is_shifted_along_the_lift() -> None:
    placed_steps_n = DATA.bank.placed_steps_n.copy()
    placed_steps_n[0, 1] = np.nan
    placed_steps_n[2, 0, 0] = np.nan  # of the other cell, one of two
    found = find_scatter(replace(DATA.bank, placed_steps_n=placed_steps_n))
    slope = whitened_features._slopes(STEPS_N)[0]
    np.testing.assert_allclose(found[0], UNPLACED_SHIFT_MM**2 * np.outer(slope, slope))
    assert np.trace(found[1]) == pytest.approx(np.trace(find_scatter(DATA.bank)[1]), rel=0.3)


def test_a_cell_that_its_height_changes_much_counts_less() -> None:
    far_n = DATA.bank.placed_steps_n.copy()
    far_n[0, 1] = DATA.bank.centre_steps_n[0, 1] * np.array([0.5, 1.5])[:, None]
    widths = []
    for bank in (DATA.bank, replace(DATA.bank, placed_steps_n=far_n)):
        training = replace(DATA, bank=bank).training
        lead_n = training.predict_with_lead(np.array([10.0, 0.6, 0.42]))
        features = whiten_features(training, lead_n, 1.0)
        widths.append(np.linalg.slogdet(features.whiteners[features.is_mean]).logabsdet)
    grasps = training.grasps.select(np.flatnonzero(features.is_mean))
    is_cell = (grasps.tool == 0) & (grasps.obj == 1)
    assert is_cell.sum() == 1
    assert (widths[1][is_cell] < widths[0][is_cell] - 0.5).all()
    np.testing.assert_allclose(widths[1][~is_cell], widths[0][~is_cell])
