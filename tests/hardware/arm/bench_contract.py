"""What every bench must do: subclass `BenchContract` and give it a fixture `bench` of an open bench with `TOOLS`.

The bench's world answers with `tests.hardware.station.test_station.physics`: a hump of 9 N on object 0, of 10 N on
object 1, released at a lift of 48 mm. `docs/how-to/write-a-bench-driver.md` explains the tests.
"""

import threading

import numpy as np
import pytest

from fast.hardware.grasp_bench import GraspBench
from fast.hardware.parts.safe_state import StopAskedError, Verb
from fast.hardware.station.station import MeasuredGrasp
from fast.hardware.tools.mounted import MountedTool
from fast.models.design.fin_ray import FinRay
from fast.models.errors import FastError, UsageError
from fast.models.records import BENCH_FAULT, GraspSetup
from fast.models.traces import peak_force_n

DESIGN = FinRay(
    length_mm=30, width_mm=30, height_mm=110, tip_length_mm=25, front_thickness_mm=2.5, back_thickness_mm=2.5,
    rib_thickness_mm=2.5, rib_count=5, rib_angle_deg=0,
)  # fmt: skip
TOOLS = {0: MountedTool("a/B01T0", DESIGN), 3: MountedTool("a/B01T3", DESIGN)}
SETUP = GraspSetup()
RELEASE_MM = 48.0


class TakenOverError(FastError):
    """Another process has the bench."""


class BenchContract:
    """Tests of `hardware.grasp_bench.GraspBench`."""

    def test_grasps_are_made_in_order_and_given_at_once(self, bench: GraspBench) -> None:
        grasps = []
        bench.measure_tool(3, [(0, 0), (1, 0), (0, 1)], SETUP, grasps.append, lambda: False)
        assert [(g.object_id, g.repeat, g.status) for g in grasps] == [(0, 0, "ok"), (1, 0, "ok"), (0, 1, "ok")]
        peaks_n = [peak_force_n(g.trace) for g in grasps]
        assert peaks_n == pytest.approx([7.5, 8.5, 7.5], abs=0.4)

    def test_a_trace_is_in_the_frame_of_the_lake(self, bench: GraspBench) -> None:
        grasps = []
        bench.measure_tool(0, [(2, 0)], SETUP, grasps.append, lambda: False)
        trace = grasps[0].trace
        assert np.all(np.diff(trace.time_s) > 0)
        assert trace.lift_mm[0] == 0.0
        assert np.all(np.diff(trace.lift_mm) >= -0.05)
        resting = trace.lift_mm == 0.0
        assert trace.time_s[resting][-1] > 1.3  # the jaws take 1.35 s, and the head rests meanwhile
        assert trace.force_n[resting].min() < -0.5  # closing fingers push the object down, and themselves up
        assert trace.lift_mm[-1] > RELEASE_MM
        assert abs(trace.force_n[-16:].mean()) < 0.3  # the fingers have left the object
        speed = np.polyfit(trace.time_s[~resting], trace.lift_mm[~resting], 1)[0]
        assert speed == pytest.approx(SETUP.lift_speed_mm_per_s, rel=0.05)

    def test_a_grasp_can_be_looked_at_while_it_is_made(self, bench: GraspBench) -> None:
        grasps, lengths = [], []
        is_over = threading.Event()

        def look() -> None:
            while not is_over.wait(0.002):
                view = bench.present_grasp()
                if view is not None:
                    found = view.read(0)
                    assert len(found.time_s) == len(found.lift_mm) == len(found.force_n)
                    lengths.append(len(found.time_s))

        looker = threading.Thread(target=look)
        looker.start()
        try:
            bench.measure_tool(3, [(0, 0)], SETUP, grasps.append, lambda: False)
        finally:
            is_over.set()
            looker.join()
        view, trace = bench.present_grasp(), grasps[0].trace
        assert view is not None
        assert (view.tool_id, view.object_id, view.repeat) == ("a/B01T3", 0, 0)
        assert len(set(lengths)) > 2
        assert view.read(5).time_s == pytest.approx(trace.time_s[5:], abs=1e-3)
        assert view.read(0).force_n == pytest.approx(trace.force_n, abs=0.02)

    def test_the_tool_is_hung_back_when_asked_to_stop(self, bench: GraspBench) -> None:
        grasps = []
        bench.measure_tool(3, [(0, 0), (0, 1), (0, 2)], SETUP, grasps.append, lambda: len(grasps) >= 1)
        assert len(grasps) == 1
        bench.measure_tool(3, [(0, 1)], SETUP, grasps.append, lambda: False)  # it can be taken again
        assert [g.repeat for g in grasps] == [0, 1]

    def test_a_plan_that_cannot_be_carried_out_moves_nothing(self, bench: GraspBench) -> None:
        moved = []
        bench.set_leave(lambda: moved.append(1))
        with pytest.raises(UsageError, match="Slot 7 has no tool"):
            bench.measure_tool(7, [(0, 0)], SETUP, print, lambda: False)
        with pytest.raises(UsageError, match="this bench has"):
            bench.measure_tool(3, [(0, 0)], GraspSetup(close_speed_mm_per_s=0.5), print, lambda: False)
        with pytest.raises(UsageError, match="place"):
            bench.measure_tool(3, [(900, 0)], SETUP, print, lambda: False)
        assert moved == []

    def test_without_leave_nothing_moves(self, bench: GraspBench) -> None:
        def refuse() -> None:
            raise TakenOverError("another host has the bench")

        bench.set_leave(refuse)
        with pytest.raises(TakenOverError):
            bench.measure_tool(3, [(0, 0)], SETUP, print, lambda: False)

    def test_a_stop_ends_a_grasp_that_is_kept_as_failed(self, bench: GraspBench) -> None:
        grasps = []

        def keep(grasp: MeasuredGrasp) -> None:
            grasps.append(grasp)
            if len(grasps) == 1:  # the next grasp begins now, however long the tool took
                threading.Timer(0.3, lambda: bench.ask(Verb.STOP)).start()

        with pytest.raises(StopAskedError):
            bench.measure_tool(3, [(0, n) for n in range(200)], SETUP, keep, lambda: False)
        assert (grasps[-1].status, grasps[-1].details["end"]) == ("failed", BENCH_FAULT)
        assert [g.status for g in grasps[:-1]] == ["ok"] * (len(grasps) - 1)

    def test_the_head_is_where_it_is_believed_to_be(self, bench: GraspBench) -> None:
        assert max(map(abs, bench.check_position())) < 0.1
