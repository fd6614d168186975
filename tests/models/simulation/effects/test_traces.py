"""Effects that act on a trace, against closed forms and limit cases."""

import numpy as np
import pytest

from fast.models.design.fin_ray import planar_profile
from fast.models.design.space import BEST_PUBLISHED
from fast.models.records import GraspContext, GraspSetup, Trace
from fast.models.simulation.effects.actuation import LiftStartError
from fast.models.simulation.effects.base import Effect, relifted, speed_mm_per_s
from fast.models.simulation.effects.contact import ObjectPostCompliance
from fast.models.simulation.effects.material import StressRelaxation
from fast.models.simulation.effects.sensor import (
    LiftMisalignment,
    LoadCellDrift,
    LoadCellGain,
    LoadCellLag,
    LoadCellOffset,
    ToolWeight,
)

TIME_S = np.array([0.0, 0.5, 1.0, 1.1, 1.2, 3.0, 8.0])
TRACE = Trace(TIME_S, np.array([0, 0, 0, 0.5, 1.0, 10.0, 35.0]), np.array([0, -4.0, -8, 2, 14, 9, 0.0]))
NO_LIFT = Trace(TIME_S[:3], np.zeros(3), np.array([0, -4.0, -8]))
V = 5.0  # mm/s


def lifted(force_of_lift, closing_n: float = 0.0) -> Trace:
    """One second of closing, then a lift of 40 mm at 5 mm/s with this force over the lift."""
    lift = np.linspace(0.0, 40.0, 401)
    force = np.concatenate([[0.0, closing_n], force_of_lift(lift)])
    return Trace(np.concatenate([[0.0, 0.5], 1.0 + lift / V]), np.concatenate([[0.0, 0.0], lift]), force)


@pytest.mark.parametrize(
    "effect",
    [
        StressRelaxation(0.2, 5.0),
        LiftMisalignment(1.0),
        LiftStartError(0.2, 0.1),
        ObjectPostCompliance(0.02),
        LoadCellLag(0.2),
    ],
)
def test_a_trace_without_a_lift_is_no_trouble(effect: Effect) -> None:
    assert np.isfinite(effect.modify_trace(NO_LIFT).force_n).all()
    empty = Trace(np.zeros(0), np.zeros(0), np.zeros(0))
    assert len(effect.modify_trace(empty).force_n) == 0


def test_lag_follows_a_ramp_late_by_its_time_constant() -> None:
    time_s = np.linspace(0, 20, 41)
    ramp = Trace(time_s, 5 * time_s, 3.0 * time_s)
    late = LoadCellLag(0.4).modify_trace(ramp)
    assert np.diff(late.time_s).max() < 0.14  # the reported force bends within a sample of 0.5 s
    assert np.allclose(late.force_n, 3.0 * (late.time_s - 0.4 * (1 - np.exp(-late.time_s / 0.4))))


def test_lag_does_not_depend_on_the_sampling() -> None:
    fine_time = np.unique(np.concatenate([TIME_S, np.linspace(0, 8, 801)]))
    fine = Trace(fine_time, np.interp(fine_time, TIME_S, TRACE.lift_mm), np.interp(fine_time, TIME_S, TRACE.force_n))
    coarse = LoadCellLag(0.3).modify_trace(TRACE)
    finer = LoadCellLag(0.3).modify_trace(fine)
    at_s = np.intersect1d(coarse.time_s, fine_time)
    found = (np.interp(at_s, late.time_s, late.force_n) for late in (coarse, finer))
    assert np.allclose(*found, atol=1e-9)


def test_gain_scales_the_force_alone() -> None:
    scaled = LoadCellGain(1.1).modify_trace(TRACE)
    assert np.allclose(scaled.force_n, 1.1 * TRACE.force_n)
    assert np.array_equal(scaled.lift_mm, TRACE.lift_mm)


def test_offset_drift_and_weight_add_to_every_sample() -> None:
    assert np.allclose(LoadCellOffset(-0.3).modify_trace(TRACE).force_n, TRACE.force_n - 0.3)
    setup = GraspSetup()
    drift = LoadCellDrift(0.5).in_grasp(BEST_PUBLISHED, setup, GraspContext(clock_s=7200.0)).modify_trace(TRACE)
    assert np.allclose(drift.force_n - TRACE.force_n, 0.5 * (2.0 + TIME_S / 3600.0))
    weight = ToolWeight(0.5).in_grasp(BEST_PUBLISHED, setup, GraspContext()).modify_trace(TRACE)
    volume_cm3 = planar_profile(BEST_PUBLISHED).area * BEST_PUBLISHED.width_mm / 1000.0
    assert np.allclose(weight.force_n - TRACE.force_n, 0.5 * 2.0 * volume_cm3 * 1.1e-3 * 9.80665)
    assert 0.1 < weight.force_n[0] < 0.6


def test_relaxation_starts_at_the_end_of_closing_and_ends_at_the_relaxed_share() -> None:
    relaxed = StressRelaxation(0.3, 0.5).modify_trace(TRACE)
    assert np.array_equal(relaxed.force_n[:3], TRACE.force_n[:3])
    held = TIME_S[3:] - 1.0
    assert np.allclose(relaxed.force_n[3:], TRACE.force_n[3:] * (0.7 + 0.3 * np.exp(-held / 0.5)))
    slow, fast = (StressRelaxation(0.3, tau).modify_trace(TRACE).force_n for tau in (100.0, 0.3))
    assert np.allclose(slow, TRACE.force_n, rtol=0.03)
    assert fast[5] == pytest.approx(0.7 * TRACE.force_n[5], rel=1e-2)


def test_misalignment_shifts_the_trace_rigidly() -> None:
    trace = lifted(lambda lift: 20.0 * np.exp(-(((lift - 15.0) / 3.0) ** 2)))
    late = LiftMisalignment(2.0).modify_trace(trace)
    early = LiftMisalignment(-2.0).modify_trace(trace)
    assert late.lift_mm[np.argmax(late.force_n)] == pytest.approx(17.0)
    assert early.lift_mm[np.argmax(early.force_n)] == pytest.approx(13.0)
    assert late.force_n.max() == pytest.approx(trace.force_n.max())
    back = LiftMisalignment(-2.0).modify_trace(late)
    assert np.allclose(np.interp(trace.time_s, back.time_s, back.force_n), trace.force_n, atol=1e-9)


def test_backlash_delays_the_lift_and_leaves_the_force_at_rest() -> None:
    trace = lifted(lambda lift: -8.0 + 2.0 * lift)
    late = LiftStartError(0.4, 0.0).modify_trace(trace)
    lift = late.lift_mm[late.is_lift]
    assert lift[0] == 0.0
    assert np.allclose(late.force_n[late.is_lift], -8.0 + 2.0 * np.maximum(lift - 0.4, 0.0))
    assert np.allclose(np.diff(late.time_s[late.is_lift]), np.diff(lift) / V)


@pytest.mark.parametrize("power", [0.5, 1.0, 4.0])
def test_a_start_is_behind_by_what_its_speed_lacked(power: float) -> None:
    ramp_s = 0.4
    start = LiftStartError(0.1, ramp_s, power)
    late = start.modify_trace(lifted(lambda lift: lift))
    time_s = np.linspace(0.0, ramp_s, 100_001)
    lacked = V * (1.0 - time_s / ramp_s) ** power
    behind_mm = 0.1 + float(((lacked[1:] + lacked[:-1]) / 2.0 * np.diff(time_s)).sum())
    assert late.lift_mm[-1] - late.force_n[-1] == pytest.approx(behind_mm, rel=1e-4)
    assert start.behind_mm(np.array([ramp_s]), V)[0] == pytest.approx(behind_mm, rel=1e-4)


def test_ramp_is_uniformly_accelerated_and_ends_half_a_ramp_behind() -> None:
    trace = lifted(lambda lift: lift)  # the force is the true lift
    ramp_s = 0.4
    late = LiftStartError(0.0, ramp_s).modify_trace(trace)
    t = late.time_s[late.is_lift] - 1.0
    true_mm = np.where(t < ramp_s, 0.5 * V * t**2 / ramp_s, V * (t - 0.5 * ramp_s))
    assert np.allclose(late.force_n[late.is_lift], true_mm)
    assert np.allclose(late.lift_mm[late.is_lift], V * t)


def test_a_compliant_post_is_a_spring_in_series() -> None:
    k, compliance = 3.0, 0.05  # N/mm, mm/N
    trace = lifted(lambda lift: k * lift)
    soft = ObjectPostCompliance(compliance).modify_trace(trace)
    series = 1.0 / (1.0 / k + compliance)
    assert np.allclose(soft.force_n[soft.is_lift], series * soft.lift_mm[soft.is_lift])
    assert soft.force_n.max() == trace.force_n.max()
    assert speed_mm_per_s(soft) == pytest.approx(V)


def test_a_compliant_post_springs_back_where_the_force_drops() -> None:
    trace = lifted(lambda lift: np.where(lift < 20.0, 10.0, 2.0))
    soft = ObjectPostCompliance(0.2).modify_trace(trace)
    assert (np.diff(soft.lift_mm[soft.is_lift]) > 0.0).all()
    assert (np.diff(soft.time_s) > 0.0).all()
    assert set(np.round(soft.force_n[soft.is_lift], 9)) == {10.0, 2.0}


def test_the_same_lift_gives_the_same_trace() -> None:
    same = relifted(TRACE, TRACE.lift_mm[TRACE.is_lift])
    assert np.array_equal(same.lift_mm, TRACE.lift_mm)
    assert np.array_equal(same.force_n, TRACE.force_n)
