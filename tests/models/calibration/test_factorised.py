"""The factorised posterior: its densities and its draws against the joint one, the whole recipe."""

import numpy as np
import pytest

from fast.models.calibration.inference.result import K_HAT_LIMIT, CalibrationResult
from fast.models.calibration.inference.settings import CalibrationSettings
from fast.models.calibration.means.factorised import calibrate_factorised, find_first_box
from fast.models.calibration.means.joint import JointDensity, calibrate_joint, guess_starts
from fast.models.calibration.means.parameters import Parameters
from fast.models.calibration.means.problem import THETA, Standardised
from fast.models.calibration.means.psi_density import Measurements
from fast.models.calibration.means.reweight import (
    PSI_PER_PHI,
    NormalPhi,
    approximate_phi,
    compute_exact_log_density,
    thin,
)
from tests.synthetic.calibration import make_up_problem

PROBLEM = make_up_problem(40, 8, seed=3, scales_with_modulus=True)
SHORT = CalibrationSettings(chains=2, draws=50, tune=50, target_accept=0.8, workers=1)


@pytest.fixture(scope="module")
def measured() -> Measurements:
    data = Standardised.of(PROBLEM)
    return Measurements(data, Parameters.of(data, SHORT))


@pytest.fixture(scope="module")
def psi(measured: Measurements) -> np.ndarray:
    return guess_starts(measured.parameters)[1][measured.parameters.n_phi :]


@pytest.fixture(scope="module")
def normal_phi(measured: Measurements) -> NormalPhi:
    mean = np.concatenate([np.full(measured.parameters.n_inputs, 0.7), [0.3, np.log(0.03)]])
    return NormalPhi(mean, 0.1 * np.eye(len(mean)))


def test_weights_are_of_the_joint_density(measured: Measurements, normal_phi: NormalPhi, psi: np.ndarray) -> None:
    group = np.array([psi, psi + 0.1])
    exact = compute_exact_log_density(measured, (normal_phi.mean, group))
    joint = JointDensity(measured.data, measured.parameters)
    for value, row in zip(exact, group, strict=True):
        prior = measured.parameters.log_prior_psi(row)[0]
        assert value + prior == pytest.approx(joint(np.concatenate([normal_phi.mean, row]))[0], abs=1e-7)


def test_normal_approximation_of_phi_has_the_joint_curvature(measured: Measurements, psi: np.ndarray) -> None:
    density = JointDensity(measured.data, measured.parameters)
    mode = np.concatenate([np.full(measured.parameters.n_inputs, 0.5), [0.3, np.log(0.03)], psi])
    normal, _ = approximate_phi(density, mode, 1)
    draws, log_density = normal.draw(4000, np.random.default_rng(0))
    covariance = normal.root @ normal.root.T
    np.testing.assert_allclose(np.cov(draws.T), covariance, atol=0.12 * np.diag(covariance).max())
    offset = draws[0] - normal.mean
    assert log_density[0] == pytest.approx(-0.5 * offset @ np.linalg.solve(covariance, offset), rel=1e-6)


def test_the_recipe_runs_and_says_how_good_it_is() -> None:
    lines: list[str] = []
    found = calibrate_factorised(PROBLEM, SHORT, lines.append)
    assert found.method == "factorised"
    assert found.draws.shape[0] == SHORT.chains
    assert found.draws.shape[2] == len(found.names)
    assert (found.of("poisson_ratio") < 0.5).all()
    assert (found.of("noise_sd_n") > 0).all()
    assert found.k_hat is not None
    assert found.n_gradients > 200
    assert set(found.steps) >= {"emulator", "optimum", "curvature", "theta surrogate", "sampling", "weights"}
    assert any(line.startswith("k-hat") for line in lines)
    assert any("box of theta" in line or "nodes" in line for line in lines)


def test_the_box_holds_the_whole_poisson_ratio_and_stays_within_the_prior(
    measured: Measurements, psi: np.ndarray
) -> None:
    box = find_first_box(measured, psi, 100.0 * np.eye(len(psi)))
    friction, poisson = zip(box.lower, box.upper, strict=True)
    assert -0.02 < friction[0] < friction[1] < 2.0
    assert poisson == pytest.approx((0.0, 1.0), abs=1e-5)


def test_pairs_are_neighbours_of_a_chain() -> None:
    chains = np.arange(3 * 50.0).reshape(3, 50, 1)
    groups = thin(chains, 30)
    assert groups.shape == (15, PSI_PER_PHI, 1)
    assert (np.diff(groups[..., 0], axis=1) > 0).all()
    assert (np.bincount((groups[:, 0, 0] // 50).astype(int)) == 5).all()


@pytest.mark.study
@pytest.mark.timeout(3600)
def test_the_factorised_method_agrees_with_joint_sampling() -> None:
    """A problem small enough for joint NUTS, with an emulator good enough for the factorised method."""
    problem = make_up_problem(250, 15, seed=3)
    settings = CalibrationSettings(chains=4, draws=800, tune=400)
    joint = calibrate_joint(problem, settings)
    factorised = calibrate_factorised(problem, settings)
    assert joint.n_divergences == factorised.n_divergences == 0
    if factorised.k_hat is not None and factorised.k_hat < K_HAT_LIMIT:
        _assert_same(factorised, joint)


def _assert_same(found: CalibrationResult, joint: CalibrationResult) -> None:
    """Means and spreads of theta, discrepancy and noise, within 4 Monte-Carlo standard errors."""
    for name in (*THETA, "sd_e_n", "noise_sd_n"):
        ours, theirs = np.log(found.of(name)), np.log(joint.of(name))
        error = theirs.std() * np.sqrt(1.0 / found.ess_bulk[name] + 1.0 / joint.ess_bulk[name])
        assert abs(ours.mean() - theirs.mean()) < 4.0 * error, name
        assert ours.std() == pytest.approx(theirs.std(), rel=0.3), name
