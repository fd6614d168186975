"""The factorised method draws from the same posterior as full joint NUTS, which approximates nothing."""

import numpy as np
import pytest

from models.calibration.inference.result import K_HAT_LIMIT
from models.calibration.inference.settings import CalibrationSettings
from models.calibration.means.factorised import calibrate_factorised
from models.calibration.means.joint_nuts import calibrate_joint
from models.calibration.means.problem import THETA
from models.calibration.means.synthetic import make_up_problem

SETTINGS = CalibrationSettings(chains=4, draws=500, tune=250, target_accept=0.8, workers=1)
NAMES = (*THETA, "sd_e_n", "noise_sd_n", "sd_h")


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
