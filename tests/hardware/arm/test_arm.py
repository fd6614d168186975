"""The arm against its controller's protocols, in a process of its own, and the gantry by the same contract."""

import threading
import time
from collections.abc import Iterator
from itertools import count

import numpy as np
import pytest

from fast.hardware.arm.bench import ArmBench, open_arm_bench
from fast.hardware.arm.link import ArmLink
from fast.hardware.arm.settings import ArmSettings
from fast.hardware.bench import Bench, open_virtual_bench
from fast.hardware.parts.safe_state import EmergencyStopError, StopAskedError, Verb
from fast.hardware.virtual.arm.controller import VirtualArm
from fast.hardware.virtual.arm.server import STEP_S, ArmServer
from fast.hardware.virtual.arm.urscript import Move, Output, Register, Stop, read_program
from fast.hardware.virtual.world.file import Sensor, World
from fast.models.errors import DeviceError, InterlockError, UsageError
from fast.models.records import BENCH_FAULT, GraspSetup
from fast.models.traces import peak_force_n
from tests.hardware.arm.arm_lines import ArmProcess
from tests.hardware.arm.bench_contract import SETUP, TOOLS, BenchContract
from tests.hardware.station.test_station import physics
from tests.waiting import wait_for


@pytest.fixture
def controller() -> Iterator[ArmProcess]:
    process = ArmProcess()
    yield process
    process.end()


class TestArm(BenchContract):
    @pytest.fixture
    def bench(self, controller: ArmProcess) -> Iterator[ArmBench]:
        with open_arm_bench(controller.settings, TOOLS) as bench:
            yield bench


class TestGantry(BenchContract):
    @pytest.fixture
    def bench(self) -> Iterator[Bench]:
        world = World(seed=7, sensor=Sensor(noise_sd_n=0.05))
        with open_virtual_bench(world, TOOLS, physics, wires="memory") as bench:
            yield bench


def measure(bench: ArmBench, plan, setup: GraspSetup = SETUP, on_grasp=None) -> list:
    grasps = []
    bench.measure_tool(3, plan, setup, on_grasp or grasps.append, lambda: False)
    return grasps


def test_an_object_that_is_missing_fails_its_grasp_and_the_plan_goes_on(controller):
    controller.tell("inject object_missing")
    with open_arm_bench(controller.settings, TOOLS) as bench:
        grasps = []

        def put_back(grasp):
            grasps.append(grasp)
            controller.tell("clear object_missing")

        measure(bench, [(0, 0), (0, 1)], on_grasp=put_back)
    assert [g.status for g in grasps] == ["failed", "ok"]
    assert "it is missing or moved" in grasps[0].reason
    assert controller.tell("state") == {"tool": None, "docked": [0, 3], "z_mm": controller.settings.travel_z_mm}


@pytest.mark.parametrize(
    ("command", "error", "words"),
    [
        ("inject estop_pressed", EmergencyStopError, "emergency stop is pressed"),
        ("protective on", DeviceError, "protective stop"),
        ("power off", DeviceError, "brakes are closed"),
        ("safeguard on", DeviceError, r"stopped by its safety system \(status 0x11\)"),
    ],
)
def test_a_stop_of_the_controller_is_a_sentence_and_keeps_the_grasp(controller, command, error, words):
    with open_arm_bench(controller.settings, TOOLS) as bench:
        grasps = []

        def stop(grasp):
            grasps.append(grasp)
            controller.tell(command)

        with pytest.raises(error, match=words):
            measure(bench, [(0, 0), (0, 1)], on_grasp=stop)
    assert [(g.status, g.details["end"]) for g in grasps] == [("ok", "separated"), ("failed", BENCH_FAULT)]


@pytest.mark.parametrize(
    ("command", "ends_by", "words"),
    [("safeguard on", "safeguard off", "safety system"), ("pause", "state", "paused on the pendant")],
)
def test_what_interrupts_a_motion_and_ends_again_starts_nothing(controller, command, ends_by, words):
    """A safeguard stop ends as the door is closed, a pause by *play*: what they interrupted must not go on then."""
    n_motions = count(1)

    def interrupt() -> None:
        if next(n_motions) == 3:  # the way down to the tool
            threading.Timer(0.02, controller.tell, [command]).start()

    with open_arm_bench(controller.settings, TOOLS) as bench:
        bench.set_leave(interrupt)
        with pytest.raises(DeviceError, match=words):
            measure(bench, [(0, 0)])
    stopped = controller.tell(ends_by)
    assert stopped["z_mm"] > controller.settings.rack_mm[3][2] + 1.0, "it was on its way"
    time.sleep(0.5)
    assert controller.tell("state") == stopped


def test_a_lift_with_the_slider_down_is_no_result(controller):
    with open_arm_bench(controller.settings, TOOLS) as bench:
        grasps = []

        def turn_up(grasp):
            grasps.append(grasp)
            controller.tell("slider 1")

        controller.tell("slider 0.5")
        measure(bench, [(0, 0), (0, 1)], on_grasp=turn_up)
    assert [g.status for g in grasps] == ["failed", "ok"]
    assert "slider of the pendant stood at 50 % in the lift" in grasps[0].reason


def test_a_tool_that_is_not_there_is_noticed_by_its_weight(controller):
    with (
        open_arm_bench(controller.settings, TOOLS | {5: TOOLS[0]}) as bench,
        pytest.raises(DeviceError, match="was not picked from slot 5"),
    ):
        bench.measure_tool(5, [(0, 0)], SETUP, print, lambda: False)


def test_a_pull_beyond_the_limit_ends_the_grasp(controller):
    settings = controller.settings.model_copy(update={"most_force_n": 4.0})
    with open_arm_bench(settings, TOOLS) as bench:
        (grasp,) = measure(bench, [(0, 0)])
    assert grasp.status == "failed"
    assert "is above most_force_n, 4 N" in grasp.reason
    assert grasp.trace.force_n.max() < 6.0


def test_an_object_that_comes_along_stops_the_bench(controller):
    with open_arm_bench(controller.settings, TOOLS) as bench:

        def stick(grasp):
            controller.tell("inject object_sticks")

        with pytest.raises(DeviceError, match="an object came along"):
            measure(bench, [(0, 0), (0, 1), (0, 2)], on_grasp=stick)


def test_what_an_earlier_session_left_on_the_arm_is_refused(controller):
    link = ArmLink(controller.settings)
    link.connect()
    link.run(["set_standard_digital_out(0, True)"], 1.0)
    with pytest.raises(InterlockError, match="The gripper is closed"), open_arm_bench(controller.settings, TOOLS):
        pass
    link.run(["set_standard_digital_out(0, False)", "set_standard_digital_out(1, True)"], 1.0)
    with pytest.raises(InterlockError, match="A tool is still locked"), open_arm_bench(controller.settings, TOOLS):
        pass
    link.close()


def test_a_program_waits_for_the_stop_before_it(controller, monkeypatch):
    """Each comes on a connection of its own: a stop that came later than the next program would end it."""
    monkeypatch.setattr("fast.hardware.arm.link._STOPPED_S", 1000.0)  # the arm's time runs fast here
    link = ArmLink(controller.settings)
    link.connect()
    send = link._send
    monkeypatch.setattr(link, "_send", lambda text: threading.Timer(0.3, send, [text]).start())
    link.halt()
    monkeypatch.setattr(link, "_send", send)
    x_mm, y_mm, z_mm = link.read().position_mm.tolist()
    link.run([link.write_move((x_mm, y_mm, z_mm - 20.0), 1.0), "set_standard_digital_out(2, True)"], 20.0)
    assert link.read().is_on(2)
    link.close()


def test_an_arm_that_does_not_answer_is_named():
    settings = ArmSettings(
        kind="ur", host="127.0.250.250", travel_z_mm=500, rack_mm=((0, 0, 0),), mounts_mm={0: (0, 0, 0)}
    )
    with (
        pytest.raises(DeviceError, match=r"127\.0\.250\.250 does not answer on port 30004"),
        open_arm_bench(settings, TOOLS),
    ):
        pass


def test_a_lift_that_ends_above_the_travel_height_is_refused(controller):
    settings = controller.settings.model_copy(update={"travel_z_mm": 300.0})
    with open_arm_bench(settings, TOOLS) as bench, pytest.raises(UsageError, match="travel_z_mm is 300; raise it"):
        measure(bench, [(0, 0)])


@pytest.mark.slow
def test_the_arm_measures_what_the_gantry_measures(controller):
    world = World(seed=7, sensor=Sensor(rate_hz=125, noise_sd_n=0.05))
    with open_arm_bench(controller.settings, TOOLS) as arm:
        by_arm = measure(arm, [(0, 0), (2, 0)])
    with open_virtual_bench(world, TOOLS, physics, wires="memory") as gantry:
        by_gantry = measure(gantry, [(0, 0), (2, 0)])
    peaks_n = np.array([[peak_force_n(grasp.trace) for grasp in grasps] for grasps in (by_arm, by_gantry)])
    np.testing.assert_allclose(peaks_n[0], peaks_n[1], atol=0.25)


def test_programs_are_read_or_refused():
    text = (
        "def fast():\n  movel(p[0.1, -0.2, 0.3, 0.0, 3.14, 0.0], a=0.5, v=0.25)\n  set_standard_digital_out(1, True)\n"
        "  stopl(0.5)\n  write_output_integer_register(12, 7)\nend\n"
    )
    move, *rest = read_program(text)
    assert isinstance(move, Move)
    assert (move.speed_m_per_s, move.pose.tolist()) == (0.25, [0.1, -0.2, 0.3, 0.0, 3.14, 0.0])
    assert rest == [Output(1, True), Stop(), Register(12, 7)]
    for wrong in ("movel()", text.replace("movel", "movej"), text.removesuffix("end\n"), text.replace("-0.2", "x")):
        with pytest.raises(ValueError, match="function|understood"):
            read_program(wrong)


def test_outputs_that_are_the_same_are_refused():
    with pytest.raises(ValueError, match="a tool would fall"):
        ArmSettings(kind="ur", host="h", travel_z_mm=1, rack_mm=((0, 0, 0),), mounts_mm={0: (0, 0, 0)}, grip_output=1)


def test_a_person_who_stopped_the_arm_is_told_what_to_do_with_it(controller):
    with open_arm_bench(controller.settings, TOOLS) as bench:
        bench.ask(Verb.STOP)
        with pytest.raises(StopAskedError, match="hang the tool back by hand"):
            measure(bench, [(0, 0)])


def test_at_rest_an_arm_takes_longer_steps_and_none_of_a_program():
    steps_s: list[tuple[float, bool]] = []

    class Watched(VirtualArm):
        def advance(self, duration_s: float) -> None:
            is_at_work = bool(self._program)
            super().advance(duration_s)
            steps_s.append((duration_s, is_at_work))

    server = ArmServer(Watched(World(seed=1), TOOLS, physics), "127.0.0.47", speed_up=10.0)
    server.start()
    try:
        assert wait_for(lambda: server.arm.rest_s > 22.0, limit_s=60.0)
        server.arm.run_program("def fast():\n  movel(p[0.1, 0.1, 0.6, 0, 3.14159, 0], a=1, v=0.05)\nend\n")
        assert wait_for(lambda: server.arm.rest_s > 1.0, limit_s=60.0)
    finally:
        server.stop()
    assert {duration_s for duration_s, is_at_work in steps_s if is_at_work} == {STEP_S}
    assert {duration_s for duration_s, _ in steps_s} == {STEP_S, 10.0 * STEP_S}
    assert max(at for at, (_, is_at_work) in enumerate(steps_s) if is_at_work) > 100  # it did run


@pytest.mark.parametrize("host", ["no such host", "a\0b", "192.0.2.1"])
def test_an_address_that_is_not_of_this_computer_is_refused(host):
    arm = VirtualArm(World(seed=1), TOOLS, physics)
    with pytest.raises(DeviceError, match="cannot be listened on"):
        ArmServer(arm, host).start()
