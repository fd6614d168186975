"""A gantry of another size and speed than the lab's: said in the bench file, checked before anything moves."""

import pytest

from fast.flows.cli.real import what_moves
from fast.hardware.bench import BenchSettings, open_real_bench, open_virtual_bench, open_virtual_servers
from fast.hardware.checkup.bench import check_bench
from fast.hardware.clock import VirtualClock
from fast.hardware.grbl.profile import GrblProfile
from fast.hardware.parts.gantry import Gantry
from fast.hardware.parts.layout import BenchLayout
from fast.hardware.virtual.grbl.server import VirtualGrbl
from fast.hardware.wire.serial import SerialTransport
from fast.models.errors import ConfigError, DeviceError, InterlockError, UsageError
from fast.models.records import Placement
from fast.models.validation import load_record
from tests.hardware.cell.test_cell import QUIET, SETUP, TOOLS, physics

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


def test_the_bench_file_says_what_the_controller_must_have():
    clock = VirtualClock()
    with open_virtual_servers(QUIET, TOOLS, physics, clock) as virtual:
        virtual.grbl._machine.settings.update({110: 6000.0})
        at = virtual.endpoints
        lab = BenchSettings(
            serial_port=at.serial_port, plc_host=at.plc_host, plc_port=at.plc_port,
            transmitter_host=at.transmitter_host, transmitter_port=at.transmitter_port, modbus_time_out_s=5.0,
            stale_after_s=None,
        )  # fmt: skip
        with pytest.raises(DeviceError, match=r"\$110 is 6000, profile 12000"), open_real_bench(lab, TOOLS, clock):
            pass
        own = lab.model_copy(update={"gantry_settings": {110: 6000.0}})
        (seen,) = [finding for finding in check_bench(own, clock) if finding.name == "gantry settings"]
        assert seen.ok, seen.note
        with open_real_bench(own, TOOLS, clock) as bench:
            with pytest.raises(InterlockError, match="Speed 150 mm/s is outside 0..100 mm/s"):
                bench.gantry.move_to(x_mm=1000.0, speed_mm_per_s=150.0)
    assert "at up to 100, 200, 50 mm/s" in what_moves("b", own, {})


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
        bench.cell._layout = BenchLayout(dock_y_mm=1600.0)
        before = bench.gantry.position_mm(), bench.clock.now_s()
        with pytest.raises(UsageError, match="Tool slot 3 stands at x 555, y 1600 mm"):
            bench.cell.measure_tool(3, [(0, 0)], SETUP, print, lambda: False)
        assert (bench.gantry.position_mm(), bench.clock.now_s()) == before
