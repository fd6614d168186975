"""What the scientist costs: fitting the surrogate and proposing, at growing numbers of data."""

from functools import partial

import numpy as np

from fast.models.scientist.surrogate.observations import ObservationSet
from fast.models.scientist.surrogate.posterior import Surrogate
from tests.studies.benchmarks.base import Options, Tables, timed

SIZES = ((10, 30), (30, 150), (60, 400), (110, 1000))  # measured, simulated
N_PENDING = 10
N_SINGLE = 100


def measure_scientist(options: Options) -> Tables:
    """CPU of fitting the surrogate, of proposing ten tools and of single simulations with ten pending."""
    rows = []
    for n_real, n_sim in SIZES:
        options.tell(f"{n_real} measured and {n_sim} simulated designs")
        rows.append(cost_of_scientist(made_up_data(n_real, n_sim)))
    return {"scientist": rows}


def made_up_data(n_real: int, n_sim: int) -> ObservationSet:
    """A hill in nine dimensions, and a simulator that scales and moves it, observed at random designs."""
    from fast.models.design.space import random_unit
    from fast.models.scientist.surrogate.observations import REAL, SIM

    rng = np.random.default_rng(0)
    x, s = random_unit(n_real + n_sim, rng), np.repeat([SIM, REAL], [n_sim, n_real])
    centre = np.where(s == REAL, 0.6, 0.5)[:, None]
    hill_n = 11.0 + 16.0 * np.exp(-1.5 * ((x - centre) ** 2).sum(axis=1))
    y = np.where(s == REAL, hill_n + 0.5 * rng.normal(size=len(x)), 0.6 * hill_n)
    return ObservationSet(x, s, y, np.zeros(len(x)))


def cost_of_scientist(data: ObservationSet) -> dict[str, float]:
    """CPU seconds of fitting, of proposing ten tools, and of one simulation by each rule."""
    from fast.models.scientist.surrogate.fit import fit_surrogate

    surrogate, cold_s = timed(partial(fit_surrogate, data))
    _, warm_s = timed(partial(fit_surrogate, data, surrogate.parameters))
    row: dict[str, float] = {"n_real": data.n_real, "n_sim": data.n_sim, "cold_fit_cpu_s": cold_s, "fit_cpu_s": warm_s}
    _, row["ten_tools_mes_cpu_s"] = timed(partial(_propose, surrogate, "mes", 1, 10, 0))
    costs = [timed(partial(_simulation, surrogate, "mes", seed))[1] for seed in range(N_SINGLE)]
    row["one_simulation_mes_cpu_s"] = float(np.median(costs))
    row["one_simulation_mes_p99_cpu_s"] = float(np.quantile(costs, 0.99))
    return row


def _simulation(surrogate: Surrogate, rule: str, seed: int) -> None:
    """What the end of one simulation costs: condition on its result, then propose the next."""
    _propose(surrogate.updated(surrogate.data), rule, 0, 1, seed)


def _propose(surrogate: Surrogate, rule: str, fidelity: int, n: int, seed: int) -> None:
    from fast.models.design.space import random_unit
    from fast.models.scientist.propose import Room, Rule, propose

    pending = np.column_stack([random_unit(N_PENDING, np.random.default_rng(7)), np.zeros(N_PENDING)])
    propose(surrogate, fidelity, n, pending, np.random.default_rng(seed), Rule(rule), Room(min_distance=0.0))
