"""Grasps with their own setup and placement: carried out by the cell, refused beyond the bench's limits."""

from dataclasses import replace

import numpy as np
import pytest

from fast.hardware.bench import open_virtual_bench
from fast.hardware.parts.limits import BenchLimits
from fast.hardware.station.cycle_time import plan_time
from fast.hardware.tools.mounted import MountedTool
from fast.hardware.virtual.world.file import World
from fast.hardware.virtual.world.state import at_pressure
from fast.models.design.space import BEST_PUBLISHED
from fast.models.errors import UsageError
from fast.models.records import EffectValue, GraspRequest, GraspSetup, Placement, Trace
from tests.hardware.station.grasp_stub import holds_to_the_top

TOOL = MountedTool("a/B01T0", BEST_PUBLISHED)
SETUP, FLAT = GraspSetup(), 8
OTHER = GraspSetup(lift_speed_mm_per_s=20.0, closed_gap_mm=20.0, dwell_s=6.0, supply_pressure_psi=25.0)


def asked(setup=SETUP, tool_id=TOOL.tool_id, **placement):
    return GraspRequest(tool_id=tool_id, object_id=FLAT, setup=setup, placement=Placement(**placement), repeat=3)


def measure(items):
    """The grasps, and what the world was asked to solve."""
    made, solved = [], []

    def physics(request):
        solved.append(request)
        return holds_to_the_top(request)

    with open_virtual_bench(World(seed=7), {0: TOOL}, physics, wires="memory") as bench:
        bench.station.measure_tool(0, items, SETUP, made.append, lambda: False)
    return made, solved


def test_every_grasp_is_made_with_its_own_setup_and_placement():
    aside = asked(OTHER, offset_x_mm=1.5, offset_y_mm=-0.3)
    (first, other, last), solved = measure([(FLAT, 0), aside, (FLAT, 1)])
    assert [grasp.status for grasp in (first, other, last)] == ["ok"] * 3, other.reason
    assert (other.setup, other.request, first.request) == (OTHER, aside, None)
    assert [request.placement for request in solved] == [Placement(), aside.placement]
    assert [request.setup.closed_gap_mm for request in solved] == [16.0, 20.0]
    assert solved[1].setup.timed_as(OTHER) == OTHER, "the physics is the same at every speed"
    held_s = [grasp.trace.time_s[grasp.trace.lift_mm == 0].max() for grasp in (first, other, last)]
    assert held_s[1] - held_s[0] == pytest.approx(6.0 - 0.1, abs=0.2)  # 2 mm less to close
    assert held_s[2] == pytest.approx(held_s[0], abs=0.05)
    is_middle = (other.trace.lift_mm > 3) & (other.trace.lift_mm < 15)
    assert np.polyfit(other.trace.time_s[is_middle], other.trace.lift_mm[is_middle], 1)[0] == pytest.approx(
        20, rel=0.05
    )
    assert [grasp.details["supply_pressure_psi"] for grasp in (first, other, last)] == [30.0, 25.0, 30.0]


@pytest.mark.parametrize(
    ("item", "message"),
    [
        (
            asked(GraspSetup(lift_speed_mm_per_s=80)),
            "lift_speed_mm_per_s 80 mm/s was asked for, this bench has 0.1 to 50",
        ),
        (
            asked(GraspSetup(dwell_s=300)),
            "dwell_s 300 s was asked for, this bench has 0 to 120 s; ask for a value within",
        ),
        (asked(offset_y_mm=12), "offset_y_mm 12 mm was asked for, this bench has -10 to 10 mm"),
        (asked(yaw_deg=10), "yaw_deg 10 deg was asked for, but this bench has no axis for it; leave it at 0 deg"),
        (asked(roll_deg=1), "roll_deg 1 deg was asked for, but this bench has no axis for it"),
        (asked(GraspSetup(open_gap_mm=30, closed_gap_mm=40)), "closed_gap_mm 40 is not below open_gap_mm 30 mm"),
        (asked(GraspSetup(tip_below_mm=-40, max_lift_mm=120)), "needs z from .* the axis has 0 to 180 mm"),
        (asked(tool_id="a/B01T9"), "A grasp of tool a/B01T9 is asked for, but slot 0 holds a/B01T0; mount the tool"),
    ],
)
def test_what_the_bench_cannot_do_is_refused_before_anything_moves(item, message):
    with open_virtual_bench(World(), {0: TOOL}, holds_to_the_top, wires="memory") as bench:
        before_mm = bench.gantry.position_mm()
        with pytest.raises(UsageError, match=message):
            bench.station.measure_tool(0, [(FLAT, 0), item], SETUP, lambda grasp: None, lambda: False)
        assert bench.gantry.position_mm() == before_mm


def test_what_cannot_be_made_need_not_be_asked():
    limits = BenchLimits(lift_speed_mm_per_s=(1.0, 10.0))
    assert limits.can_make(GraspSetup())
    assert not limits.can_make(GraspSetup(lift_speed_mm_per_s=20.0))
    assert not limits.can_make(GraspSetup(), Placement(yaw_deg=5.0))


def test_the_time_of_an_asked_grasp_counts_its_own_setup():
    usual, waiting = (plan_time(TOOL, 0, [item], SETUP) for item in ((FLAT, 0), asked(GraspSetup(dwell_s=30.0))))
    assert waiting.item_s[0] - usual.item_s[0] == pytest.approx(30.0)


def test_a_lagging_transmitter_knows_how_long_the_fingers_waited_and_how_fast_they_rise():
    """Its delay is a time: a wait lets it catch up, and in a fast lift the peak comes later."""
    lag = EffectValue(effect="load_cell_lag", parameters={"time_constant_s": 0.5})

    def strong(request):
        weak = holds_to_the_top(request)
        return replace(weak, trace=Trace(weak.trace.time_s, weak.trace.lift_mm, 10 * weak.trace.force_n))

    setups = (SETUP, GraspSetup(dwell_s=5.0), GraspSetup(lift_speed_mm_per_s=10.0))
    made = []
    with open_virtual_bench(World(seed=7, hidden=(lag,)), {0: TOOL}, strong, wires="memory") as bench:
        bench.station.measure_tool(0, [asked(setup) for setup in setups], SETUP, made.append, lambda: False)
    at_start = [grasp.trace.force_n[grasp.trace.lift_mm == 0][-1] for grasp in made]
    assert at_start[1] == pytest.approx(-10.0, abs=0.1)
    assert at_start[0] > -8.0
    peak_mm = [grasp.trace.lift_mm[np.argmax(grasp.trace.force_n)] for grasp in made]
    assert peak_mm[2] - peak_mm[0] == pytest.approx(0.5 * (10.0 - 5.0), abs=0.8)


def test_less_pressure_weakens_the_jaws_of_a_world_that_limits_them():
    closing = EffectValue(effect="force_limited_closing", parameters={"max_force_n": 60.0})
    limited = World(hidden=(closing,))
    assert at_pressure(limited, 2 / 3).hidden[0].parameters["max_force_n"] == pytest.approx(40.0)
    assert at_pressure(limited, 1.0) is limited
    assert at_pressure(World(), 0.5) == World()
