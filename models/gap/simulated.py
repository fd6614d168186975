"""Another simulator's forces as the prediction: what they miss, in the words of this one.

Its forces are first fitted as if they were measured: that is where in theta it stands. Then what is measured less what
it predicts is put on top of what this simulator predicts there. Effects, variants and errors are those of the bank, so
what may be missing is told as ever, and a theta that moves from there is one that the other simulator should have.
"""

from dataclasses import dataclass, replace

import numpy as np

from fast.models.gap.data import GapData
from fast.models.gap.evidence.likelihood import EvidenceFit, Problem, fit_evidence
from fast.models.gap.evidence.reading import compute_rms


@dataclass(frozen=True, eq=False)
class Beside:
    """Measured grasps as they are beside another simulator. theta: 3, of this simulator where it is most like that.

    apart: what the two differ by there, root mean square, as a share of the force. factor: the measured forces over
    those of the other simulator, by their root mean squares.
    """

    data: GapData
    theta: np.ndarray
    apart: float
    factor: float


def stand_beside(data: GapData, simulated_n: np.ndarray) -> Beside:
    """Put the grasps of `data` beside forces that another simulator predicts of them (n x 120)."""
    rows = np.flatnonzero(np.isfinite(simulated_n).all(axis=1))
    grasps = data.grasps.select(rows)
    own = replace(data, grasps=replace(grasps, steps_n=simulated_n[rows]))
    fit = fit_evidence(Problem.of(own.usable))
    nearest_n = _predict(fit, own)
    known = np.isfinite(nearest_n).all(axis=1)
    apart = compute_rms(own.grasps.steps_n[known] - nearest_n[known]) / compute_rms(nearest_n[known])
    steps_n = grasps.steps_n - simulated_n[rows] + nearest_n
    factor = compute_rms(grasps.steps_n) / compute_rms(simulated_n[rows])
    return Beside(replace(data, grasps=replace(grasps, steps_n=steps_n)), fit.theta, apart, factor)


def _predict(fit: EvidenceFit, data: GapData) -> np.ndarray:
    """Predict the step means of every grasp at a fit, n x 120."""
    factor = np.exp(fit.moduli)[data.grasps.tool][:, None]
    return np.asarray(factor * data.surrogate.predict_steps(fit.theta, ()))
