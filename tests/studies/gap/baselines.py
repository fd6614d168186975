"""What closes a gap without knowing its name: the paper's discrepancy and a black-box residual, on the same split.

Both learn measured minus predicted force of the grasps that were not held out, and say it of the others. They see
designs, shapes of objects and the predicted trace: an object that is new is known by its measures.
"""

import warnings
from typing import Any

import numpy as np

from fast.models.gap.evaluation.held_out import HeldOut, Prediction
from fast.models.gap.where.residuals import Residuals, amplitudes
from fast.models.gap.where.strata import object_shape
from fast.models.traces.step_features import STEP_MM

GAUSSIAN_PROCESS, BLACK_BOX = "GP discrepancy", "black-box residual"
_N_COMPONENTS = 5
_MOST_CELLS = 250  # of the GP's O(n^3)
_EVERY = 3  # steps of the trace that the trees see


def predict_baselines(
    residuals: Residuals, held_out: HeldOut, predicted_n: np.ndarray, seed: int = 0
) -> tuple[Prediction, ...]:
    """Both, fitted on `residuals` and added to predicted_n (m x steps) of the held-out grasps."""
    return (
        Prediction(GAUSSIAN_PROCESS, predicted_n + _gaussian_process(residuals, held_out, predicted_n, seed)),
        Prediction(BLACK_BOX, predicted_n + _boosted_trees(residuals, held_out, predicted_n, seed)),
    )


def _gaussian_process(residuals: Residuals, held_out: HeldOut, predicted_n: np.ndarray, seed: int) -> np.ndarray:
    """Kennedy and O'Hagan's delta(x): a GP for each principal component of the relative residual, with ARD."""
    from sklearn.exceptions import ConvergenceWarning
    from sklearn.gaussian_process import GaussianProcessRegressor  # costs a second, most commands never need it
    from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel

    cell, rows = np.unique(residuals.tool * len(residuals.objects) + residuals.obj, return_inverse=True)
    relative = (residuals.measured_n - residuals.predicted_n) / residuals.amplitude_n[:, None]
    means = np.zeros((len(cell), relative.shape[1]))
    np.add.at(means, rows, relative)
    means /= np.bincount(rows)[:, None]
    if len(cell) > _MOST_CELLS:
        kept = np.sort(np.random.default_rng(seed).choice(len(cell), _MOST_CELLS, replace=False))
        cell, means = cell[kept], means[kept]
    inputs = _inputs(residuals)
    x = inputs[cell // len(residuals.objects), cell % len(residuals.objects)]
    centre, scale = x.mean(axis=0), np.maximum(x.std(axis=0), 1e-9)
    u, s, components = np.linalg.svd(means, full_matrices=False)
    k = min(_N_COMPONENTS, len(s))
    new = (inputs[held_out.tool, held_out.obj] - centre) / scale
    correction = np.zeros((len(new), means.shape[1]))
    for score, component in zip((u[:, :k] * s[:k]).T, components[:k], strict=True):
        size = max(float(score.std()), 1e-12)
        kernel: Any = ConstantKernel(1.0, (1e-3, 1e2)) * RBF(np.full(x.shape[1], 4.0), (0.5, 1e3))
        process = GaussianProcessRegressor(kernel + WhiteKernel(0.2, (1e-3, 1e1)), random_state=seed)
        process.optimizer = _few_steps
        with warnings.catch_warnings():
            # A length scale at its bound is an input that does not matter.
            warnings.simplefilter("ignore", ConvergenceWarning)
            process.fit((x - centre) / scale, score / size)
        correction += np.outer(size * process.predict(new), component)
    return np.asarray(correction * amplitudes(predicted_n)[:, None])


def _few_steps(objective: Any, start: np.ndarray, bounds: np.ndarray) -> tuple[np.ndarray, float]:
    """Forty steps of L-BFGS: length scales need no more, and a warning about it would tell nobody anything."""
    from scipy.optimize import minimize

    found = minimize(objective, start, jac=True, method="L-BFGS-B", bounds=bounds, options={"maxiter": 40})
    return found.x, float(found.fun)


def _boosted_trees(residuals: Residuals, held_out: HeldOut, predicted_n: np.ndarray, seed: int) -> np.ndarray:
    """Gradient-boosted trees of the relative residual at a lift, given design, shape, lift and predicted force."""
    from sklearn.ensemble import HistGradientBoostingRegressor

    inputs = _inputs(residuals)
    amplitude = residuals.amplitude_n[:, None]
    left = (residuals.measured_n - residuals.predicted_n) / amplitude
    x = _rows(inputs[residuals.tool, residuals.obj], residuals.predicted_n / amplitude)
    model = HistGradientBoostingRegressor(
        max_iter=100,
        learning_rate=0.08,
        max_leaf_nodes=15,
        min_samples_leaf=60,
        l2_regularization=1.0,
        random_state=seed,
    )
    model.fit(x, left[:, ::_EVERY].ravel())
    over = amplitudes(predicted_n)[:, None]
    found = model.predict(_rows(inputs[held_out.tool, held_out.obj], predicted_n / over)).reshape(len(predicted_n), -1)
    steps = np.arange(predicted_n.shape[1])
    return over * np.array([np.interp(steps, steps[::_EVERY], row) for row in found])


def _inputs(residuals: Residuals) -> np.ndarray:
    """Design parameters and shape of the object for every tool and object, t x o x 17."""
    tools = residuals.tool_table
    shapes = np.array([object_shape(number).numbers for number in residuals.objects])
    shape = (len(tools), len(shapes))
    return np.concatenate(
        [np.broadcast_to(tools[:, None], (*shape, tools.shape[1])), np.broadcast_to(shapes, (*shape, shapes.shape[1]))],
        axis=2,
    )


def _rows(inputs: np.ndarray, relative: np.ndarray) -> np.ndarray:
    """One row a step: inputs, lift, force there and its slope."""
    force, slope = relative[:, ::_EVERY], np.gradient(relative, axis=1)[:, ::_EVERY]
    lift_mm = np.broadcast_to(STEP_MM * (_EVERY * np.arange(force.shape[1]) + 0.5), force.shape)
    repeated = np.repeat(inputs, force.shape[1], axis=0)
    return np.column_stack([repeated, lift_mm.ravel(), force.ravel(), slope.ravel()])
