"""`fast virtual`: the physics of a bench that stays up is solved in a process of its own."""

import multiprocessing
from pathlib import Path

import numpy as np

from fast.flows.cli.virtual import rack, solver
from fast.hardware.bench import open_virtual_bench
from fast.hardware.virtual.world.physics import simulate_request
from fast.models.errors import SimulationFailed
from fast.models.records import GraspSetup
from fast.tasks.campaign.setup import read_world


def test_the_physics_is_solved_as_here_in_a_process_that_ends_with_the_bench():
    requests = []

    def keep(request):
        requests.append(request)
        raise SimulationFailed("not here.", "crash")

    with open_virtual_bench(read_world(Path("worlds/quick.toml")), rack(None), keep, wires="memory") as bench:
        bench.station.measure_tool(0, [(2, 0)], GraspSetup(max_lift_mm=2.0), lambda grasp: None, lambda: False)
    before = set(multiprocessing.active_children())
    with solver() as solve:
        (worker,) = set(multiprocessing.active_children()) - before
        there = solve(requests[0])
    worker.join(10.0)
    assert not worker.is_alive()
    here = simulate_request(requests[0])
    assert np.array_equal(there.trace.force_n, here.trace.force_n)
    assert there.trace.force_n.max() > 1.0
