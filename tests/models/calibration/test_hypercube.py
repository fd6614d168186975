import numpy as np
import pytest

from fast.models.calibration.inference.settings import CalibrationSettings
from fast.models.calibration.means.checks import is_held_out, score
from fast.models.calibration.means.hypercube import HypercubePlan, draw_hypercube
from fast.models.calibration.means.predict import predict_simulated
from fast.models.calibration.means.problem import THETA_LOWER, THETA_UPPER
from fast.models.calibration.means.trend import FRICTION_OFFSET
from fast.models.design.space import PARAMETERS, RIB_COUNT_COLUMN, to_unit
from tests.synthetic.calibration import Truth, make_up_problem
from tests.tasks.calibration.calibration_lake import made_up_result


def columns(plan):
    points = draw_hypercube(plan)
    theta = np.array([list(p.theta.model_dump().values()) for p in points])
    return to_unit([p.design for p in points]), theta


@pytest.mark.parametrize("spread", ["uniform", "log-uniform"])
def test_every_column_has_one_point_in_each_nth_of_its_range(spread):
    n = 50
    x, theta = columns(HypercubePlan(n=n, spread=spread, seed=2))
    lower, upper = THETA_LOWER.copy(), THETA_UPPER.copy()
    if spread == "log-uniform":
        for values in (theta[:, :2].T, lower[:2], upper[:2]):
            values[0], values[1] = np.log(values[0]), np.log(values[1] + FRICTION_OFFSET)
    theta = (theta - lower) / (upper - lower)
    unit = np.column_stack([x, theta])
    for place in range(unit.shape[1]):
        if place != RIB_COUNT_COLUMN:
            # Rounding of theta to six digits moves a point by less than this.
            assert sorted(np.floor(unit[:, place] * n + 1e-3)) == list(range(n)), place
    counts = np.bincount(np.round(9 * x[:, RIB_COUNT_COLUMN]).astype(int), minlength=10)
    assert counts.tolist() == [5] * 10


def test_a_plan_is_the_same_whenever_asked_and_another_is_another():
    plan = HypercubePlan(n=30, seed=1)
    assert draw_hypercube(plan) == draw_hypercube(HypercubePlan(n=30, seed=1))
    assert len({p.design.design_id for p in draw_hypercube(plan) + draw_hypercube(HypercubePlan(n=31, seed=1))}) == 61
    assert plan.plan_id != HypercubePlan(n=30, seed=1, spread="uniform").plan_id


def test_no_point_is_incompressible():
    assert max(p.theta.poisson_ratio for p in draw_hypercube(HypercubePlan(n=5000))) < 0.4999


def test_one_design_of_each_five_is_held_out_and_stays_so():
    names = [f"D{number}" for number in range(42)]
    few, more = is_held_out(names[:20], seed=3), is_held_out(names, seed=3)
    assert few.sum() == 4
    assert few.reshape(4, 5).sum(axis=1).tolist() == [1] * 4
    assert np.array_equal(few, more[:20])
    assert not np.array_equal(more, is_held_out(names, seed=4))
    assert not is_held_out(names[:9], seed=3).any()  # too few to spare one
    twice = is_held_out([*names[:20], names[int(np.argmax(few))], names[0]], seed=3)
    assert twice[20]  # another print of a held-out design


def test_scores_of_few_or_constant_forces_have_no_correlation():
    measured = np.array([1.0, 2.0, 4.0])
    assert score(measured + 1.0, measured).correlation == pytest.approx(1.0)
    assert score(measured + 1.0, measured).rmse_n == pytest.approx(1.0)
    assert score(measured[:2], measured[:2]).correlation is None
    assert score(np.ones(3), measured).correlation is None


@pytest.mark.parametrize("scales", [True, False])
def test_the_emulator_predicts_the_simulator_at_any_theta(scales):
    problem = make_up_problem(400, 20, 1, Truth(discrepancy=0.0, noise_sd_n=0.0), scales_with_modulus=scales)
    result = made_up_result(problem, CalibrationSettings(chains=2, draws=50))
    x, y = problem.x_real, problem.y_real
    at_truth = score(predict_simulated(problem, result, x, np.array(Truth().theta)).mean, y)
    elsewhere = score(predict_simulated(problem, result, x, np.array([20.0, 0.2, 0.25])).mean, y)
    assert at_truth.correlation > 0.9
    assert at_truth.rmse_n < 0.6 * elsewhere.rmse_n


def test_every_design_of_a_plan_is_legal():
    for point in draw_hypercube(HypercubePlan(n=300, seed=5)):
        assert set(point.design.model_dump()) == set(PARAMETERS)
