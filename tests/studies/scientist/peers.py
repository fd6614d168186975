"""What the scientist costs beside BoTorch on the same data."""

import time
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from fast.models.scientist.surrogate.observations import ObservationSet
from tests.studies.benchmarks.base import Options, Rows, Tables, timed
from tests.studies.benchmarks.scientist import N_PENDING, SIZES, cost_of_scientist, made_up_data

BOTORCH_LIMIT_S = 120.0  # CPU time after which BoTorch's fit is stopped
_CANDIDATES, _RESTARTS, _RAW_SAMPLES, _ITERATIONS = 1000, 4, 64, 50


def measure_scientist_peers(options: Options) -> Tables:
    """Fit the surrogate, propose ten tools and single simulations with ten pending; BoTorch on the same data."""
    limit_s = min(BOTORCH_LIMIT_S, 60.0 * options.limit_minutes)
    ours: Rows = []
    theirs: Rows = []
    bridged: Rows = []
    for n_real, n_sim in SIZES:
        data = made_up_data(n_real, n_sim)
        options.tell(f"{n_real} measured and {n_sim} simulated designs")
        ours.append(cost_of_scientist(data))
        bridged.append(_through_bridge(data))
        options.tell("the same in BoTorch")
        theirs.append(_botorch(data, limit_s))
    if options.figure is not None:
        _draw(options.figure, ours, theirs)
    return {"scientist": ours, "botorch": theirs, "bridge": bridged}


def make_log_improvement(model: Any, situation: Any) -> object:
    """BoTorch's own rule for noisy measurements, as a user would name it in a config."""
    from botorch.acquisition.logei import qLogNoisyExpectedImprovement

    return qLogNoisyExpectedImprovement(model, X_baseline=situation.measured)


def make_entropy(model: Any, situation: Any) -> object:
    """FAST's entropy search as an acquisition function, as a user would name it in a config."""
    from fast.models.scientist.bridge.entropy import MaxValueEntropy

    return MaxValueEntropy(model, situation.candidates)


def _through_bridge(data: ObservationSet) -> dict[str, float]:
    """The same fitted surrogate by numpy and as a BoTorch model: its posterior, and ten tools by several rules."""
    import torch

    from fast.models.design.space import random_unit
    from fast.models.scientist.bridge.model import SurrogateModel
    from fast.models.scientist.propose import NO_PENDING, Rule, propose
    from fast.models.scientist.surrogate.fit import fit_surrogate
    from fast.models.scientist.surrogate.observations import REAL

    torch.set_num_threads(1)
    surrogate = fit_surrogate(data)
    x = random_unit(_CANDIDATES, np.random.default_rng(0))
    points = torch.from_numpy(np.column_stack([x, np.ones(len(x))]))
    model = SurrogateModel(surrogate)
    row: dict[str, float] = {"n_real": data.n_real, "n_sim": data.n_sim}
    surrogate.posterior(x[:2], REAL)
    _, row["posterior_numpy_cpu_s"] = timed(partial(surrogate.posterior, x, REAL))
    _, row["posterior_bridge_cpu_s"] = timed(lambda: model.posterior(points).distribution.covariance_matrix)
    rules = {"mes": "mes", "entropy": f"{__name__}:make_entropy", "log_nei": f"{__name__}:make_log_improvement"}
    for column, rule in rules.items():
        choose = partial(propose, surrogate, REAL, rule=Rule(rule))
        choose(1, NO_PENDING, np.random.default_rng(1))  # imports
        _, row[f"ten_tools_{column}_cpu_s"] = timed(partial(choose, 10, NO_PENDING, np.random.default_rng(0)))
    return row


def _botorch(data: ObservationSet, limit_s: float) -> dict[str, float | str]:
    """The same model in BoTorch: its fit, and one proposal of multi-fidelity max-value entropy search."""
    import torch
    from botorch.fit import fit_gpytorch_mll
    from botorch.models import SingleTaskGP
    from botorch.models.transforms import Standardize
    from gpytorch.mlls import ExactMarginalLogLikelihood
    from gpytorch.priors import NormalPrior

    from fast.models.scientist.surrogate.parameters import RHO_MEAN, RHO_SD
    from tests.synthetic.scientist import BiFidelityKernel

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
    from fast.flows.report.style import BEST, FIRST, SIMULATED, figure_style, new_axes

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
