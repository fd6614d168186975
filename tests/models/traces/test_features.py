"""Features of traces: answers known on paper, the compiled pass against plain numpy and SciPy, the bootstrap."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import find_peaks

from fast.models.errors import UsageError
from fast.models.records import Trace
from fast.models.traces import initial_force_n, peak_force_n, work_j
from fast.models.traces import step_features as calibration
from fast.models.traces.batch import features_of, features_of_samples
from fast.models.traces.kernel import features_of_flat
from fast.models.traces.names import (
    DIP_MM,
    END_MM,
    FEATURES,
    HOLD,
    LET_GO,
    MIN_PROMINENCE,
    NOISE_N,
    PROFILE_STEP_MM,
    SEPARATED,
    STEP_MM,
)
from fast.models.traces.quality import difference_of_tools, mean_of_tools


def trace_of(places_mm: list[float], forces_n: list[float], rate: float = 16.0, sd_n: float = 0.0) -> Trace:
    """Five readings of closing to -2 N, then a lift through the given places with `rate` readings a millimetre."""
    lift = np.arange(0.0, places_mm[-1] + 0.5 / rate, 1.0 / rate)
    force = np.interp(lift, places_mm, forces_n)
    lift, force = np.concatenate([np.zeros(5), lift]), np.concatenate([[0.0, -0.5, -2.0, -1.0, -1.0], force])
    force = force + np.random.default_rng(1).normal(0.0, sd_n, force.size)
    return Trace(np.arange(float(lift.size)), lift, force)


def plain(trace: Trace) -> dict[str, float]:
    """The definitions of docs/explanation/trace-features.md, one trace at a time, in numpy and SciPy."""
    lift, force = trace.lift_mm[trace.is_lift], trace.force_n[trace.is_lift]
    ordered = np.maximum.accumulate(lift)
    n = int(ordered[-1] / STEP_MM)
    fine = np.unique(np.concatenate([ordered, STEP_MM * np.arange(n + 1)]))
    last_of_place = np.flatnonzero(np.append(np.diff(ordered) > 0, True))
    first_of_place = np.flatnonzero(np.append(True, np.diff(ordered) > 0))
    steps = np.zeros(n)
    for left, right in zip(fine[:-1], fine[1:], strict=True):
        after = int(np.searchsorted(ordered[first_of_place], right))
        a, b = last_of_place[after - 1], first_of_place[after]
        middle = np.interp(0.5 * (left + right), ordered[[a, b]], force[[a, b]])
        if left / STEP_MM < n:
            steps[int(left / STEP_MM)] += middle * (right - left) / STEP_MM
    top, peak = int(np.argmax(steps)), float(steps.max())
    found = {
        "peak_force_n": peak_force_n(trace),
        "peak_lift_mm": lift[np.argmax(force)],
        "initial_force_n": initial_force_n(trace),
        "closing_lowest_n": trace.force_n[~trace.is_lift].min(initial=force[0]),
        "dip_n": steps[: round(DIP_MM / STEP_MM)].min(),
        "positive_after_mm": STEP_MM * (np.flatnonzero(np.append(0.0, steps[: top + 1]) <= 0.0)[-1]),
        "work_j": work_j(trace),
        "lowest_after_n": steps[top:].min(),
    }
    found["end_force_n"] = force[lift >= lift.max() - END_MM].mean()
    held = np.flatnonzero(force >= max(SEPARATED * force.max(), NOISE_N))
    found["separation_lift_mm"] = lift[held[-1]] if held.size else np.nan
    runs = np.split(np.arange(n), np.flatnonzero(np.diff((steps >= HOLD * peak).astype(int))) + 1)
    runs = [run for run in runs if steps[run[0]] >= HOLD * peak]
    longest = max(runs, key=len, default=np.arange(1))
    is_held = peak > 0
    found["hold_mm"] = STEP_MM * len(longest) if is_held else 0.0
    found["hold_start_mm"] = STEP_MM * longest[0] if is_held else np.nan
    found["hold_force_n"] = steps[longest].mean() if is_held else np.nan
    is_line = is_held and len(longest) >= 3
    found["hold_slope_n_per_mm"] = np.polyfit(STEP_MM * longest, steps[longest], 1)[0] if is_line else np.nan
    found["half_peak_lift_mm"] = STEP_MM * (steps > 0.5 * peak).sum() if is_held else 0.0
    least, base = max(MIN_PROMINENCE * peak, NOISE_N), min(steps.min(), 0.0)
    shape = find_peaks(np.concatenate([[base], steps, [base]]), height=least, prominence=least)[1]
    ranked = [*np.sort(shape["prominences"])[::-1], 0.0, 0.0]
    found |= {"n_peaks": len(shape["prominences"]), "prominence_n": ranked[0], "second_prominence_n": ranked[1]}
    found["drop_rate_n_per_mm"] = _drop_rate(steps, top, peak)
    return found


def _drop_rate(steps: np.ndarray, top: int, peak: float) -> float:
    gone = top + np.flatnonzero(steps[top:] <= LET_GO * peak)
    if peak < NOISE_N or not gone.size:
        return np.nan
    end = gone[0]
    begin = top + np.flatnonzero(steps[top:end] >= HOLD * peak)[-1]
    places = [
        np.interp(-level * peak, -steps[k : k + 2], [k, k + 1]) for level, k in ((HOLD, begin), (LET_GO, end - 1))
    ]
    return (HOLD - LET_GO) * peak / (STEP_MM * (places[1] - places[0]))


def test_a_triangle() -> None:
    found = features_of([trace_of([0, 10, 30], [0, 20, 0])]).row(0)
    assert found["peak_force_n"] == pytest.approx(20.0)
    assert found["peak_lift_mm"] == pytest.approx(10.0)
    assert found["work_j"] == pytest.approx(0.3)  # 20 N x 30 mm / 2
    assert (found["initial_force_n"], found["closing_lowest_n"]) == (-1.0, -2.0)
    assert found["half_peak_lift_mm"] == pytest.approx(15.0)  # half the base
    assert found["hold_mm"] == pytest.approx(6.0, abs=STEP_MM)  # 20 % of it
    assert found["n_peaks"] == 1
    assert found["prominence_n"] == pytest.approx(20.0, abs=0.5)
    assert found["second_prominence_n"] == 0.0
    assert found["drop_rate_n_per_mm"] == pytest.approx(1.0)  # 20 N over 20 mm
    assert found["separation_lift_mm"] == pytest.approx(28.0)  # 2 N are left
    assert found["lowest_after_n"] == pytest.approx(0.25)  # mean of the last step


def test_a_sloping_plateau() -> None:
    found = features_of([trace_of([0, 2, 22, 24, 40], [0, 20, 18, 0, 0])]).row(0)
    assert found["hold_start_mm"] == pytest.approx(1.5, abs=STEP_MM)
    assert found["hold_mm"] == pytest.approx(20.5, abs=2 * STEP_MM)
    assert found["hold_force_n"] == pytest.approx(19.0, abs=0.1)
    assert found["hold_slope_n_per_mm"] == pytest.approx(-0.1, abs=0.02)
    assert found["drop_rate_n_per_mm"] == pytest.approx(9.0, rel=0.02)
    assert found["n_peaks"] == 1


def test_two_peaks_and_a_push_at_the_start() -> None:
    found = features_of([trace_of([0, 2, 5, 10, 15, 20, 25], [-3, -1, 10, 4, 9, 0, 0])]).row(0)
    assert found["dip_n"] == pytest.approx(-2.75)  # mean of the first half millimetre
    assert found["positive_after_mm"] == pytest.approx(2.5)  # the force is zero at 2.27 mm
    assert found["n_peaks"] == 2
    assert found["second_prominence_n"] == pytest.approx(5.0, abs=0.6)
    assert found["prominence_n"] == pytest.approx(13.0, abs=0.6)  # above the push
    assert found["drop_rate_n_per_mm"] == pytest.approx(1.8, rel=0.02)  # of the second: between them it still holds


def test_noise_makes_no_peaks_and_moves_little() -> None:
    places, forces = [0, 2, 22, 26, 40], [0.0, 12.0, 12.0, 0.0, 0.0]
    clean, noisy = features_of([trace_of(places, forces), trace_of(places, forces, sd_n=0.12)]).values
    assert noisy[FEATURES.index("n_peaks")] == 1
    for name, limit in (("work_j", 2e-3), ("hold_mm", 1.0), ("hold_slope_n_per_mm", 0.03), ("hold_force_n", 0.1)):
        assert abs(noisy - clean)[FEATURES.index(name)] < limit, name


def test_an_object_that_is_never_pulled_has_no_hold() -> None:
    found = features_of([trace_of([0, 20], [-3, -1])]).row(0)
    assert (found["hold_mm"], found["n_peaks"], found["half_peak_lift_mm"]) == (0.0, 0.0, 0.0)
    for name in ("hold_start_mm", "hold_force_n", "hold_slope_n_per_mm", "drop_rate_n_per_mm", "separation_lift_mm"):
        assert found[name] is None


def test_a_trace_that_ends_while_it_holds_has_no_drop() -> None:
    assert features_of([trace_of([0, 20], [0, 15])]).row(0)["drop_rate_n_per_mm"] is None


def test_the_profile_holds_the_area_and_ends_with_zeros() -> None:
    found = features_of([trace_of([0, 10, 30], [0, 20, 0])])
    assert found.profile_n[0].sum() * PROFILE_STEP_MM == pytest.approx(300.0)
    assert not found.profile_n[0, 15:].any()


FORCES = st.lists(st.floats(-20, 40, allow_subnormal=False), min_size=4, max_size=8)


@settings(max_examples=60, deadline=None)
@given(forces=FORCES, end_mm=st.floats(6, 70), sd_n=st.sampled_from([0.0, 0.3]), sd_mm=st.sampled_from([0.0, 0.05]))
def test_the_compiled_pass_agrees_with_plain_numpy(forces, end_mm, sd_n, sd_mm) -> None:
    places = np.linspace(0.0, end_mm, len(forces))
    clean = trace_of(places.tolist(), forces, sd_n=sd_n)
    shake_mm = sd_mm * np.random.default_rng(2).normal(size=clean.lift_mm.size)
    stepped = np.abs(clean.lift_mm + shake_mm * (clean.lift_mm > 0))
    trace = Trace(clean.time_s, stepped, clean.force_n)
    values = features_of([trace, trace]).values
    expected = plain(trace)
    assert values[1].tolist() == pytest.approx(values[0].tolist(), nan_ok=True)
    for name, value in zip(FEATURES, values[0], strict=True):
        assert value == pytest.approx(expected[name], rel=1e-6, abs=1e-6, nan_ok=True), name


def test_steps_are_those_of_calibration_on_traces() -> None:
    assert (STEP_MM, DIP_MM) == (calibration.STEP_MM, calibration.DIP_MM)
    trace = trace_of([0, 2, 5, 10, 15, 20, 25], [-3, -1, 10, 4, 9, 0, 0], sd_n=0.12)
    steps_n = calibration.step_means(trace)
    assert features_of([trace]).profile_n[0] == pytest.approx(steps_n.reshape(30, -1).mean(axis=1))


def test_traces_of_any_length_lie_end_to_end_without_mixing() -> None:
    traces = [trace_of([0, 10, 30], [0, 20, 0]), trace_of([0, 6, 8], [0, 9, 0]), trace_of([0, 3, 50], [0, 4, 0])]
    together = features_of(traces)
    for place, trace in enumerate(traces):
        alone = features_of([trace])
        np.testing.assert_array_equal(together.values[place], alone.values[0])
        np.testing.assert_array_equal(together.profile_n[place], alone.profile_n[0])


def test_what_is_read_only_is_measured_by_the_same_code() -> None:
    trace = trace_of([0, 10, 30], [0, 20, 0])
    lift_mm, force_n, offsets = trace.lift_mm.copy(), trace.force_n.copy(), np.array([0, trace.lift_mm.size])
    expected = features_of_samples(lift_mm, force_n, offsets).values
    lift_mm.flags.writeable = force_n.flags.writeable = False
    np.testing.assert_array_equal(features_of_samples(lift_mm, force_n, offsets).values, expected)
    assert len(features_of_flat.signatures) == 1


def test_what_shows_no_lift_has_no_features() -> None:
    closed = Trace(np.arange(4.0), np.zeros(4), np.ones(4))
    assert features_of([trace_of([0, 10, 30], [0, 20, 0]), closed, None]).is_usable.tolist() == [True, False, False]


def test_wrong_input_is_one_sentence() -> None:
    with pytest.raises(UsageError, match=r"no trace was given.*measure or import grasps first\."):
        features_of([])
    with pytest.raises(UsageError, match=r"offsets 0 to 9 do not divide 4 lifts"):
        features_of_samples(np.zeros(4), np.zeros(4), np.array([0, 9]))


@pytest.mark.parametrize(("n_tools", "part"), [(4, 0.79), (10, 0.91), (30, 0.94)])
def test_the_interval_holds_the_mean_as_often_as_the_page_says(n_tools: int, part: float) -> None:
    rng = np.random.default_rng(0)
    intervals = [mean_of_tools(rng.normal(10.0, 3.0, n_tools), seed) for seed in range(1000)]
    held = np.mean([interval.lower <= 10.0 <= interval.upper for interval in intervals])
    assert held == pytest.approx(part, abs=0.03)
    width = 2 * 1.96 * 3 / np.sqrt(n_tools)
    assert np.mean([i.upper - i.lower for i in intervals]) == pytest.approx(width, rel=0.25)


def test_difference_and_small_groups() -> None:
    first, last = np.array([1.0, 2.0, 3.0]), np.array([11.0, 12.0, 13.0])
    found = difference_of_tools(first, last)
    assert found.mean == 10.0
    assert 8.0 <= found.lower < 10.0 < found.upper <= 12.0
    assert np.isnan(mean_of_tools(np.array([4.0])).lower)
