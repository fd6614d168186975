import pickle
from pathlib import Path

import numpy as np
import pytest

from fast.hardware.virtual.world.file import Scatter, Sensor, World, load_world
from fast.hardware.virtual.world.hidden import build_hidden
from fast.hardware.virtual.world.physics import (
    NEGLIGIBLE_TURN_DEG,
    PhysicsCache,
    SensorNoise,
    build_request,
    grasp_curve,
    tool_modulus_factor,
)
from fast.models.design.fin_ray import FinRay
from fast.models.design.space import BEST_PUBLISHED
from fast.models.errors import SimulationFailed
from fast.models.records import EffectValue, GraspSetup, GraspSimulation, Placement, Trace

DESIGN = FinRay(
    length_mm=30, width_mm=30, height_mm=110, tip_length_mm=25, front_thickness_mm=2.5, back_thickness_mm=2.5,
    rib_thickness_mm=2.5, rib_count=5, rib_angle_deg=0,
)  # fmt: skip
SCATTERED = World(seed=7, scatter=Scatter(tool_modulus_sd=0.04, placement_sd_mm=0.2, repeat_sd=0.01))


def simulation():
    time_s = np.array([0.0, 0.5, 1.0, 2.0, 3.0, 4.0])
    lift_mm = np.array([0.0, 0.0, 0.0, 5.0, 10.0, 15.0])
    force_n = np.array([0.0, -1.0, -2.0, 10.0, 0.0, 0.0])
    return GraspSimulation(Trace(time_s, lift_mm, force_n), 10.0, 5.0, 0.05, 6, 6, 100, 0.1)


def test_requests_pickle_and_are_the_same_for_every_repeat():
    request = build_request(SCATTERED, "a/B01T0", DESIGN, 4, GraspSetup())
    assert pickle.loads(pickle.dumps(request)) == request
    assert build_request(SCATTERED, "a/B01T0", DESIGN, 4, GraspSetup()).request_id == request.request_id
    assert build_request(SCATTERED, "a/B01T1", DESIGN, 4, GraspSetup()).request_id != request.request_id
    assert build_request(SCATTERED, "a/B01T0", DESIGN, 5, GraspSetup()).request_id != request.request_id


def test_placement_scatter_is_first_order_in_z_only():
    placements = [build_request(SCATTERED, "a/B01T0", DESIGN, o, GraspSetup()).placement for o in range(36)]
    assert np.std([p.offset_z_mm for p in placements]) == pytest.approx(0.2, rel=0.4)
    assert all(p.offset_x_mm == 0 for p in placements), "symmetry is kept below 0.75 mm"
    rough = World(seed=7, scatter=Scatter(placement_sd_mm=2.0))
    assert any(build_request(rough, "t", DESIGN, o, GraspSetup()).placement.offset_x_mm for o in range(36))
    assert build_request(World(), "t", DESIGN, 0, GraspSetup()).placement.offset_z_mm == 0


def test_worlds_of_before_draw_the_same_numbers_and_keep_their_hash():
    """Numbers of version 0.1.0, so that a lake of then goes on as one bench."""
    root = Path(__file__).parents[3]
    world = load_world((root / "worlds" / "slip.toml").read_text(), "slip.toml")
    assert world.world_hash == "W1179a54ef65d"
    requests = [build_request(world, "a/B01T0", BEST_PUBLISHED, o, GraspSetup()) for o in range(3)]
    heights_mm = [request.placement.offset_z_mm for request in requests]
    assert heights_mm == [0.03841956285665698, -0.03858175031115964, -0.09146749791344681]
    assert all(r.placement == Placement(offset_z_mm=r.placement.offset_z_mm) for r in requests)
    assert requests[0].theta.young_modulus_mpa == 9.15547007758048
    assert requests[0].hidden == world.hidden
    scatter = world.scatter.model_copy(update={"placement_sd_mm": 2.0, "yaw_sd_deg": 3.0, "offset_y_sd_mm": 3.0})
    rough = world.model_copy(update={"scatter": scatter})
    assert rough.world_hash != world.world_hash
    offsets_mm = [
        build_request(rough, "a/B01T0", BEST_PUBLISHED, o, GraspSetup()).placement.offset_x_mm for o in (1, 3)
    ]
    assert offsets_mm == [4.227573044523634, 1.5869989682474728]


def test_y_and_yaw_scatter_by_mounting_and_roll_by_tool():
    world = World(seed=7, scatter=Scatter(offset_y_sd_mm=2.0, yaw_sd_deg=3.0, roll_sd_deg=4.0))
    tools = [f"a/B{b:02d}T{t}" for b in range(1, 9) for t in range(10)]
    poses = {tool: [build_request(world, tool, DESIGN, o, GraspSetup()).placement for o in range(4)] for tool in tools}
    every = [pose for own in poses.values() for pose in own]
    assert np.std([pose.offset_y_mm for pose in every]) == pytest.approx(2.0, rel=0.15)
    assert np.std([pose.yaw_deg for pose in every]) == pytest.approx(3.0, rel=0.15)
    assert np.std([own[0].roll_deg for own in poses.values()]) == pytest.approx(4.0, rel=0.25)
    assert all(len({pose.roll_deg for pose in own}) == 1 for own in poses.values())
    assert all(len({pose.yaw_deg for pose in own}) > 1 for own in poses.values())
    small = [abs(pose.yaw_deg) for pose in every if abs(pose.yaw_deg) < NEGLIGIBLE_TURN_DEG]
    assert small, "some turns are negligible"
    assert set(small) == {0.0}
    assert {pose.offset_x_mm for pose in every} == {pose.offset_z_mm for pose in every} == {0.0}


def test_walls_scatter_by_tool_beside_what_the_world_hides():
    gain = EffectValue(effect="load_cell_gain", parameters={"gain": 1.1})
    lag = EffectValue(effect="load_cell_lag", parameters={"time_constant_s": 0.1})  # of readings, not of grasps
    world = World(seed=7, scatter=Scatter(thickness_sd_mm=0.05), hidden=(gain, lag))
    requests = [build_request(world, f"a/B01T{t}", DESIGN, 0, GraspSetup()) for t in range(400)]
    assert all(request.hidden[0] == gain for request in requests)
    offsets_mm = [request.hidden[1].parameters["offset_mm"] for request in requests]
    assert np.std(offsets_mm) == pytest.approx(0.05, rel=0.15)
    assert build_request(world, "a/B01T3", DESIGN, 9, GraspSetup()).hidden == requests[3].hidden
    assert len(build_hidden(requests[3].hidden, requests[3].tool_seed)) == 2


def test_a_cache_solves_each_request_once_and_remembers_failures():
    calls = []

    def physics(request):
        calls.append(request.object_id)
        if request.object_id == 1:
            raise SimulationFailed("no contact solution", "diverged")
        return simulation()

    cache = PhysicsCache(physics)
    requests = [build_request(SCATTERED, "t", DESIGN, o, GraspSetup()) for o in (0, 1, 2)]
    for _ in range(2):
        assert cache(requests[0]).peak_force_n == 10.0
        with pytest.raises(SimulationFailed, match="no contact solution") as caught:
            cache(requests[1])
        assert caught.value.reason == "diverged"
    assert calls == [0, 1]
    assert cache.missing([*requests, requests[2]]) == [requests[2]]
    cache.put(requests[2], simulation())
    assert cache.missing(requests) == []


def curve_of(simulation, world, repeat):
    return grasp_curve(simulation, world, build_request(world, "t", DESIGN, 0, GraspSetup(max_lift_mm=15)), repeat)


def test_the_curve_is_the_trace_scaled_by_tool_and_repeat():
    curve = curve_of(simulation(), World(), 0)
    assert curve.closing_force_at(0.0) == 0.0
    assert curve.closing_force_at(0.5) == -1.0
    assert curve.closing_force_at(1.0) == curve.lift_force_at(0.0) == -2.0
    assert curve.lift_force_at(2.5) == pytest.approx(4.0)
    assert curve.release_lift_mm == 10.0
    scaled = curve_of(simulation(), SCATTERED, 0)
    again = curve_of(simulation(), SCATTERED, 1)
    assert scaled.lift_force_at(5.0) == pytest.approx(10.0, rel=0.04)
    assert scaled.lift_force_at(5.0) != again.lift_force_at(5.0)
    assert scaled.lift_force_at(5.0) == curve_of(simulation(), SCATTERED, 0).lift_force_at(5.0)


def test_a_curve_that_never_lets_go_has_no_release():
    held = simulation()
    trace = Trace(held.trace.time_s[:4], held.trace.lift_mm[:4], held.trace.force_n[:4])
    ended = GraspSimulation(trace, 10.0, 5.0, 0.05, 4, 4, 1, 0.1)
    request = build_request(World(), "t", DESIGN, 0, GraspSetup(max_lift_mm=5))
    curve = grasp_curve(ended, World(), request, 0)
    assert curve.release_lift_mm == float("inf")
    assert curve.lift_force_at(80.0) == 10.0
    assert curve_of(ended, World(), 0).release_lift_mm == 5.0, "a solver that stops early saw the fingers come free"


def test_tool_scatter_has_the_asked_size():
    factors = [tool_modulus_factor(SCATTERED, f"B01T{i}") for i in range(400)]
    assert np.std(np.log(factors)) == pytest.approx(0.04, rel=0.15)
    assert tool_modulus_factor(World(), "B01T0") == 1.0
    theta = build_request(SCATTERED, "B01T7", DESIGN, 0, GraspSetup()).theta
    assert theta.young_modulus_mpa == SCATTERED.theta.young_modulus_mpa * factors[7]


def test_sensor_noise_has_sd_and_correlation_however_often_it_is_read():
    world = World(seed=1, sensor=Sensor(rate_hz=80, noise_sd_n=0.12, noise_correlation_s=0.05))
    noise = SensorNoise(world, "t", 0, 0)
    every = np.array([noise.advance(1) for _ in range(20000)])
    assert every.std() == pytest.approx(0.12, rel=0.05)
    assert np.corrcoef(every[1:], every[:-1])[0, 1] == pytest.approx(np.exp(-1 / 4), abs=0.03)
    skipping = np.array([noise.advance(4) for _ in range(20000)])
    assert skipping.std() == pytest.approx(0.12, rel=0.05)
    assert np.corrcoef(skipping[1:], skipping[:-1])[0, 1] == pytest.approx(np.exp(-1), abs=0.03)
    same = SensorNoise(world, "t", 0, 0)
    assert [same.advance(1) for _ in range(5)] == list(every[:5])
