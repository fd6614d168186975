"""A gantry of another size and speed than the lab's: said in the bench file, checked before anything moves."""

import pytest

from fast.flows.cli.real import what_moves
from fast.hardware.bench import BenchSettings, open_real_bench, open_virtual_bench, open_virtual_servers, wires_to
from fast.hardware.checkup.bench import check_bench
from fast.hardware.clock import ScaledClock, VirtualClock
from fast.hardware.grbl.profile import GrblProfile
from fast.hardware.laumas.strings import parse_line
from fast.hardware.parts.gantry import Gantry
from fast.hardware.parts.layout import BenchLayout
from fast.hardware.virtual.grbl.server import VirtualGrbl
from fast.hardware.virtual.world.state import HEAD_MASS_KG
from fast.hardware.wire.serial import SerialTransport
from fast.models.errors import ConfigError, DeviceError, InterlockError, UsageError
from fast.models.records import Placement
from fast.models.units import force_n_from_kg
from fast.models.validation import load_record
from tests.hardware.station.test_station import QUIET, SETUP, TOOLS, physics

SMALL = {130: 806.0, 131: 806.0, 110: 6000.0}
SMALL_MM = (800.0, 800.0, 180.0)


def test_a_small_gantry_homes_to_its_own_corner_and_stays_in_its_own_box():
    clock, profile = VirtualClock(), GrblProfile().with_settings(SMALL)
    with (
        VirtualGrbl(clock, profile, start_mm=(790.0, 790.0, 175.0)) as controller,
        Gantry(SerialTransport(controller.port), clock, profile, SMALL_MM) as gantry,
    ):
        assert gantry.home() == pytest.approx(SMALL_MM)
        gantry.move_to(0.0, 0.0, 180.0)
        assert gantry.status().machine_mm[:2] == pytest.approx((-803.0, -803.0))
        with pytest.raises(InterlockError, match=r"x = 801.000 mm is outside the workspace 0..800 mm"):
            gantry.move_to(x_mm=801.0)


def _name_devices(at, modbus_time_out_s):
    """A bench file of virtual devices."""
    return BenchSettings(
        serial_port=at.serial_port, plc_host=at.plc_host, plc_port=at.plc_port,
        transmitter_host=at.transmitter_host, transmitter_port=at.transmitter_port,
        modbus_time_out_s=modbus_time_out_s, stale_after_s=0.0,
    )  # fmt: skip


def test_the_bench_file_says_what_the_controller_must_have():
    clock = VirtualClock()
    with open_virtual_servers(QUIET, TOOLS, physics, clock) as virtual:
        virtual.grbl._machine.settings.update({110: 6000.0})
        at = virtual.endpoints
        lab = _name_devices(at, modbus_time_out_s=5.0)
        with pytest.raises(DeviceError, match=r"\$110 is 6000, profile 12000"), open_real_bench(lab, TOOLS, clock):
            pass
        own = lab.model_copy(update={"gantry_settings": {110: 6000.0}})
        (seen,) = [finding for finding in check_bench(own, clock) if finding.name == "gantry settings"]
        assert seen.ok, seen.note
        with open_real_bench(own, TOOLS, clock) as bench:
            with pytest.raises(InterlockError, match="Speed 150 mm/s is outside 0..100 mm/s"):
                bench.gantry.move_to(x_mm=1000.0, speed_mm_per_s=150.0)
    assert "at up to 100, 200, 50 mm/s" in what_moves("b", own, {})


def test_a_virtual_bench_is_like_the_bench_file():
    like = BenchSettings(
        gantry_settings=SMALL, layout=BenchLayout(workspace_mm=SMALL_MM, n_places=9, n_columns=3, n_slots=4),
        transmitter_mode="continuous", transmitter_serial_port="x", transmitter_unit="N", transmitter_division=0.01,
    )  # fmt: skip
    with open_virtual_servers(QUIET, {}, physics, ScaledClock(20.0), like=like) as virtual:
        assert virtual.grbl.position_mm() == pytest.approx((780.0, 780.0, 175.0))
        assert virtual.grbl.profile.max_speed_mm_per_s[0] == 100.0
        string = parse_line(virtual.transmitter.send_string().rstrip())
        assert 0.01 * string.counts == pytest.approx(force_n_from_kg(HEAD_MASS_KG), abs=0.05)


def test_a_smaller_grid_and_dock_are_said_in_the_bench_file():
    layout = BenchLayout(n_places=9, n_columns=3, n_slots=4)
    assert [layout.object_xy_mm(number) for number in (0, 4, 8)] == [(600, 600), (750, 750), (900, 900)]
    assert layout.object_at(900, 900) == 8
    assert layout.dock_at(layout.dock_xy_mm(3)[0], layout.dock_y_mm, 90.0) == 3
    with pytest.raises(UsageError, match="Object 9 has no place on the bench; use an id from 0 to 8"):
        layout.object_xy_mm(9)
    with pytest.raises(UsageError, match="Tool slot 4 does not exist; use a slot from 0 to 3"):
        layout.dock_xy_mm(4)
    assert BenchLayout(n_places=9, n_columns=3, own_objects=((20, 3),)).object_xy_mm(20) == (600, 750)


def test_a_faster_board_and_another_cell_are_said_in_the_bench_file():
    fast_board = {"max_step_rate_hz": 100_000, "gantry_settings": {"101": 200}, "full_scale_kg": 5.0}
    settings = load_record(BenchSettings, fast_board | {"serial_baud_rate": 250_000, "stale_after_s": 0}, "b")
    assert settings.gantry_profile.settings[101] == 200
    assert wires_to(settings, VirtualClock()).gantry._baudrate == 250_000
    for wrong, said in (
        ({"full_scale_kg": 0}, "`full_scale_kg` is 0 kg, it must be above 0"),
        ({"serial_baud_rate": 300}, "`serial_baud_rate` is 300, it must be at least 9600"),
        ({"max_step_rate_hz": 1e9}, "`max_step_rate_hz` is .*, it must be at most"),
        ({"layout": {"n_slots": 11}}, "`layout.n_slots` is 11, it must be at most 10"),
        ({"layout": {"n_places": 37}}, "`layout.n_places` is 37, it must be at most 36"),
    ):
        with pytest.raises(ConfigError, match=said):
            load_record(BenchSettings, wrong, "b")


def test_what_moves_tells_the_box_of_this_machine():
    settings = BenchSettings(gantry_settings=SMALL, layout=BenchLayout(workspace_mm=SMALL_MM))
    assert "box        x 0 to 800, y 0 to 800, z 0 to 180 mm" in what_moves("b", settings, {})


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({13: 1}, "gantry_settings has 13, which no machine may have its own; it may have 0, 2, 3"),
        ({22: 0}, "gantry_settings has 22, which"),
        ({481: 1}, "gantry_settings has 481, which"),
        ({100: 0}, "gantry_settings.100 is 0, it must be above 0"),
        ({101: 200}, "asks 40000 steps/s of axis y, limit 30000; lower $111"),
        ({23: 4}, "gantry_settings.23 is 4: Z would home down onto the bench"),
        ({130: 806}, r"layout.workspace_mm is 1500 mm in x, the controller reaches 803 mm (travel $130 less"),
    ],
)
def test_settings_that_would_be_unsafe_are_refused(settings, said):
    with pytest.raises(ConfigError) as caught:
        load_record(BenchSettings, {"gantry_settings": {str(number): value for number, value in settings.items()}}, "b")
    assert said in str(caught.value)
    assert str(caught.value).startswith("b: ")


def test_places_outside_the_workspace_are_refused_before_anything_moves():
    layout = BenchLayout(workspace_mm=SMALL_MM)
    with pytest.raises(UsageError, match="Tool slot 3 stands at x 555, y 1420 mm, the workspace ends at 800, 800 mm"):
        layout.dock_xy_mm(3)
    wide = BenchLayout(workspace_mm=SMALL_MM, object_pitch_mm=170.0)
    with pytest.raises(UsageError, match="Object 0 stands at x -25, y -25 mm"):
        wide.grasp_xy_mm(0, Placement())
    with open_virtual_bench(QUIET, TOOLS, physics, wires="memory") as bench:
        bench.station._layout = BenchLayout(dock_y_mm=1600.0)
        before = bench.gantry.position_mm(), bench.clock.now_s()
        with pytest.raises(UsageError, match="Tool slot 3 stands at x 555, y 1600 mm"):
            bench.station.measure_tool(3, [(0, 0)], SETUP, print, lambda: False)
        assert (bench.gantry.position_mm(), bench.clock.now_s()) == before


def test_between_two_sessions_somebody_frees_a_virtual_carriage_from_its_limit_switch():
    clock = ScaledClock(20.0)
    with open_virtual_servers(QUIET, TOOLS, physics, clock) as virtual:
        at = virtual.endpoints
        settings = _name_devices(at, modbus_time_out_s=20.0)
        with open_real_bench(settings, TOOLS, clock):
            pass
        until_s = clock.now_s() + 200.0
        while virtual.grbl.is_motor_enabled and clock.now_s() < until_s:  # without a host the PLC takes their power
            clock.sleep(1.0)
        virtual.grbl.inject("limit", axis="y")
        virtual.grbl.inject("nudge", axis="x", distance_mm=4.0)
        assert virtual.grbl._machine._pins() == "XY"
        with open_real_bench(settings, TOOLS, clock) as bench:
            assert bench.gantry.position_mm() == pytest.approx((1500.0, 1500.0, 180.0), abs=0.05)
