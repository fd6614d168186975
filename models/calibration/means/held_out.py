"""Designs that a calibration never sees, and how well the simulator predicts them with one theta or another."""

from dataclasses import dataclass

import numpy as np

from models.calibration.inference.result import CalibrationResult
from models.calibration.means.parameters import Phi
from models.calibration.means.predict import Emulator
from models.calibration.means.problem import CalibrationProblem, Standardised
from models.ids import seed_from

BLOCK = 5  # one design of each five is held out
MIN_BLOCKS = 2  # with fewer designs than these blocks hold, all are needed to learn from
MIN_CORRELATED = 3  # a correlation of two points is 1 or -1


@dataclass(frozen=True)
class Score:
    """Predicted against measured mean peak forces. `correlation`: Pearson's, None of fewer than three designs."""

    correlation: float | None
    rmse_n: float


def is_held_out(groups: list[str], seed: int) -> np.ndarray:
    """Mask (m) of the held-out designs; `groups`: what each measurement is of, oldest first.

    One, drawn, of each five designs in the order in which they were first measured. So a design stays on its side when
    more are measured, and the prints of one design are always on the same side. None of fewer than ten designs.
    """
    order = {group: place for place, group in enumerate(dict.fromkeys(groups))}
    if len(order) < BLOCK * MIN_BLOCKS:
        return np.zeros(len(groups), dtype=bool)
    n_blocks = -(-len(order) // BLOCK)
    chosen = {block * BLOCK + seed_from("held-out", seed, block) % BLOCK for block in range(n_blocks)}
    return np.array([order[group] in chosen for group in groups])


def score(predicted_n: np.ndarray, measured_n: np.ndarray) -> Score:
    """Correlation and root mean square error of predictions (m) of measured forces (m), N."""
    rmse_n = float(np.sqrt(np.mean((predicted_n - measured_n) ** 2)))
    can_correlate = len(measured_n) >= MIN_CORRELATED and min(np.ptp(predicted_n), np.ptp(measured_n)) > 0
    return Score(float(np.corrcoef(predicted_n, measured_n)[0, 1]) if can_correlate else None, rmse_n)


def emulate(problem: CalibrationProblem, result: CalibrationResult, x: np.ndarray, theta: np.ndarray) -> np.ndarray:
    """Mean peak force that the simulator would give, by the calibration's emulator with median hyperparameters.

    x: m x 9 designs in the unit cube. theta: 3, in physical units. Returns m, N, without discrepancy and rho: what
    `SimulatorVersion` with this theta predicts.
    """
    lengthscale_names = [name for name in result.names if name.startswith("lengthscale_h.")]
    lengthscales = np.median(result.flat(*lengthscale_names), axis=0)
    sd, nugget = np.median(result.flat("sd_h", "nugget"), axis=0)
    emulator = Emulator.condition(Standardised.of(problem), Phi(lengthscales, float(sd), float(nugget)))
    return emulator.simulated(x, theta)[0]
