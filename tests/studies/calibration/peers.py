"""Calibration beside surmise (PyPI) on the same made-up problems: errors, coverage of intervals, cost, features.

surmise emulates designs x thetas, every design at every theta. A Latin hypercube over both is not that, so it is given
extra simulations: all measured designs at the same thetas. It also needs to be told the variance of the measurements
around the simulator: once it is told the noise, once noise and discrepancy, which nobody knows outside of a made-up
problem.
"""

from collections.abc import Sequence
from functools import partial

import numpy as np

from fast.models.calibration.inference.settings import CalibrationSettings, ThetaPriors
from fast.models.calibration.means.predict import Mixture
from fast.models.calibration.means.problem import THETA, CalibrationProblem
from fast.models.errors import MissingDependencyError
from fast.models.records import Record
from tests.studies.benchmarks.base import Options, Rows, Tables, timed
from tests.studies.benchmarks.outcomes import RecordFile, read_records
from tests.synthetic.calibration import Truth, discrepancy_n, force_n, make_up_problem

N_PROBLEMS = 10
N_SIM, N_REAL = 120, 25
N_THETAS = 60
OURS, TOLD_NOISE, TOLD_ALL = "FAST", "surmise, told the noise", "surmise, told noise and discrepancy"
TOOLS = (OURS, TOLD_NOISE, TOLD_ALL)
# Full joint NUTS: at this size the automatic choice ends there too, after a vain attempt.
SETTINGS = CalibrationSettings(method="joint", chains=2, draws=600, tune=400, workers=1)
_N_PILOT, _N_DRAWS, _N_BURN = 1500, 6000, 1000
_FIRST_STEPS = np.array([0.25, 0.12, 0.05])  # of ln E, friction, Poisson's ratio
_STEP_PER_SD = 0.7  # Metropolis accepts about a third of such steps on a ridge in three dimensions

FEATURES: Rows = [
    {"feature": "simulations with their own design and theta each", "FAST": "yes", "surmise": "no, designs x thetas"},
    {"feature": "discrepancy", "FAST": "Gaussian process, inferred", "surmise": "a covariance that is given"},
    {"feature": "measurement noise", "FAST": "inferred; extra variance of a mean known", "surmise": "given"},
    {"feature": "emulator's parameters", "FAST": "inferred jointly", "surmise": "fitted before"},
    {"feature": "scale rho", "FAST": "fixed or inferred", "surmise": "no"},
    {"feature": "exact factor among the parameters (E)", "FAST": "yes", "surmise": "no"},
    {"feature": "R-hat, effective sample size, k-hat", "FAST": "always", "surmise": "no"},
    {"feature": "prediction of designs not measured", "FAST": "yes", "surmise": "no, measured designs only"},
    {"feature": "samplers", "FAST": "NUTS, factorised with correction", "surmise": "Metropolis, PTLMC"},
    {"feature": "several outputs of a simulation", "FAST": "by traces", "surmise": "yes, principal components"},
]


class Estimate(Record):
    """Theta as one tool found it in one problem; tuples are in the order of `THETA`."""

    tool: str
    seed: int
    truth: tuple[float, ...]
    mean: tuple[float, ...]
    sd: tuple[float, ...]
    q05: tuple[float, ...]
    q95: tuple[float, ...]
    crps: tuple[float, ...]
    ess_bulk: float
    cpu_s: float
    n_simulations: int


def measure_calibration_peers(options: Options) -> Tables:
    """Posterior of theta by FAST and by surmise on made-up problems with a known theta."""
    _require_surmise()
    known = {(e.tool, e.seed): e for e in read_records(options.results, Estimate, "estimate of a calibration")}
    with RecordFile(options.results) as file:
        for seed in range(options.worlds or N_PROBLEMS):
            for tool in TOOLS:
                if (tool, seed) not in known:
                    known[tool, seed] = estimate(tool, seed)
                    file.append(known[tool, seed])
                    options.tell(f"problem {seed}, {tool}: {known[tool, seed].cpu_s:.0f} s of CPU")
    found = [known[tool, seed] for tool in TOOLS for seed in range(options.worlds or N_PROBLEMS)]
    return {"calibration peers": summary_rows(found), "features": FEATURES}


def estimate(tool: str, seed: int) -> Estimate:
    """Calibrate problem `seed` with a tool."""
    truth = truth_of(seed)
    problem = make_up_problem(N_SIM, N_REAL, seed, truth)
    if tool == OURS:
        (draws, ess), cpu_s = timed(partial(_ours, problem, seed))
        n_simulations = problem.n_sim
    else:
        (draws, ess), cpu_s = timed(partial(_surmise, problem, truth, seed, tool == TOLD_ALL))
        n_simulations = N_THETAS * problem.n_real
    return estimate_of(tool, seed, truth.theta, draws, ess, cpu_s, n_simulations)


def truth_of(seed: int) -> Truth:
    """A hidden theta of its own for each problem, well inside the priors."""
    rng = np.random.default_rng([seed, 11])
    theta = (float(np.exp(rng.uniform(np.log(5), np.log(20)))), rng.uniform(0.35, 0.9), rng.uniform(0.25, 0.45))
    return Truth(theta=theta)


def estimate_of(
    tool: str, seed: int, truth: Sequence[float], draws: np.ndarray, ess: float, cpu_s: float, n_simulations: int
) -> Estimate:
    """What draws of theta (n x 3) say about it, beside the truth."""
    # A draw is a normal distribution without spread; 500 give the score to a few per cent.
    few = draws[:: max(1, len(draws) // 500)]
    score = Mixture.equal(few, np.zeros(few.shape)).crps(np.array(truth))
    q05, q95 = np.quantile(draws, (0.05, 0.95), axis=0)
    return Estimate(
        tool=tool,
        seed=seed,
        truth=tuple(truth),
        mean=tuple(draws.mean(axis=0).tolist()),
        sd=tuple(draws.std(axis=0, ddof=1).tolist()),
        q05=tuple(q05.tolist()),
        q95=tuple(q95.tolist()),
        crps=tuple(score.tolist()),
        ess_bulk=ess,
        cpu_s=cpu_s,
        n_simulations=n_simulations,
    )


def summary_rows(estimates: Sequence[Estimate]) -> Rows:
    """One row a tool: by parameter the error of the mean, coverage and width of the 90 % interval; then cost."""
    rows: Rows = []
    for tool in dict.fromkeys(e.tool for e in estimates):
        mine = [e for e in estimates if e.tool == tool]
        truth, mean, q05, q95, crps = (
            np.array([getattr(e, c) for e in mine]) for c in ("truth", "mean", "q05", "q95", "crps")
        )
        inside = (q05 <= truth) & (truth <= q95)
        row: dict[str, object] = {"tool": tool, "problems": len(mine), "simulations": mine[0].n_simulations}
        for place, name in enumerate(THETA):
            row[f"{name}_rmse"] = float(np.sqrt(np.mean((mean - truth)[:, place] ** 2)))
            row[f"{name}_in_90"] = float(np.mean(inside[:, place]))
            row[f"{name}_width_90"] = float(np.mean((q95 - q05)[:, place]))
            row[f"{name}_crps"] = float(np.mean(crps[:, place]))
        row["cpu_s"] = float(np.median([e.cpu_s for e in mine]))
        row["ess_per_cpu_s"] = float(np.median([e.ess_bulk / e.cpu_s for e in mine]))
        rows.append(row)
    return rows


def _ours(problem: CalibrationProblem, seed: int) -> tuple[np.ndarray, float]:
    from fast.models.calibration.means.calibrate import calibrate

    result = calibrate(problem, SETTINGS.model_copy(update={"seed": seed}))
    return result.flat(*THETA), min(result.ess_bulk[name] for name in THETA)


def _surmise(problem: CalibrationProblem, truth: Truth, seed: int, is_told_all: bool) -> tuple[np.ndarray, float]:
    """Draws of theta (n x 3) by PCGP, direct Bayes and Metropolis, as its examples do; in ln E."""
    from surmise import set_RNG
    from surmise.calibration import calibrator
    from surmise.emulation import emulator

    rng = np.random.default_rng(seed)
    set_RNG(rng)
    prior = _SurmisePrior(CalibrationSettings().priors, rng)
    thetas = prior.rnd(N_THETAS)
    x, y = problem.x_real, problem.y_real
    outputs = np.column_stack([force_n(x, np.broadcast_to(_physical(t[None])[0], (len(x), 3))) for t in thetas])
    emulate = emulator(x=x, theta=thetas, f=outputs, method="PCGP")
    variance = truth.noise_sd_n**2 + (float(np.mean(discrepancy_n(x) ** 2)) if is_told_all else 0.0)
    draws = np.array([[np.log(prior.priors.young_modulus_median_mpa), 0.56, 0.35]])
    steps = _FIRST_STEPS
    for n_draws in (_N_PILOT, _N_PILOT, _N_DRAWS):  # its sampler does not tune itself: two pilots find the steps
        sampler = {"sampler": "metropolis_hastings", "theta0": draws[-1:], "nSamples": n_draws,
                   "nBurnSamples": _N_BURN, "stepType": "normal", "stepParam": steps, "verbose": False}  # fmt: skip
        found = calibrator(emu=emulate, x=x, y=y, yvar=np.full(len(y), variance), thetaprior=prior,
                           method="directbayeswoodbury", args=sampler)  # fmt: skip
        draws = found.info["thetarnd"]
        steps = _STEP_PER_SD * draws.std(axis=0)
    return _physical(draws), _least_ess(draws)


class _SurmisePrior:
    """Table 3 on (ln E, friction, Poisson's ratio), with the two functions that surmise asks for."""

    def __init__(self, priors: ThetaPriors, rng: np.random.Generator) -> None:
        from scipy import stats

        self.priors, self._rng = priors, rng
        width = priors.poisson_ratio_upper - priors.poisson_ratio_lower
        self._parts = (
            stats.norm(np.log(priors.young_modulus_median_mpa), priors.young_modulus_log_sd),
            stats.gamma(priors.friction_shape, scale=1.0 / priors.friction_rate),
            stats.uniform(priors.poisson_ratio_lower, width),
        )

    def lpdf(self, theta: np.ndarray) -> np.ndarray:
        """Log density of theta (n x 3), n x 1."""
        values = [part.logpdf(column) for part, column in zip(self._parts, theta.T, strict=True)]
        return np.sum(values, axis=0)[:, None]

    def rnd(self, n: int) -> np.ndarray:
        """Draws, n x 3."""
        return np.column_stack([part.rvs(n, random_state=self._rng) for part in self._parts])


def _physical(theta: np.ndarray) -> np.ndarray:
    """(ln E, friction, Poisson's ratio) as theta, n x 3."""
    return np.column_stack([np.exp(theta[:, 0]), theta[:, 1:]])


def _least_ess(draws: np.ndarray) -> float:
    from fast.models.calibration.inference.result import measure_convergence

    parts = draws[: len(draws) // 4 * 4].reshape(4, -1, len(THETA))  # as if they were chains
    _, ess_bulk, _ = measure_convergence(THETA, parts)
    return min(ess_bulk.values())


def _require_surmise() -> None:
    try:
        import surmise  # noqa: F401 - only whether it is there
    except ImportError as error:
        raise MissingDependencyError(
            "surmise is not installed; run `pip install surmise==1.0.0` in the environment of `fast`, and again."
        ) from error
