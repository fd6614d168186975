"""Each measured design predicted from all others, before and after calibration, and which inputs matter.

Leaving a design out would need one calibration per design; instead the draws of the one calibration are reweighted by
1 / p(y_i | all others, draw), Pareto-smoothed (Vehtari et al. 2017; Buerkner et al. 2021 for processes). Their Pareto k
tells where that is not enough.
"""

from dataclasses import dataclass

import numpy as np

from models.calibration.inference.importance import smooth
from models.calibration.inference.result import CalibrationResult
from models.calibration.means.mixture import Mixture
from models.calibration.means.predict import N_DRAWS, DrawnModel, drawn_models
from models.calibration.means.problem import CalibrationProblem
from models.calibration.means.relevance import discrepancy_relevance, emulator_relevance


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
    """All checks in one pass over thinned draws. theta_before: 3, physical."""
    rng = np.random.default_rng(result.settings.seed)
    parts = [_at_draw(model, problem.x_real, theta_before, rng) for model in drawn_models(problem, result, n_draws)]
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
        emulator_relevance(model, rng),
        discrepancy_relevance(model, rng),
    )


def _left_out_weights(left_out: Mixture, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Weights of the draws without each measurement, draws x m, and their Pareto k, m."""
    log_weights = np.log(left_out.sds) + 0.5 * ((y - left_out.means) / left_out.sds) ** 2
    smoothed = [smooth(column) for column in log_weights.T]
    return np.column_stack([s.weights for s in smoothed]), np.array([s.k_hat for s in smoothed])
