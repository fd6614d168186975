import pickle

import numpy as np
import pytest

from hardware.virtual.world.file import Scatter, Sensor, World
from hardware.virtual.world.physics import PhysicsCache, SensorNoise, build_request, grasp_curve, tool_modulus_factor
from models.errors import SimulationFailed
from models.records import Design, GraspSetup, GraspSimulation, Trace

DESIGN = Design(
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
