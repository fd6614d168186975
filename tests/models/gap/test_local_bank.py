"""The bank around a fitted theta: where it lies, when it moves, and which effects it holds."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from fast.models.calibration.traces.response_surface import ResponseSurfaces, n_terms
from fast.models.calibration.traces.theta_grid import ThetaGrid
from fast.models.gap.bank.bank import (
    CENTRE,
    CLOSED_LESS,
    NUMERICAL,
    SIMULATED,
    WIDE,
    BankPlan,
    carry_changes,
    list_versions,
)
from fast.models.gap.data import GapData
from fast.models.gap.findings import Candidate
from fast.models.gap.fit.recalibrate import recalibrate
from fast.models.gap.local_bank import (
    MOST_EFFECTS,
    MOST_RUNS,
    add_runs,
    choose_bank,
    has_left,
    move_bank,
    name_locally,
)
from fast.models.records import EffectValue, Theta
from fast.models.simulation.effects.catalogue import CATALOGUE
from fast.models.simulation.version import SimulatorVersion
from tests.synthetic.gap import GapTruth, made_up_gap, made_up_steps, with_bank

THETA = np.array([9.23456, 0.61341, 0.43219])


def fit(theta: np.ndarray, sd: float = 0.01, effects: tuple[str, ...] = ()) -> Any:
    values = tuple(EffectValue(effect=name, parameters={}) for name in effects)
    return SimpleNamespace(theta=theta, deflated_covariance=np.diag([0.01, sd, sd]) ** 2, effects=values)


def friction(kinetic_ratio: float, slip_scale_mm: float) -> EffectValue:
    parameters = {"kinetic_ratio": kinetic_ratio, "slip_scale_mm": slip_scale_mm}
    return EffectValue(effect="static_kinetic_friction", parameters=parameters)


def naming(base: Any, best: Any, r2: dict[str, float], drift: str = "") -> Any:
    """What the choice of a bank looks at."""
    rows = [Candidate(effect=name, probability=0.1, nats=value) for name, value in r2.items()]
    return SimpleNamespace(fit=base, best=best, candidates=tuple(rows), named=SimpleNamespace(drift=drift))


def test_the_wide_bank_is_the_default() -> None:
    assert (WIDE.centre, WIDE.grid, WIDE.effects) == (CENTRE, ThetaGrid(), SIMULATED)
    assert len(list_versions(SimulatorVersion())) == 12 + 1 + len(NUMERICAL) + sum(
        len(spec.bank_runs) for spec in CATALOGUE.values()
    )


def test_a_bank_around_theta_has_its_modulus_and_few_points() -> None:
    plan = BankPlan.around(THETA, THETA[None, 1:], ("shear_adhesion",))
    assert plan.centre.model_dump() == {"young_modulus_mpa": 9.03, "friction": 0.6, "poisson_ratio": 0.44}
    assert plan.centre in plan.grid_thetas  # so that it is simulated once
    assert plan.grid.friction == pytest.approx((0.8 * 0.6, 1.2 * 0.6))
    assert plan.grid.poisson_ratio == pytest.approx((0.4, 0.48))
    versions = list_versions(SimulatorVersion(), plan)
    assert len(versions) == 5 + 1 + len(CATALOGUE["shear_adhesion"].bank_runs)
    assert {version.theta.young_modulus_mpa for version in versions} == {9.03}


def test_searches_that_nearly_agree_on_theta_share_a_bank() -> None:
    middle = np.array([9.1, 0.6, 0.42])
    plan = BankPlan.around(middle, middle[None, 1:], ())
    for share in (0.98, 0.99, 1.01, 1.02):
        assert BankPlan.around(middle * share, middle[None, 1:] * share, ()) == plan
    drawn = np.random.default_rng(0).uniform([3.0, 0.35, 0.3], [20.0, 0.95, 0.46], (200, 3))
    for theta in drawn:
        centre = np.array(list(BankPlan.around(theta, theta[None, 1:], ()).centre.model_dump().values()))
        assert (np.abs(centre - theta) < [0.055 * theta[0], 0.0201, 0.0101]).all()


def test_theta_is_in_the_middle_of_its_cross_wherever_it_must_reach() -> None:
    plan = BankPlan.around(THETA, np.array([[0.613, 0.432], [0.42, 0.44]]), ())
    assert plan.grid.friction == pytest.approx((0.6 - 0.12 * 1.25**2, 0.6 + 0.12 * 1.25**2))
    assert plan.centre in plan.grid_thetas
    assert len(plan.grid.points) == 5


def test_a_cross_carries_a_curve_in_friction_and_a_line_in_poisson_ratio() -> None:
    grid = np.array(ThetaGrid((0.4, 0.8), (0.38, 0.46), 3, 3, is_cross=True).points)
    values = 2.0 + 3.0 * grid[:, 0] ** 2 - 4.0 * grid[:, 1]
    at = (np.array([0.5, 0.75]), np.array([0.39, 0.45]))
    found = ResponseSurfaces.fitted(grid, values[None, None, :, None], np.ones((1, 1), bool), 10.0, np.ones(1, bool))
    assert n_terms(grid) == 4
    assert found.rows(*at) @ found.coefficients[0, 0, :, 0] == pytest.approx(2.0 + 3.0 * at[0] ** 2 - 4.0 * at[1])
    assert found.error[0, 0, 0, 0] == pytest.approx(0.0, abs=1e-12)


def test_what_a_variant_changes_goes_with_the_force() -> None:
    from_n, to_n = np.full((1, 2, 4), 2.0), np.full((1, 2, 4), 3.0)
    variants = from_n[:, :, None] + np.array([0.2, -0.4])[:, None]
    carried = carry_changes(variants, from_n, to_n)
    assert carried[0, 0, :, 0] == pytest.approx([3.3, 2.4])


def test_no_bank_is_beyond_the_wide_one() -> None:
    plan = BankPlan.around(np.array([9.0, 0.1, 0.499]), np.array([[0.05, 0.55]]), ())
    wide = ThetaGrid()
    assert plan.grid.friction[0] == wide.friction[0]
    assert plan.grid.poisson_ratio[1] == wide.poisson_ratio[1]
    assert not plan.is_at_edge(np.array([9.0, 0.2, 0.49]))  # there is nowhere to go


def test_the_grid_holds_theta_without_the_effect_and_what_is_not_known_of_it() -> None:
    without = np.array([9.0, 0.42, 0.41])
    plan = choose_bank(naming(fit(without), fit(THETA), {}))
    assert plan.centre.friction == 0.6
    assert plan.grid.friction[0] <= 0.42 * 0.95
    unsure = choose_bank(naming(fit(THETA), fit(THETA, sd=0.09), {}))
    assert unsure.grid.friction == pytest.approx((0.6 - 0.2344, 0.6 + 0.2344), abs=1e-4)  # two sd of 0.09 about 0.613
    lost = choose_bank(naming(fit(THETA), fit(THETA, sd=9.0), {}))
    assert lost.grid.friction == pytest.approx((0.6 - 0.293, 0.6 + 0.293), abs=1e-4)  # 0.4 x 0.613, no further


def test_only_credible_effects_are_simulated_again_and_those_of_the_model() -> None:
    r2 = {"shear_adhesion": 0.2, "rib_imperfection": 0.1, "load_cell_lag": 0.5, "print_anisotropy": -0.1}
    model = fit(THETA, effects=("static_kinetic_friction", "load_cell_lag"))
    plan = choose_bank(naming(model, fit(THETA), r2))
    assert set(plan.effects) == {"shear_adhesion", "rib_imperfection", "static_kinetic_friction"}
    many = choose_bank(naming(fit(THETA), fit(THETA), {name: 0.1 + 0.01 * i for i, name in enumerate(SIMULATED)}))
    assert set(many.effects) == set(SIMULATED[-MOST_EFFECTS:])  # falling pressure among them
    drifting = choose_bank(naming(fit(THETA), fit(THETA), {"shear_adhesion": 0.1}, "repeats differ"))
    assert set(drifting.effects) == {"shear_adhesion", *CLOSED_LESS}


def test_a_later_round_adds_effects_and_the_bank_moves_only_if_theta_leaves_it() -> None:
    former = choose_bank(naming(fit(THETA), fit(THETA), {"shear_adhesion": 0.2}))
    inside = naming(fit(THETA), fit(THETA * [1.0, 1.1, 1.0]), {"object_edge_radius": 0.1})
    again = choose_bank(inside, former)
    assert (again.centre, again.grid) == (former.centre, former.grid)
    assert set(again.effects) == {"shear_adhesion", "object_edge_radius"}
    assert not has_left(inside, former)
    for outside in (
        naming(fit(THETA * [1.0, 1.25, 1.0]), fit(THETA), {}),
        naming(fit(THETA), fit(THETA * [1, 1.25, 1]), {}),
    ):
        assert has_left(outside, former)
    moved = move_bank(naming(fit(THETA), fit(THETA * [1.0, 1.25, 1.0]), {}), former)
    assert moved.centre.friction == pytest.approx(0.76)
    assert moved.effects == former.effects
    assert not moved.is_at_edge(THETA * [1.0, 1.25, 1.0])
    assert not moved.is_at_edge(THETA)


def test_a_bank_around_theta_knows_what_the_wide_one_guesses() -> None:
    """At a theta far from the wide bank's centre: forces without an effect, and what effects change."""
    data = made_up_gap(4, 3, 0, n_repeats=1)
    names = ("static_kinetic_friction", "pressure_dependent_friction", "force_limited_closing", "base_compliance")
    theta = Theta(young_modulus_mpa=8.0, friction=0.85, poisson_ratio=0.46)
    at = np.array(list(theta.model_dump().values()))
    near = with_bank(data, BankPlan.around(at * [1.02, 1.03, 0.99], at[None, 1:], names))
    laws = {
        "static_kinetic_friction": {"kinetic_ratio": 0.7, "slip_scale_mm": 2.0},
        "pressure_dependent_friction": {"exponent": 0.18},
        "force_limited_closing": {"max_force_n": 5.5},
        "base_compliance": {"compliance_mm_per_n": 0.05},
    }
    base_n = made_up_steps(data, theta, {})

    def change_n(found: GapData, name: str) -> np.ndarray:
        of_effect = found.surrogate.predict_steps(at, [EffectValue(effect=name, parameters=laws[name])])
        return of_effect - found.surrogate.predict_steps(at)

    def size(values_n: np.ndarray) -> float:
        return float(np.sqrt((values_n**2).mean()))

    assert size(near.surrogate.predict_steps(at) - base_n) < 0.3 * size(data.surrogate.predict_steps(at) - base_n)
    for name, law in laws.items():
        true_n = made_up_steps(data, theta, {name: law}) - base_n
        assert size(change_n(near, name) - true_n) < 0.2 * size(true_n), name
        assert size(change_n(near, name) - true_n) < 0.7 * size(change_n(data, name) - true_n), name


def test_a_named_effect_gets_a_run_where_it_was_fitted() -> None:
    plan = choose_bank(naming(fit(THETA), fit(THETA), {"static_kinetic_friction": 0.2}))

    def named(*values: EffectValue) -> Any:
        return naming(fit(THETA), SimpleNamespace(theta=THETA, effects=values), {})

    finer = add_runs(named(friction(0.8747, 1.325)), plan)
    assert finer.runs == (friction(0.87, 1.3),)
    assert finer.list_amplitudes("static_kinetic_friction")[-1] == {"kinetic_ratio": 0.87, "slip_scale_mm": 1.3}
    more = {version.version_id for version in list_versions(SimulatorVersion(), finer)}
    assert len(more) == 1 + len({version.version_id for version in list_versions(SimulatorVersion(), plan)})
    assert add_runs(named(friction(0.871, 1.35)), finer) == finer, "there is one as near"
    assert len(add_runs(named(friction(0.87, 2.0)), finer).runs) == 2
    assert add_runs(named(friction(0.999, 1.3)), plan) == plan, "as good as nothing"
    assert add_runs(named(friction(0.8, 1.05)), plan) == plan, "the bank has one"
    lag = EffectValue(effect="load_cell_lag", parameters={"time_constant_s": 0.2})
    assert add_runs(named(lag), plan) == plan, "no simulation depends on it"
    edges = EffectValue(effect="object_edge_radius", parameters={"extra_radius_mm": 0.8})
    assert add_runs(named(edges), plan) == plan, "not an effect of this bank"


def test_parameters_come_nearer_run_by_run() -> None:
    """Friction between the slip scales of the bank: their fit is off, and is mended by runs where it was fitted."""
    hidden = friction(0.88, 1.9)
    data = made_up_gap(7, 6, 3, GapTruth(effects=(hidden,), mesh=0.0), n_repeats=2)
    errors = []

    def answer(plan: BankPlan) -> tuple[None, Any]:
        near = with_bank(data, plan)
        found = recalibrate(near.training, [hidden])
        errors.append(abs(np.log(found.effects[0].parameters["slip_scale_mm"] / 1.9)))
        return None, naming(found, found, {"static_kinetic_friction": 0.5})

    wide = recalibrate(data.training, [hidden])
    _, _, plan = name_locally(naming(wide, wide, {"static_kinetic_friction": 0.5}), None, answer)
    assert 1 <= len(plan.runs) <= MOST_RUNS
    assert errors[-1] < 0.5 * errors[0]
