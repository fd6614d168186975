"""How well theta is known from traces, over worlds that are not the simulator.

A world is a finer mesh, another contact law, misplaced objects, prints that scatter and sensor noise.
"""

import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fast.models.calibration.inference.result import CalibrationResult
from fast.models.calibration.inference.settings import CalibrationSettings
from fast.models.calibration.means.problem import THETA
from fast.models.calibration.traces.response_surface import ResponseSurfaces
from fast.models.calibration.traces.theta_grid import GRID_MODULUS_MPA, ThetaGrid
from fast.models.design.space import numbered_design
from fast.models.gap.bank.sensor_effects import N_LEAD
from fast.models.gap.bank.surrogate import Surrogate
from fast.models.gap.data import GapData
from fast.models.gap.fit.theta import calibrate_theta, make_grid_bank, of_bench
from fast.models.gap.grasps import Grasps, of_one_setup
from fast.models.records import GraspContext, Theta, Trace
from fast.models.traces.step_features import FEATURES, N_STEPS, PEAK, features_of_steps, step_means
from fast.models.traces.step_noise import SensorNoise
from tests.studies.benchmarks.base import Options, Tables
from tests.studies.calibration.trace_bank import SETUP, Bank, BankJob, bank_jobs, fill_bank

N_DESIGNS, OBJECTS = 10, (1, 6, 14, 25, 28, 30, 32, 34)
N_WORLDS = 40
N_REPEATS = 3
TRUTHS = ((9.2, 0.62, 0.43), (7.0, 0.45, 0.36), (12.5, 0.85, 0.4), (10.5, 0.52, 0.46))
TOOL_SD, REPEAT_SD = 0.04, 0.01
NOISE = SensorNoise(sd_n=0.12, correlation_s=0.05, rate_hz=80.0)
SAMPLING = CalibrationSettings(chains=2, draws=400, tune=200, workers=1)


@dataclass(frozen=True, eq=False)
class Answer:
    """What is made of a world whose theta is known."""

    theta: tuple[float, float, float]
    simulator: CalibrationResult
    bench: CalibrationResult
    cpu_s: float


def measure_calibration_traces(options: Options) -> Tables:
    """How well theta is known from traces: errors, widths, coverage of the intervals of simulator and bench, cost."""
    designs, objects = range(options.designs or N_DESIGNS), options.objects or OBJECTS
    truths = [_bank_theta(friction, ratio) for _, friction, ratio in TRUTHS]
    bank = fill_bank(bank_jobs(designs, objects, ThetaGrid(), truths), options)
    simulated_n = _simulated_steps(bank, designs, objects)
    answers: list[Answer] = []
    for world in range(options.worlds or N_WORLDS):
        theta = TRUTHS[world % len(TRUTHS)]
        answers.append(_answer(theta, make_training(bank, simulated_n, designs, objects, theta, world)))
        options.tell(f"world {world}: {_short(answers[-1])}")
    if options.figure is not None:
        _draw(options.figure, answers[0])
    return {
        "how well theta is known": [_row(answers, of) for of in ("simulator", "bench")],
        "surfaces": [_surface_row(simulated_n, bank)],
    }


def make_training(
    bank: Bank,
    simulated_n: np.ndarray,
    designs: Sequence[int],
    objects: Sequence[int],
    theta: tuple[float, float, float],
    world: int,
) -> Surrogate:
    """The training problem of a world: its measured grasps, and the simulations (t x o x g x 120) around them."""
    rng = np.random.default_rng([world, 11])
    places: list[tuple[int, int]] = []
    steps_n: list[np.ndarray] = []
    for t, design in enumerate(designs):
        scale = theta[0] / GRID_MODULUS_MPA * np.exp(TOOL_SD * rng.standard_normal())
        for o, object_id in enumerate(objects):
            true = bank.trace(BankJob(kind="true", design=design, object_id=object_id, theta=_bank_theta(*theta[1:])))
            if true is not None:
                places += [(t, o)] * N_REPEATS
                steps_n += [step_means(_measure(true, scale, rng)) for _ in range(N_REPEATS)]
    tool, obj = np.array(places).T
    grasps = Grasps(
        tools=tuple(f"T{design:02d}" for design in designs),
        designs=tuple(numbered_design(design) for design in designs),
        objects=tuple(objects),
        tool=tool,
        obj=obj,
        contexts=(GraspContext(),) * len(places),
        steps_n=np.array(steps_n),
        grasp_ids=tuple(f"g{number}" for number in range(len(places))),
        noise=NOISE,
        **of_one_setup(len(places), SETUP),
    )
    # Samples of the bank have no times: the force before the lift is taken to be that at its start.
    grid_bank = make_grid_bank(grasps.cells, simulated_n, np.repeat(simulated_n[..., :1], N_LEAD, axis=-1))
    return GapData.of_all(grasps, grid_bank).training


def _simulated_steps(bank: Bank, designs: Sequence[int], objects: Sequence[int]) -> np.ndarray:
    """Step means of the grid, t x o x g x 120; NaN where a simulation failed."""
    points = ThetaGrid().points
    found = np.full((len(designs), len(objects), len(points), N_STEPS), np.nan)
    for t, design in enumerate(designs):
        for o, object_id in enumerate(objects):
            for g, point in enumerate(points):
                job = BankJob(kind="simulated", design=design, object_id=object_id, theta=_bank_theta(*point))
                trace = bank.trace(job)
                if trace is not None:
                    found[t, o, g] = step_means(trace)
    return found


def _answer(theta: tuple[float, float, float], training: Surrogate) -> Answer:
    started = time.process_time()
    result = calibrate_theta(training, SAMPLING)
    cpu_s = time.process_time() - started
    return Answer(theta, result, of_bench(result, training.bank.grid), cpu_s)


def _bank_theta(friction: float, poisson_ratio: float) -> Theta:
    return Theta(young_modulus_mpa=GRID_MODULUS_MPA, friction=friction, poisson_ratio=poisson_ratio)


def _measure(true: Trace, scale: float, rng: np.random.Generator) -> Trace:
    """What the load cell reads of a true trace: its scatter from grasp to grasp and its noise at every reading."""
    is_lift = true.is_lift
    step_mm = SETUP.lift_speed_mm_per_s / NOISE.rate_hz
    lift_mm = np.arange(0.0, true.lift_mm[-1] + step_mm, step_mm)
    factor = scale * np.exp(REPEAT_SD * rng.standard_normal())
    force_n = factor * np.interp(lift_mm, true.lift_mm[is_lift], true.force_n[is_lift])
    return Trace(lift_mm / SETUP.lift_speed_mm_per_s, lift_mm, force_n + _ar1_noise(len(lift_mm), rng))


def _ar1_noise(n: int, rng: np.random.Generator) -> np.ndarray:
    """Sensor noise of n readings, in N."""
    from scipy.signal import lfilter

    r = np.exp(-1.0 / (NOISE.rate_hz * NOISE.correlation_s))
    draws = rng.standard_normal(n)
    draws[1:] *= np.sqrt(1.0 - r * r)
    return np.asarray(NOISE.sd_n * lfilter([1.0], [1.0, -r], draws))


def _row(answers: Sequence[Answer], of: str) -> dict[str, float | str]:
    """Over worlds: mean sd and width of the 90 % interval, bias and RMS error of the median, share with the truth."""
    results: list[CalibrationResult] = [getattr(answer, of) for answer in answers]
    truth = np.array([answer.theta for answer in answers])
    draws = [result.flat(*THETA) for result in results]
    low, median, high = np.swapaxes([np.quantile(rows, (0.05, 0.5, 0.95), axis=0) for rows in draws], 0, 1)
    error, inside = median - truth, (low <= truth) & (truth <= high)
    row: dict[str, float | str] = {"theta of": of, "worlds": len(answers)}
    for place, name in enumerate(THETA):
        row[f"{name}_sd"] = float(np.mean([rows[:, place].std() for rows in draws]))
        row[f"{name}_width_90"] = float((high - low)[:, place].mean())
        row[f"{name}_bias"] = float(error[:, place].mean())
        row[f"{name}_error"] = float(np.sqrt(np.mean(error[:, place] ** 2)))
        row[f"{name}_in_90"] = float(inside[:, place].mean())
    row["correlation_log_e_log_friction"] = float(np.mean([np.corrcoef(np.log(r[:, :2]).T)[0, 1] for r in draws]))
    row["r_hat"] = max(result.r_hat[name] for result in results for name in THETA)
    row["ess_bulk"] = min(result.ess_bulk[name] for result in results for name in THETA)
    row["divergences"] = sum(result.n_divergences for result in results)
    row["cpu_s"] = float(np.mean([answer.cpu_s for answer in answers]))
    return row


def _surface_row(simulated_n: np.ndarray, bank: Bank) -> dict[str, float]:
    """How well the response surfaces predict simulations that were left out, and what the bank cost."""
    with np.errstate(invalid="ignore"):
        features = features_of_steps(simulated_n)
    is_known = np.isfinite(simulated_n[..., 0]).all(axis=2)
    is_force = np.ones(len(FEATURES), dtype=bool)
    grid = np.array(ThetaGrid().points)
    surfaces = ResponseSurfaces.fitted(grid, features, is_known, GRID_MODULUS_MPA, is_force)
    first = FEATURES.index(PEAK)
    sd = np.sqrt(np.diagonal(surfaces.error, axis1=2, axis2=3))[is_known][:, :first]
    share = 100.0 * sd / np.abs(features[..., first]).max(axis=2)[is_known][:, None]
    return {
        "cells": int(is_known.sum()),
        "simulations": int(np.isfinite(simulated_n[..., 0]).sum()),
        "left_out_error_percent_of_largest_peak": float(np.median(share)),
        "p90_percent": float(np.quantile(share, 0.9)),
        "bank_cpu_s": bank.cpu_s,
    }


def _short(answer: Answer) -> str:
    draws = answer.bench.flat(*THETA)
    return " ".join(f"{m:.3f}({s:.3f})" for m, s in zip(np.median(draws, axis=0), draws.std(axis=0), strict=True))


def _draw(path: Path, answer: Answer) -> None:
    """Young's modulus against friction: draws of both thetas in one world, and its truth."""
    from fast.flows.report.style import BEST, INK, MUTED, figure_style, new_axes

    path.parent.mkdir(parents=True, exist_ok=True)
    with figure_style():
        figure, axes = new_axes(4.8, 3.6, grid="both")
        for result, colour, label in (
            (answer.bench, MUTED, "of the bench"),
            (answer.simulator, BEST, "of the simulator"),
        ):
            draws = result.flat(*THETA[:2])
            axes.plot(*draws.T, ".", color=colour, markersize=2.5, alpha=0.5, label=label, markeredgewidth=0)
        axes.plot(*answer.theta[:2], "+", color=INK, markersize=12, markeredgewidth=1.5, label="truth")
        axes.set_xlabel("Young's modulus (MPa)")
        axes.set_ylabel("friction")
        handles: Any = figure.legend(loc="outside right upper").legend_handles
        for handle in handles[:2]:
            handle.set_markersize(7)
        figure.savefig(path, dpi=160)
