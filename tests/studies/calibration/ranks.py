"""Simulation-based calibration of the calibration: are posterior intervals as wide as they claim, over many worlds?

Three kinds of small worlds. In a *model* world parameters come from the prior and outputs from the Gaussian processes:
the rank of the true parameter among posterior draws is uniform if and only if density and sampler are right (Talts et
al. 2018; the log density as a further quantity after Modrak et al. 2023). In a *forces* world
outputs come from closed-form grasp forces with a discrepancy (`tests.synthetic.calibration`), as in practice,
in a *factor* world from forces proportional to Young's modulus: there it counts how often the 90 % interval holds the
truth. A parameter of which the data say little keeps its prior, whose interval misses every truth near its ends and no
other. So that the count does not hinge on what was drawn, true thetas of 100 worlds are a Latin hypercube of the prior.
"""

import time
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, ProcessPoolExecutor, wait
from itertools import islice
from multiprocessing import get_context
from pathlib import Path
from typing import Literal, get_args

import numpy as np
from scipy.stats import binom, chisquare, kstest, qmc

from fast.models.blas import one_blas_thread
from fast.models.calibration.inference.settings import CalibrationSettings, ThetaPriors
from fast.models.calibration.means.problem import THETA
from fast.models.records import Record
from tests.studies.benchmarks.base import Options, Rows, Tables
from tests.studies.benchmarks.outcomes import RecordFile, read_records

N_WORLDS = 100
N_SIM, N_REAL = 80, 25
SETTINGS = CalibrationSettings(chains=2, tune=150, draws=150, target_accept=0.8, workers=1)
N_RANKED = 99  # draws a truth is ranked among, so a rank is one of 100
N_BINS = 10
INTERVAL = (0.05, 0.95)
LOG_DENSITY = "log_density"
HYPERCUBE = 100  # worlds whose true thetas fill the prior evenly
Kind = Literal["model", "forces", "factor"]


class WorldOutcome(Record):
    """One calibrated world. `ranks` of the truth among `N_RANKED` draws; `inside`: the 90 % interval holds it."""

    kind: Kind
    world: int
    sampler: str
    ranks: Mapping[str, int]
    inside: Mapping[str, bool]
    worst_r_hat: float
    least_ess: float
    n_divergences: int
    cpu_s: float


def measure_calibration_ranks(options: Options) -> Tables:
    """Ranks of true parameters among posterior draws, and coverage of 90 % intervals, over made-up worlds."""
    outcomes = _outcomes(options)
    if options.figure is not None:
        _draw(options.figure, [outcome for outcome in outcomes if outcome.kind == "model"])
    by_kind = [[outcome for outcome in outcomes if outcome.kind == kind] for kind in get_args(Kind)]
    return {
        "worlds": [_summary(own) for own in by_kind if own],
        "ranks": _rank_rows(by_kind[0]),
        "coverage": [row for own in by_kind for row in _coverage_rows(own)],
    }


def _outcomes(options: Options) -> list[WorldOutcome]:
    """Worlds from the results file, else calibrated now, in order; stops early at the time limit."""
    records = read_records(options.results, WorldOutcome, "outcome of a calibrated world")
    known = {(record.kind, record.world): record for record in records if record.sampler == sampler(record.kind)}
    wanted = [(kind, world) for world in range(options.worlds or N_WORLDS) for kind in get_args(Kind)]
    missing = [key for key in wanted if key not in known]
    with RecordFile(options.results) as file:
        for outcome in _calibrate(missing, options):
            known[outcome.kind, outcome.world] = outcome
            file.append(outcome)
            options.tell(
                f"{outcome.kind} world {outcome.world}: {outcome.cpu_s:.1f} s of CPU, R-hat {outcome.worst_r_hat:.3f}, "
                f"{outcome.n_divergences} divergences"
            )
    return [known[key] for key in wanted if key in known]


def _calibrate(missing: Sequence[tuple[Kind, int]], options: Options) -> Iterator[WorldOutcome]:
    """Outcomes as they come, from one process or several, until the time is up."""
    end = time.monotonic() + 60.0 * options.limit_minutes
    left = iter(missing)
    if (options.workers or 1) == 1:
        yield from (calibrate_world(*key) for key in left if time.monotonic() < end)
        return
    with ProcessPoolExecutor(options.workers, get_context("spawn")) as pool:
        running = {pool.submit(calibrate_world, *key) for key in islice(left, options.workers)}
        while running:
            done, running = wait(running, return_when=FIRST_COMPLETED)
            if time.monotonic() < end:
                running |= {pool.submit(calibrate_world, *key) for key in islice(left, len(done))}
            yield from (future.result() for future in done)


def calibrate_world(kind: Kind, world: int) -> WorldOutcome:
    """Make a world, calibrate it by full joint NUTS, rank the truth."""
    with one_blas_thread():
        return _calibrate_world(kind, world)


def _calibrate_world(kind: Kind, world: int) -> WorldOutcome:
    from fast.models.calibration.inference.result import measure_convergence
    from fast.models.calibration.means.joint import JointDensity, sample_joint
    from fast.models.calibration.means.parameters import Parameters
    from fast.models.calibration.means.problem import Standardised
    from tests.synthetic.calibration import Truth, draw_outputs, draw_prior, make_up_problem

    settings = SETTINGS.model_copy(update={"seed": world})
    theta, rng = _true_theta(kind, settings.priors, world)
    truth = Truth(theta=tuple(theta.tolist()))
    data = Standardised.of(make_up_problem(N_SIM, N_REAL, world, truth, scales_with_modulus=kind == "factor"))
    parameters = Parameters.of(data, settings)
    if kind == "model":
        true_values = draw_prior(parameters, rng)
        data = draw_outputs(data, parameters, true_values, rng)
        names = parameters.names
    else:
        true_values = np.concatenate(
            [np.zeros(parameters.n_phi + parameters.n_psi - 3), parameters.unconstrained_theta(theta)]
        )
        names = THETA
    samples, steps = sample_joint(data, parameters, settings)
    numbers = [parameters.names.index(name) for name in names]
    r_hat, ess, _ = measure_convergence(names, samples.draws[:, :, numbers])
    rows = np.linspace(0, len(samples.flat) - 1, N_RANKED).round().astype(int)
    ranks = {name: _rank(samples.flat[rows, k], true_values[k]) for name, k in zip(names, numbers, strict=True)}
    if kind == "model":
        density = JointDensity(data, parameters)
        values = np.array([density(row)[0] for row in samples.flat[rows]])
        ranks[LOG_DENSITY] = _rank(values, density(true_values)[0])
    lower, upper = np.quantile(samples.flat[:, numbers], INTERVAL, axis=0)
    return WorldOutcome(
        kind=kind,
        world=world,
        sampler=sampler(kind),
        ranks=ranks,
        inside={n: bool(a <= true_values[k] <= b) for n, k, a, b in zip(names, numbers, lower, upper, strict=True)},
        worst_r_hat=max(r_hat.values()),
        least_ess=min(ess.values()),
        n_divergences=samples.n_divergences,
        cpu_s=round(sum(steps.values()), 2),
    )


def sampler(kind: Kind) -> str:
    """How a world was made and sampled: outcomes of another are not continued."""
    chains = f"{SETTINGS.chains} x ({SETTINGS.tune}+{SETTINGS.draws}) at {SETTINGS.target_accept}"
    return f"{N_SIM}+{N_REAL}, {chains}" + ("" if kind == "model" else f", truths in hypercubes of {HYPERCUBE}")


def _true_theta(kind: Kind, priors: ThetaPriors, world: int) -> tuple[np.ndarray, np.random.Generator]:
    """Theta (3) that a world hides, and the generator that draws what else it needs."""
    rng = np.random.default_rng([world, 7])
    if kind == "model":
        return priors.draw(1, rng)[0], rng
    block, row = divmod(world, HYPERCUBE)
    shares = qmc.LatinHypercube(d=len(THETA), rng=np.random.default_rng([block, 11])).random(HYPERCUBE)
    return priors.quantile(shares[row]), rng


def _rank(draws: np.ndarray, truth: float) -> int:
    return int(np.sum(draws < truth))


def _summary(outcomes: Sequence[WorldOutcome]) -> dict[str, object]:
    return {
        "kind": outcomes[0].kind,
        "worlds": len(outcomes),
        "n_sim": N_SIM,
        "n_real": N_REAL,
        "median_cpu_s": float(np.median([o.cpu_s for o in outcomes])),
        "worlds_with_divergences": sum(o.n_divergences > 0 for o in outcomes),
        "median_least_ess": float(np.median([o.least_ess for o in outcomes])),
        "worst_r_hat": max(o.worst_r_hat for o in outcomes),
    }


def _rank_rows(outcomes: Sequence[WorldOutcome]) -> Rows:
    """Whether ranks are uniform: p-values of chi-square over bins and of Kolmogorov-Smirnov, by parameter."""
    rows: Rows = []
    for name, ranks in _ranks(outcomes):
        rows.append(
            {
                "parameter": name,
                "worlds": len(ranks),
                "mean_rank_percent": 100.0 * float(np.mean((ranks + 0.5) / (N_RANKED + 1))),
                "chi_square_p": float(chisquare(_counts(ranks)).pvalue),
                "ks_p": float(kstest((ranks + 0.5) / (N_RANKED + 1), "uniform").pvalue),
            }
        )
    return rows


def _coverage_rows(outcomes: Sequence[WorldOutcome]) -> Rows:
    rows: Rows = []
    for name in outcomes[0].inside if outcomes else ():
        n_inside = sum(outcome.inside[name] for outcome in outcomes)
        rows.append({"kind": outcomes[0].kind, "parameter": name, "worlds": len(outcomes), "inside_90": n_inside})
    return rows


def _ranks(outcomes: Sequence[WorldOutcome]) -> Iterator[tuple[str, np.ndarray]]:
    for name in outcomes[0].ranks if outcomes else ():
        yield name, np.array([outcome.ranks[name] for outcome in outcomes])


def _counts(ranks: np.ndarray) -> np.ndarray:
    return np.bincount(ranks * N_BINS // (N_RANKED + 1), minlength=N_BINS)


def _draw(path: Path, outcomes: Sequence[WorldOutcome]) -> None:
    """A histogram of ranks a parameter, with the band that holds 95 % of uniform counts."""
    from fast.flows.report.style import BEST, FAINT, figure_style, new_figure

    ranks = list(_ranks(outcomes))
    n_columns = 5
    n_rows = -(-len(ranks) // n_columns)
    low, high = binom.ppf([0.025, 0.975], len(outcomes), 1.0 / N_BINS)
    path.parent.mkdir(parents=True, exist_ok=True)
    with figure_style():
        figure = new_figure(9.0, 1.3 * n_rows)
        axes = figure.subplots(n_rows, n_columns, sharex=True, sharey=True, squeeze=False).ravel()
        for axis, (name, own) in zip(axes, ranks, strict=False):
            axis.axhspan(low, high, color=FAINT)
            axis.bar(np.arange(N_BINS) + 0.5, _counts(own), width=0.9, color=BEST)
            axis.set_title(name, fontsize=6)
            axis.set_xticks([0, N_BINS], ["0", "1"])
        for axis in axes[len(ranks) :]:
            axis.set_visible(False)
        figure.supxlabel("rank of the truth among posterior draws")
        figure.supylabel("worlds")
        figure.savefig(path, dpi=160)
