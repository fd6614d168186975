"""How well objects are recognised by tools that the classifier has never seen."""

from collections.abc import Callable, Iterator

import numpy as np

from fast.models.errors import UsageError
from fast.models.traces.identification.classifier import Beliefs, count_columns, train

N_FOLDS = 6

Fit = Callable[[np.ndarray, np.ndarray], Callable[[np.ndarray], np.ndarray]]
"""From inputs and objects to a function from inputs to probabilities (n x 36, or more with own objects)."""


def fit_trees(inputs: np.ndarray, object_id: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
    """The classifier of `models.traces.identification.classifier` as a `Fit`."""
    identifier = train(inputs, object_id)
    return lambda unseen: identifier.beliefs(unseen).objects


def folds_of(tool: np.ndarray, n_folds: int = N_FOLDS) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Places of grasps to learn from and to test on; all grasps of a tool are on one side.

    Raises:
        UsageError: there is one tool.
    """
    tools = np.unique(tool)
    if len(tools) < 2:
        raise UsageError("grasps of one tool were given, and a test on unseen tools needs 2; measure more tools.")
    fold = np.arange(len(tools)) % min(n_folds, len(tools))
    of_grasp = fold[np.searchsorted(tools, tool)]
    for number in np.unique(fold):
        yield np.flatnonzero(of_grasp != number), np.flatnonzero(of_grasp == number)


def beliefs_of_unseen(
    inputs: np.ndarray, object_id: np.ndarray, tool: np.ndarray, fit: Fit = fit_trees, n_folds: int = N_FOLDS
) -> Beliefs:
    """Beliefs about each of n grasps, by a classifier that learnt from other tools."""
    objects = np.zeros((len(inputs), count_columns(object_id)))
    for learnt, tested in folds_of(tool, n_folds):
        found = fit(inputs[learnt], object_id[learnt])(inputs[tested])
        objects[tested, : found.shape[1]] = found
    return Beliefs(objects)


def rank_of_truth(probabilities: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """Rank (n, from 1) of the true column in each row; among equals the truth comes last."""
    own = np.take_along_axis(probabilities, truth[:, None], axis=1)
    return np.asarray((probabilities >= own).sum(axis=1))
