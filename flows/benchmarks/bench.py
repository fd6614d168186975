"""What a measured grasp costs beside its physics: drivers, wires and servers of the virtual bench."""

import time
from typing import Any

import numpy as np

from flows.benchmarks.base import Tables


def measure_bench() -> Tables:
    """Grasps on the lockstep virtual bench: what drivers, wires and servers cost without the physics."""
    from hardware.bench import open_virtual_bench
    from hardware.cell import MeasuredGrasp
    from hardware.tools import MountedTool
    from hardware.world.spec import World
    from models.design_space import BEST_PUBLISHED
    from models.records import GraspSetup

    made: list[MeasuredGrasp] = []
    tools = {0: MountedTool(tool_id="B00T0", design=BEST_PUBLISHED)}
    plan = [(object_id, repeat) for object_id in (0, 7, 35) for repeat in range(3)]
    wall, cpu = time.perf_counter(), time.process_time()
    with open_virtual_bench(World(), tools, physics=lambda request: _plain_grasp()) as opened:
        opened.cell.measure_tool(0, plan, GraspSetup(), made.append, lambda: False)
        bench_s = opened.clock.now_s()
    wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
    n = len(made)
    row = {"n_grasps": n, "bench_s_per_grasp": bench_s / n, "wall_s_per_grasp": wall / n, "cpu_s_per_grasp": cpu / n}
    return {"bench": [row]}


def _plain_grasp() -> Any:
    """A grasp of plausible shape that costs nothing: 50 mm of lift, 10 N at most."""
    from models.records import GraspSimulation, Trace

    lift = np.concatenate([np.zeros(8), np.linspace(0, 55, 56)])
    force = np.concatenate([np.linspace(0, -4, 8), np.interp(lift[8:], [0, 3, 45, 55], [-4, 10, 4, 0])])
    time_s = np.concatenate([np.linspace(0, 1.3, 8), 1.4 + lift[8:] / 5])
    trace = Trace(time_s=time_s, lift_mm=lift, force_n=force)
    return GraspSimulation(
        trace=trace, peak_force_n=10, contact_force_n=20, work_j=0.4, n_steps=64, n_newton=300, n_dof=1600, cpu_s=0
    )
