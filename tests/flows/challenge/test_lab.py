"""Hidden laws of time, memory and sensors in their limits, and the lab that measures a truth."""

import numpy as np
import pytest

from fast.flows.challenge.hidden.lab import NASTIER, SETUP, Lab, Nuisance, Site, Variants, retime
from fast.flows.challenge.hidden.lab_laws import LAB_LAWS, LabLaw, Moment, lift_speed_mm_per_s
from fast.flows.challenge.hidden.other_lab_laws import OTHER_LAB_LAWS, build_lab_law
from fast.models.design.space import numbered_design
from fast.models.errors import UsageError
from fast.models.records import GraspContext, GraspSetup, Trace
from fast.models.traces.step_features import step_means

FRESH = GraspContext()
QUIET = Nuisance(tool_sd=0.0, cell_sd=0.0, repeat_sd=0.0, noise_sd_n=0.0, tare_n=0.0, missing=0.0)


def _moment(height_mm: float = 40.0, setup: GraspSetup = SETUP, **context: float) -> Moment:
    return Moment(numbered_design(0), 3, height_mm, GraspContext.model_validate(context), setup)


def _trace() -> Trace:
    """Closing for a second, then a force that rises and falls over 40 mm at 5 mm/s."""
    lift_mm = np.linspace(0.0, 40.0, 161)
    time_s = np.concatenate([[0.0, 0.5], 1.0 + lift_mm / 5.0])
    force_n = np.concatenate([[0.0, -0.5], 10.0 * np.sin(np.pi * lift_mm / 40.0)])
    return Trace(time_s, np.concatenate([[0.0, 0.0], lift_mm]), force_n)


@pytest.mark.parametrize("kind", [*LAB_LAWS.values(), *OTHER_LAB_LAWS.values()])
def test_amplitude_zero_changes_nothing(kind: type[LabLaw]) -> None:
    """All hooks at zero, late in a batch."""
    law, trace = kind(0.0), _trace()
    moment = _moment(repeat=2, tool_grasps=30, batch_grasps=100, clock_s=9000.0)
    assert law.modulus_factor(moment) == law.friction_factor(moment) == 1.0
    assert law.wider_mm(moment) == law.raised_mm(moment) == 0.0
    made = step_means(law.trace(trace, moment))
    assert np.abs(made - step_means(trace)).max() < 0.02


def test_relaxation_has_no_time_constant() -> None:
    """The force halves as often from 1 to 3 s as from 3 to 7 s: twice the time, the same factor."""
    trace = _trace()
    ratio = LAB_LAWS["stress_relaxation"](0.2).trace(trace, _moment()).force_n[3:-1] / trace.force_n[3:-1]
    held_s = trace.time_s[3:-1] - 1.0
    assert np.interp([0.0, 1.0, 3.0, 7.0], held_s, ratio)[1:] == pytest.approx(
        2.0 ** (-0.2 * np.arange(1, 4)), rel=1e-3
    )


def test_softening_goes_with_repeats_and_recovers_a_little() -> None:
    """n / (n + 1) of the loss when fresh."""
    law = LAB_LAWS["mullins_softening"](0.1)
    assert [law.modulus_factor(_moment(repeat=n)) for n in range(3)] == pytest.approx([1.0, 0.95, 1.0 - 0.2 / 3.0])
    assert law.modulus_factor(_moment(repeat=1, clock_s=1e6)) == pytest.approx(1.0 - 0.8 * 0.05)


def test_warming_goes_with_the_root_of_time() -> None:
    """Half the loss at the time scale; cooling stiffens."""
    assert LAB_LAWS["temperature_softening"](0.2).modulus_factor(_moment(clock_s=2400.0)) == pytest.approx(0.9)
    assert LAB_LAWS["temperature_softening"](-0.2).modulus_factor(_moment(clock_s=2400.0)) == pytest.approx(1.1)


def test_wear_goes_with_the_logarithm_of_the_tools_grasps() -> None:
    """All of the loss after 36 grasps, whatever the repeat."""
    law = LAB_LAWS["friction_wear"](0.3)
    assert law.friction_factor(_moment(tool_grasps=36)) == pytest.approx(0.7)
    assert law.friction_factor(_moment(tool_grasps=36, repeat=2)) == law.friction_factor(_moment(tool_grasps=36))
    assert law.friction_factor(_moment()) == 1.0


def test_a_post_gives_way_more_under_a_tall_object_and_keeps_the_peak() -> None:
    """The peak comes later by C h / 40 mm F / (1 + F / 40 N); the speed stays."""
    trace = _trace()
    for height_mm in (20.0, 40.0):
        made = LAB_LAWS["object_post_compliance"](0.1).trace(trace, _moment(height_mm))
        peak = np.argmax(made.force_n)
        assert made.force_n[peak] == pytest.approx(10.0)
        assert made.lift_mm[peak] == pytest.approx(20.0 + 0.1 * height_mm / 40.0 * 10.0 / 1.25, abs=0.2)
        assert lift_speed_mm_per_s(made) == pytest.approx(5.0, rel=1e-6)
        assert (np.diff(made.lift_mm) >= 0.0).all()


def test_a_transmitter_that_averages_is_late_by_its_amplitude_and_clips_peaks() -> None:
    """Mean delay: half the window plus the latency, 0.75 + 0.25 of the amplitude."""
    trace = _trace()
    made = LAB_LAWS["load_cell_lag"](0.6).trace(trace, _moment())
    centre = (step_means(made) * np.arange(120)).sum() / step_means(made).sum()
    before = (step_means(trace) * np.arange(120)).sum() / step_means(trace).sum()
    assert (centre - before) * 0.5 == pytest.approx(0.6 * 5.0, rel=0.15)
    assert made.force_n.max() < trace.force_n.max()


def test_sensor_laws() -> None:
    """Offset, drift, span, weight and magnet add what they say."""
    trace, moment = _trace(), _moment(clock_s=3600.0)

    def change(name: str, amplitude: float) -> np.ndarray:
        return np.asarray(LAB_LAWS[name](amplitude).trace(trace, moment).force_n - trace.force_n)

    assert change("load_cell_offset", 0.2)[0] == pytest.approx(0.2)
    assert change("load_cell_drift", 0.4)[0] == pytest.approx(0.4)
    assert change("load_cell_gain", 0.05) == pytest.approx(0.05 * trace.force_n)
    assert 0.05 < change("tool_weight", 1.0)[0] < 2.0
    assert np.ptp(change("tool_weight", 1.0)) < 1e-9
    magnet = change("magnetic_pull", 2.0)
    assert np.interp([0.0, 8.0], trace.lift_mm[2:], magnet[2:]) == pytest.approx([2.0, 2.0 / np.e], rel=1e-3)
    hose = change("pulling_hose", 2.0)
    assert np.interp([0.0, 30.0], trace.lift_mm[2:], hose[2:]) == pytest.approx([0.2, 1.1])


def test_time_laws() -> None:
    """A shift is rigid; a smooth start ends that much behind; a saw tooth starts again."""
    trace = _trace()
    late = LAB_LAWS["lift_misalignment"](1.0).trace(trace, _moment())
    assert 0.6 < late.lift_mm[np.argmax(late.force_n)] - 20.0 < 1.4
    started = LAB_LAWS["lift_start_error"](1.0).trace(trace, _moment())
    assert started.lift_mm[np.argmax(started.force_n)] == pytest.approx(21.0, abs=0.2)
    droop = LAB_LAWS["pressure_droop"](1.8)
    assert [droop.wider_mm(_moment(batch_grasps=n)) for n in (0, 45, 90)] == pytest.approx([0.0, 0.9, 0.0])
    posts = LAB_LAWS["warm_posts"](0.5)
    assert posts.raised_mm(_moment(clock_s=7200.0)) == pytest.approx(0.5)
    assert LAB_LAWS["batch_ageing"](0.1).modulus_factor(_moment()) == pytest.approx(1.1)


def test_other_laws_of_memory_have_other_curves() -> None:
    """Each over its clock."""
    softening = OTHER_LAB_LAWS["mullins_softening"](0.1)
    found = [softening.modulus_factor(_moment(repeat=n, clock_s=9000.0 * n)) for n in range(3)]
    assert found == pytest.approx([1.0, 1.0 - 0.1 * np.log(2.0) / np.log(3.0), 0.9])
    warming = OTHER_LAB_LAWS["temperature_softening"](0.2)
    found = [warming.modulus_factor(_moment(clock_s=3600.0 * hours)) for hours in (0.0, 1.5, 3.0)]
    assert found == pytest.approx([1.0, 0.9, 0.8])
    wear = OTHER_LAB_LAWS["friction_wear"](0.3)
    assert [wear.friction_factor(_moment(tool_grasps=n)) for n in (0, 18, 36, 72)] == pytest.approx(
        [1.0, 0.85, 0.7, 0.7]
    )
    bottle = OTHER_LAB_LAWS["pressure_droop"](1.8)
    assert [bottle.wider_mm(_moment(batch_grasps=n)) for n in (0, 60, 120, 200)] == pytest.approx([0.0, 0.9, 1.8, 1.8])


def test_other_laws_of_sensors() -> None:
    """What they add to a trace: a decade of relaxation, a zero of its own for each tool, a drift that runs away."""
    trace, moment = _trace(), _moment(clock_s=7200.0)

    def change(name: str, amplitude: float, at: Moment = moment) -> np.ndarray:
        return np.asarray(OTHER_LAB_LAWS[name](amplitude).trace(trace, at).force_n - trace.force_n)

    relaxed = OTHER_LAB_LAWS["stress_relaxation"](0.1).trace(trace, moment).force_n[3:-1] / trace.force_n[3:-1]
    assert np.interp([0.0, 2.7], trace.time_s[3:-1] - 1.0, relaxed)[1] == pytest.approx(0.9, abs=1e-3)
    offsets = [change("load_cell_offset", 0.2, Moment(numbered_design(0), seed, 40.0, FRESH))[0] for seed in range(30)]
    assert np.mean(offsets) == pytest.approx(0.2, rel=0.1)
    assert 0.02 < np.std(offsets) < 0.06
    assert change("load_cell_drift", 0.1)[0] == pytest.approx(0.4)
    weight = change("tool_weight", 1.0)
    assert np.ptp(weight) < 1e-9
    assert weight[0] > 9.81 * 0.015


def test_other_laws_of_time() -> None:
    """Filters in a row are late by their sum; a curved start by its amplitude; a clock wanders from grasp to grasp."""
    for effect, amplitude, late_mm in (("load_cell_lag", 0.4, 2.0), ("lift_start_error", 1.0, 1.0)):
        assert _late_mm(effect, amplitude, SETUP, is_other=True) == pytest.approx(late_mm, rel=0.15)
    assert _late_mm("lift_start_error", 0.4, FASTER, is_other=True) > 3.0 * _late_mm(
        "lift_start_error", 0.4, SETUP, True
    )
    clock, trace = OTHER_LAB_LAWS["lift_misalignment"](1.0), _trace()
    peaks_mm = []
    for grasp in range(40):
        made = clock.trace(trace, _moment(tool_grasps=grasp))
        peaks_mm.append(made.lift_mm[np.argmax(made.force_n)] - 20.0)
    assert np.mean(peaks_mm) == pytest.approx(1.0, abs=0.2)
    assert 0.15 < np.std(peaks_mm) < 0.45


def test_a_bending_post_gives_way_with_the_cube_of_the_height() -> None:
    peaks_mm = []
    for height_mm in (20.0, 40.0):
        made = OTHER_LAB_LAWS["object_post_compliance"](0.1).trace(_trace(), _moment(height_mm))
        peaks_mm.append(made.lift_mm[np.argmax(made.force_n)] - 20.0)
    assert peaks_mm[1] == pytest.approx(8.0 * peaks_mm[0], rel=0.1)


@pytest.mark.parametrize("name", ["load_cell_lag", "lift_misalignment", "lift_start_error"])
def test_what_is_late_still_comes_after_the_last_sample(name: str) -> None:
    """A trace that ends in a dip, as a tip springs off, is late as a whole: the dip is no force that stays."""
    lift_mm = np.array([0.0, 10.0, 20.0, 20.2, 20.4])
    trace = Trace(2.0 + lift_mm / 5.0, lift_mm, np.array([0.0, 9.0, 3.0, -7.0, 0.0]))
    made = LAB_LAWS[name](0.1).trace(trace, _moment())
    assert made.force_n.min() < -1.0
    assert made.force_n[-1] == pytest.approx(0.0, abs=1e-9)
    assert np.diff(made.lift_mm).max() < 0.2


def _late_mm(name: str, amplitude: float, setup: GraspSetup, is_other: bool = False) -> float:
    """How much later in the lift a law brings the middle of the force at a setup."""
    trace = retime(_trace(), setup)
    made = step_means(build_lab_law(name, amplitude, is_other).trace(trace, _moment(setup=setup)))
    true = step_means(trace)
    places = 0.5 * np.arange(len(true))
    return float((made * places).sum() / made.sum() - (true * places).sum() / true.sum())


FASTER, WAITING = SETUP.model_copy(update={"lift_speed_mm_per_s": 20.0}), SETUP.model_copy(update={"dwell_s": 10.0})


@pytest.mark.parametrize(("name", "amplitude"), [("lift_misalignment", 0.5), ("load_cell_lag", 0.1)])
def test_what_is_late_by_a_time_is_later_in_a_fast_lift(name: str, amplitude: float) -> None:
    """Clocks and transmitters know no millimetres: at four times the speed they are four times as late in the lift."""
    assert _late_mm(name, amplitude, FASTER) == pytest.approx(4.0 * _late_mm(name, amplitude, SETUP), rel=0.1)


def test_a_fast_lift_starts_further_behind() -> None:
    """A gantry ramps in time: what it is behind in the end goes with the speed."""
    usual, fast = (_late_mm("lift_start_error", 0.4, setup) for setup in (SETUP, FASTER))
    assert fast > 3.0 * usual


def test_a_finger_that_waits_has_relaxed_before_the_lift() -> None:
    """(1 + t)^-n goes on in the wait: after ten seconds the lift starts at 11^-n of the force."""
    law = LAB_LAWS["stress_relaxation"](0.2)
    usual, waiting = (law.trace(retime(_trace(), setup), _moment(setup=setup)) for setup in (SETUP, WAITING))
    held = waiting.force_n[waiting.is_lift][1:] / usual.force_n[usual.is_lift][1:]
    held_s = usual.time_s[usual.is_lift][1:] - usual.time_s[usual.is_lift][0]
    assert held[:-1] == pytest.approx(((11.0 + held_s) / (1.0 + held_s))[:-1] ** -0.2, rel=1e-6)


def test_a_drift_goes_on_while_the_fingers_wait() -> None:
    waits = (retime(_trace(), setup) for setup in (SETUP, WAITING))
    usual, waiting = (LAB_LAWS["load_cell_drift"](4.0).trace(trace, _moment()).force_n[-1] for trace in waits)
    assert waiting > usual + 0.02


def test_a_lab_answers_at_other_strokes_only_where_it_knows_them() -> None:
    trace = _trace()
    stroke = SETUP.model_copy(update={"closed_gap_mm": 18.0, "tip_below_mm": 6.0})
    site = Site(0, 0, GraspContext(), stroke)
    lab = Lab((0,), (1,), 1, nuisance=QUIET)
    halved, raised = (Trace(trace.time_s, trace.lift_mm, share * trace.force_n) for share in (0.8, 0.9))
    found = lab.true_trace(site, Variants(trace, wider=halved, raised=raised), ())
    assert found.force_n == pytest.approx((1.0 - 0.2 * 0.5 - 0.1) * trace.force_n)
    with pytest.raises(UsageError, match="no grasps at another stroke or height"):
        lab.true_trace(site, Variants(trace), ())


def test_asked_grasps_are_of_the_same_tools_as_mounted() -> None:
    lab, trace = Lab((0, 1), (1, 14), 3), _trace()
    asked = [Site(tool, obj, GraspContext(clock_s=9000.0), FASTER) for tool in (0, 1) for obj in (0, 1)] * 20
    usual, made = (lab.measure(lambda tool, obj: Variants(trace), (), asked=of) for of in (None, asked))
    for tool, obj in ((0, 0), (1, 1)):
        peaks = [
            np.mean([t.force_n.max() for s, t in rows if (s.tool, s.obj) == (tool, obj)]) for rows in (usual, made)
        ]
        assert peaks[1] == pytest.approx(peaks[0], rel=0.03)
    assert lift_speed_mm_per_s(made[0][1]) == pytest.approx(20.0, rel=1e-3)


def test_a_lab_makes_every_grasp_once_in_random_rounds_with_a_clock() -> None:
    """Repeats count per object, grasps per tool and batch; a second batch starts a new clock."""
    lab = Lab(range(8), (1, 14, 30), seed=5)
    sites = lab.order()
    assert len({(s.tool, s.obj, s.context.repeat) for s in sites}) == len(sites) == 8 * 3 * 3
    assert sites == Lab(range(8), (1, 14, 30), seed=5).order() != Lab(range(8), (1, 14, 30), seed=6).order()
    first = [s.context.clock_s for s in sites if s.tool < 7]
    assert (np.diff(first) > 20.0).all()
    second = next(s.context for s in sites if s.tool == 7)
    assert second.batch_grasps == second.tool_grasps == 0
    assert second.clock_s < 400.0
    assert len({tuple(s.obj for s in sites[n : n + 3]) for n in range(0, len(sites), 3)}) > 3


def test_a_quiet_lab_measures_the_truth() -> None:
    """Without nuisance the step means are the true ones; beyond the trace nothing is in the fingers."""
    trace = _trace()
    measured = Lab((0,), (1,), 1, nuisance=QUIET).measure(lambda tool, obj: Variants(trace), ())
    assert len(measured) == 3
    assert np.abs(step_means(measured[0][1]) - step_means(trace)).max() < 0.03


def test_nuisance_is_as_large_as_it_says() -> None:
    """Tools 4 %, noise 0.12 N with a correlation of 0.05 s, one grasp of 70 lost; nastier worlds have more."""
    lab = Lab(range(40), (1, 14), seed=2)
    trace = _trace()
    measured = lab.measure(lambda tool, obj: Variants(trace), ())
    assert 0.0 <= 1.0 - len(measured) / 240.0 < 0.05
    peaks = {tool: np.mean([t.force_n.max() for s, t in measured if s.tool == tool]) for tool in range(40)}
    assert 0.03 < np.std(list(peaks.values())) / 10.0 < 0.06
    tail = np.array([t.force_n[-200:] - t.force_n[-200:].mean() for _, t in measured])
    assert tail.std() == pytest.approx(0.12, rel=0.1)
    neighbours = (tail[:, 1:] * tail[:, :-1]).mean() / tail.var()
    assert neighbours == pytest.approx(np.exp(-1.0 / 4.0), abs=0.05)
    assert NASTIER.tool_sd == 2.0 * Nuisance().tool_sd
    unscaled = lab.measure(lambda tool, obj: Variants(trace), (), is_scaled=False)
    assert np.std([np.mean([t.force_n.max() for s, t in unscaled if s.tool == tool]) for tool in range(40)]) < 0.2


def test_friction_closing_and_height_go_in_proportion_to_their_variants() -> None:
    """Half of the way to the variant's friction is half of its change."""
    base = _trace()
    lower = Trace(base.time_s, base.lift_mm, 0.8 * base.force_n)
    variants = Variants(base, lower=lower, wider=lower, raised=lower, lower_factor=0.6)
    lab = Lab((0,), (1,), 1, nuisance=QUIET)
    worn = lab.true_trace(Site(0, 0, GraspContext(tool_grasps=36)), variants, [LAB_LAWS["friction_wear"](0.2)])
    assert worn.force_n == pytest.approx(0.9 * base.force_n)
    drooped = lab.true_trace(Site(0, 0, GraspContext(batch_grasps=45)), variants, [LAB_LAWS["pressure_droop"](2.0)])
    assert drooped.force_n == pytest.approx(0.9 * base.force_n)
