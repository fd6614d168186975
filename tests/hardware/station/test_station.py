import threading

import numpy as np
import pytest

from fast.hardware.bench import BenchSettings, MountedTool, open_real_bench, open_virtual_bench, open_virtual_servers
from fast.hardware.click import tags
from fast.hardware.clock import VirtualClock
from fast.hardware.parts.layout import BenchLayout
from fast.hardware.virtual.click import VirtualClick
from fast.hardware.virtual.world.file import Scatter, Sensor, World
from fast.hardware.virtual.world.physics import PhysicsCache, build_request
from fast.models.design.fin_ray import FinRay
from fast.models.errors import DeviceError, InterlockError, LakeError, SimulationFailed, UsageError
from fast.models.records import BENCH_FAULT, GraspSetup, GraspSimulation, Trace
from fast.models.traces import peak_force_n

DESIGN = FinRay(
    length_mm=30, width_mm=30, height_mm=110, tip_length_mm=25, front_thickness_mm=2.5, back_thickness_mm=2.5,
    rib_thickness_mm=2.5, rib_count=5, rib_angle_deg=0,
)  # fmt: skip
TOOLS = {0: MountedTool("a/B01T0", DESIGN), 3: MountedTool("a/B01T3", DESIGN)}
QUIET = World(seed=7)
NOISY = World(seed=7, sensor=Sensor(noise_sd_n=0.12), scatter=Scatter(tool_modulus_sd=0.04, repeat_sd=0.01))
SETUP = GraspSetup()


def lift_force_n(lift_mm, object_id):
    """An analytic grasp: pushed up at first, a hump, released at 48 mm."""
    hump = -1.0 + (8.0 + object_id) * np.sin(np.pi * lift_mm / 48.0) ** 2 + lift_mm / 48.0
    return np.where(lift_mm < 48.0, hump, 0.0)


def physics(request):
    setup = request.setup
    closing_s = (setup.open_gap_mm - setup.closed_gap_mm) / 2 / setup.close_speed_mm_per_s
    closing = np.linspace(0, 1, 30)
    lift_mm = np.linspace(0, setup.max_lift_mm, 321)[1:]
    trace = Trace(
        np.concatenate([closing * closing_s, closing_s + lift_mm / setup.lift_speed_mm_per_s]),
        np.concatenate([np.zeros(30), lift_mm]),
        np.concatenate([-(closing**3), lift_force_n(lift_mm, request.object_id)]),
    )
    return GraspSimulation(trace, 8.0, 5.0, 0.2, 1, 1, 1, 0.0)


def measure(
    world, plan, slot=3, physics=physics, setup=SETUP, prepare=lambda bench: None, stop_after=99, wires="memory"
):
    grasps = []
    with open_virtual_bench(world, TOOLS, physics, wires=wires) as bench:
        prepare(bench)
        bench.station.measure_tool(slot, plan, setup, grasps.append, lambda: len(grasps) >= stop_after)
        assert bench.changer.status().slot is None, "the tool is parked"
        assert bench.changer.full_slots() == sorted(TOOLS)
        assert bench.virtual.state.supply_psi == 30.0
    return grasps


def when_pulled(bench, act, above_n=4.0):
    """Do something, once, in the middle of a lift."""

    def watch(_now_s):
        if bench.virtual.state.grasp_force_n() > above_n:
            bench.clock.remove_listener(watch)
            act()

    bench.clock.add_listener(watch)


def inject_when_pulled(bench, fault, above_n=4.0):
    when_pulled(bench, lambda: bench.virtual.state.inject(fault), above_n)


def test_a_quiet_world_is_measured_as_its_physics_says():
    plan = [(0, 0), (35, 0), (0, 1)]
    grasps = measure(QUIET, plan)
    assert [(g.object_id, g.repeat) for g in grasps] == plan
    for grasp in grasps:
        trace = grasp.trace
        assert grasp.status == "ok", grasp.reason
        assert grasp.details["end"] == "separated"
        assert grasp.details["force_rate_hz"] == 80.0
        lifting = (trace.lift_mm > 0.5) & (np.abs(trace.lift_mm - 48.0) > 0.5)
        expected_n = lift_force_n(trace.lift_mm[lifting], grasp.object_id)
        assert trace.force_n[lifting] == pytest.approx(expected_n, abs=0.05)
        assert peak_force_n(trace) == pytest.approx(7.5 + grasp.object_id, abs=0.05)
        closing = trace.force_n[trace.lift_mm == 0]
        assert closing.min() == pytest.approx(-1.0, abs=0.05)
        assert 0.0 <= trace.time_s[0] < 0.05
        assert np.diff(trace.time_s[:1]).sum() >= 0
        assert np.median(np.diff(trace.time_s)) == pytest.approx(1 / 80, rel=0.01)
        assert np.all(np.diff(trace.lift_mm) >= -1e-6)
        assert 46 < trace.lift_mm[-1] < 50.5, "tips over the object, force back at zero"
        assert grasp.details["separation_mm"] == pytest.approx(46.5 if grasp.object_id else 44.0, abs=1.0)
        assert abs(grasp.details["zero_drift_n"]) < 0.25
        speed = np.polyfit(trace.time_s[lifting], trace.lift_mm[lifting], 1)[0]
        assert speed == pytest.approx(5.0, rel=0.01)
        assert grasp.tare_force_n == pytest.approx(9.80665 * (0.85 + TOOLS[3].expected_mass_kg), abs=0.05)


def test_a_resumed_bench_measures_what_an_uninterrupted_one_would():
    whole = measure(NOISY, [(0, 0), (1, 0), (1, 1)])
    resumed = measure(NOISY, [(1, 1)])
    assert peak_force_n(resumed[0].trace) == pytest.approx(peak_force_n(whole[2].trace), abs=0.03)
    assert peak_force_n(whole[1].trace) != pytest.approx(peak_force_n(whole[2].trace), abs=1e-3)


def test_noise_reaches_the_trace():
    (grasp,) = measure(NOISY, [(0, 0)])
    tail = grasp.trace.force_n[grasp.trace.lift_mm > 44.5]
    assert 0.04 < tail.std() < 0.25
    assert 0.04 < grasp.details["baseline_sd_n"] < 0.25


def test_stop_finishes_the_grasp_and_parks():
    grasps = measure(QUIET, [(0, 0), (1, 0), (2, 0)], stop_after=1)
    assert [g.object_id for g in grasps] == [0]


def test_the_setup_reaches_the_world_over_the_wire():
    seen = []

    def remember(request):
        seen.append(request)
        return physics(request)

    setup = GraspSetup(open_gap_mm=60, closed_gap_mm=12.5, tip_below_mm=8, close_speed_mm_per_s=30, max_lift_mm=70)
    measure(QUIET, [(4, 0), (4, 1)], physics=remember, setup=setup)
    assert len(seen) == 1, "one solution for all repeats"
    assert seen[0].setup == setup.timed_as(GraspSetup()), "its physics is the same at every speed"
    assert seen[0].design == DESIGN


def test_requests_made_ahead_are_those_the_bench_asks_for():
    """A caller may solve a tool's grasps in a pool first: odd heights must not change the request."""
    design = DESIGN.model_copy(update={"height_mm": 97.123456})
    world = World(seed=3, scatter=Scatter(placement_sd_mm=0.2))
    setup = GraspSetup(tip_below_mm=7.5)

    def refuse(request):
        raise AssertionError(f"asked for {request}")

    ahead = PhysicsCache(refuse)
    for object_id in (2, 11):
        request = build_request(world, "a/B02T1", design, object_id, setup)
        ahead.put(request, physics(request))
    grasps = []
    with open_virtual_bench(world, {1: MountedTool("a/B02T1", design)}, ahead, wires="memory") as bench:
        bench.station.measure_tool(1, [(2, 0), (11, 0)], setup, grasps.append, lambda: False)
    assert [g.status for g in grasps] == ["ok", "ok"]


def test_a_grasp_without_physics_fails_and_the_plan_goes_on():
    def broken_on_one(request):
        if request.object_id == 1:
            raise SimulationFailed("no solution", "diverged")
        return physics(request)

    grasps = measure(QUIET, [(1, 0), (2, 0)], physics=broken_on_one)
    assert [g.status for g in grasps] == ["failed", "ok"]
    assert "converter fault" in grasps[0].reason


def test_overload_stops_the_lift_lowers_and_goes_on():
    def strong(request):
        simulation = physics(request)
        scale = 40.0 if request.object_id == 0 else 1.0
        trace = simulation.trace
        scaled = Trace(trace.time_s, trace.lift_mm, scale * trace.force_n)
        return GraspSimulation(scaled, 8.0, 5.0, 0.2, 1, 1, 1, 0.0)

    grasps = measure(QUIET, [(0, 0), (1, 0)], physics=strong)
    assert [g.status for g in grasps] == ["failed", "ok"]
    assert "full scale is 196 N" in grasps[0].reason
    assert grasps[0].trace.force_n.max() < 200


def run_into(bench, error, match, plan=((0, 0), (1, 0))):
    grasps = []
    with pytest.raises(error, match=match):
        bench.station.measure_tool(3, plan, SETUP, grasps.append, lambda: False)
    return grasps


@pytest.mark.parametrize(
    ("shown", "message"),
    [
        (6.895, r"has 206\.\d psi, at most 33\.0 psi fit the 30 psi .* regulator follows DF2, .* writes psi into DF1"),
        (1.2, r"has 3[56]\.\d psi, at most 33\.0 psi"),
        (0.0689, r"has 2\.1 psi, it needs 28\.0 psi; check for a leak, and that the ladder writes psi into DF1"),
    ],
)
def test_another_pressure_than_the_one_that_was_set_lifts_nothing(shown, message, monkeypatch):
    """The ladder writes kPa, a regulator by hand stands higher, the ladder writes bar."""
    tell = VirtualClick._set

    def scaled(plc, name, value):
        tell(plc, name, shown * value if name == tags.PRESSURE_REGISTER else value)

    monkeypatch.setattr(VirtualClick, "_set", scaled)
    with open_virtual_bench(QUIET, TOOLS, physics, wires="memory") as bench:
        (grasp,) = run_into(bench, DeviceError, message)
        assert (grasp.status, grasp.details["end"], grasp.trace.lift_mm.max()) == ("failed", BENCH_FAULT, 0.0)
        assert bench.pneumatics.is_gripping(), "nobody has looked"
        assert not bench.supervisor.is_ok


def test_losing_the_lock_in_a_lift_holds_everything():
    with open_virtual_bench(QUIET, TOOLS, physics, wires="memory") as bench:
        inject_when_pulled(bench, "lock_sensor_dead")
        grasps = run_into(bench, InterlockError, "lock sensor went off")
        assert [g.status for g in grasps] == ["failed"]
        assert peak_force_n(grasps[0].trace) > 3.0, "what was recorded is kept"
        assert bench.pneumatics.is_gripping(), "an object in the air is not dropped"
        assert bench.virtual.state.is_locked
        assert bench.plc.read_bit("Y3"), "nothing is switched"
        z_mm = bench.gantry.position_mm()[2]
        bench.clock.sleep(1.0)
        assert bench.gantry.position_mm()[2] == z_mm, "motion is held"
        with pytest.raises(InterlockError, match="latched in its safe state: The lock sensor went off"):
            bench.station.measure_tool(3, [(0, 0)], SETUP, grasps.append, lambda: False)
        bench.supervisor.acknowledge("test")
        with pytest.raises(InterlockError, match="closed from an earlier grasp"):
            bench.station.measure_tool(3, [(0, 0)], SETUP, grasps.append, lambda: False)


def test_a_person_recovers_and_the_tool_on_the_head_is_known():
    with open_virtual_bench(QUIET, TOOLS, physics, wires="memory") as bench:
        inject_when_pulled(bench, "lock_sensor_dead", above_n=6.0)
        run_into(bench, InterlockError, "lock sensor went off", plan=((0, 0),))
        bench.virtual.state.clear("lock_sensor_dead")
        bench.clock.sleep(0.05)
        assert bench.changer.status().slot == 3
        bench.station.recover()
        assert not bench.pneumatics.is_gripping()
        bench.station.park()
        assert bench.changer.status().slot is None


def test_the_emergency_stop_refuses_to_start():
    with open_virtual_bench(QUIET, TOOLS, physics, wires="memory") as bench:
        bench.virtual.state.inject("estop_pressed")
        bench.clock.sleep(0.1)
        assert run_into(bench, InterlockError, "emergency stop is pressed") == []


def test_plans_that_cannot_be_carried_out_move_nothing():
    with open_virtual_bench(QUIET, TOOLS, physics, wires="memory") as bench:
        before = bench.gantry.position_mm(), bench.clock.now_s()
        cases = [
            (5, [(0, 0)], SETUP, "Slot 5 has no tool; mounted are slots .0, 3."),
            (3, [(36, 0)], SETUP, "Object 36 has no place on the bench; use an id from 0 to 35"),
            (3, [(0, 0)], GraspSetup(max_lift_mm=120), "needs z from 78.0 to 198.0 mm, the axis has 0 to 180"),
        ]
        for slot, plan, setup, message in cases:
            with pytest.raises(UsageError, match=message):
                bench.station.measure_tool(slot, plan, setup, lambda grasp: None, lambda: False)
        bench.station.measure_tool(3, [], SETUP, lambda grasp: None, lambda: False)
        assert (bench.gantry.position_mm(), bench.clock.now_s()) == before


def test_a_callback_that_fails_leaves_the_gripper_open():
    def full_disk(grasp):
        raise LakeError("The disk is full.")

    with open_virtual_bench(QUIET, TOOLS, physics, wires="memory") as bench:
        with pytest.raises(LakeError, match="disk is full"):
            bench.station.measure_tool(3, [(0, 0)], SETUP, full_disk, lambda: False)
        assert not bench.pneumatics.is_gripping()
        grasps = []
        bench.supervisor.acknowledge("test")
        bench.station.measure_tool(0, [(0, 0)], SETUP, grasps.append, lambda: False)
        assert grasps[0].status == "ok", "the tool left on the head was docked first"


def test_drivers_reach_a_virtual_bench_by_its_addresses():
    clock = VirtualClock()
    with open_virtual_servers(NOISY, TOOLS, physics, clock) as virtual:
        at = virtual.endpoints
        settings = BenchSettings(
            serial_port=at.serial_port, plc_host=at.plc_host, plc_port=at.plc_port,
            transmitter_serial_port=at.transmitter_serial_port, modbus_time_out_s=5.0,
        )  # fmt: skip
        with open_real_bench(settings, TOOLS, clock) as bench:
            assert bench.settings.serial_port == at.serial_port
            bench.pneumatics.open_supply()
            assert bench.changer.pick(0).tool_id == "a/B01T0"
            bench.station.park()
            bench.plc.request("C3", {"Y2": True}, 5.0, "Gripping")
        with (
            pytest.raises(InterlockError, match="closed from an earlier session"),
            open_real_bench(settings, TOOLS, clock),
        ):
            pass
        with open_real_bench(settings, TOOLS, clock, may_vent=True) as bench:
            assert not bench.pneumatics.is_gripping()
        settings = settings.model_copy(update={"tool_mass_kg": {0: 1.0}})
        with open_real_bench(settings, TOOLS, clock) as bench, pytest.raises(InterlockError, match="table says 1.000"):
            bench.changer.pick(0)


def test_every_device_that_does_not_connect_is_named():
    settings = BenchSettings(
        serial_port="/dev/null/none", plc_host="127.0.0.1", plc_port=1, transmitter_host="127.0.0.1", transmitter_port=1
    )
    with pytest.raises(DeviceError, match="gantry: .*PLC: .*load cell: ") as caught, open_real_bench(settings, TOOLS):
        pass
    assert "cannot be reached" in str(caught.value)


def test_nothing_is_left_running():
    before = set(threading.enumerate())
    measure(QUIET, [(0, 0)], wires="lines")
    assert set(threading.enumerate()) == before


def test_a_clock_that_runs_by_itself():
    grasps = []
    with open_virtual_bench(QUIET, TOOLS, physics, speed_up=10.0) as bench:
        bench.station.measure_tool(3, [(35, 0)], SETUP, grasps.append, lambda: False)
    assert grasps[0].status == "ok", grasps[0].reason
    assert peak_force_n(grasps[0].trace) == pytest.approx(42.5, abs=2.0)  # a busy machine misses samples


def test_layout_heights():
    layout = BenchLayout()
    assert layout.grasp_z_mm(DESIGN, SETUP) == pytest.approx(78.0)
    assert layout.tip_below_mm(DESIGN, 78.0) == pytest.approx(5.0)
    assert layout.object_xy_mm(0) == (375.0, 375.0)
    assert layout.object_xy_mm(35) == (1125.0, 1125.0)
    assert layout.object_at(1126.0, 1124.0) == 35
    assert layout.object_at(450.0, 450.0) is None
    tallest = DESIGN.model_copy(update={"height_mm": 120.0})
    assert layout.grasp_z_mm(tallest, SETUP) + SETUP.max_lift_mm <= 180
    assert layout.top_z_mm + layout.head_offset_mm - 120 > layout.mount_height_mm + layout.object_height_mm
    with pytest.raises(UsageError, match="Tool slot 10 does not exist"):
        layout.dock_xy_mm(10)
