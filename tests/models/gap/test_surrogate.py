"""Predictions of gap discovery: bit-exact without effects, exact where the bank is, and in agreement with replay."""

from dataclasses import replace

import numpy as np
import pytest

from fast.models.errors import UsageError
from fast.models.gap.bank import sensor_effects
from fast.models.gap.bank.sensor_effects import N_LEAD, apply_sensor_effect, read_lead
from fast.models.gap.bank.surrogate import Surrogate
from fast.models.gap.data import GapData
from fast.models.records import EffectValue, GraspSetup, Trace
from fast.models.simulation.effects.catalogue import CATALOGUE, build_effects
from fast.models.traces.step_features import STEP_MM, step_means
from tests.synthetic.gap import made_up_gap
from tests.synthetic.simulation import replayed

CENTRE = np.array([10.0, 0.6, 0.42])
THETA = np.array([8.0, 0.7, 0.4])


def make_trace(steps_n: np.ndarray, setup: GraspSetup) -> Trace:
    """A trace with these step means and lead (132), to first order: closed, held, lifted as the setup says."""
    at_mm = np.append(sensor_effects._AT_MM, sensor_effects._AT_MM[-1] + 0.5 * STEP_MM)
    force_n = np.append(sensor_effects._fine(steps_n[None])[0], steps_n[-1])
    time_s = sensor_effects._closed_s(setup) + at_mm / setup.lift_speed_mm_per_s
    return Trace(time_s, np.maximum(at_mm, 0.0), force_n)


def test_effects_on_traces_say_what_they_do_to_forces() -> None:
    """The bank asks for nothing else: one that changed finished traces alone would be seen nowhere in a search."""
    kinds = {name: spec.kind for name, spec in CATALOGUE.items()}
    assert [name for name, kind in kinds.items() if kind.acts_on_traces() and not kind.overrides("modify_forces")] == []


ON_TRACES = {
    "stress_relaxation": {"relaxed_share": 0.2, "time_constant_s": 4.0},
    "object_post_compliance": {"compliance_mm_per_n": 0.05},
    "lift_start_error": {"backlash_mm": 0.4, "ramp_s": 0.3, "ramp_power": 2.0},
    "lift_misalignment": {"shift_mm": -0.8},
    "load_cell_offset": {"offset_n": 0.3},
    "load_cell_drift": {"drift_per_hour_n": 0.5},
    "load_cell_lag": {"time_constant_s": 0.4},
    "tool_weight": {"share": 0.5},
    "mullins_softening": {"softening": 0.1, "scale_repeats": 2.0},
    "temperature_softening": {"softening": 0.2, "warm_up_s": 2000.0},
}


@pytest.fixture(scope="module")
def data() -> GapData:
    return made_up_gap(4, 4, 0)


OTHER_TIMING = GraspSetup(lift_speed_mm_per_s=2.0, dwell_s=3.0)


def with_other_timing(data: GapData) -> GapData:
    """The same grasps, every second one slower and after a wait."""
    n = len(data.grasps.tool)
    setups = (*data.grasps.setups, OTHER_TIMING)
    return replace(data, grasps=replace(data.grasps, setups=setups, setup=np.arange(n) % 2))


@pytest.fixture(scope="module")
def surrogate(data: GapData) -> Surrogate:
    return data.surrogate


def test_effects_of_no_amplitude_change_nothing(surrogate: Surrogate) -> None:
    base = surrogate.predict_steps(THETA)
    for name in surrogate.names:
        np.testing.assert_array_equal(surrogate.predict_steps(THETA, [CATALOGUE[name].neutral]), base)


def test_forces_scale_with_the_modulus_and_tools(surrogate: Surrogate) -> None:
    base = surrogate.predict_steps(THETA)
    np.testing.assert_allclose(surrogate.predict_steps(THETA * [2.0, 1.0, 1.0]), 2.0 * base)
    factor = np.array([1.0, 1.1, 1.0, 1.0])
    of_tool = surrogate.predict_steps(THETA, tool_factor=factor)
    np.testing.assert_allclose(of_tool, base * factor[surrogate.grasps.tool][:, None])


def test_the_bank_is_met_at_its_amplitudes(data: GapData, surrogate: Surrogate) -> None:
    base = surrogate.predict_steps(CENTRE)
    tool, obj = data.grasps.tool, data.grasps.obj
    for name, runs in data.bank.effects.items():
        for place, parameters in enumerate(runs.parameters):
            change = surrogate.predict_steps(CENTRE, [EffectValue(effect=name, parameters=dict(parameters))]) - base
            wanted = (runs.steps_n[:, :, place] - data.bank.centre_steps_n)[tool, obj]
            np.testing.assert_allclose(change, wanted, atol=1e-9, err_msg=name)


def test_an_effect_with_its_own_force_counts_more_in_a_soft_finger(surrogate: Surrogate) -> None:
    """F(E, a) = E / E_c F(E_c, a E_c / E): twice the modulus and twice the strength are twice the force."""
    soft = surrogate.predict_steps(
        THETA, [EffectValue(effect="shear_adhesion", parameters={"shear_strength_mpa": 0.005})]
    )
    stiff = surrogate.predict_steps(
        THETA * [2.0, 1.0, 1.0], [EffectValue(effect="shear_adhesion", parameters={"shear_strength_mpa": 0.01})]
    )
    np.testing.assert_allclose(stiff, 2.0 * soft)


def test_a_pressure_scale_is_a_factor_on_friction(surrogate: Surrogate) -> None:
    law = {"exponent": 0.2, "reference_mpa": 0.1}
    shifted = surrogate.predict_steps(CENTRE, [EffectValue(effect="pressure_dependent_friction", parameters=law)])
    known = EffectValue(effect="pressure_dependent_friction", parameters=law | {"reference_mpa": 0.05})
    np.testing.assert_allclose(shifted, surrogate.predict_steps(CENTRE * [1.0, 2.0**0.2, 1.0], [known]), atol=1e-9)


@pytest.mark.parametrize("name", ON_TRACES)
def test_laws_for_all_grasps_at_once_agree_with_replay(data: GapData, name: str) -> None:
    surrogate = with_other_timing(data).surrogate
    value = EffectValue(effect=name, parameters=ON_TRACES[name])
    grasps, with_lead = surrogate.grasps, surrogate.predict_with_lead(CENTRE)
    base, found = with_lead[:, N_LEAD:], surrogate.predict_steps(CENTRE, [value])
    (effect,) = build_effects([value])
    for row in range(0, len(base), 7):
        design, setup = grasps.designs[grasps.tool[row]], grasps.setups[grasps.setup[row]]
        acting = effect.in_grasp(design, setup, grasps.contexts[row])
        trace = make_trace(with_lead[row], setup)
        change = step_means(replayed(trace, [acting], design, surrogate.centre)) - step_means(trace)
        error = np.abs(found[row] - base[row] - change)
        assert np.sqrt((error**2).mean()) < 0.07 * np.sqrt((change**2).mean()) + 1e-9


@pytest.mark.parametrize(
    ("name", "parameters"),
    [("load_cell_lag", {"time_constant_s": 0.1}), ("lift_misalignment", {"shift_mm": 0.8})],
)
def test_the_end_of_closing_is_read_into_the_lift(
    surrogate: Surrogate, name: str, parameters: dict[str, float]
) -> None:
    """A force that is still rising when the lift starts makes a late record start low; a hold does not."""
    n, rows_n = len(surrogate.grasps.tool), surrogate.rows_n.copy()
    rows_n[..., :N_LEAD] = np.linspace(0.0, 1.0, N_LEAD) * rows_n[..., N_LEAD : N_LEAD + 1]
    rising = replace(surrogate, rows_n=rows_n)
    value = EffectValue(effect=name, parameters=parameters)
    base, held, late = (
        surrogate.predict_steps(CENTRE),
        surrogate.predict_steps(CENTRE, [value]),
        rising.predict_steps(CENTRE, [value]),
    )
    (effect,) = build_effects([value])
    for row in range(0, n, 7):
        trace = make_trace(rising.predict_with_lead(CENTRE)[row], rising.grasps.base_setup)
        change = step_means(effect.modify_trace(trace)) - step_means(trace)
        error = late[row] - base[row] - change
        assert np.sqrt((error[:4] ** 2).mean()) < 0.1 * np.sqrt((change[:4] ** 2).mean())
        assert abs(late[row, 0] - base[row, 0]) > 3.0 * abs(held[row, 0] - base[row, 0])


@pytest.mark.parametrize(
    ("name", "parameter"),
    [("lift_misalignment", 0.1), ("lift_misalignment", -0.1), ("object_post_compliance", 0.02), ("load_cell_lag", 0.1)],
)
def test_a_force_that_turns_round_within_a_step_is_read_as_it_is(name: str, parameter: float) -> None:
    """It rises from -3.7 N to a plateau of 4.3 N within 0.65 mm, as on weak friction."""
    setup, time_s = GraspSetup(), np.linspace(0.0, 18.0, 36001)
    lift_mm = setup.lift_speed_mm_per_s * np.clip(time_s - 5.4, 0.0, None)
    force_n = np.where(lift_mm > 0, np.minimum(-3.7 + 12.3 * lift_mm, 4.3 - 0.05 * lift_mm), -3.7 * time_s / 5.4)
    trace = Trace(time_s, lift_mm, force_n)
    (effect,) = build_effects([EffectValue(effect=name, parameters={CATALOGUE[name].parameters[0].name: parameter})])
    true_n = step_means(effect.modify_trace(trace)) - step_means(trace)
    known_n = np.concatenate([read_lead(trace, setup), step_means(trace)])[None]
    found_n = (apply_sensor_effect([effect], known_n, setup) - known_n)[0, N_LEAD:]
    assert np.abs(true_n).max() > 0.4
    assert np.abs(found_n - true_n).max() < 0.15 * np.abs(true_n).max()


def test_the_lead_of_a_grasp_is_the_end_of_its_closing() -> None:
    setup = GraspSetup()
    time_s = np.array([0.0, 1.0, 1.35, 1.45, 5.35])
    lead_n = read_lead(Trace(time_s, np.array([0, 0, 0, 0.5, 20.0]), np.array([0, 0, 3.5, 4.0, 4.0])), setup)
    # Every 0.1 s, the last where the lift starts.
    np.testing.assert_allclose(lead_n[-4:], [0.5, 1.5, 2.5, 3.5], atol=1e-12)
    assert (lead_n[:-4] == 0.0).all()


def test_grasps_with_other_timing_are_the_same_simulation_at_other_times(data: GapData) -> None:
    """Without effects nothing but the end of closing differs: after a wait the force before the lift has not moved."""
    usual, other = data.surrogate, with_other_timing(data).surrogate
    assert other.is_usable.all()
    is_other = other.grasps.setup == 1
    before, after = (surrogate.predict_with_lead(CENTRE) for surrogate in (usual, other))
    np.testing.assert_array_equal(after[:, N_LEAD:], before[:, N_LEAD:])
    np.testing.assert_array_equal(after[~is_other], before[~is_other])
    at_lift = np.repeat(before[is_other, N_LEAD - 1 : N_LEAD], N_LEAD, axis=1)
    np.testing.assert_allclose(after[is_other, :N_LEAD][:, -8:], at_lift[:, -8:])  # 2 s at 2 mm/s, within the wait


def test_what_the_bank_does_not_have_is_not_used(data: GapData) -> None:
    setups = (*data.grasps.setups, GraspSetup(closed_gap_mm=20.0))
    rows = np.zeros(len(data.grasps.tool), dtype=int)
    rows[3] = 1
    found = replace(data, grasps=replace(data.grasps, setups=setups, setup=rows))
    assert list(np.flatnonzero(~found.surrogate.is_usable)) == [3]
    cells = found.grasps.cells
    assert [target.setup.closed_gap_mm for target in cells.targets[len(data.grasps.objects) :]] == [20.0]
    assert cells.is_wanted[:, -1].sum() == 1
    assert found.grasps.content_id != data.grasps.content_id


def test_memory_acts_through_friction_modulus_and_closing(data: GapData, surrogate: Surrogate) -> None:
    contexts = data.grasps.contexts
    base = surrogate.predict_steps(CENTRE)
    worn = surrogate.predict_steps(CENTRE, [EffectValue(effect="friction_wear", parameters={"loss": 0.3})])
    first = np.array([context.tool_grasps == 0 for context in contexts])
    np.testing.assert_array_equal(worn[first], base[first])
    assert (np.abs(worn[~first] - base[~first]).max(axis=1) > 0).all()
    left = surrogate.predict_steps(CENTRE, [EffectValue(effect="pressure_droop", parameters={"loss_mm": 2.0})])
    assert (left.sum(axis=1) <= base.sum(axis=1)).mean() > 0.9


def test_an_effect_without_simulations_is_refused(surrogate: Surrogate) -> None:
    assert "rib_imperfection" not in surrogate.names
    with pytest.raises(UsageError, match="no simulations with `rib_imperfection`"):
        surrogate.predict_steps(CENTRE, [EffectValue(effect="rib_imperfection", parameters={"bow_mm": 0.2})])


def test_some_of_the_grasps_are_predicted_as_among_all(data: GapData, surrogate: Surrogate) -> None:
    rows = np.array([3, 17, 30])
    effects = [EffectValue(effect=name, parameters=ON_TRACES[name]) for name in ("load_cell_lag", "mullins_softening")]
    some = surrogate.select(rows)
    assert some.grasps.grasp_ids == tuple(data.grasps.grasp_ids[row] for row in rows)
    np.testing.assert_allclose(some.predict_steps(THETA, effects), surrogate.predict_steps(THETA, effects)[rows])
