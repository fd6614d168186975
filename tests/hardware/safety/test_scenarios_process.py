"""The host dies, in a process of its own, in the middle of a lift: what the bench does, and how the next one starts."""

import json
import os
import signal
import subprocess
import sys
from contextlib import contextmanager
from pathlib import Path

import pytest

from fast.hardware.bench import open_virtual_servers
from fast.hardware.clock import ScaledClock
from fast.hardware.virtual.bench import VirtualBench
from tests.hardware.safety.host_process import OBJECTS
from tests.hardware.safety.scenario_bench import REST_Z_MM, TOOLS, WORLD, is_pulling, physics
from tests.waiting import wait_for

SPEED_UP = 8.0
ROOT = Path(__file__).parents[3]
PATIENCE_S = 120.0  # real; other work may take the machine


@pytest.fixture
def virtual():
    with open_virtual_servers(WORLD, TOOLS, physics, ScaledClock(SPEED_UP)) as servers:
        yield servers


@contextmanager
def host(virtual: VirtualBench, may_vent: bool = False):
    at = virtual.endpoints
    addresses = {name: getattr(at, name) for name in ("serial_port", "plc_host", "plc_port", "transmitter_serial_port")}
    command = [sys.executable, "-m", "tests.hardware.safety.host_process", json.dumps(addresses), str(SPEED_UP)]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    process = subprocess.Popen(
        [*command, "vent" if may_vent else "keep"], cwd=ROOT, env=environment, text=True,
        stdout=subprocess.PIPE, stderr=subprocess.PIPE,
    )  # fmt: skip
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


def end(process):
    """Exit status, grasps told, last line of stderr."""
    out, err = process.communicate(timeout=PATIENCE_S)
    lines = [json.loads(line) for line in out.splitlines()]
    return process.returncode, lines, err.strip().splitlines()[-1:] or [""]


def state_of(virtual):
    lock, grip, supply = virtual.state.outputs
    return {"lock": lock, "grip": grip, "supply": supply, "motors": virtual.grbl.is_motor_enabled}


WATCHDOG = {"lock": True, "grip": True, "supply": False, "motors": False}


def kill_in_a_lift(virtual, number):
    """Exit status of a host that gets a signal in its first lift, and the grasps it told."""
    with host(virtual) as process:
        wait_for(lambda: is_pulling(virtual) or process.poll() is not None, PATIENCE_S)
        process.send_signal(number)
        status, lines, says = end(process)
    wait_for(lambda: state_of(virtual) == WATCHDOG, PATIENCE_S)
    assert virtual.state.pressure_psi == pytest.approx(30.0, abs=0.5), says
    assert virtual.grbl.position_mm()[2] > REST_Z_MM
    return status, lines


@pytest.mark.parametrize(("number", "expected"), [(signal.SIGINT, -signal.SIGINT), (signal.SIGTERM, 143)])
def test_a_host_that_is_ended_in_a_lift_drops_nothing_and_keeps_the_data(virtual, number, expected):
    status, lines = kill_in_a_lift(virtual, number)
    assert status == expected
    ((object_id, grasp_status, peak_n),) = [line.values() for line in lines]
    assert (object_id, grasp_status) == (OBJECTS[0], "failed")
    assert peak_n > 1.0, "the data until then is kept"


def test_after_a_killed_host_nothing_is_dropped_and_the_next_one_asks_first(virtual):
    assert kill_in_a_lift(virtual, signal.SIGKILL) == (-signal.SIGKILL, [])
    rest_mm = virtual.grbl.position_mm()

    with host(virtual) as process:
        status, lines, (says,) = end(process)
    assert (status, lines) == (1, [])
    assert "The gripper is closed from an earlier session (30 psi, a tool on the head, lock closed" in says
    assert "nothing was moved" in says
    assert virtual.grbl.position_mm() == pytest.approx(rest_mm, abs=0.01)
    assert virtual.state.outputs[1], "still kept"

    with host(virtual, may_vent=True) as process:
        status, lines, _ = end(process)
    assert status == 0
    assert [line.get("status") for line in lines] == ["ok", None], "the missing grasp is made"
    assert virtual.state.tool is None
    assert sorted(virtual.state.docked) == sorted(TOOLS)
