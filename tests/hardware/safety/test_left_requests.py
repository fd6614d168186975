"""Requests that a host left on in the PLC when it died: the next one takes them back before anything moves."""

import pytest

from fast.hardware.bench import MountedTool, open_virtual_bench
from fast.hardware.click import tags
from fast.hardware.click.codec import parse_address
from fast.hardware.click.driver import ClickPlc
from fast.hardware.clock import VirtualClock
from fast.hardware.parts.layout import BenchLayout
from fast.hardware.virtual.bench import VirtualBench
from fast.hardware.virtual.memory_wires import memory_link
from fast.hardware.virtual.world.file import World
from fast.hardware.virtual.world.physics import simulate_request
from fast.models.design.space import BEST_PUBLISHED

TOOLS = {3: MountedTool("a/B01T3", BEST_PUBLISHED)}


def host(bench: VirtualBench, clock: VirtualClock) -> ClickPlc:
    plc = ClickPlc(memory_link("CLICK PLC", bench.plc.server), clock)
    plc.connect()
    return plc


@pytest.fixture
def clock() -> VirtualClock:
    return VirtualClock()


@pytest.fixture
def devices(clock):
    bench = VirtualBench(World(), TOOLS, simulate_request, clock, BenchLayout())
    bench.start()
    yield bench
    bench.stop()


def test_requests_left_on_are_taken_back_and_the_grip_is_kept_until_it_is_vented(devices, clock):
    died = host(devices, clock)
    died.write_bit(tags.SUPPLY_REQUEST, True)
    died.write_bit(tags.GRIP_REQUEST, True)
    clock.sleep(0.1)
    plc = host(devices, clock)
    clock.sleep(0.1)
    assert plc.read_bit(tags.GRIP_OUTPUT), "the grip is kept"
    plc.request(tags.VENT_REQUEST, {tags.GRIP_OUTPUT: False}, 1.0, "Venting")
    clock.sleep(0.1)
    assert not plc.read_bit(tags.GRIP_OUTPUT), "and does not come back"
    assert not plc.read_bit(tags.SUPPLY_OUTPUT)


def test_opening_a_bench_takes_all_of_them_back(monkeypatch):
    def start_as_a_dead_host_left_it(bench: VirtualBench) -> None:
        start(bench)
        for request in tags.REQUESTS:
            bench.plc.write_bits(parse_address(request).wire, [True])

    start = VirtualBench.start
    monkeypatch.setattr(VirtualBench, "start", lambda bench, *ports: start_as_a_dead_host_left_it(bench))
    monkeypatch.setattr("fast.hardware.parts.pneumatics.Pneumatics.is_gripping", lambda self: False)
    with open_virtual_bench(World(), TOOLS, wires="memory") as bench:
        assert not any(bench.plc.read_bit(request) for request in tags.REQUESTS)
