"""A surrogate of the values on every object, from which an outcome that one of them decides is taken."""

import numpy as np
import pytest

from fast.models.errors import UsageError
from fast.models.scientist.object_surrogate import N_COMPONENTS, fit_objects
from fast.models.scientist.objectives import OUTCOMES
from fast.models.scientist.surrogate.fit import fit_surrogate
from fast.models.scientist.surrogate.imputation import fill_objects
from fast.models.scientist.surrogate.observations import REAL, SIM, ObjectValues, ObservationSet

WORST = OUTCOMES["worst_peak_n"]


def forces(x: np.ndarray) -> np.ndarray:
    """Two hills that cross: which of four objects is held worst changes with the first parameter."""
    along = np.stack([np.exp(1 + 2 * x[:, 0]), np.exp(3 - 2 * x[:, 0])], axis=1)
    return np.concatenate([along, 1.3 * along], axis=1) * (1 + 0.3 * x[:, 1:2])


def worlds(n: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    x = rng.random((n, 3))
    return x, forces(x) * np.exp(0.03 * rng.normal(size=(n, 4)))


def test_the_worst_object_is_predicted_better_than_by_a_surrogate_of_the_worst() -> None:
    x, values = worlds(25, 0)
    unseen = np.random.default_rng(1).random((200, 3))
    true = forces(unseen).min(axis=1)
    objects = fit_objects(ObjectValues(x, np.full(25, REAL), values), WORST.of_all)
    plain = fit_surrogate(ObservationSet(x, np.full(25, REAL), values.min(axis=1), np.zeros(25)).in_logs())
    error = np.sqrt(np.mean((objects.mean(unseen, REAL) / true - 1) ** 2))
    error_plain = np.sqrt(np.mean((plain.data.force_n(plain.mean(unseen, REAL)) / true - 1) ** 2))
    assert error < 0.7 * error_plain
    assert error < 0.1


def test_draws_hold_the_truth_as_often_as_they_say() -> None:
    x, values = worlds(15, 2)
    unseen = np.random.default_rng(3).random((200, 3))
    drawn = fit_objects(ObjectValues(x, np.full(15, REAL), values), WORST.of_all).draw(
        unseen, 200, np.random.default_rng(4)
    )
    low, high = np.quantile(drawn, [0.05, 0.95], axis=1)
    true = forces(unseen).min(axis=1)
    assert 0.75 < np.mean((low <= true) & (true <= high)) <= 1.0
    assert np.median(high - low) < true.mean()


def test_simulations_of_another_level_and_gaps_are_learnt_from() -> None:
    x, values = worlds(12, 5)
    x_sim, simulated = worlds(60, 6)
    values[3, 1] = simulated[7, 2] = np.nan
    s = np.repeat([SIM, REAL], [60, 12])
    known = ObjectValues(np.concatenate([x_sim, x]), s, np.concatenate([0.6 * simulated, values]))
    unseen = np.random.default_rng(7).random((200, 3))
    true = forces(unseen).min(axis=1)
    found = fit_objects(known, WORST.of_all).mean(unseen, REAL)
    assert np.sqrt(np.mean((found / true - 1) ** 2)) < 0.1


def test_objects_that_a_fidelity_never_saw_are_left_out() -> None:
    x, values = worlds(10, 8)
    values[:, 2] = np.nan
    objects = fit_objects(ObjectValues(x, np.full(10, REAL), values), WORST.of_all)
    assert objects.loadings.shape == (N_COMPONENTS, 3)
    assert objects.data.y == pytest.approx(values[:, [0, 1, 3]].min(axis=1))


def test_a_design_that_has_only_objects_of_the_other_fidelity_is_left_out() -> None:
    x, values = worlds(10, 8)
    x_sim, simulated = worlds(12, 6)
    simulated[:, 2] = np.nan  # the simulator fails on it
    values[4, [0, 1, 3]] = np.nan
    s = np.repeat([SIM, REAL], [12, 10])
    known = ObjectValues(np.concatenate([x_sim, x]), s, np.concatenate([simulated, values]))
    objects = fit_objects(known, WORST.of_all)
    assert (objects.data.n_sim, objects.data.n_real) == (12, 9)


def test_too_few_designs_are_refused() -> None:
    x, values = worlds(2, 9)
    with pytest.raises(UsageError, match="needs at least 3"):
        fit_objects(ObjectValues(x, np.full(2, REAL), values), WORST.of_all)


def test_what_is_filled_makes_the_scores_uncertain_by_its_slope() -> None:
    """The variance of a filled force (N^2), through ln(1 + force) and the loadings by finite differences."""
    x, values = worlds(12, 5)
    values[3, 1] = np.nan
    objects = fit_objects(ObjectValues(x, np.full(12, REAL), values), WORST.of_all)
    filled = fill_objects(values)
    step = 1e-6 * np.eye(4)[1]
    slopes = objects.loadings @ (np.log1p(filled.values[3] + step) - np.log1p(filled.values[3] - step)) / 2e-6
    noise = np.array([part.data.noise_variance for part in objects.parts])
    assert noise[:, 3] == pytest.approx(slopes**2 * filled.variance[3, 1], rel=1e-6)
    assert (np.delete(noise, 3, axis=1) == 0.0).all()
