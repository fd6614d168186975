import numpy as np
import pytest

from fast.models.errors import UsageError
from fast.models.gap.evaluation.evaluate import AFTER, BEFORE, Evaluation, evaluate, measure_change
from fast.models.gap.evaluation.held_out import (
    HeldOut,
    Prediction,
    PrintFactors,
    _intervals,
    add_scatter,
    compute_metrics,
)
from fast.models.gap.where.residuals import Residuals
from fast.models.records import EffectValue
from tests.studies.gap.baselines import predict_baselines
from tests.synthetic.gap import GapTruth, made_up_gap

LAG = EffectValue(effect="load_cell_lag", parameters={"time_constant_s": 0.3})


@pytest.fixture(scope="module")
def world() -> tuple[HeldOut, Prediction, Prediction, Residuals]:
    truth = GapTruth(effects=(LAG,))
    data = made_up_gap(10, 9, 0, truth, held_out=(3, 3))
    theta = np.array(list(truth.theta.model_dump().values()))
    before, after = data.held_out.predict_steps(theta), data.held_out.predict_steps(theta, [LAG])
    held_out = HeldOut.of(data, truth.theta)
    residuals = Residuals.of(data.training, data.training.predict_steps(theta), truth.theta.young_modulus_mpa)
    return held_out, Prediction(BEFORE, before), Prediction(AFTER, after), residuals


@pytest.fixture(scope="module")
def evaluation(world: tuple[HeldOut, Prediction, Prediction, Residuals]) -> Evaluation:
    held_out, before, after, _ = world
    return evaluate(held_out, before, after)


def test_what_is_held_out_is_not_learned_from(world: tuple[HeldOut, Prediction, Prediction, Residuals]) -> None:
    held_out, _, _, residuals = world
    assert not set(held_out.tool[held_out.is_new_tool]) & set(residuals.tool)
    assert not set(held_out.obj[held_out.is_new_object]) & set(residuals.obj)
    assert len(held_out.tool) + len(residuals.tool) == 10 * 9 * 3


def test_the_right_effect_closes_most_of_the_gap(evaluation: Evaluation) -> None:
    gap = evaluation.gap
    assert gap.rmse_floor_n < gap.rmse_after_n < gap.rmse_before_n
    assert gap.closed_fraction == pytest.approx(
        (gap.rmse_before_n - gap.rmse_after_n) / (gap.rmse_before_n - gap.rmse_floor_n)
    )
    assert 0.5 < gap.ci95[0] < gap.closed_fraction < gap.ci95[1] <= 1.0


def test_what_has_no_pattern_is_no_part_of_the_gap(world: tuple[HeldOut, Prediction, Prediction, Residuals]) -> None:
    held_out, before, after, _ = world
    usual, higher = (evaluate(held_out, before, after, patternless_n=least).gap for least in (0.0, 0.3))
    assert usual.rmse_floor_n < 0.3 == higher.rmse_floor_n < usual.rmse_before_n
    share = (usual.rmse_before_n - usual.rmse_after_n) / (usual.rmse_before_n - 0.3)
    assert higher.closed_fraction == pytest.approx(min(share, 1.0))
    assert higher.closed_fraction > usual.closed_fraction


def test_no_change_closes_nothing_and_harm_is_negative(
    world: tuple[HeldOut, Prediction, Prediction, Residuals],
) -> None:
    held_out, before, after, _ = world
    assert evaluate(held_out, before, before).gap.closed_fraction == 0.0
    worse = evaluate(held_out, after, before)
    assert worse.gap.closed_fraction < 0.0
    assert any("got worse" in warning for warning in worse.warnings)


def test_only_what_helps_whatever_was_held_out_is_a_gain(
    world: tuple[HeldOut, Prediction, Prediction, Residuals],
) -> None:
    held_out, before, after, _ = world
    better = measure_change(held_out, before.steps_n, after.steps_n)
    prints = [PrintFactors.of(held_out, p.steps_n).factor[:, None] for p in (before, after)]
    left_n = [held_out.measured_n - own * p.steps_n for own, p in zip(prints, (before, after), strict=True)]
    errors = [float(np.sqrt((one**2).mean())) for one in left_n]
    assert [better.before_n, better.after_n] == pytest.approx(errors)
    low, high = better.ci90_n
    assert low < errors[1] - errors[0] < high < 0.0
    assert better.is_gain
    assert not measure_change(held_out, before.steps_n, before.steps_n).is_gain
    worse = measure_change(held_out, after.steps_n, before.steps_n)
    assert worse.ci90_n == pytest.approx((-high, -low))
    assert not worse.is_gain
    # A gain of one object that another pays for.
    of_one = held_out.obj == held_out.obj[0]
    lucky = np.where(of_one[:, None], after.steps_n, before.steps_n)
    lucky[held_out.obj == held_out.obj[-1]] += 0.6
    assert not measure_change(held_out, before.steps_n, lucky).is_gain
    assert f"goes from {worse.before_n:.3g} to {worse.after_n:.3g} N, a change of +" in worse.sentence


def test_machines_without_a_name_learn_on_the_same_split_and_help(
    world: tuple[HeldOut, Prediction, Prediction, Residuals], evaluation: Evaluation
) -> None:
    held_out, before, _, residuals = world
    errors_n = [compute_metrics(held_out, p).rmse_n for p in predict_baselines(residuals, held_out, before.steps_n)]
    assert len(errors_n) == 2
    assert max(errors_n) < evaluation.of(BEFORE).rmse_n
    assert {m.block for m in evaluation.metrics} == {"all held out", "new designs", "new objects", "both new"}


def test_metrics_of_a_known_error(world: tuple[HeldOut, Prediction, Prediction, Residuals]) -> None:
    held_out, _, _, _ = world
    found = compute_metrics(held_out, Prediction("exact but for 0.2 N", held_out.measured_n - 0.2))
    assert found.rmse_n == pytest.approx(0.2)
    assert found.peak_bias_n == pytest.approx(0.2)
    assert found.work_error_j == pytest.approx(0.2 * 60.0 / 1e3)
    assert found.rank_by_design == pytest.approx(1.0)
    assert found.coverage_90 is None


def test_intervals_that_know_the_scatter_cover_nine_in_ten(
    world: tuple[HeldOut, Prediction, Prediction, Residuals],
) -> None:
    held_out, _, after, _ = world
    draws = np.repeat(after.steps_n[None], 3, axis=0)
    relative_sd = np.full(len(held_out.tool), np.sqrt(0.04**2 + 0.03**2 + 0.01**2))
    found = compute_metrics(held_out, add_scatter(AFTER, draws, held_out, relative_sd, noise_sd_n=0.08))
    assert found.coverage_90 == pytest.approx(0.9, abs=0.08)
    assert found.width_90_n is not None
    assert found.width_90_n > 0


def test_nothing_held_out_is_said() -> None:
    with pytest.raises(UsageError, match="no grasp is held out"):
        HeldOut.of(made_up_gap(5, 4, 0), GapTruth().theta)


def test_intervals_are_judged_where_there_is_force() -> None:
    """More than 5 % of the largest force of the grasp, of either sign."""
    predicted = np.array([[10.0, 0.5, 0.6, -3.0], [1.0, 0.04, -0.06, 0.0]])
    off = np.array([[0.0, 99.0, 1.6, 1.7], [0.0, 99.0, 0.0, 99.0]])
    sd = np.array([[1.0, 50.0, 1.0, 1.0], [2.0, 50.0, 5.0, 50.0]])
    share, width_n = _intervals(predicted + off, predicted, sd)
    assert share == pytest.approx(4 / 5)
    assert width_n == pytest.approx(2 * 1.6449 * 2.0, rel=1e-4)
    assert _intervals(predicted, predicted, None) == (None, None)
