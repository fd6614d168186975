"""The health card: it finds a simulator that tells nothing, a surrogate that is too sure, and is silent otherwise."""

import numpy as np
import pandas as pd
import pytest

from fast.models.design.space import random_unit
from fast.models.scientist.insights.health import surrogate_cards
from fast.models.scientist.surrogate.fit import fit_surrogate
from fast.models.scientist.surrogate.health import (
    MANY,
    SurrogateHealth,
    health_of,
    is_overconfident,
    predict_left_out,
)
from fast.models.scientist.surrogate.observations import REAL, SIM, ObservationSet
from fast.models.scientist.surrogate.posterior import Surrogate


def force(x: np.ndarray) -> np.ndarray:
    return 12 + 4 * np.sin(3 * x[:, 0]) + 5 * x[:, 5] * x[:, 2] - 3 * (x[:, 7] - 0.4) ** 2


def observed(n_real: int, n_sim: int, *, is_related: bool, seed: int = 0) -> ObservationSet:
    """Measurements of `force`; simulations of its double, or of something else altogether."""
    rng = np.random.default_rng(seed)
    x, s = random_unit(n_real + n_sim, rng), np.repeat([REAL, SIM], [n_real, n_sim])
    simulated = 2 * force(x) - 5 if is_related else 8 + 3 * np.cos(7 * x[:, 3]) + 2 * x[:, 8]
    y = np.where(s == REAL, force(x) + 0.1 * rng.normal(size=len(x)), simulated)
    return ObservationSet(x, s, y, np.zeros(len(x)))


def cards_of(surrogate: Surrogate) -> dict[str, str]:
    return {card.name: card.sentence for card in surrogate_cards(health_of(surrogate), "demo")}


def test_a_good_simulator_helps_and_nothing_is_found():
    health = health_of(fit_surrogate(observed(25, 150, is_related=True)))
    assert {card.tone for card in surrogate_cards(health, "demo")} == {"green"}
    assert health.simulation_gain is not None
    assert health.simulation_gain > 0.3
    assert health.shared_variance > 0.8
    assert health.rho == pytest.approx(0.5, abs=0.1)


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_a_simulator_of_something_else_is_found_out(seed):
    health = health_of(fit_surrogate(observed(40, 120, is_related=False, seed=seed)))
    (card,) = [card for card in surrogate_cards(health, "demo") if card.name == "simulator"]
    assert card.tone in ("yellow", "red")
    assert card.sentence.startswith("Simulation is not informative: with it the error at measured designs is ")
    assert "fast gap --campaign demo" in card.next_step


def test_a_surrogate_that_is_too_sure_is_found_out():
    """It takes scatter for bends of the force: with all known its intervals hold, of new designs they miss half."""
    data = observed(40, 60, is_related=True)
    noisy = ObservationSet(
        data.x, data.s, data.y + np.where(data.s == REAL, 1.5, 0) * np.sin(97 * data.x[:, 4]), data.noise_variance
    )
    fitted = fit_surrogate(noisy)
    too_sure = Surrogate.condition(noisy, fitted.parameters.model_copy(update={"noise_sd": 0.02, "sd_e": 0.02}))
    assert "confidence" in cards_of(too_sure)
    assert "confidence" in cards_of(fitted)


def test_a_left_out_design_is_as_hard_to_predict_as_a_new_one():
    """What the simulator lacks is learnt from twelve tools; with the parameters of all their error looks too small."""

    def measured(x: np.ndarray) -> np.ndarray:
        return force(x) + 1.5 * np.sin(6 * x[:, 4] + 2 * x[:, 6])

    left_out, with_all, new = [], [], []
    for seed in range(6):
        data = observed(12, 36, is_related=True, seed=seed)
        missed = np.where(data.s == REAL, measured(data.x) - force(data.x), 0.0)
        surrogate = fit_surrogate(ObservationSet(data.x, data.s, data.y + missed, data.noise_variance))
        is_real, y = surrogate.data.s == REAL, surrogate.data.y
        left_out += list((y - predict_left_out(surrogate).mean)[is_real])
        with_all += list((y - surrogate.leave_one_out().mean)[is_real])
        x = random_unit(100, np.random.default_rng(seed + 100))
        new += list(measured(x) - surrogate.predict(x, REAL)[0])
    error, error_with_all, error_of_new = (np.sqrt(np.mean(np.square(one))) for one in (left_out, with_all, new))
    assert error == pytest.approx(error_of_new, rel=0.2)
    assert error_with_all < 0.75 * error_of_new


def test_many_designs_are_left_out_without_a_fit_for_each_group():
    data = observed(MANY + 10, 40, is_related=True)
    surrogate = fit_surrogate(data)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("fast.models.scientist.surrogate.health.refit_without", None)
        left_out = predict_left_out(surrogate)
    is_real, x = surrogate.data.s == REAL, random_unit(100, np.random.default_rng(1))
    error = np.sqrt(np.mean((surrogate.data.y - left_out.mean)[is_real] ** 2))
    of_new = np.sqrt(np.mean((force(x) - surrogate.predict(x, REAL)[0]) ** 2) + 0.1**2)
    assert error == pytest.approx(of_new, rel=0.15)
    assert np.isnan(left_out.mean[~is_real]).all()


@pytest.mark.parametrize(
    ("coverage", "n", "expected"), [(0.9, 30, False), (0.8, 30, False), (0.6, 30, True), (0.5, 4, False)]
)
def test_overconfidence_is_more_than_chance(coverage, n, expected):
    assert is_overconfident(coverage, n) is expected


def test_one_sided_data_have_no_simulation_gain():
    only_real = health_of(fit_surrogate(observed(10, 0, is_related=True)))
    only_sim = health_of(fit_surrogate(observed(0, 10, is_related=True)))
    assert (only_real.simulation_gain, only_sim.simulation_gain, only_sim.loo_rmse_n) == (None, None, None)
    assert SurrogateHealth.model_validate(only_real.model_dump()) == only_real


def test_a_gross_outlier_is_found_and_does_not_spoil_the_fit_elsewhere():
    """One tool with a broken finger: the surrogate calls it noise, says so and still predicts the others."""
    data = observed(40, 120, is_related=True)
    y = data.y.copy()
    y[3] -= 12.0
    unseen = random_unit(200, np.random.default_rng(9))
    clean, spoilt = fit_surrogate(data), fit_surrogate(ObservationSet(data.x, data.s, y, data.noise_variance))

    def rmse(surrogate: Surrogate) -> float:
        return float(np.sqrt(np.mean((surrogate.mean(unseen, REAL) - force(unseen)) ** 2)))

    assert rmse(clean) < rmse(spoilt) < 1.8  # of a spread of 2.7 N
    assert (health_of(clean).n_outliers, health_of(spoilt).n_outliers) == (0, 1)
    assert cards_of(spoilt)["outliers"].startswith("1 of 40 measured designs lie more than 4 standard deviations")


def test_observations_may_be_columns_of_a_data_frame() -> None:
    x = random_unit(8, np.random.default_rng(3))
    frame = pd.DataFrame({"s": np.repeat([SIM, REAL], 4), "y": 10.0 + 5.0 * x[:, 0], "none": 0.0}).iloc[::-1]
    columns = ObservationSet(x[frame.index], frame["s"], frame["y"], frame["none"])
    arrays = ObservationSet(x[::-1], *(frame[name].to_numpy() for name in frame))
    means = [fit_surrogate(data).predict(x, REAL)[0] for data in (columns, arrays)]
    assert means[0].tolist() == means[1].tolist()
