"""Freedom of laws: what a fit grants an effect for another law, and what that does to parameters and curves."""

import numpy as np
import pytest

from fast.models.gap.fit.fit import Fit, axes_of
from fast.models.gap.fit.law_freedom import (
    LAW_SD,
    N_KNOTS,
    LawFreedom,
    compute_law_curve,
    estimate_freed_parameters,
    free_law,
    solve_step,
)
from fast.models.gap.fit.recalibrate import recalibrate
from fast.models.records import EffectValue, GraspContext, GraspSetup, Theta
from fast.models.simulation.effects.actuation import LiftStartError, PressureDroop
from fast.models.simulation.effects.catalogue import CATALOGUE
from fast.models.simulation.effects.contact import FrictionWear, StaticKineticFriction
from fast.models.simulation.effects.material import MullinsSoftening, TemperatureSoftening
from tests.synthetic.gap import GapTruth, made_up_gap

LAG = EffectValue(effect="load_cell_lag", parameters={"time_constant_s": 0.35})
OFFSET = EffectValue(effect="load_cell_offset", parameters={"offset_n": 0.3})


@pytest.fixture(scope="module")
def fit() -> Fit:
    """Grasps that lag and have an offset, by the catalogue's laws, with both in the model."""
    data = made_up_gap(7, 7, 20, GapTruth(effects=(LAG, OFFSET)), n_repeats=2)
    return recalibrate(data.training, [LAG, OFFSET])


def test_a_freed_law_is_columns_with_a_prior(fit: Fit) -> None:
    """Before those of the parameters; at its best without them a fit does not move."""
    freed = free_law(fit, "load_cell_lag")
    place = len(fit.columns) - fit.n_effect_columns
    assert len(freed.columns) == len(fit.columns) + N_KNOTS
    assert np.array_equal(freed.columns[-fit.n_effect_columns :], fit.columns[-fit.n_effect_columns :])
    assert freed.precision[place : place + N_KNOTS] == pytest.approx(LAW_SD**-2.0)
    assert np.abs(solve_step(freed)[place : place + N_KNOTS]).max() > 0.0
    assert freed.raw is fit.raw


def test_a_law_apart_does_nothing_that_its_parameters_do(fit: Fit) -> None:
    """Its columns are those of the free law less what a change of the parameters makes of them."""
    free, apart = free_law(fit, "load_cell_lag"), free_law(fit, "load_cell_lag", is_apart=True)
    place = len(fit.columns) - fit.n_effect_columns
    own = apart.columns[place + N_KNOTS].ravel()
    law, whole = (one.columns[place : place + N_KNOTS].reshape(N_KNOTS, -1) for one in (apart, free))
    assert np.abs(law @ own).max() < 1e-6 * (own @ own)
    assert np.abs(whole @ own).max() > 1e-2 * (own @ own)
    lost = whole - law
    assert np.abs(lost - np.outer(lost @ own / (own @ own), own)).max() < 1e-6 * np.abs(own).max()


def test_a_law_may_differ_by_so_much_at_every_state(fit: Fit) -> None:
    """The prior of h is as wide as said at the knots, and smooth between them."""
    freedom = LawFreedom.of(fit, "load_cell_lag")
    assert freedom is not None
    assert (freedom.basis(freedom.knots) ** 2).sum(axis=0) == pytest.approx(1.0, abs=1e-3)
    middle = 0.5 * (freedom.knots[1:] + freedom.knots[:-1])
    assert (freedom.basis(middle) ** 2).sum(axis=0).min() > 0.95


def test_a_plain_number_has_no_law(fit: Fit) -> None:
    """A zero that is off stays one."""
    assert free_law(fit, "load_cell_offset") is fit
    assert compute_law_curve(fit, "load_cell_offset") is None


def test_freedom_widens_an_interval_so_that_it_holds(fit: Fit) -> None:
    """The lag is the catalogue's, but meshes differ: without freedom its interval misses the truth."""
    (axis,) = axes_of("load_cell_lag")
    before_s = 2.0 * 1.645 * axis.sd * np.sqrt(fit.covariance[-2, -2])
    (after,) = estimate_freed_parameters(fit, "load_cell_lag").values()
    assert after.median == fit.effects[0].parameters["time_constant_s"]
    assert np.ptp(after.ci90) > 1.5 * before_s
    assert abs(after.median - 0.35) > 0.5 * before_s
    assert after.ci90[0] < 0.35 < after.ci90[1]


def test_the_curve_of_a_law_holds_the_truth_and_not_everything(fit: Fit) -> None:
    """A delay of 0.35 s at most lifts, and never none nor twice as much."""
    curve = compute_law_curve(fit, "load_cell_lag")
    assert curve is not None
    assert (curve.quantity, curve.state) == ("delay of the load cell, s", "lift, mm")
    low, high = np.array(curve.low), np.array(curve.high)
    assert ((low < 0.35) & (high > 0.35)).mean() > 0.6
    assert low.min() > 0.1
    assert high.max() < 0.7


def test_states_are_of_effects_and_have_an_inverse() -> None:
    """On an axis that is linear first and logarithmic beyond."""
    assert all(spec.state for spec in CATALOGUE.values() if spec.quantity)
    assert all(spec.kind.overrides("law") == (spec.quantity is not None) for spec in CATALOGUE.values())
    for state in (spec.state for spec in CATALOGUE.values() if spec.state):
        values = np.array([0.0, 0.3, 2.0, 50.0])
        assert state.state_at(state.place(values)) == pytest.approx(values)


def test_quantities_are_the_laws_of_the_catalogue() -> None:
    """Each against the effect itself."""
    at, theta, setup = np.array([0.0, 1.0, 7.0]), Theta(), GraspSetup()
    tool = made_up_gap(1, 1, 0).grasps.designs[0]

    slip = StaticKineticFriction(0.7, 2.0)
    assert slip.law(at) == pytest.approx(slip.friction_factor(at, at))
    start = LiftStartError(0.2, 0.3, 2.0)
    behind = start.behind_mm(at / setup.lift_speed_mm_per_s, setup.lift_speed_mm_per_s)
    assert start.law(at) == pytest.approx(behind)
    contexts = [GraspContext(repeat=int(n), tool_grasps=int(n), batch_grasps=int(n), clock_s=3600.0 * n) for n in at]
    for effect in (MullinsSoftening(0.2, 3.0), TemperatureSoftening(0.2, 3000.0)):
        moduli = [effect.in_grasp(tool, setup, c).modify_theta(theta, tool).young_modulus_mpa for c in contexts]
        assert effect.law(at) == pytest.approx(np.array(moduli) / theta.young_modulus_mpa)
    wear, droop = FrictionWear(0.3, 20.0), PressureDroop(0.5, 30.0)
    factors = [wear.in_grasp(tool, setup, c).friction_factor(at, at) for c in contexts]
    assert wear.law(at) == pytest.approx(np.array(factors))
    gaps = [droop.in_grasp(tool, setup, c).modify_setup(setup, tool).closed_gap_mm for c in contexts]
    assert droop.law(at) == pytest.approx(0.5 * (np.array(gaps) - setup.closed_gap_mm))
