"""`fast doctor --speed`: what this computer takes for a grasp, a fit of the scientist, and a search for a gap."""

import os
import time
from collections.abc import Callable
from typing import Any, TypeVar

T = TypeVar("T")

N_DESIGNS, OBJECTS = 2, (2, 14, 30)  # a sphere, a tube, a cube
N_REAL, N_SIM, N_BATCH = 110, 850, 10  # designs measured and simulated at the end of the paper's schedule; its batch
SEARCH_TOOLS, SEARCH_OBJECTS = 10, 8
PAPER_GRASPS = 50_608  # that the paper simulated


def measure_speed() -> list[dict[str, Any]]:
    """Measure each kind of work, a row each: CPU seconds, and hours where all cores of this computer work on it."""
    grasp_s = time_grasp()
    fit_s, propose_s = time_scientist()
    n_search = count_search_grasps()
    return [
        _row("a simulated grasp", grasp_s),
        _row(f"{PAPER_GRASPS} grasps, as many as the paper simulated", PAPER_GRASPS * grasp_s, True),
        _row(f"a fit to {N_REAL} measured and {N_SIM} simulated designs", fit_s),
        _row(f"a batch of {N_BATCH} tools proposed with it", propose_s),
        _row(
            f"a first gap search with {SEARCH_TOOLS} tools on {SEARCH_OBJECTS} objects, {n_search} grasps",
            n_search * grasp_s,
            True,
        ),
    ]


def time_grasp() -> float:
    """Measure the mean CPU seconds of a few whole grasps by the production simulator, kernels compiled before."""
    from fast.models.design.space import BEST_PUBLISHED, numbered_design
    from fast.models.objects.catalogue import get_object
    from fast.models.records import GraspSetup
    from fast.models.simulation.grasp import simulate_grasp

    simulate_grasp(BEST_PUBLISHED, get_object(OBJECTS[0]), setup=GraspSetup(max_lift_mm=2))
    cases = [(numbered_design(number), get_object(object_id)) for number in range(N_DESIGNS) for object_id in OBJECTS]
    _, cpu_s = _time(lambda: [simulate_grasp(design, obj) for design, obj in cases])
    return cpu_s / len(cases)


def time_scientist() -> tuple[float, float]:
    """Measure the CPU seconds of a surrogate fit, and of choosing a batch with it by max-value entropy search."""
    import numpy as np

    from fast.models.design.space import random_unit
    from fast.models.scientist.propose import NO_PENDING, propose
    from fast.models.scientist.surrogate.fit import fit_surrogate
    from fast.models.scientist.surrogate.observations import REAL, SIM, ObservationSet

    rng = np.random.default_rng(0)
    x, s = random_unit(N_REAL + N_SIM, rng), np.repeat([SIM, REAL], [N_SIM, N_REAL])
    hill_n = 11.0 + 16.0 * np.exp(-1.5 * ((x - np.where(s == REAL, 0.6, 0.5)[:, None]) ** 2).sum(axis=1))
    y = np.where(s == REAL, hill_n + 0.5 * rng.normal(size=len(x)), 0.6 * hill_n)
    surrogate, fit_s = _time(lambda: fit_surrogate(ObservationSet(x, s, y, np.zeros(len(x)))))
    _, propose_s = _time(lambda: propose(surrogate, REAL, N_BATCH, NO_PENDING, rng))
    return fit_s, propose_s


def count_search_grasps() -> int:
    """Count the grasps of the bank of simulations that a search needs before its first answer."""
    from fast.models.design.space import numbered_design
    from fast.models.gap.grasps import Cells
    from fast.models.records import GraspSetup
    from fast.models.simulation.version import SimulatorVersion
    from fast.tasks.gap.bank import plan_bank

    designs = [numbered_design(number) for number in range(SEARCH_TOOLS)]
    cells = Cells.full(designs, range(SEARCH_OBJECTS), GraspSetup())
    return sum(plan.n_grasps for plan in plan_bank(SimulatorVersion(), cells))


def _row(work: str, cpu_s: float, is_shared: bool = False) -> dict[str, Any]:
    hours = cpu_s / 3600 / (os.cpu_count() or 1)
    return {"work": work, "cpu_s": float(f"{cpu_s:.3g}"), "hours": float(f"{hours:.2g}") if is_shared else None}


def _time(work: Callable[[], T]) -> tuple[T, float]:
    """Return the result and the CPU seconds of `work`."""
    start = time.process_time()
    result = work()
    return result, time.process_time() - start
