"""People and the safe state: who may end it, in which order, and what goes on by itself."""

import datetime

import numpy as np
import pytest

from fast.hardware.parts.safe_state import EmergencyStopError, SafeAction, StopAskedError, Verb
from fast.models.errors import DeviceError, InterlockError, LakeError
from tests.hardware.safety.scenario_bench import (
    REST_Z_MM,
    SETUP,
    is_free,
    is_pulling,
    is_travelling,
    open_bench,
    when,
)

PLAN = [(0, 0), (1, 0)]


def run(bench, grasps, plan=PLAN, slot=3):
    bench.station.measure_tool(slot, plan, SETUP, grasps.append, lambda: False)


def heights_while(bench, act):
    """Height of the head and pressure of the gripper over time, while `act` runs."""
    seen = []

    def look(_now_s):
        seen.append((bench.virtual.grbl.position_mm()[2], bench.virtual.state.pressure_psi))

    bench.clock.add_listener(look)
    act()
    bench.clock.remove_listener(look)
    return np.array(seen).T


def test_the_safe_state_ends_by_lowering_venting_and_raising():
    with open_bench() as bench:
        when(bench, is_pulling, lambda: bench.virtual.inject("lock_sensor_dead"))
        with pytest.raises(InterlockError):
            run(bench, [])
        bench.virtual.clear("lock_sensor_dead")
        bench.clock.sleep(0.1)
        z_mm, psi = heights_while(bench, bench.station.recover)
        opening = int(np.argmax(psi < 25.0))
        assert psi[0] > 29.0
        assert z_mm[opening] == pytest.approx(REST_Z_MM, abs=0.5), "nothing falls"
        assert np.all(np.diff(z_mm[:opening]) <= 1e-6), "down first"
        assert np.all(np.diff(z_mm[opening:]) >= -1e-6), "then up"
        assert z_mm[-1] == pytest.approx(175.0)
        assert psi[-1] < 1.0
        assert bench.changer.status().slot == 3
        assert bench.supervisor.is_ok


def test_a_closed_gripper_that_cannot_be_lowered_opens_only_when_its_load_is_taken():
    with open_bench() as bench:
        when(bench, is_pulling, lambda: bench.virtual.inject("grbl_reset"))
        with pytest.raises(DeviceError):
            run(bench, [])
        with pytest.raises(InterlockError, match="cannot be lowered, since the position is unknown"):
            bench.supervisor.end_safe_state("test")
        assert bench.pneumatics.is_gripping()
        assert not bench.supervisor.is_ok
        assert bench.supervisor.end_safe_state("test", is_load_taken=True) == (SafeAction.VENT,)
        assert not bench.pneumatics.is_gripping()
        bench.supervisor.home()
        assert bench.changer.status().slot == 3


def test_an_emergency_stop_needs_release_acknowledgement_homing_and_the_tool():
    grasps = []
    with open_bench() as bench:
        when(bench, is_pulling, lambda: bench.virtual.inject("estop"))
        with pytest.raises(EmergencyStopError, match="Release it, acknowledge, then home and check the tool"):
            run(bench, grasps)
        with pytest.raises(EmergencyStopError, match="is pressed"):
            bench.supervisor.acknowledge("test")
        bench.virtual.clear("estop")
        bench.clock.sleep(5.0)
        assert not bench.supervisor.is_ok, "releasing the button resumes nothing"
        assert not bench.virtual.state.outputs[2]
        bench.supervisor.acknowledge("test")
        with pytest.raises(InterlockError, match="closed from an earlier grasp"):
            run(bench, grasps)
        bench.supervisor.end_safe_state("test", is_load_taken=True)
        bench.gantry.connect()
        bench.supervisor.home()
        assert bench.changer.status().slot == 3
        run(bench, grasps)
    assert [grasp.status for grasp in grasps] == ["failed", "ok", "ok"]


@pytest.mark.parametrize("verb", [Verb.STOP, Verb.ABORT])
@pytest.mark.parametrize("moment", [is_travelling, is_pulling], ids=["travelling", "pulling"])
def test_stop_and_abort_make_safe_at_once_and_keep_the_data(verb, moment):
    grasps = []
    with open_bench() as bench:
        when(bench, moment, lambda: bench.supervisor.ask(verb))
        with pytest.raises(StopAskedError, match=f"asked to {verb}: the bench is in its safe state") as caught:
            run(bench, grasps)
        assert caught.value.verb is verb
        assert [grasp.status for grasp in grasps] == ["failed"]
        assert not bench.gantry.is_moving()
        before_mm = bench.virtual.grbl.position_mm()
        bench.clock.sleep(3.0)
        assert bench.virtual.grbl.position_mm() == before_mm, "held"
        assert bench.virtual.state.outputs == (True, moment is is_pulling, False), "lock and grip kept, supply closed"
        bench.station.recover()
        run(bench, grasps, plan=[(0, 0)])
    assert grasps[-1].status == "ok"
    if moment is is_pulling:
        assert grasps[0].trace.force_n.max() > 3.0, "the data is kept"


def test_pause_finishes_the_grasp_and_parks():
    grasps = []
    with open_bench() as bench:
        asked = []
        when(bench, is_pulling, lambda: asked.append(Verb.PAUSE))
        when(bench, is_pulling, lambda: bench.supervisor.ask(Verb.PAUSE))
        bench.station.measure_tool(3, PLAN, SETUP, grasps.append, lambda: bool(asked))
        assert bench.supervisor.is_ok
        assert bench.changer.status().slot is None
    assert [grasp.status for grasp in grasps] == ["ok"]


def test_ctrl_c_in_a_lift_ends_in_the_safe_state():
    def press():
        raise KeyboardInterrupt

    grasps = []
    with open_bench() as bench:
        when(bench, is_pulling, press)
        with pytest.raises(KeyboardInterrupt):
            run(bench, grasps)
        assert [(grasp.status, grasp.reason) for grasp in grasps] == [("failed", "KeyboardInterrupt")]
        assert bench.supervisor.cause == "KeyboardInterrupt"
        assert not bench.gantry.is_moving()
        assert bench.virtual.state.outputs == (True, True, False)


def test_the_bench_is_safe_before_the_data_is_kept():
    moving = []
    with open_bench() as bench:
        when(bench, is_pulling, lambda: bench.virtual.inject("lock_sensor_dead"))
        with pytest.raises(InterlockError):
            run(bench, grasps := Kept(lambda: moving.append(bench.gantry.is_moving())))
    assert moving == [False]
    assert len(grasps) == 1


class Kept(list):
    """A list that does something on every append."""

    def __init__(self, act):
        super().__init__()
        self._act = act

    def append(self, grasp):
        self._act()
        super().append(grasp)


def test_low_air_before_a_grasp_waits_and_goes_on():
    grasps = []
    with open_bench() as bench:
        bench.virtual.inject("low_air")
        start_s = bench.clock.now_s()
        when(bench, lambda _: bench.clock.now_s() > start_s + 40.0, lambda: bench.virtual.clear("low_air"))
        run(bench, grasps)
    assert [grasp.status for grasp in grasps] == ["ok", "ok"], "nothing is lost"


def test_low_air_in_a_lift_lowers_before_it_opens():
    with open_bench() as bench:
        when(bench, is_pulling, lambda: bench.virtual.inject("low_air"))
        grasps = []

        def act():
            with pytest.raises(DeviceError):
                run(bench, grasps)

        z_mm, psi = heights_while(bench, act)
        opening = int(np.argmax((psi < 25.0) & (np.maximum.accumulate(psi) > 29.0)))
        assert z_mm[opening] == pytest.approx(REST_Z_MM, abs=0.5)
        assert "mains went low in the lift" in grasps[0].reason
        assert bench.virtual.state.is_locked


def test_an_object_that_sticks_for_a_moment_costs_nothing(caplog):
    grasps = []
    with open_bench() as bench:

        def stick():
            bench.virtual.inject("object_sticks")
            when(bench, lambda virtual: not virtual.state.outputs[1], let_go_later)

        def let_go_later():
            until_s = bench.clock.now_s() + 1.2  # after the first look at what hangs there
            when(bench, lambda _: bench.clock.now_s() > until_s, lambda: bench.virtual.clear("object_sticks"))

        when(bench, is_free, stick)
        run(bench, grasps)
    assert [grasp.status for grasp in grasps] == ["ok", "ok"]
    assert "venting once more" in caplog.text


def test_a_small_drift_is_tared_and_told(caplog):
    grasps = []
    with open_bench() as bench:
        when(bench, is_pulling, lambda: bench.virtual.inject("zero_drift"))
        run(bench, grasps)
    assert [grasp.status for grasp in grasps] == ["ok", "ok"]
    assert "The load cell's zero moved by" in caplog.text
    assert abs(float(grasps[1].details["zero_step_n"])) > 0.1


def test_a_full_disk_stops_before_the_next_grasp_and_drops_nothing():
    made = []

    def full(grasp):
        made.append(grasp)
        raise LakeError("The disk is full.")

    with open_bench() as bench:
        with pytest.raises(LakeError, match="disk is full"):
            bench.station.measure_tool(3, PLAN, SETUP, full, lambda: False)
        assert not bench.pneumatics.is_gripping(), "the grasp itself had ended"
        assert bench.virtual.state.is_locked
    assert [grasp.object_id for grasp in made] == [0]


def test_a_clock_that_jumps_back_does_not_reach_the_trace(monkeypatch):
    class Jumping(datetime.datetime):
        days = 0

        @classmethod
        def now(cls, tz=None):
            cls.days += 1
            return datetime.datetime(2026, 1, 28, tzinfo=tz) - datetime.timedelta(days=cls.days)

    monkeypatch.setattr("fast.hardware.station.station.datetime", Jumping)
    monkeypatch.setattr("time.time", lambda: -1e9)
    grasps = []
    with open_bench() as bench:
        run(bench, grasps)
    assert grasps[1].started_at < grasps[0].started_at, "wall time is only told"
    for grasp in grasps:
        assert grasp.status == "ok"
        assert np.all(np.diff(grasp.trace.time_s) > 0)
