"""How far a calibration can be trusted beyond its draws: designs left out or held out, and which inputs matter.

Leaving a design out would need one calibration per design; instead the draws of the one calibration are reweighted by
1 / p(y_i | all others, draw), Pareto-smoothed (Vehtari et al. 2017; Buerkner et al. 2021 for processes). Their Pareto k
tells where that is not enough.

An inverse lengthscale says how fast a process bends along an input, and overrates inputs that bend it without moving
it far (Paananen et al. 2019). The relevance here is the share of the variance of the posterior mean f that is lost
when an input is known no more:

    R_j = E[(f(z) - f(z with column j permuted))^2] / (2 Var f(z)).

For independent inputs it is the total Sobol index (Jansen 1999), and the VAR relevance of Paananen et al. averaged over
the data; shares add up to more than 1 where inputs act together.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from fast.models.calibration.inference.result import CalibrationResult
from fast.models.calibration.means.predict import N_DRAWS, DrawnModel, Mixture, condition_models
from fast.models.calibration.means.problem import CalibrationProblem
from fast.models.calibration.means.reweight import smooth_weights
from fast.models.ids import seed_from

BLOCK = 5  # one design of each five is held out
MIN_BLOCKS = 2  # with fewer designs than these blocks hold, all are needed to learn from
MIN_CORRELATED = 3  # a correlation of two points is 1 or -1
N_POINTS = 256


@dataclass(frozen=True, eq=False)
class CalibrationChecks:
    """Checks of a calibration at its m measured designs; draws are the thinned ones.

    before: simulated at the theta before calibration. after: simulated at theta, inferred without the design.
    predicted: measured force expected from all other designs. k_hat: Pareto k of leaving a design out, m.
    discrepancy: what the calibrated simulator misses at the measured designs, learned from all of them.
    relevance_h, relevance_e: permutation relevance of the inputs, draws x d and draws x 9.
    """

    before: Mixture
    after: Mixture
    predicted: Mixture
    k_hat: np.ndarray
    discrepancy: Mixture
    relevance_h: np.ndarray
    relevance_e: np.ndarray


def check_calibration(
    problem: CalibrationProblem, result: CalibrationResult, theta_before: np.ndarray, n_draws: int = N_DRAWS
) -> CalibrationChecks:
    """Do all checks in one pass over thinned draws. theta_before: 3, physical."""
    rng = np.random.default_rng(result.settings.seed)
    parts = [_at_draw(model, problem.x_real, theta_before, rng) for model in condition_models(problem, result, n_draws)]
    before, after, left_out, discrepancy = (
        Mixture.equal(*(np.array([part[place][side] for part in parts]) for side in (0, 1))) for place in range(4)
    )
    weights, k_hat = _left_out_weights(left_out, problem.y_real)
    return CalibrationChecks(
        before=before,
        after=after.reweighted(weights),
        predicted=left_out.reweighted(weights),
        k_hat=k_hat,
        discrepancy=discrepancy,
        relevance_h=np.array([part[4] for part in parts]),
        relevance_e=np.array([part[5] for part in parts]),
    )


def _at_draw(model: DrawnModel, x: np.ndarray, theta_before: np.ndarray, rng: np.random.Generator) -> tuple:
    return (
        model.simulated(x, theta_before),
        model.simulated(x),
        model.leave_one_out(),
        model.discrepancy(x),
        measure_emulator_relevance(model, rng),
        measure_relevance(model.discrepancy_mean, model.emulator.data.x_real, rng),
    )


def _left_out_weights(left_out: Mixture, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the weights of the draws without each measurement, draws x m, and their Pareto k, m."""
    log_weights = np.log(left_out.sds) + 0.5 * ((y - left_out.means) / left_out.sds) ** 2
    smoothed = [smooth_weights(column) for column in log_weights.T]
    return np.column_stack([weights for weights, _ in smoothed]), np.array([k_hat for _, k_hat in smoothed])


def measure_relevance(
    predict: Callable[[np.ndarray], np.ndarray], inputs: np.ndarray, rng: np.random.Generator
) -> np.ndarray:
    """Measure the relevance of each column of `inputs` (n x d) for a function of them that returns n values, d."""
    values = predict(inputs)
    spread = float(np.var(values))
    relevance = np.zeros(inputs.shape[1])
    if spread <= 0:
        return relevance
    for column in range(inputs.shape[1]):
        shuffled = inputs.copy()
        # A shift in a random order leaves no row in its place.
        order = rng.permutation(len(inputs))
        shuffled[order, column] = inputs[np.roll(order, 1), column]
        relevance[column] = 0.5 * np.mean((values - predict(shuffled)) ** 2) / spread
    return relevance


def measure_emulator_relevance(model: DrawnModel, rng: np.random.Generator) -> np.ndarray:
    """Measure relevance of the simulator's inputs at up to `N_POINTS` simulations, d: nine of a design, then theta."""
    z = model.emulator.data.z_sim
    points = z[rng.permutation(len(z))[:N_POINTS]]
    return measure_relevance(model.emulator.mean, points, rng)


@dataclass(frozen=True)
class Score:
    """Predicted against measured mean peak forces. `correlation`: Pearson's, None of fewer than three designs."""

    correlation: float | None
    rmse_n: float


def is_held_out(groups: list[str], seed: int) -> np.ndarray:
    """Return the mask (m) of the held-out designs; `groups`: what each measurement is of, oldest first.

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
    """Compute correlation and root mean square error of predictions (m) of measured forces (m), N."""
    rmse_n = float(np.sqrt(np.mean((predicted_n - measured_n) ** 2)))
    can_correlate = len(measured_n) >= MIN_CORRELATED and min(np.ptp(predicted_n), np.ptp(measured_n)) > 0
    return Score(float(np.corrcoef(predicted_n, measured_n)[0, 1]) if can_correlate else None, rmse_n)
