"""How much of the gap anything could explain: boosted trees on all that is known of a grasp.

The ceiling against which a named effect is held. It knows designs, object sizes, the phase of the lift, repeats, order
and the simulated force, and is scored on designs and object classes that it has not seen.
"""

from dataclasses import dataclass

import numpy as np

from models.gap.bank.features import FEATURES
from models.gap.fit.fit import Fit
from models.gap.groups import design_folds, object_folds
from models.gap.naming.flexible import inputs_of

N_FOLDS = 4
_CLIP_SD = 6.0  # of the residuals that trees learn from
_TREES = {"max_iter": 40, "learning_rate": 0.1, "max_leaf_nodes": 8, "min_samples_leaf": 40, "l2_regularization": 5.0}


@dataclass(frozen=True, eq=False)
class Ceiling:
    """r2: of the residual's squares, the smaller of left-out designs and classes.

    predicted, predicted_classes: m x f, for left-out designs and classes, whitened.
    """

    r2: float
    predicted: np.ndarray
    predicted_classes: np.ndarray


def ceiling(fit: Fit) -> Ceiling:
    """Trees grown on the residual of a fit, grouped by design and by object class."""
    grasps = fit.working.predictor.grasps
    inputs = _inputs(fit)
    by_design = _left_out(fit, inputs, design_folds(grasps, N_FOLDS))
    by_class = _left_out(fit, inputs, object_folds(grasps, N_FOLDS))
    total = float((fit.residual**2).sum())
    r2 = min(1.0 - float(((fit.residual - part * fit.weight) ** 2).sum()) / total for part in (by_design, by_class))
    return Ceiling(r2, by_design, by_class)


def _left_out(fit: Fit, inputs: np.ndarray, folds: np.ndarray) -> np.ndarray:
    """Predictions for rows by trees that have not seen their fold, m x f, whitened."""
    # Its import takes seconds, and few commands need it.
    from sklearn.ensemble import HistGradientBoostingRegressor

    data = fit.working
    sd = _standard_deviations(fit)
    found = data.measured - fit.modelled
    target = np.clip(found / sd, -_CLIP_SD, _CLIP_SD)
    predicted = np.zeros_like(target)
    for fold in np.unique(folds):
        is_out = folds == fold
        trees = HistGradientBoostingRegressor(early_stopping=False, random_state=0, **_TREES)
        trees.fit(inputs[~is_out].reshape(-1, inputs.shape[-1]), target[~is_out].ravel())
        predicted[is_out] = trees.predict(inputs[is_out].reshape(-1, inputs.shape[-1])).reshape(-1, len(FEATURES))
    return data.whitened(predicted * sd)


def _standard_deviations(fit: Fit) -> np.ndarray:
    """Of each feature of a single grasp about as far as its cell is known, m x f."""
    sd = np.zeros_like(fit.residual)
    for places in fit.working.cells:
        covariance = np.linalg.inv(_gram(fit.working.whiteners[places[:, 0]]))
        sd[places] = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2) / places.shape[1])[:, None]
    return sd


def _gram(whiteners: np.ndarray) -> np.ndarray:
    return np.swapaxes(whiteners, -1, -2) @ whiteners


def _inputs(fit: Fit) -> np.ndarray:
    """All that is known of each feature of each grasp, m x f x inputs."""
    of_grasp = inputs_of(fit.working.predictor.grasps)
    m, f = fit.residual.shape
    wide = np.broadcast_to(of_grasp[:, None], (m, f, of_grasp.shape[1]))
    phase = np.broadcast_to(np.arange(f, dtype=float)[None, :, None], (m, f, 1))
    simulated = np.stack([fit.modelled, fit.modelled / fit.working.amplitude, fit.working.amplitude], axis=-1)
    return np.concatenate([wide, phase, simulated], axis=-1)
