"""The factorised and the blocked posterior against NUTS on the full joint density, and the parts around them."""

import os

import numpy as np
import pytest

from models.calibration.blocked import calibrate_blocked
from models.calibration.factorised import calibrate_factorised
from models.calibration.importance import PSI_PER_PHI, thin
from models.calibration.joint import calibrate_joint
from models.calibration.parallel import spread
from models.calibration.problem import THETA
from models.calibration.result import K_HAT_LIMIT, CalibrationResult
from models.calibration.settings import CalibrationSettings
from models.calibration.synthetic import made_up_problem
from models.errors import FastError

PROBLEM = made_up_problem(150, 12, seed=3, scales_with_modulus=True)
SETTINGS = CalibrationSettings(chains=4, draws=300, tune=200, target_accept=0.8, workers=1)


@pytest.fixture(scope="module")
def joint() -> CalibrationResult:
    return calibrate_joint(PROBLEM, SETTINGS)


def test_weighted_draws_agree_with_joint_sampling(joint: CalibrationResult) -> None:
    lines: list[str] = []
    found = calibrate_factorised(PROBLEM, SETTINGS, lines.append)
    assert found.k_hat is not None
    assert found.k_hat < K_HAT_LIMIT
    assert found.n_divergences == 0
    assert any("k-hat" in line for line in lines)
    _assert_same(found, joint)


def test_blocked_draws_agree_with_joint_sampling(joint: CalibrationResult) -> None:
    found = calibrate_blocked(PROBLEM, SETTINGS)
    assert found.draws.shape == joint.draws.shape
    _assert_same(found, joint)


def test_pairs_are_neighbours_of_a_chain() -> None:
    chains = np.arange(3 * 50.0).reshape(3, 50, 1)
    groups = thin(chains, 30)
    assert groups.shape == (15, PSI_PER_PHI, 1)
    assert (np.diff(groups[..., 0], axis=1) > 0).all()
    assert (np.bincount((groups[:, 0, 0] // 50).astype(int)) == 5).all()


def test_processes_change_no_result_and_keep_its_order() -> None:
    alone, _ = spread(_square, 3.0, list(range(7)), 1)
    beside, cpu_s = spread(_square, 3.0, list(range(7)), 2)
    assert alone == beside == [3.0 * i * i for i in range(7)]
    assert cpu_s > 0


def test_a_dead_process_is_said() -> None:
    with pytest.raises(FastError, match=r"a process that worked on squares died"):
        spread(_die, None, [0, 1], 2, what="squares")


def _square(factor: float, i: int) -> float:
    return factor * i * i


def _die(shared: None, i: int) -> None:
    os._exit(3)


def _assert_same(found: CalibrationResult, joint: CalibrationResult) -> None:
    """Means and spreads of theta, discrepancy and noise, within 4 Monte-Carlo standard errors."""
    for name in (*THETA, "sd_e_n", "noise_sd_n"):
        ours, theirs = np.log(found.of(name)), np.log(joint.of(name))
        error = theirs.std() * np.sqrt(1.0 / found.ess_bulk[name] + 1.0 / joint.ess_bulk[name])
        assert abs(ours.mean() - theirs.mean()) < 4.0 * error, name
        assert ours.std() == pytest.approx(theirs.std(), rel=0.3), name
