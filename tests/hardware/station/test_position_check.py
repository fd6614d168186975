"""Lost steps: found against the home switches, in both directions, and the limits are on again afterwards."""

import logging

import pytest

from fast.hardware.bench import open_virtual_bench
from fast.hardware.clock import VirtualClock
from fast.hardware.grbl.profile import HARD_LIMITS, SOFT_LIMITS, GrblProfile
from fast.hardware.parts.gantry import Gantry
from fast.hardware.station.lost_steps import LostStepsError
from fast.hardware.virtual.grbl.server import VirtualGrbl
from fast.hardware.wire.serial import SerialTransport
from fast.models.errors import InterlockError
from tests.hardware.safety.scenario_bench import TOOLS, WORLD, physics, when

LIMITS_ON = {SOFT_LIMITS: 1, HARD_LIMITS: 1}


@pytest.fixture
def bench():
    with open_virtual_bench(WORLD, TOOLS, physics, wires="memory") as bench:
        yield bench


def limits(controller):
    return {number: controller._machine.settings[number] for number in LIMITS_ON}


def slip(bench, axis, distance_mm):
    bench.virtual.grbl.inject("nudge", axis=axis, distance_mm=distance_mm)


def test_a_carriage_where_it_is_counted_passes(bench):
    bench.gantry.move_to(300.0, 400.0, 50.0)
    assert bench.position.run() == pytest.approx((0, 0, 0), abs=0.03)
    assert bench.supervisor.is_ok
    assert limits(bench.virtual.grbl) == LIMITS_ON
    bench.gantry.move_to(300.0, 400.0, 50.0)


@pytest.mark.parametrize(
    ("axis", "lost_mm"), [("x", 0.5), ("x", -0.5), ("y", 0.2), ("y", -0.2), ("z", 0.3), ("z", -0.3)]
)
def test_lost_steps_are_found_in_both_directions_and_cured(bench, axis, lost_mm):
    slip(bench, axis, lost_mm)
    with pytest.raises(LostStepsError, match=rf"stood [+-]0\.\d\d mm in {axis} from") as lost:
        bench.position.run()
    assert lost.value.slip_mm["xyz".index(axis)] == pytest.approx(lost_mm, abs=0.03)
    assert not bench.supervisor.is_ok  # a person is needed
    assert limits(bench.virtual.grbl) == LIMITS_ON
    bench.supervisor.end_safe_state("a person who has looked")
    assert bench.position.run() == pytest.approx((0, 0, 0), abs=0.03)


def test_a_slip_within_the_limit_passes_and_is_told(bench):
    slip(bench, "y", 0.08)
    assert bench.position.run()[1] == pytest.approx(0.07, abs=0.02)


def test_more_than_the_search_reaches_is_told_as_its_reach(bench):
    slip(bench, "x", -2.0)
    with pytest.raises(LostStepsError, match=r"stood -1.00 mm in x"):
        bench.position.run()


def test_a_tool_on_the_head_is_docked_first(bench):
    bench.changer.pick(3)
    bench.position.run()
    assert bench.changer.status().slot is None


def test_a_stop_in_the_search_leaves_no_limit_off(bench):
    when(bench, lambda virtual: not limits(virtual.grbl)[HARD_LIMITS], lambda: bench.supervisor.ask("stop"))
    with pytest.raises(InterlockError, match="A person asked to stop"):
        bench.position.run()
    assert not bench.gantry.is_position_known
    bench.supervisor.acknowledge("a person")
    bench.supervisor.home()
    assert limits(bench.virtual.grbl) == LIMITS_ON


def test_limits_that_a_dead_host_left_off_are_switched_on_at_the_next_connection(caplog):
    clock = VirtualClock()
    left = GrblProfile().with_settings({SOFT_LIMITS: 0, HARD_LIMITS: 0})
    with VirtualGrbl(clock, left) as controller, Gantry(SerialTransport(controller.port), clock) as gantry:
        assert limits(controller) == LIMITS_ON
        with caplog.at_level(logging.WARNING):
            gantry.home()
    assert "limit setting $21 is off and is switched on" in caplog.text


@pytest.mark.parametrize("lost_mm", [0.3, -0.3])
def test_an_axis_that_homes_to_its_other_end(lost_mm):
    clock, profile = VirtualClock(), GrblProfile().with_settings({23: 1})
    with VirtualGrbl(clock, profile) as controller, Gantry(SerialTransport(controller.port), clock, profile) as gantry:
        gantry.home()
        controller.inject("nudge", axis="x", distance_mm=lost_mm)
        assert gantry.slip_mm() == pytest.approx((lost_mm, 0, 0), abs=0.03)


def test_only_from_where_homing_left_it(bench):
    bench.gantry.move_to(300.0, 400.0, 50.0)
    with pytest.raises(InterlockError, match="not where homing left it"):
        bench.gantry._driver.slip_mm()
