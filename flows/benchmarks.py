"""Benchmarks: cost per unit of work, in CPU seconds of this process, and how it grows."""

import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

Rows = list[dict[str, Any]]


def grasp() -> Rows:
    """One simulated grasp (production tier): best published and two random designs on four objects."""
    from models.design_space import BEST_PUBLISHED, random_designs
    from models.fem.grasp import simulate_grasp
    from models.objects.catalogue import get_object

    simulate_grasp(BEST_PUBLISHED, get_object(0))  # compiled kernels are loaded once
    designs = [BEST_PUBLISHED, *random_designs(2, np.random.default_rng(0))]
    rows: Rows = []
    for object_id in (0, 14, 24, 30):
        for design in designs:
            result = simulate_grasp(design, get_object(object_id))
            rows.append(
                {
                    "object_id": object_id,
                    "design_id": design.design_id,
                    "cpu_s": result.cpu_s,
                    "n_dof": result.n_dof,
                    "n_newton": result.n_newton,
                    "peak_force_n": result.peak_force_n,
                }
            )
    return rows


def propose() -> Rows:
    """Fit the surrogate, propose ten tools and one simulation, at growing numbers of data."""
    from models.design_space import random_unit
    from models.scientist import NO_PENDING
    from models.scientist import propose as propose_designs
    from models.surrogate.fit import fit_surrogate
    from models.surrogate.observations import ObservationSet

    rows: Rows = []
    for n_real, n_sim in ((10, 30), (30, 150), (60, 500), (110, 1000)):
        rng = np.random.default_rng(0)
        x = random_unit(n_real + n_sim, rng)
        s = np.repeat([1.0, 0.0], [n_real, n_sim])
        y = 10 + 5 * np.sin(3 * x[:, 0]) + 4 * x[:, 5] * x[:, 1] + s + 0.05 * rng.standard_normal(len(s))
        data = ObservationSet(x=x, s=s, y=y, noise_variance=np.zeros(len(s)))
        surrogate, fit_s = _timed(partial(fit_surrogate, data))
        _, batch_s = _timed(partial(propose_designs, surrogate, 1, 10, NO_PENDING, _rng()))
        _, single_s = _timed(partial(propose_designs, surrogate, 0, 1, NO_PENDING, _rng()))
        rows.append(
            {"n_real": n_real, "n_sim": n_sim, "fit_cpu_s": fit_s, "batch_of_10_cpu_s": batch_s, "one_cpu_s": single_s}
        )
    return rows


def lake() -> Rows:
    """Append grasps one by one as the bench does, read them back, compact, read again."""
    from lake.maintenance import compact
    from lake.provenance import current_provenance
    from lake.store import Lake
    from lake.tables import GraspRow, TraceRow
    from models.records import Trace

    lift = np.linspace(0, 60, 1200)
    trace = Trace(time_s=lift / 5, lift_mm=lift, force_n=10 * np.exp(-lift / 20))
    rows: Rows = []
    with tempfile.TemporaryDirectory() as folder:
        found = Lake.open(Path(folder) / "lake", create=True)
        provenance = current_provenance()
        for n_grasps in (108, 1080):
            start = time.process_time()
            n_before = len(found.ids(GraspRow))
            for number in range(n_before, n_grasps):
                found.append([TraceRow.of(f"K{number}", trace), _grasp_row(number)], provenance)
            append_s = (time.process_time() - start) / (n_grasps - n_before)
            _, read_s = _timed(lambda: found.query("SELECT tool_id, avg(peak_force_n) FROM grasps GROUP BY tool_id"))
            rows.append({"n_grasps": n_grasps, "append_cpu_ms": 1e3 * append_s, "first_query_cpu_s": read_s})
        _, compact_s = _timed(lambda: [compact(found, table) for table in ("grasps", "traces")])
        fresh = Lake.open(found.root)
        _, read_s = _timed(lambda: fresh.query("SELECT tool_id, avg(peak_force_n) FROM grasps GROUP BY tool_id"))
        rows.append({"n_grasps": n_grasps, "compact_cpu_s": compact_s, "first_query_cpu_s": read_s})
    return rows


def bench() -> Rows:
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
    return [{"n_grasps": n, "bench_s_per_grasp": bench_s / n, "wall_s_per_grasp": wall / n, "cpu_s_per_grasp": cpu / n}]


BENCHMARKS: dict[str, Callable[[], Rows]] = {"grasp": grasp, "propose": propose, "lake": lake, "bench": bench}


def _timed(work: Callable[[], Any]) -> tuple[Any, float]:
    """Result and CPU seconds of `work`."""
    start = time.process_time()
    result = work()
    return result, time.process_time() - start


def _rng() -> np.random.Generator:
    return np.random.default_rng(1)


def _grasp_row(number: int) -> Any:
    from lake.tables import GraspRow

    return GraspRow(
        grasp_id=f"K{number}",
        campaign_id="benchmark",
        tool_id=f"benchmark/B01T{number // 108}",
        design_id="D0",
        object_id=number % 36,
        repeat=number % 3,
        status="ok",
        peak_force_n=10.0,
        setup_id="G0",
        setup_json="{}",
        bench="virtual",
    )


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
