"""What the scientist costs: fitting the surrogate and proposing, at growing numbers of data, and BoTorch beside it."""

import time
from functools import partial
from pathlib import Path

import numpy as np

from flows.benchmarks.base import Options, Rows, Tables, timed
from models.scientist.surrogate.observations import ObservationSet
from models.scientist.surrogate.posterior import Surrogate

SIZES = ((10, 30), (30, 150), (60, 400), (110, 1000))  # measured, simulated
N_PENDING = 10
N_SINGLE = 100
BOTORCH_LIMIT_S = 120.0  # CPU time after which BoTorch's fit is stopped
_CANDIDATES, _RESTARTS, _RAW_SAMPLES, _ITERATIONS = 1000, 4, 64, 50


def measure_scientist(options: Options) -> Tables:
    """Fit the surrogate, propose ten tools and single simulations with ten pending; BoTorch on the same data."""
    limit_s = min(BOTORCH_LIMIT_S, 60.0 * options.limit_minutes)
    ours: Rows = []
    theirs: Rows = []
    for n_real, n_sim in SIZES:
        data = _data(n_real, n_sim)
        options.tell(f"{n_real} measured and {n_sim} simulated designs")
        ours.append(_ours(data))
        options.tell("the same in BoTorch")
        theirs.append(_botorch(data, limit_s))
    if options.figure is not None:
        _draw(options.figure, ours, theirs)
    return {"scientist": ours, "botorch": theirs}


def _data(n_real: int, n_sim: int) -> ObservationSet:
    """A landscape of the comparison, observed at random designs."""
    from flows.scientist.landscape import synthetic_landscape
    from models.design.space import random_unit
    from models.scientist.surrogate.observations import REAL, SIM

    landscape, rng = synthetic_landscape(0), np.random.default_rng(0)
    x, s = random_unit(n_real + n_sim, rng), np.repeat([SIM, REAL], [n_sim, n_real])
    y = np.where(s == REAL, landscape.real(x) + landscape.noise_sd_n * rng.normal(size=len(x)), landscape.simulated(x))
    return ObservationSet(x, s, y, np.zeros(len(x)))


def _ours(data: ObservationSet) -> dict[str, float]:
    from models.scientist.surrogate.fit import fit_surrogate

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
    from models.design.space import random_unit
    from models.scientist.propose import propose

    pending = np.column_stack([random_unit(N_PENDING, np.random.default_rng(7)), np.zeros(N_PENDING)])
    propose(surrogate, fidelity, n, pending, np.random.default_rng(seed), min_distance=0.0, acquisition=rule)


def _botorch(data: ObservationSet, limit_s: float) -> dict[str, float | str]:
    """The same model in BoTorch: its fit, and one proposal of multi-fidelity max-value entropy search."""
    import torch
    from botorch.fit import fit_gpytorch_mll
    from botorch.models import SingleTaskGP
    from botorch.models.transforms import Standardize
    from gpytorch.mlls import ExactMarginalLogLikelihood
    from gpytorch.priors import NormalPrior

    from models.scientist.surrogate.kernel import BiFidelityKernel
    from models.scientist.surrogate.parameters import RHO_MEAN, RHO_SD

    torch.set_num_threads(1)
    torch.manual_seed(0)
    x = torch.tensor(np.column_stack([data.x, data.s]))
    y = torch.tensor(data.y)[:, None]
    kernel = BiFidelityKernel(9, rho_prior=NormalPrior(RHO_MEAN, RHO_SD)).double()
    model = SingleTaskGP(x, y, covar_module=kernel, outcome_transform=Standardize(1))
    likelihood = ExactMarginalLogLikelihood(model.likelihood, model)
    start_s, started_s = time.process_time(), time.monotonic()
    fit_gpytorch_mll(likelihood, optimizer_kwargs={"timeout_sec": limit_s})
    fit_s = time.process_time() - start_s
    _, proposal_s = timed(partial(_botorch_proposal, model, x))
    return {
        "n_real": data.n_real,
        "n_sim": data.n_sim,
        "fit_cpu_s": fit_s,
        "fit": "stopped" if time.monotonic() - started_s - proposal_s >= limit_s else "finished",
        "one_simulation_mes_cpu_s": proposal_s,
    }


def _botorch_proposal(model: object, x: object) -> None:
    """One design for the simulator with ten pending, by `qMultiFidelityMaxValueEntropy`."""
    import torch
    from botorch.acquisition.max_value_entropy_search import qMultiFidelityMaxValueEntropy
    from botorch.optim import optimize_acqf

    generator = torch.Generator().manual_seed(1)
    candidates = torch.rand(_CANDIDATES, 10, generator=generator, dtype=torch.float64)
    candidates[:, -1] = 1.0
    pending = torch.rand(N_PENDING, 10, generator=generator, dtype=torch.float64)
    pending[:, -1] = 0.0

    def as_real(points: torch.Tensor) -> torch.Tensor:
        return torch.cat([points[..., :-1], torch.ones_like(points[..., -1:])], dim=-1)

    rule = qMultiFidelityMaxValueEntropy(model, candidates, num_fantasies=8, X_pending=pending, project=as_real)
    bounds = torch.tensor([[0.0] * 10, [1.0] * 10], dtype=torch.float64)
    optimize_acqf(rule, bounds, q=1, num_restarts=_RESTARTS, raw_samples=_RAW_SAMPLES, fixed_features={9: 0.0},
                  options={"maxiter": _ITERATIONS})  # fmt: skip


def _draw(path: Path, ours: Rows, theirs: Rows) -> None:
    """Cost against the number of observations, both axes logarithmic."""
    from flows.report.style import BEST, FIRST, SIMULATED, figure_style, new_axes

    lines = (
        (ours, "fit_cpu_s", BEST, "o-", "fit"),
        (ours, "ten_tools_mes_cpu_s", SIMULATED, "o-", "ten tools"),
        (ours, "one_simulation_mes_cpu_s", FIRST, "o-", "one simulation, 10 pending"),
        (theirs, "fit_cpu_s", BEST, "s--", "fit, BoTorch"),
        (theirs, "one_simulation_mes_cpu_s", FIRST, "s--", "one simulation, BoTorch"),
    )
    path.parent.mkdir(parents=True, exist_ok=True)
    with figure_style():
        figure, axes = new_axes(5.6, 3.6, grid="both")
        for rows, column, colour, style, label in lines:
            n = [row["n_real"] + row["n_sim"] for row in rows]
            axes.loglog(n, [row[column] for row in rows], style, color=colour, label=label, markersize=4)
        axes.set_xlabel("observations (measured and simulated designs)")
        axes.set_ylabel("CPU (s)")
        figure.legend(loc="outside right upper")
        figure.savefig(path, dpi=160)
