"""What the scientist costs: fitting the surrogate and proposing, at growing numbers of data."""

from functools import partial

import numpy as np

from flows.benchmarks.base import Rows, Tables, timed


def measure_propose() -> Tables:
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
        surrogate, fit_s = timed(partial(fit_surrogate, data))
        _, batch_s = timed(partial(propose_designs, surrogate, 1, 10, NO_PENDING, _rng()))
        _, single_s = timed(partial(propose_designs, surrogate, 0, 1, NO_PENDING, _rng()))
        rows.append(
            {"n_real": n_real, "n_sim": n_sim, "fit_cpu_s": fit_s, "batch_of_10_cpu_s": batch_s, "one_cpu_s": single_s}
        )
    return {"proposals": rows}


def _rng() -> np.random.Generator:
    return np.random.default_rng(1)
