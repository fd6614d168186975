"""Which algorithm a calibration uses, what it says about bad input and doubtful posteriors."""

import dataclasses
import re

import numpy as np
import pytest

from fast.models.calibration.inference.result import CalibrationResult, SamplerCounts, make_result
from fast.models.calibration.inference.settings import CalibrationSettings, read_settings
from fast.models.calibration.inference.summary import check_convergence, check_quality, summarise_theta
from fast.models.calibration.means import calibrate as choice
from fast.models.calibration.means.calibrate import calibrate
from fast.models.calibration.means.parameters import Parameters
from fast.models.calibration.means.problem import THETA, Standardised, drop_repeats
from fast.models.errors import UsageError
from fast.models.units import spell_share
from tests.synthetic.calibration import draw_prior, make_up_problem

SETTINGS = CalibrationSettings(chains=2, draws=1000, tune=50)
PROBLEM = make_up_problem(40, 10, seed=0)
NAMES = ("rho", *THETA)


def made_up_result(method, k_hat=None, ess=1500.0):
    sizes = dict.fromkeys(THETA, ess)
    draws = np.ones((2, 1000, 3))
    return CalibrationResult(
        names=THETA,
        draws=draws,
        settings=SETTINGS,
        method=method,
        r_hat=dict.fromkeys(THETA, 1.0),
        ess_bulk=sizes,
        ess_tail=sizes,
        n_divergences=0,
        k_hat=k_hat,
        warnings=("own",),
        cpu_s=2.0,
        steps={"step": 2.0},
    )


def calibrate_with(monkeypatch, factorised, problem=PROBLEM, settings=SETTINGS, longer=None):
    used = []

    def by(method, problem, settings, progress, length=1):
        used.append(method if length == 1 else f"{length} times {method}")
        if method == "factorised":
            return factorised if length == 1 else longer
        return made_up_result(method)

    monkeypatch.setattr(choice, "_by", by)
    return calibrate(problem, settings), used


def test_a_factorised_result_with_good_weights_is_kept(monkeypatch):
    result, used = calibrate_with(monkeypatch, made_up_result("factorised", k_hat=0.3))
    assert used == ["factorised"]
    assert result.warnings == ("own",)


@pytest.mark.parametrize(
    ("k_hat", "ess", "why"),
    [(1.08, 1500.0, "importance weights cannot be trusted .k-hat 1.08"), (0.3, 14.0, "bulk ESS 14, at least 200")],
)
def test_bad_weights_fall_back_to_the_joint_sampler_and_say_so(monkeypatch, k_hat, ess, why):
    result, used = calibrate_with(monkeypatch, made_up_result("factorised", k_hat, ess))
    assert used == ["factorised", "joint"]
    assert result.method == "joint"
    assert (result.cpu_s, result.k_hat) == (4.0, k_hat)
    assert re.search(why, result.warnings[0])
    assert result.warnings[1:] == ("own",)


def test_the_fallback_draws_no_more_than_it_needs(monkeypatch):
    asked = []

    def by(method, problem, settings, progress, length=1):
        asked.append((method, settings.draws, settings.tune))
        return made_up_result(method, k_hat=1.0)

    monkeypatch.setattr(choice, "_by", by)
    calibrate(PROBLEM, CalibrationSettings(chains=4, draws=8000, tune=8000))
    assert asked == [("factorised", 8000, 8000), ("joint", 1400, 600)]


def test_r_hat_is_that_of_the_chains_that_were_drawn():
    rng = np.random.default_rng(0)
    resampled = np.exp(rng.normal(size=(4, 500, 4)))
    names = ("sd_h", *THETA)
    chains = rng.normal(size=(4, 500, 3))
    chains[0, :, 1] += 3.0  # one chain is elsewhere in friction, which the weights have hidden
    result = make_result(PROBLEM, names, resampled, SETTINGS, "factorised", SamplerCounts(), chains)
    assert result.r_hat["friction"] > 1.4
    assert max(result.r_hat[name] for name in names if name != "friction") < 1.02
    assert any("friction" in sentence for sentence in result.warnings)


def test_a_large_problem_with_bad_weights_has_not_converged_and_is_not_replaced(monkeypatch):
    large = make_up_problem(600, 10, seed=0)
    result, used = calibrate_with(monkeypatch, made_up_result("factorised", 0.9), large)
    assert used == ["factorised"]
    assert re.search(
        r"not converged: .*k-hat 0.90, .* simulate more designs, or give --method joint", check_quality(result)
    )


def test_short_chains_of_a_large_problem_are_sampled_again_and_what_is_still_short_is_refused(monkeypatch):
    large, short = make_up_problem(600, 10, seed=0), made_up_result("factorised", 0.3, ess=14.0)
    enough, used = calibrate_with(monkeypatch, short, large, longer=made_up_result("factorised", 0.3))
    assert used == ["factorised", "3 times factorised"]
    assert (enough.warnings, enough.cpu_s, enough.k_hat) == (("own",), 4.0, 0.3)
    assert enough.steps == {"short chains step": 2.0, "step": 2.0}
    assert check_convergence(enough) == ""
    still_short, used = calibrate_with(monkeypatch, short, large, longer=made_up_result("factorised", 0.3, ess=150.0))
    assert used == ["factorised", "3 times factorised"]
    assert re.search(
        "not converged .*bulk ESS 150, at least 200.*give more --tune and --draws", check_quality(still_short)
    )
    assert still_short.cpu_s == 4.0


def test_a_chosen_method_is_used(monkeypatch):
    settings = SETTINGS.model_copy(update={"method": "joint"})
    assert calibrate_with(monkeypatch, made_up_result("factorised"), settings=settings)[1] == ["joint"]


def test_rows_entered_twice_are_left_out_and_told(monkeypatch):
    twice = dataclasses.replace(
        PROBLEM,
        x_sim=np.vstack([PROBLEM.x_sim, PROBLEM.x_sim[:2]]),
        theta_sim=np.vstack([PROBLEM.theta_sim, PROBLEM.theta_sim[:2]]),
        y_sim=np.append(PROBLEM.y_sim, [PROBLEM.y_sim[0], 99.0]),
        variance_sim=np.append(PROBLEM.variance_sim, PROBLEM.variance_sim[:2]),
    )
    fewer, sentences = drop_repeats(twice)
    assert fewer.n_sim == 41
    np.testing.assert_array_equal(fewer.y_sim, np.append(PROBLEM.y_sim, 99.0))
    assert sentences == (
        "1 of 42 simulations repeat another in design and force (the first is row 40) and were left out; "
        "check whether they were entered twice.",
    )
    result, _ = calibrate_with(monkeypatch, made_up_result("factorised", k_hat=0.3), twice)
    assert result.warnings == (*sentences, "own")
    assert drop_repeats(PROBLEM) == (PROBLEM, ())


@pytest.mark.parametrize(
    ("changes", "match"),
    [
        ({"y_sim": np.full(40, 3.0)}, "all simulated forces are 3 N; a calibration needs forces that vary"),
        ({"y_real": np.full(10, 2.0)}, "all measured forces are 2 N"),
        ({"y_real": np.array([1.0, np.nan, *range(8)])}, "row 1 of y_real is not finite; leave that design out"),
        ({"theta_sim": np.zeros((40, 3))}, "Young's modulus of 0 MPa or less"),
        ({"x_real": np.zeros((10, 8))}, r"x_real has shape \(10, 8\); give \(10, 9\)"),
        ({"variance_sim": np.full(40, -1.0)}, "a known variance is negative"),
    ],
)
def test_bad_input_is_refused_in_a_sentence(changes, match):
    with pytest.raises(UsageError, match=match):
        dataclasses.replace(PROBLEM, **changes)


@pytest.mark.parametrize(("n_sim", "n_real", "match"), [(19, 10, "19 simulations, it .* 20"), (40, 4, "4 measured")])
def test_too_few_designs_are_refused(n_sim, n_real, match):
    with pytest.raises(UsageError, match=match):
        make_up_problem(n_sim, n_real, seed=0)


def some_draws(seed=0, **columns):
    """Independent draws of rho and theta well inside the simulated range, some columns replaced: 2 x 1500 x 4."""
    rng = np.random.default_rng(seed)
    found = {
        "rho": rng.normal(1.0, 0.1, 3000),
        "young_modulus_mpa": 20.0 * np.exp(0.1 * rng.standard_normal(3000)),
        "friction": rng.normal(0.8, 0.05, 3000),
        "poisson_ratio": rng.normal(0.35, 0.02, 3000),
    }
    found |= {name: column(rng, found) for name, column in columns.items()}
    return np.stack([found[name].reshape(2, 1500) for name in NAMES], axis=-1)


def test_sound_draws_raise_no_doubt():
    found = make_result(PROBLEM, NAMES, some_draws(), SETTINGS, "joint", SamplerCounts())
    assert found.warnings == ()
    assert all(0.99 < r_hat < 1.01 for r_hat in found.r_hat.values())
    assert all(2000 < size < 4500 for size in found.ess_bulk.values())


@pytest.mark.parametrize(
    ("columns", "n_divergences", "sentence"),
    [
        ({}, 7, "7 of 3000 draws diverged: .* raise target_accept above 0.9"),
        ({"friction": lambda rng, found: np.repeat([0.7, 0.9], 1500) + rng.normal(0, 0.03, 3000)}, 0,
         "R-hat of friction is .*, above 1.01: the chains do not agree yet"),
        ({"friction": lambda rng, found: 0.8 + 0.01 * np.tile(np.sin(np.arange(1500) / 30), 2)}, 0,
         "bulk effective sample size of friction is .*, below 1000"),
        ({"young_modulus_mpa": lambda rng, found: 1.5 + 0.05 * rng.standard_normal(3000)}, 0,
         "100 % of the posterior of Young's modulus lies outside the simulated range .* MPa.*simulate a wider range"),
        ({"poisson_ratio": lambda rng, found: 0.495 - 0.003 * rng.random(3000)}, 0,
         "100 % of the posterior of Poisson's ratio piles up at the upper end of the simulated range"),
        ({"poisson_ratio": lambda rng, found: rng.uniform(0.2, 0.5, 3000)}, 0,
         "say little about Poisson's ratio: posterior and prior overlap by 9. %"),
        ({"rho": lambda rng, found: 0.8 / found["friction"]}, 0,
         "rho and friction are correlated by -1.00: .* fix rho"),
    ],
)  # fmt: skip
def test_every_problem_of_the_draws_is_said(columns, n_divergences, sentence):

    found = make_result(PROBLEM, NAMES, some_draws(**columns), SETTINGS, "joint", SamplerCounts(n_divergences))
    assert any(re.search(sentence, said) for said in found.warnings), found.warnings


def test_the_range_of_a_factor_is_no_range():
    problem = make_up_problem(40, 10, seed=0, scales_with_modulus=True)
    draws = some_draws(young_modulus_mpa=lambda rng, found: 1.5 + 0.05 * rng.standard_normal(3000))
    assert make_result(problem, NAMES, draws, SETTINGS, "joint", SamplerCounts()).warnings == ()


def test_the_overlap_that_is_warned_of_is_that_of_the_summary():
    draws = some_draws(poisson_ratio=lambda rng, found: rng.uniform(0.2, 0.5, 3000))
    result = make_result(PROBLEM, NAMES, draws, SETTINGS, "joint", SamplerCounts())
    shown = spell_share(summarise_theta(result)["poisson_ratio"].overlap)
    assert [said for said in result.warnings if f"posterior and prior overlap by {shown};" in said]


@pytest.mark.parametrize("rho", ["fixed", "free"])
def test_vectors_become_parameters_in_their_units(rho):
    data = Standardised.of(PROBLEM)
    parameters = Parameters.of(data, CalibrationSettings(rho=rho))
    vector = draw_prior(parameters, np.random.default_rng(0))
    row = dict(zip(parameters.names, parameters.constrain(vector, data.force_scale_n), strict=True))
    phi, psi = parameters.phi(vector[: parameters.n_phi]), parameters.psi(vector[parameters.n_phi :])
    assert row["sd_h"] == phi.sd
    assert row["noise_sd_n"] == pytest.approx(psi.noise_sd * data.force_scale_n)
    assert row.get("rho", 1.0) == psi.rho
    assert [row[name] for name in THETA] == pytest.approx(list(psi.theta))
    np.testing.assert_allclose(parameters.unconstrained_theta(psi.theta), vector[-3:])


def test_settings_that_an_older_version_stored_are_read():
    stored = read_settings('{"method": "blocked", "print_scatter": 0.05, "gone": 1}')
    assert (stored.method, stored.print_scatter) == ("auto", 0.05)
