"""Where to simulate for a calibration on means: all in a hypercube, or a part at the measured designs.

The same number of simulations both ways, in closed-form worlds whose forces are proportional to Young's modulus, with
and without a discrepancy. Compared are modes of the posterior given the best emulator, which cost a second each; the
log density at the truth below the mode is half a chi-square of three degrees of freedom if the posterior is honest.
"""

import time
from typing import NamedTuple

import numpy as np

from flows.benchmarks.base import Options, Rows, Tables
from models.blas import one_blas_thread
from models.calibration.inference.optimise import climb
from models.calibration.inference.settings import CalibrationSettings
from models.calibration.means import psi_density
from models.calibration.means.factorised import factorise_at
from models.calibration.means.joint_nuts import guess_starts
from models.calibration.means.problem import CalibrationProblem, Standardised
from models.calibration.means.synthetic import Truth, make_up_problem, with_measured_designs

N_WORLDS = 20
N_REAL, N_THETAS, N_SIM = 16, 4, 264
WAYS = ("all in a hypercube", f"{N_THETAS} at each measured design")
DISCREPANCIES = (0.0, 0.3)
DROP_90 = 3.13  # half the 90 % quantile of chi-square with three degrees of freedom


class Found(NamedTuple):
    """One world one way: mode over truth of E and friction (logarithms), log density lost at the truth, CPU seconds."""

    log_modulus: float
    log_friction: float
    drop: float
    cpu_s: float


def measure_calibration_designs(options: Options) -> Tables:
    """Error of the mode of theta, and density at the truth, for two ways to spend the same simulations."""
    rows: Rows = []
    for discrepancy in DISCREPANCIES:
        found: dict[str, list[Found]] = {way: [] for way in WAYS}
        for world in range(options.worlds or N_WORLDS):
            truth = truth_of(world, discrepancy)
            for way, problem in zip(WAYS, problems_of(world, truth), strict=True):
                found[way].append(find(problem, truth))
            options.tell(f"discrepancy {discrepancy:g}, world {world}: " + _short(found))
        rows += [_row(discrepancy, way, found[way]) for way in WAYS]
    return {"modes": rows}


def truth_of(world: int, discrepancy: float) -> Truth:
    """What a world hides: theta well inside the prior, and how much of the discrepancy of `synthetic` there is."""
    rng = np.random.default_rng([world, 5])
    theta = (float(np.exp(rng.uniform(np.log(5), np.log(20)))), rng.uniform(0.35, 0.9), rng.uniform(0.25, 0.45))
    return Truth(theta=theta, discrepancy=discrepancy)


def problems_of(world: int, truth: Truth) -> tuple[CalibrationProblem, CalibrationProblem]:
    """The same measurements with simulations in the order of `WAYS`."""
    in_hypercube = make_up_problem(N_SIM, N_REAL, world, truth, scales_with_modulus=True)
    fewer = make_up_problem(N_SIM - N_REAL * N_THETAS, N_REAL, world, truth, scales_with_modulus=True)
    same = with_measured_designs(fewer, N_THETAS, world)
    return in_hypercube, same


def find(problem: CalibrationProblem, truth: Truth) -> Found:
    """Mode of the posterior given the emulator's best parameters, and the best density with theta at the truth."""
    from models.calibration.means import emulator
    from models.calibration.means.parameters import ParameterVector
    from models.calibration.means.psi_density import Setting

    started = time.process_time()
    data = Standardised.of(problem)
    setting = Setting.of(data, ParameterVector.of(data, CalibrationSettings()))
    parameters = setting.parameters
    with one_blas_thread():
        factor = factorise_at(emulator.find_mode(data, parameters, seed=0).values, setting)
        guesses = [guess[parameters.n_phi :] for guess in guess_starts(parameters)]
        best = climb(lambda psi: psi_density.log_posterior(psi, factor, setting), guesses)[0]
        true = parameters.unconstrained_theta(np.array(truth.theta))

        def at_truth(rest: np.ndarray) -> tuple[float, np.ndarray]:
            value, gradient = psi_density.log_posterior(np.concatenate([rest, true]), factor, setting)
            return value, gradient[:-3]

        held = climb(at_truth, [best.vector[:-3]])[0]
    off = best.vector[-3:] - true
    return Found(float(off[0]), float(off[1]), best.value - held.value, time.process_time() - started)


def _row(discrepancy: float, way: str, found: list[Found]) -> dict[str, object]:
    values = np.array(found)
    rms = np.sqrt(np.mean(values**2, axis=0))
    return {
        "discrepancy": discrepancy,
        "simulations": way,
        "worlds": len(found),
        "log_modulus_bias": float(values[:, 0].mean()),
        "log_modulus_rmse": float(rms[0]),
        "log_friction_bias": float(values[:, 1].mean()),
        "log_friction_rmse": float(rms[1]),
        "truth_in_90": int(np.sum(values[:, 2] < DROP_90)),
        "cpu_s": float(np.median(values[:, 3])),
    }


def _short(found: dict[str, list[Found]]) -> str:
    return ", ".join(f"{way} {own[-1].log_modulus:+.2f}, {own[-1].log_friction:+.2f}" for way, own in found.items())
