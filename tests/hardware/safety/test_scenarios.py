"""Every fault of the virtual bench, injected by name, ends as the table says: on the wire, in words, with the data.

One row of `TABLE` is one row of that table. What is asserted: what moved and what was switched after the fault, the
typed error with its sentence, and the grasps that were kept.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest

from fast.hardware.click.driver import LadderError
from fast.hardware.grbl.errors import (
    GrblAlarmError,
    GrblReplyError,
    MoveTimeoutError,
    SilentControllerError,
    WrongPlaceError,
)
from fast.hardware.parts.force_sensor import OverloadError, SensorFaultError
from fast.hardware.parts.safe_state import EmergencyStopError, FreezeError
from fast.hardware.safety.watches import LowAirError
from fast.hardware.virtual.faults import FAULTS
from fast.hardware.wire.serial import LinkLostError
from fast.models.errors import DeviceError, InterlockError, UsageError
from tests.hardware.safety.scenario_bench import (
    REST_Z_MM,
    SETUP,
    is_down,
    is_free,
    is_pulling,
    is_travelling,
    open_bench,
    when,
)

WATCHDOG_S = 3.0  # longer than the ladder waits for a heartbeat
KEPT, LET_GO = True, False


@dataclass(frozen=True)
class Row:
    """One fault and its end.

    `moment` None: before the batch. `error` None: the batch goes on to its end. `grasps`: status of what was reported,
    in order. `grip`: whether the gripper is still closed. `supply`, `motors`: valve and motor power when the ladder's
    watchdog has had its time. `place`: `held` where the fault found it (within the way to stop), `dock` over or in the
    dock, `rest` at the height of the grasp, `anywhere` when it is not said.
    """

    fault: str
    moment: Callable[..., bool] | None
    error: type[Exception] | None
    says: str = ""
    grasps: tuple[str, ...] = ()
    grip: bool = LET_GO
    supply: bool = False
    motors: bool = True
    place: str = "anywhere"


TABLE = [
    # Gantry
    Row("usb_unplugged", is_pulling, LinkLostError, "is gone", ("failed",), KEPT, motors=False),
    Row("grbl_silent", is_pulling, SilentControllerError, "drop the motor enable", ("failed",), KEPT, motors=False),
    Row("grbl_power_loss", is_pulling, SilentControllerError, "Check power", ("failed",), KEPT, motors=False),
    Row("grbl_reset", is_pulling, SilentControllerError, "home again", ("failed",), KEPT, place="held"),
    Row("hard_limit", is_pulling, GrblAlarmError, "ALARM:1", ("failed",), KEPT, supply=True, place="held"),
    Row("soft_limit", is_travelling, GrblAlarmError, "ALARM:2.*stop the campaign", ("failed",), place="held"),
    Row("bad_line", is_down, GrblReplyError, "answered error:.*stop the campaign", ("failed",), KEPT, place="held"),
    Row("feed_hold", is_travelling, MoveTimeoutError, "Not done after .*home again", ("failed",), place="held"),
    Row("feed_hold", is_pulling, WrongPlaceError, "came to rest .* off its target", ("failed",), KEPT, place="held"),
    Row("stray_move", is_travelling, WrongPlaceError, "0.985 mm off its way", ("failed",)),
    # PLC
    Row("plc_unplugged", is_pulling, LinkLostError, "CLICK PLC at", ("failed",), KEPT, motors=False, place="held"),
    Row("plc_stop", is_pulling, LadderError, "is in STOP", ("failed",), KEPT, motors=False, place="held"),
    Row("plc_restart", is_pulling, LadderError, "was restarted", ("failed",), KEPT, motors=False, place="held"),
    # Air
    Row("grip_valve_stuck", None, DeviceError, "has 0 psi 2 s after its valve opened", ("failed",), place="rest"),
    Row("vent_valve_stuck", is_pulling, InterlockError, "Venting .* not confirmed", ("failed",), place="free"),
    Row("low_air", None, LowAirError, "no grasp was begun and none is lost", ()),
    Row("low_air", is_pulling, LowAirError, "too low for 60 s", ("failed",)),
    Row("leak", is_pulling, DeviceError, "check the air supply", ("failed", "failed")),
    # Tool
    Row("lock_sensor_dead", None, InterlockError, "Locking the tool of slot 3", (), place="dock"),
    Row("tool_heavy", None, InterlockError, "weighs 0.*kg, the table says", (), place="dock"),
    Row("slots_empty", None, InterlockError, "Slot 3 should hold", (), place="anywhere"),
    Row("lock_sensor_dead", is_pulling, FreezeError, "don't switch", ("failed",), KEPT, supply=True, place="held"),
    Row("tool_lost", is_pulling, FreezeError, "The tool sensor", ("failed",), KEPT, supply=True, place="held"),
    Row("part_dropped", is_free, InterlockError, r"5\d g lighter .*a part fell off", ("failed",)),
    # Object
    Row("object_slips", is_pulling, None, "", ("ok", "failed", "failed")),
    Row("object_sticks", is_free, InterlockError, "the object was not released", ("failed",)),
    Row("object_missing", None, None, "", ("failed", "failed", "failed")),
    # Load cell
    Row("cell_unplugged", is_pulling, SensorFaultError, "cable", ("failed",)),
    Row("cell_saturated", is_pulling, SensorFaultError, "out of range", ("failed",)),
    Row("overload", is_pulling, OverloadError, "The head is stopped on its way", ("failed",)),
    Row("overload", is_travelling, OverloadError, "head is stopped on its way: .* carries 2", ("failed",)),
    Row("transmitter_frozen", is_pulling, SensorFaultError, "it is frozen", ("failed",)),
    Row("transmitter_unplugged", is_pulling, LinkLostError, "Weight transmitter", ("failed",), KEPT, place="held"),
    Row("zero_drift", None, InterlockError, r"has drifted by \+0\.[34]", ("ok", "failed")),
    # People
    Row("estop", is_pulling, EmergencyStopError, "was pressed", ("failed",), KEPT, motors=False),
    Row("estop", is_travelling, EmergencyStopError, "was pressed", ("failed",), motors=False),
]
ELSEWHERE = {
    "dead_switch": "test_a_dead_homing_switch_stops_after_the_second_try",
    "lost_steps": "test_lost_steps_are_cured_by_homing",
}


ON_LINES = {"usb_unplugged", "plc_unplugged", "transmitter_unplugged"}  # a hang-up as the operating system tells it


@pytest.mark.parametrize("row", TABLE, ids=lambda row: f"{row.fault}-{getattr(row.moment, '__name__', 'before')}")
def test_a_fault_ends_as_the_table_says(row):
    grasps, found, raised = [], {}, None
    with open_bench("lines" if row.fault in ON_LINES else "memory") as bench:
        virtual = bench.virtual

        def inject():
            found["place"], found["outputs"] = virtual.grbl.position_mm(), virtual.state.outputs
            virtual.inject(row.fault)

        if row.moment is None:
            inject()
        else:
            when(bench, row.moment, inject)
        try:
            bench.station.measure_tool(3, [(0, 0), (1, 0), (2, 0)], SETUP, grasps.append, lambda: False)
        except DeviceError as error:
            raised = error
        assert found, "the moment came"
        before_mm = virtual.grbl.position_mm()
        bench.clock.sleep(WATCHDOG_S)
        assert virtual.state.is_locked == (virtual.state.tool is not None or row.fault == "tool_lost"), "never unlocked"
        assert [grasp.status for grasp in grasps] == list(row.grasps)
        if row.error is None:
            assert raised is None
            assert bench.supervisor.is_ok
            return
        assert type(raised) is row.error, repr(raised)
        with pytest.raises(row.error, match=row.says):
            raise raised
        assert not bench.supervisor.is_ok, "latched"
        _, grip, supply = virtual.state.outputs
        assert (grip, supply, virtual.grbl.is_motor_enabled) == (row.grip, row.supply, row.motors)
        if row.grip is KEPT:
            assert virtual.state.pressure_psi > 25.0, "nothing that hangs is dropped"
        check_place(row.place, found["place"], before_mm, virtual.grbl.position_mm())
        with pytest.raises(InterlockError, match="latched in its safe state"):
            bench.station.measure_tool(0, [(5, 0)], SETUP, grasps.append, lambda: False)
    if row.moment is is_pulling:
        assert max(grasps[0].trace.force_n) > 3.0, "what was recorded is kept"
        assert grasps[-1].reason


def check_place(place, found_mm, before_mm, now_mm):
    if place == "held":
        assert now_mm[2] == pytest.approx(found_mm[2], abs=6.0), "it came to rest where the fault found it"
        assert now_mm == pytest.approx(before_mm, abs=0.01), "and stays"
    elif place == "free":
        assert now_mm[2] > REST_Z_MM + 48.0
        assert now_mm == pytest.approx(before_mm, abs=0.01)
    elif place == "rest":
        assert now_mm[2] == pytest.approx(REST_Z_MM, abs=0.01)
    elif place == "dock":
        assert now_mm[1] == pytest.approx(1420.0, abs=0.01)


def test_every_named_fault_has_its_scenario():
    assert {row.fault for row in TABLE} | set(ELSEWHERE) == set(FAULTS)
    assert set(ELSEWHERE.values()) <= set(globals())


def test_every_named_fault_is_told_to_people():
    page = (Path(__file__).parents[3] / "docs" / "explanation" / "safety.md").read_text(encoding="utf-8")
    assert [fault for fault in FAULTS if f"`{fault}`" not in page] == []


def test_an_unknown_fault_is_refused():
    with open_bench() as bench:
        with pytest.raises(UsageError, match="no fault `low_airr`.*low_air"):
            bench.virtual.inject("low_airr")
        with pytest.raises(UsageError, match="no fault"):
            bench.virtual.inject_at("nothing", 1.0)


def test_a_dead_homing_switch_stops_after_the_second_try(caplog):
    with open_bench() as bench:
        bench.virtual.inject("dead_switch")
        with pytest.raises(GrblAlarmError, match="ALARM:9.*check the limit switches"):
            bench.supervisor.home()
        assert caplog.text.count("Homing once more") == 1
        assert not bench.supervisor.is_ok


def test_a_homing_that_is_interrupted_is_begun_once_more(caplog):
    with open_bench() as bench:
        when(
            bench, lambda virtual: virtual.grbl.state == "Home", lambda: bench.virtual.grbl.inject("typed", line="\x18")
        )
        bench.supervisor.home()
        assert "ALARM:6" in caplog.text
        assert bench.supervisor.is_ok
        assert bench.gantry.is_position_known


def test_lost_steps_are_cured_by_homing():
    """GRBL counts steps and cannot feel that they are lost; homing at the start of every session cures it."""
    grasps = []
    with open_bench() as bench:
        when(bench, is_travelling, lambda: bench.virtual.inject("lost_steps"))
        bench.station.measure_tool(3, [(0, 0)], SETUP, grasps.append, lambda: False)
        told_mm, true_mm = bench.gantry.position_mm(), bench.virtual.grbl.position_mm()
        assert true_mm[0] - told_mm[0] == pytest.approx(0.5, abs=0.02)
        bench.supervisor.home()
        assert bench.gantry.position_mm() == pytest.approx(bench.virtual.grbl.position_mm(), abs=0.02)
    assert [grasp.status for grasp in grasps] == ["ok"]
