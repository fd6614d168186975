"""Drifts: what changes from grasp to grasp is told by repeats alone, whatever the simulator gets wrong."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from fast.models.gap.bank.bank import DEEPER_MM
from fast.models.gap.data import GapData
from fast.models.gap.fit.recalibrate import recalibrate
from fast.models.gap.grasps import Grasps
from fast.models.gap.naming.candidates import score_fit
from fast.models.gap.naming.decide import decide
from fast.models.gap.naming.drifts import (
    average_evidence,
    compute_contrast_r2,
    draw_drift,
    find_batches,
    find_strongest,
    rank_drifts,
    share_evidence,
)
from fast.models.gap.naming.name import NamingResult, name_effect
from fast.models.gap.naming.thresholds import Thresholds
from fast.models.records import EffectValue, GraspContext
from fast.models.simulation.effects.catalogue import list_confusable
from tests.synthetic.gap import made_up_gap

THETA = np.array([9.2, 0.66, 0.43])
LATE = ("friction_wear", "mullins_softening", "pressure_droop", "load_cell_drift", "load_cell_lag")
PERIOD = 60  # of what comes back, in grasps of the batch


def measure(change: Callable[[GapData, np.ndarray], np.ndarray] | None = None, seed: int = 3) -> GapData:
    """Made-up grasps whose forces change by so much (n x 120, N) with a saw tooth over the batch (n, 0 to 1)."""
    problem = made_up_gap(7, 7, seed)
    problem = replace(problem, grasps=replace(problem.grasps, contexts=make_rounds(problem.grasps)))
    made = np.array([context.batch_grasps for context in problem.grasps.contexts])
    saw = (made % PERIOD) / PERIOD
    steps_n = problem.grasps.steps_n
    changed_n = np.zeros_like(steps_n) if change is None else change(problem, saw)
    return replace(problem, grasps=replace(problem.grasps, steps_n=steps_n + changed_n))


def make_rounds(grasps: Grasps) -> tuple[GraspContext, ...]:
    """Tools one after the other, each in rounds of all objects: repeats of a cell lie a round apart."""
    n, n_rounds = len(grasps.objects), 1 + max(context.repeat for context in grasps.contexts)
    found = []
    for tool, obj, context in zip(grasps.tool, grasps.obj, grasps.contexts, strict=True):
        in_tool = n * context.repeat + int(obj)
        in_batch = n * n_rounds * int(tool) + in_tool
        found.append(context.model_copy(update={"tool_grasps": in_tool, "batch_grasps": in_batch}))
    return tuple(found)


def close_less(problem: GapData, saw: np.ndarray, most_mm: float = 1.0) -> np.ndarray:
    """Each jaw stays back by up to 1 mm."""
    surrogate, grasps = problem.surrogate, problem.grasps
    wider_n = surrogate.wider_n[grasps.tool, grasps.obj, 1] / (0.5 * surrogate.wider_mm[1])
    return np.asarray(THETA[0] / 10.0 * most_mm * saw[:, None] * wider_n)


def slip_more(problem: GapData, saw: np.ndarray) -> np.ndarray:
    """Friction is lower by up to 12 %."""
    less = problem.surrogate.predict_steps(THETA * [1.0, 0.88, 1.0]) - problem.surrogate.predict_steps(THETA)
    return np.asarray(saw[:, None] * less)


def move_zero(problem: GapData, saw: np.ndarray) -> np.ndarray:
    """The zero of the load cell moves by up to 0.3 N."""
    return np.asarray(np.repeat(0.3 * saw[:, None], problem.grasps.steps_n.shape[1], axis=1))


def soften(problem: GapData, saw: np.ndarray) -> np.ndarray:
    """The modulus is lower by up to 8 %."""
    return np.asarray(-0.08 * saw[:, None] * problem.surrogate.predict_steps(THETA))


def raise_objects(problem: GapData, saw: np.ndarray) -> np.ndarray:
    """Objects stand higher by up to 2 mm."""
    grasps, placed_n = problem.grasps, problem.bank.placed_steps_n
    per_mm = (placed_n[:, :, 1] - placed_n[:, :, 0]) / (DEEPER_MM[1] - DEEPER_MM[0])
    return np.asarray(THETA[0] / 10.0 * 2.0 * saw[:, None] * per_mm[grasps.tool, grasps.obj])


def name(problem: GapData, names: tuple[str, ...] = LATE) -> NamingResult:
    return name_effect(problem, (), catalogue=names)


@pytest.fixture(scope="module")
def slipping() -> NamingResult:
    return name(measure(slip_more))


@pytest.mark.parametrize("seed", [3, 4, 5])
def test_repeats_that_only_scatter_have_no_drift(seed: int) -> None:
    """Mesh, prints and placements differ from the simulator's; repeats scatter by 1 %."""
    fit = recalibrate(measure(seed=seed).training)
    drifts = rank_drifts(fit)
    score = score_fit(fit)
    assert average_evidence(drifts) < 1.0
    assert compute_contrast_r2(fit, score, score_fit(drifts[0].pattern.add_to(fit))) < 0.01


@pytest.mark.parametrize(
    ("change", "quantity", "most"),
    [
        (close_less, "closing", 1.0),
        (slip_more, "friction", -0.12),
        (move_zero, "zero", 0.3),
        (soften, "modulus", -0.08),
        (raise_objects, "height", 2.0),
    ],
)
def test_what_changes_is_told_and_by_how_much(
    change: Callable[[GapData, np.ndarray], np.ndarray], quantity: str, most: float
) -> None:
    fit = recalibrate(measure(change).training)
    drifts = rank_drifts(fit)
    assert drifts[0].quantity == quantity
    assert 3.0 < average_evidence(drifts) < drifts[0].nats
    law = draw_drift(fit, next(one for one in drifts if (one.quantity, one.clock) == (quantity, "batch")))
    true = most * (np.array(law.at) % PERIOD) / PERIOD
    assert 0.5 < np.polyfit(true, law.median, 1)[0] < 1.3  # in the unit of the quantity; what is little is drawn less


def test_shares_of_evidence_are_probabilities(slipping: NamingResult) -> None:
    drifts, names = slipping.tried.drifts, slipping.tried.names
    shares = share_evidence(drifts, names, 5.0)
    assert sum(shares.values()) == pytest.approx(1.0)
    assert list(shares.values()) == sorted(shares.values(), reverse=True)
    assert next(iter(shares)) == "friction_wear"
    assert share_evidence(drifts, names, 1.0)["friction_wear"] > shares["friction_wear"]
    assert share_evidence(drifts, (), 5.0) == {"": pytest.approx(1.0)}


def test_batches_drift_apart() -> None:
    """The zero moves up in the first batch and down in the second: a drift of each, drawn for the larger."""
    problem = measure()
    grasps = problem.grasps
    per_batch = 4 * 3 * len(grasps.objects)
    anew = tuple(c.model_copy(update={"batch_grasps": c.batch_grasps % per_batch}) for c in grasps.contexts)
    sign = np.where(grasps.tool < 4, 1.0, -1.0)
    zero_n = sign * 0.5 * np.array([context.batch_grasps for context in anew]) / per_batch
    moved = replace(grasps, contexts=anew, steps_n=grasps.steps_n + zero_n[:, None])
    fit = recalibrate(replace(problem, grasps=moved).training)
    best = rank_drifts(fit)[0]
    assert (best.quantity, best.clock, len(best.knots)) == ("zero", "batch", 2)
    larger = draw_drift(fit, best)
    assert larger.at[-1] == per_batch - 1
    assert 0.25 < larger.median[-1] < 0.7
    with_lag = recalibrate(replace(problem, grasps=moved).training, [EffectValue(effect="load_cell_lag")])
    again = draw_drift(with_lag, rank_drifts(with_lag)[0])
    np.testing.assert_allclose(again.median, larger.median, atol=0.1)


def test_what_falls_and_comes_back_is_drawn_as_that() -> None:
    """No law of the catalogue comes back; within its band the drift does, since it need not obey one."""
    fit = recalibrate(measure(lambda problem, saw: close_less(problem, saw, 1.5)).training)
    drift = next(one for one in rank_drifts(fit) if (one.quantity, one.clock) == ("closing", "batch"))
    law = draw_drift(fit, drift)
    assert law.quantity == "how far a jaw stays back, mm"
    assert law.state == "grasps of the batch before"
    at, median = np.array(law.at), np.array(law.median)
    assert median[0] == 0.0
    true_mm = 1.5 * (at % PERIOD) / PERIOD
    assert np.corrcoef(median, true_mm)[0, 1] > 0.7
    inside = (np.array(law.low) - 0.3 < true_mm) & (true_mm < np.array(law.high) + 0.3)
    assert inside.mean() > 0.7


def test_a_small_change_is_an_alarm_and_gets_the_name_of_its_quantity(slipping: NamingResult) -> None:
    """Of 1 % and less in the forces: too little for an effect, which solvers differ by as well."""
    found = slipping
    assert found.tried.is_told_by_drift(Thresholds())
    assert found.tried.measure_alarm(Thresholds()) > 1.0
    assert found.named.effects[0] == "friction_wear"
    assert found.named.drift.startswith("repeats of the same grasps differ, as if friction changed")
    assert found.named.law is not None
    assert found.named.law.quantity == "friction over that at first"
    assert found.named.probability == pytest.approx(found.judged.gap * found.judged.name)
    assert "friction_wear" in found.named.possible


def test_confusable_effects_with_evidence_of_their_own_are_reported_together(slipping: NamingResult) -> None:
    found = slipping
    strength = {effect: drift.nats for effect, drift in find_strongest(found.tried.drifts, found.tried.names).items()}
    assert max(strength, key=lambda effect: strength[effect]) == "friction_wear"
    kin = list_confusable("friction_wear")
    least = max(3.0, 0.2 * strength["friction_wear"])
    alone = {effect for effect, nats in strength.items() if effect in kin and nats > least}
    assert alone
    assert set(found.named.effects) == {"friction_wear", *alone}
    assert set(found.named.effects) <= set(found.named.possible)
    sure = replace(found.tried, drifts=[one for one in found.tried.drifts if one.effect not in alone])
    assert decide(sure, found.look, Thresholds()).decision.effects == ("friction_wear",)
    other = replace(found.tried, drifts=[one for one in found.tried.drifts if one.quantity == "height"])
    assert not other.is_told_by_drift(Thresholds())


def test_without_its_name_it_is_not_in_the_catalogue_and_told_in_words() -> None:
    found = name(measure(slip_more), ("mullins_softening", "load_cell_lag"))
    assert found.named.kind == "unknown"
    assert "as if friction changed" in found.named.sentence
    assert found.named.law is not None
    assert "unknown" in found.named.possible


def test_what_an_effect_of_the_model_changes_is_no_other_drift() -> None:
    problem = measure(slip_more)
    fit = recalibrate(problem.training, [EffectValue(effect="friction_wear")])
    drifts = rank_drifts(fit)
    assert all(drift.effect != "friction_wear" for drift in drifts)
    assert drifts[0].nats < 3.0


def test_without_repeats_there_is_no_drift() -> None:
    assert rank_drifts(recalibrate(made_up_gap(5, 5, 0, n_repeats=1).training)) == []


def test_every_batch_counts_its_grasps_anew() -> None:
    grasps = measure().grasps
    assert (find_batches(grasps) == 0).all()
    per_tool = 3 * len(grasps.objects)
    anew = [c.model_copy(update={"batch_grasps": c.batch_grasps % (3 * per_tool)}) for c in grasps.contexts]
    np.testing.assert_array_equal(find_batches(replace(grasps, contexts=tuple(anew))), grasps.tool // 3)
    # The first tool of the second batch is left out.
    some = replace(grasps, contexts=tuple(anew)).select(np.flatnonzero(grasps.tool != 3))
    np.testing.assert_array_equal(find_batches(some)[some.tool < 3], 0)
    assert len(set(find_batches(some)[some.tool > 5])) == 1
