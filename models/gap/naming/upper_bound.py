"""The explainable upper bound: how much of a gap anything could explain that does not ask why.

Two models know all that is known of a grasp: its design, sizes of the object, repeats and order, the phase of the lift
and the simulated force. A ridge discrepancy is linear in them, phase by phase, at two strengths of the ridge; its
columns join those of a fit, so that it is scored as an effect is. Boosted trees need no such form. Both are scored on
designs and object classes that they have not seen, and name nothing.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from models.design.space import to_unit
from models.gap.bank.surrogate import FEATURES
from models.gap.fit.fit import Fit
from models.gap.fit.whitened_features import IS_LIFT
from models.gap.grasps import Grasps, assign_design_folds, assign_object_folds
from models.objects.catalogue import get_object
from models.objects.primitives import bounds

COEFFICIENT_SDS = (0.006, 0.0015)  # of the amplitude, for one standard deviation of an input: two strengths
N_FOLDS = 4
_CLIP_SD = 6.0  # of the residuals that trees learn from
_TREES = {"max_iter": 40, "learning_rate": 0.1, "max_leaf_nodes": 8, "min_samples_leaf": 40, "l2_regularization": 5.0}


def add_ridge_discrepancy(fit: Fit) -> Sequence[Fit]:
    """The fit with columns of the ridge discrepancy added, at both strengths of the ridge."""
    columns = fit.features.whiten(_columns(fit)) * fit.weight
    nothing = np.zeros(len(columns))
    return [
        replace(
            fit,
            columns=np.concatenate([fit.columns, columns]),
            precision=np.concatenate([fit.precision, np.full(len(columns), sd**-2.0)]),
            pull=np.concatenate([fit.pull, nothing]),
        )
        for sd in COEFFICIENT_SDS
    ]


def bound_with_trees(fit: Fit) -> tuple[np.ndarray, np.ndarray]:
    """Predict the residual of a fit by trees: for left-out designs and for left-out classes, whitened, m x f each."""
    grasps = fit.features.surrogate.grasps
    inputs = _inputs(fit)
    by_design = _predict_left_out(fit, inputs, assign_design_folds(grasps, N_FOLDS))
    return by_design, _predict_left_out(fit, inputs, assign_object_folds(grasps, N_FOLDS))


def describe_grasps(grasps: Grasps) -> np.ndarray:
    """What is known of each grasp besides its simulation, standardised, m x inputs, less what never varies.

    Nine design parameters; sizes of the object along x, y, z and its edge radius; whether it is a repeat, which one;
    grasps of the tool before, of the batch before.
    """
    sizes = []
    for number in grasps.objects:
        obj = get_object(number)
        low, high = bounds(obj.primitives)
        sizes.append([*(high - low), obj.parameters.get("rounding_mm", 0.0)])
    order = [[min(c.repeat, 1), c.repeat, c.tool_grasps, c.batch_grasps] for c in grasps.contexts]
    rows = np.concatenate(
        [to_unit(grasps.designs)[grasps.tool], np.array(sizes)[grasps.obj], np.array(order, float)], axis=1
    )
    sd = rows.std(axis=0)
    return np.asarray(((rows - rows.mean(axis=0)) / np.maximum(sd, 1e-12))[:, sd > 1e-9])


def _columns(fit: Fit) -> np.ndarray:
    """Columns (c x m x f), in the units of the features: responses of the force, and phases, times inputs."""
    known = describe_grasps(fit.features.surrogate.grasps)
    inputs = np.concatenate([np.ones((len(known), 1)), known], axis=1).T
    responses = np.concatenate([_responses(fit), _phases(fit)])
    return np.asarray((responses[:, None] * inputs[None, :, :, None]).reshape(-1, *responses.shape[1:]))


def _responses(fit: Fit) -> np.ndarray:
    """What a force may answer with at every phase, r x m x f: curved in itself, its slope over the lift, a constant."""
    force, amplitude = np.where(IS_LIFT, 0.0, fit.modelled), fit.features.amplitude
    slope = np.where(IS_LIFT, 0.0, np.gradient(force, axis=1))
    constant = np.where(IS_LIFT, 0.0, np.full_like(force, np.median(amplitude)))
    return np.stack([force, force * np.abs(force) / amplitude, slope, constant])


def _phases(fit: Fit) -> np.ndarray:
    """The amplitude of each feature by itself, f x m x f."""
    f = fit.modelled.shape[1]
    return np.eye(f)[:, None, :] * fit.features.amplitude[None]


def _predict_left_out(fit: Fit, inputs: np.ndarray, folds: np.ndarray) -> np.ndarray:
    """Predictions for rows by trees that have not seen their fold, m x f, whitened."""
    # Its import takes seconds, and few commands need it.
    from sklearn.ensemble import HistGradientBoostingRegressor

    features = fit.features
    sd = _standard_deviations(fit)
    found = features.measured - fit.modelled
    target = np.clip(found / sd, -_CLIP_SD, _CLIP_SD)
    predicted = np.zeros_like(target)
    for fold in np.unique(folds):
        is_out = folds == fold
        trees = HistGradientBoostingRegressor(early_stopping=False, random_state=0, **_TREES)
        trees.fit(inputs[~is_out].reshape(-1, inputs.shape[-1]), target[~is_out].ravel())
        predicted[is_out] = trees.predict(inputs[is_out].reshape(-1, inputs.shape[-1])).reshape(-1, len(FEATURES))
    return features.whiten(predicted * sd)


def _standard_deviations(fit: Fit) -> np.ndarray:
    """Of each feature of a single grasp about as far as its cell is known, m x f."""
    sd = np.zeros_like(fit.residual)
    for places in fit.features.cells:
        covariance = np.linalg.inv(_gram(fit.features.whiteners[places[:, 0]]))
        sd[places] = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2) / places.shape[1])[:, None]
    return sd


def _gram(whiteners: np.ndarray) -> np.ndarray:
    return np.swapaxes(whiteners, -1, -2) @ whiteners


def _inputs(fit: Fit) -> np.ndarray:
    """All that is known of each feature of each grasp, m x f x inputs."""
    of_grasp = describe_grasps(fit.features.surrogate.grasps)
    m, f = fit.residual.shape
    wide = np.broadcast_to(of_grasp[:, None], (m, f, of_grasp.shape[1]))
    phase = np.broadcast_to(np.arange(f, dtype=float)[None, :, None], (m, f, 1))
    simulated = np.stack([fit.modelled, fit.modelled / fit.features.amplitude, fit.features.amplitude], axis=-1)
    return np.concatenate([wide, phase, simulated], axis=-1)
