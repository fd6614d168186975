"""How much better theta is known from traces than from peaks, and from peaks than from the means of designs.

Measured grasps are those of a world that does not share the simulator's mesh nor its law of contact: made once for
each of four thetas, then given a modulus, scatter from print to print and grasp to grasp, and sensor noise.
"""

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from flows.benchmarks.base import Options, Tables
from models.calibration.inference.result import CalibrationResult
from models.calibration.inference.settings import CalibrationSettings
from models.calibration.traces.assemble import Cell, GridPoint, trace_problem
from models.calibration.traces.calibrate import (
    calibrate_traces,
    laplace,
    spread_outliers,
    trace_density,
    with_numerical_shift,
)
from models.calibration.traces.problem import TraceProblem
from models.calibration.traces.response_surface import ResponseSurfaces
from models.calibration.traces.theta_grid import ThetaGrid
from models.records import Theta, Trace
from models.traces.step_features import PEAK
from models.traces.step_noise import SensorNoise
from tests.studies.calibration.trace_bank import SETUP, Bank, BankJob, bank_jobs, fill_bank

N_DESIGNS, OBJECTS = 10, (1, 6, 14, 25, 28, 30, 32, 34)
N_WORLDS, N_DRAWS = 40, 4000
N_REPEATS = 3
TRUTHS = ((9.2, 0.62, 0.43), (7.0, 0.45, 0.36), (12.5, 0.85, 0.4), (10.5, 0.52, 0.46))
GRID_MODULUS_MPA = 10.0
TOOL_SD, REPEAT_SD = 0.04, 0.01
NOISE = SensorNoise(sd_n=0.12, correlation_s=0.05, rate_hz=80.0)
SAMPLING = CalibrationSettings(chains=2, draws=300, tune=150, workers=1)
LEVELS = ("design means", "peaks", "traces")
THETA = ("young_modulus_mpa", "friction", "poisson_ratio")


@dataclass(frozen=True, eq=False)
class Answer:
    """What one level of detail makes of a world: draws of theta (n x 3), of the simulator and of the bench."""

    level: str
    theta: tuple[float, float, float]
    simulator: np.ndarray
    bench: np.ndarray
    cpu_s: float


def measure_calibration_traces(options: Options) -> Tables:
    """How well theta is known from design means, from peaks per object, and from traces, on the same grasps."""
    designs, objects = range(options.designs or N_DESIGNS), options.objects or OBJECTS
    truths = [_bank_theta(friction, ratio) for _, friction, ratio in TRUTHS]
    bank = fill_bank(bank_jobs(designs, objects, ThetaGrid(), truths), options)
    first = _levels(_problem(bank, designs, objects, TRUTHS[0], 0))
    nuts = {level: calibrate_traces(data, SAMPLING, theta_of="simulator") for level, data in first.items()}
    answers: list[Answer] = []
    for world in range(options.worlds or N_WORLDS):
        theta = TRUTHS[world % len(TRUTHS)]
        problems = _levels(_problem(bank, designs, objects, theta, world))
        answers += [_answer(level, theta, data) for level, data in problems.items()]
        options.tell(f"world {world}: " + ", ".join(_short(answer) for answer in answers[-len(LEVELS) :]))
    if options.figure is not None:
        _draw(options.figure, nuts, TRUTHS[0])
    return {
        "how well theta is known": [_level_row(answers, level) for level in LEVELS],
        "NUTS in the first world": [_nuts_row(level, nuts[level], answers) for level in LEVELS],
        "surfaces": [_surface_row(first["traces"], bank)],
    }


def _levels(problem: TraceProblem) -> dict[str, TraceProblem]:
    peaks = problem.only([PEAK])
    return dict(zip(LEVELS, (peaks.mean_over_objects(), peaks, problem), strict=True))


def _answer(level: str, theta: tuple[float, float, float], problem: TraceProblem) -> Answer:
    """The posterior as the normal distribution at its mode: NUTS of every world would take hours."""
    rng, started = np.random.default_rng(0), time.process_time()
    density = spread_outliers(trace_density(problem, SAMPLING.priors))
    best, covariance = laplace(density)
    draws = density.constrained(rng.multivariate_normal(best, covariance, size=N_DRAWS))
    cpu_s = time.process_time() - started
    return Answer(level, theta, draws[:, 3:], with_numerical_shift(draws, density, rng)[:, 3:], cpu_s)


def _bank_theta(friction: float, poisson_ratio: float) -> Theta:
    return Theta(young_modulus_mpa=GRID_MODULUS_MPA, friction=friction, poisson_ratio=poisson_ratio)


def _problem(
    bank: Bank, designs: Sequence[int], objects: Sequence[int], theta: tuple[float, float, float], world: int
) -> TraceProblem:
    rng = np.random.default_rng([world, 11])
    measured: dict[Cell, list[Trace]] = {}
    simulated: dict[Cell, dict[GridPoint, Trace]] = {}
    for design in designs:
        scale = theta[0] / GRID_MODULUS_MPA * np.exp(TOOL_SD * rng.standard_normal())
        for object_id in objects:
            cell, key = (f"T{design:02d}", str(object_id)), {"design": design, "object_id": object_id}
            true = bank.trace(BankJob(kind="true", theta=_bank_theta(*theta[1:]), **key))
            made = {
                point: bank.trace(BankJob(kind="simulated", theta=_bank_theta(*point), **key))
                for point in ThetaGrid().points
            }
            simulated[cell] = {point: trace for point, trace in made.items() if trace is not None}
            if true is not None:
                measured[cell] = [_measured(true, scale, rng) for _ in range(N_REPEATS)]
    return trace_problem(
        measured,
        simulated,
        modulus_mpa=GRID_MODULUS_MPA,
        noise=NOISE,
        lift_speed_mm_per_s=SETUP.lift_speed_mm_per_s,
    )


def _measured(true: Trace, scale: float, rng: np.random.Generator) -> Trace:
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


def _level_row(answers: Sequence[Answer], level: str) -> dict[str, float | str]:
    """Over worlds: mean standard deviation, root mean square error, share of 90 % intervals with the truth."""
    own = [answer for answer in answers if answer.level == level]
    truth = np.array([answer.theta for answer in own])
    error = np.array([answer.simulator.mean(axis=0) for answer in own]) - truth
    low, high = np.swapaxes([np.quantile(answer.bench, (0.05, 0.95), axis=0) for answer in own], 0, 1)
    inside = (low <= truth) & (truth <= high)
    row: dict[str, float | str] = {"data": level, "worlds": len(own)}
    for place, name in enumerate(THETA):
        row[f"{name}_sd"] = float(np.mean([answer.simulator[:, place].std() for answer in own]))
        row[f"{name}_error"] = float(np.sqrt(np.mean(error[:, place] ** 2)))
        row[f"{name}_in_90"] = float(inside[:, place].mean())
    row["correlation_log_e_log_friction"] = float(np.mean([_correlation(answer.simulator) for answer in own]))
    row["cpu_s"] = float(np.mean([answer.cpu_s for answer in own]))
    return row


def _correlation(theta: np.ndarray) -> float:
    return float(np.corrcoef(np.log(theta[:, :2]).T)[0, 1])


def _nuts_row(level: str, result: CalibrationResult, answers: Sequence[Answer]) -> dict[str, float | str]:
    """Standard deviations by NUTS, over those of the normal distribution at the mode."""
    normal = next(answer for answer in answers if answer.level == level)
    theta = result.flat(*THETA)
    row: dict[str, float | str] = {"data": level}
    for place, name in enumerate(THETA):
        row[f"{name}_mean"], row[f"{name}_sd"] = float(theta[:, place].mean()), float(theta[:, place].std())
        row[f"{name}_over_normal"] = float(theta[:, place].std() / normal.simulator[:, place].std())
    row["correlation_log_e_log_friction"] = _correlation(theta)
    row["r_hat"] = max(result.r_hat[name] for name in THETA)
    row["ess_bulk"] = min(result.ess_bulk[name] for name in THETA)
    row["divergences"] = result.n_divergences
    row["cpu_s"] = result.cpu_s
    return row


def _surface_row(problem: TraceProblem, bank: Bank) -> dict[str, float]:
    """How well the response surfaces predict simulations that were left out, and what the bank cost."""
    surfaces = ResponseSurfaces.of(problem)
    sd = np.sqrt(np.diagonal(surfaces.error, axis1=2, axis2=3))
    peak = np.nanmax(np.abs(problem.simulated[..., problem.features.index(PEAK)]), axis=2)
    force_bins = sd[..., : problem.features.index(PEAK)]
    share = 100.0 * force_bins[problem.is_measured] / peak[problem.is_measured][:, None]
    return {
        "cells": int(problem.is_measured.sum()),
        "simulations": int(np.isfinite(problem.simulated[..., 0]).sum()),
        "left_out_error_percent_of_largest_peak": float(np.median(share)),
        "p90_percent": float(np.quantile(share, 0.9)),
        "bank_cpu_s": bank.cpu_s,
    }


def _short(answer: Answer) -> str:
    means, sds = answer.simulator.mean(axis=0), answer.simulator.std(axis=0)
    values = " ".join(f"{mean:.3f}({sd:.3f})" for mean, sd in zip(means, sds, strict=True))
    return f"{answer.level} {values}"


def _draw(path: Path, results: Mapping[str, CalibrationResult], truth: tuple[float, float, float]) -> None:
    """Young's modulus against friction: draws from the three levels of detail in one world, and its truth."""
    from flows.report.style import BEST, FIRST, INK, MUTED, figure_style, new_axes

    path.parent.mkdir(parents=True, exist_ok=True)
    with figure_style():
        figure, axes = new_axes(4.8, 3.6, grid="both")
        for (level, result), colour in zip(results.items(), (MUTED, FIRST, BEST), strict=True):
            draws = result.flat(*THETA[:2])
            axes.plot(*draws.T, ".", color=colour, markersize=2.5, alpha=0.5, label=level, markeredgewidth=0)
        axes.plot(*truth[:2], "+", color=INK, markersize=12, markeredgewidth=1.5, label="truth")
        axes.set_xlabel("Young's modulus (MPa)")
        axes.set_ylabel("friction")
        handles: Any = figure.legend(loc="outside right upper").legend_handles
        for handle in handles[: len(results)]:
            handle.set_markersize(7)
        figure.savefig(path, dpi=160)
