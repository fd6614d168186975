"""Whether the fast calibration draws from the posterior that full joint NUTS, which approximates nothing, draws from.

The exact chains are kept one by one: at hundreds of designs each takes minutes, at the paper's size hours. `--n-sim 200
--n-real 40` is a problem whose importance weights fail, so that what is compared there is the fallback.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from flows.benchmarks.base import Options, Rows, Tables
from flows.benchmarks.outcomes import RecordFile, read_records
from models.calibration.inference.settings import CalibrationSettings
from models.calibration.means.parameters import ParameterVector
from models.calibration.means.problem import THETA, CalibrationProblem, Standardised
from models.calibration.means.synthetic import make_up_problem
from models.records import Record

N_SIM, N_REAL, SEED = 300, 40, 0
N_CHAINS = 4
EXACT = CalibrationSettings(tune=150, draws=300, target_accept=0.8, workers=1)  # of each chain
FAST = CalibrationSettings(chains=4, tune=500, draws=1000)
NAMES = (*THETA, "sd_e_n", "noise_sd_n", "sd_h", "nugget")  # the logarithms of these are compared
QUANTILES = (0.05, 0.5, 0.95)


class ExactChain(Record):
    """One chain of full joint NUTS: `draws` by name, after `n_tune`, in the units of `CalibrationResult`."""

    n_sim: int
    n_real: int
    number: int
    n_tune: int
    draws: dict[str, tuple[float, ...]]
    n_divergences: int
    n_gradients: int
    cpu_s: float


def measure_calibration_agreement(options: Options) -> Tables:
    """Posterior of the automatic algorithm beside chains of full joint NUTS, in Monte-Carlo standard errors."""
    from models.calibration.means.calibrate import calibrate

    n_sim, n_real = options.n_sim or N_SIM, options.n_real or N_REAL
    problem = problem_of(n_sim, n_real)
    chains = _exact_chains(problem, options)
    settings = FAST.model_copy(update={"workers": options.workers or 1})
    result = calibrate(problem, settings, options.tell)
    exact = posterior_rows(np.array([[chain.draws[name] for name in NAMES] for chain in chains]).swapaxes(1, 2))
    fast = posterior_rows(result.draws[:, :, [result.names.index(name) for name in NAMES]])
    return {
        "runs": [_exact_run(problem, chains, exact), _fast_run(problem, result, fast)],
        "exact": exact,
        "fast": fast,
        "difference": [difference(a, b) for a, b in zip(fast, exact, strict=True)],
    }


def problem_of(n_sim: int, n_real: int) -> CalibrationProblem:
    """The made-up problem of a size; Young's modulus is a factor, so that the posterior is a long ridge."""
    return make_up_problem(n_sim, n_real, SEED, scales_with_modulus=True)


def posterior_rows(draws: np.ndarray) -> Rows:
    """Moments and quantiles of the logarithm of each of `NAMES`, from chains x n x names, with its effective draws."""
    from models.calibration.inference.diagnostics import measure_convergence

    r_hat, ess_bulk, ess_tail = measure_convergence(NAMES, draws)
    rows: Rows = []
    for name, values in zip(NAMES, np.moveaxis(np.log(draws), 2, 0), strict=True):
        quantiles = dict(zip(("q05", "median", "q95"), np.quantile(values, QUANTILES).tolist(), strict=True))
        moments = {"mean": float(values.mean()), "sd": float(values.std(ddof=1))}
        sizes = {"ess_bulk": ess_bulk[name], "ess_tail": ess_tail[name], "r_hat": r_hat[name]}
        rows.append({"log_of": name, **moments, **quantiles, **sizes})
    return rows


def difference(a: dict[str, Any], b: dict[str, Any]) -> dict[str, Any]:
    """How far two posteriors of one parameter are apart: means in standard errors of both, and the ratio of widths."""
    error = float(np.hypot(a["sd"] / np.sqrt(a["ess_bulk"]), b["sd"] / np.sqrt(b["ess_bulk"])))
    apart = a["mean"] - b["mean"]
    return {
        "log_of": a["log_of"],
        "means_apart_sd": apart / b["sd"],
        "means_apart_errors": apart / error,
        "sd_ratio": a["sd"] / b["sd"],
    }


def _exact_chains(problem: CalibrationProblem, options: Options) -> list[ExactChain]:
    """All chains: those that the results file has, and the others, sampled now and kept as they end."""
    records = read_records(options.results, ExactChain, "chain of a calibration")
    size = (problem.n_sim, problem.n_real, EXACT.tune)
    known = {record.number: record for record in records if (record.n_sim, record.n_real, record.n_tune) == size}
    with RecordFile(options.results) as file:
        for number in range(N_CHAINS):
            if number not in known:
                known[number] = exact_chain(problem, number)
                file.append(known[number])
                options.tell(f"chain {number} of full joint NUTS: {known[number].cpu_s:.0f} s of CPU")
    return [known[number] for number in range(N_CHAINS)]


def exact_chain(problem: CalibrationProblem, number: int) -> ExactChain:
    """One chain of full joint NUTS; its number is its seed and chooses its start."""
    from models.calibration.means.joint_nuts import sample_joint

    data = Standardised.of(problem)
    parameters = ParameterVector.of(data, EXACT)
    alone = EXACT.model_copy(update={"chains": 1, "seed": number})  # R-hat, which needs two, is of all together
    samples, _ = sample_joint(data, parameters, alone)
    draws = parameters.constrain(samples.flat, data.force_scale_n)
    columns = {name: tuple(float(f"{value:.6g}") for value in draws[:, parameters.names.index(name)]) for name in NAMES}
    return ExactChain(
        n_sim=problem.n_sim,
        n_real=problem.n_real,
        number=number,
        n_tune=EXACT.tune,
        draws=columns,
        n_divergences=samples.n_divergences,
        n_gradients=samples.n_gradients,
        cpu_s=samples.cpu_s,
    )


def _exact_run(problem: CalibrationProblem, chains: Sequence[ExactChain], rows: Rows) -> dict[str, Any]:
    return {
        "algorithm": "joint NUTS",
        **_size(problem, rows),
        "k_hat": None,
        "divergences": sum(chain.n_divergences for chain in chains),
        "gradients": sum(chain.n_gradients for chain in chains),
        "cpu_s": sum(chain.cpu_s for chain in chains),
    }


def _fast_run(problem: CalibrationProblem, result: Any, rows: Rows) -> dict[str, Any]:
    return {
        "algorithm": result.method,
        **_size(problem, rows),
        "k_hat": result.k_hat,
        "divergences": result.n_divergences,
        "gradients": result.n_gradients,
        "cpu_s": result.cpu_s,
    }


def _size(problem: CalibrationProblem, rows: Rows) -> dict[str, Any]:
    r_hat, ess = max(row["r_hat"] for row in rows), min(row["ess_bulk"] for row in rows)
    return {"simulations": problem.n_sim, "designs": problem.n_real, "r_hat_max": r_hat, "ess_bulk_min": ess}
