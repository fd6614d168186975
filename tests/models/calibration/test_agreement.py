"""The factorised method draws from the same posterior as full joint NUTS, which approximates nothing."""

import json
from pathlib import Path

import numpy as np
import pytest

from fast.models.calibration.inference.result import K_HAT_LIMIT, measure_convergence
from fast.models.calibration.inference.settings import CalibrationSettings
from fast.models.calibration.means.factorised import calibrate_factorised
from fast.models.calibration.means.joint import calibrate_joint
from fast.models.calibration.means.problem import THETA
from tests.synthetic.calibration import make_up_problem

SETTINGS = CalibrationSettings(chains=4, draws=500, tune=250, target_accept=0.8, workers=1)
NAMES = (*THETA, "sd_e_n", "noise_sd_n", "sd_h")
# Moments of the logarithms of parameters over four chains of joint NUTS, a minute of CPU each.
EXACT = json.loads((Path(__file__).parents[2] / "data" / "calibration-exact.json").read_text())


def test_the_factorised_posterior_is_that_of_stored_exact_chains() -> None:
    problem = make_up_problem(EXACT["n_sim"], EXACT["n_real"], seed=0, scales_with_modulus=True)
    found = calibrate_factorised(problem, SETTINGS.model_copy(update={"chains": 2, "tune": 100, "draws": 150}))
    assert found.k_hat is not None
    assert found.k_hat < K_HAT_LIMIT
    names = tuple(row["log_of"] for row in EXACT["log_of"])
    draws = found.draws[:, :, [found.names.index(name) for name in names]]
    _, ess_bulk, _ = measure_convergence(names, draws)
    for exact, values in zip(EXACT["log_of"], np.moveaxis(np.log(draws), 2, 0), strict=True):
        name = exact["log_of"]
        error = np.hypot(values.std() / np.sqrt(ess_bulk[name]), exact["sd"] / np.sqrt(exact["ess_bulk"]))
        assert abs(values.mean() - exact["mean"]) < 4 * error, name
        assert values.std() == pytest.approx(exact["sd"], rel=0.35), name


@pytest.mark.study
@pytest.mark.timeout(1800)
def test_both_methods_give_the_same_posterior_within_monte_carlo_error():
    problem = make_up_problem(250, 30, seed=0, scales_with_modulus=True)
    factorised = calibrate_factorised(problem, SETTINGS)
    joint = calibrate_joint(problem, SETTINGS.model_copy(update={"chains": 2, "draws": 200, "tune": 120}))
    assert factorised.k_hat is not None
    assert factorised.k_hat < K_HAT_LIMIT
    for name in NAMES:
        a, b = (np.log(result.of(name).ravel()) for result in (factorised, joint))
        n_a, n_b = (result.ess_bulk[name] for result in (factorised, joint))
        error = np.hypot(a.std() / np.sqrt(n_a), b.std() / np.sqrt(n_b))
        assert abs(a.mean() - b.mean()) < 4 * error, name
        assert a.std() == pytest.approx(b.std(), rel=0.2), name
