"""How well objects are recognised: shares with their scatter, by fewer tools, and by several grasps together."""

from typing import NamedTuple

import numpy as np

from fast.models.errors import UsageError
from fast.models.traces.identification.classifier import (
    N_FOLDS,
    N_OBJECTS,
    Beliefs,
    Fit,
    fit_trees,
    folds_of,
    rank_of_truth,
)
from fast.models.traces.quality import Interval, mean_of_tools

N_DRAWS = 200  # of sets of grasps of one object


def beliefs_from_tools(
    inputs: np.ndarray,
    object_id: np.ndarray,
    tool: np.ndarray,
    n_tools: int,
    fit: Fit = fit_trees,
    n_folds: int = N_FOLDS,
    seed: int = 0,
) -> Beliefs:
    """Like `beliefs_of_unseen`, by classifiers that learnt from `n_tools` tools each, drawn from those they might.

    Raises:
        UsageError: fewer other tools are there.
    """
    rng = np.random.default_rng(seed)
    objects = np.zeros((len(inputs), N_OBJECTS))
    for learnt, tested in folds_of(tool, n_folds):
        others = np.unique(tool[learnt])
        if len(others) < n_tools:
            raise UsageError(
                f"{n_tools} tools to learn from were asked for, and {len(others)} are there; ask for fewer."
            )
        kept = learnt[np.isin(tool[learnt], rng.choice(others, n_tools, replace=False))]
        objects[tested] = fit(inputs[kept], object_id[kept])(inputs[tested])
    return Beliefs(objects)


def top_share(probabilities: np.ndarray, truth: np.ndarray, tool: np.ndarray, k: int) -> Interval:
    """Share of grasps with the truth among the k most probable, with the bootstrap over tools."""
    is_within = rank_of_truth(probabilities, truth) <= k
    return mean_of_tools(np.array([is_within[tool == one].mean() for one in np.unique(tool)]))


def confusion(beliefs: Beliefs, object_id: np.ndarray) -> np.ndarray:
    """Grasps (36 x 36) by true object (rows) and most probable object (columns)."""
    counts = np.zeros((N_OBJECTS, N_OBJECTS), dtype=int)
    np.add.at(counts, (object_id, beliefs.objects.argmax(axis=1)), 1)
    return counts


class GraspsSeen(NamedTuple):
    """Shares of sets of grasps of one object that were recognised: in the first place, and among the first three."""

    n_tools: int
    n_repeats: int
    top_1: float
    top_3: float


def by_grasps_seen(
    beliefs: Beliefs, object_id: np.ndarray, tool: np.ndarray, n_tools: int, n_repeats: int, seed: int = 0
) -> GraspsSeen:
    """Accuracy of `n_repeats` grasps by each of `n_tools` tools together, over `N_DRAWS` random sets of each object.

    Raises:
        UsageError: an object was not met so often.
    """
    rng, hits = np.random.default_rng(seed), []
    for one in np.unique(object_id):
        places = [np.flatnonzero((object_id == one) & (tool == number)) for number in np.unique(tool)]
        able = [grasps for grasps in places if len(grasps) >= n_repeats]
        if len(able) < n_tools:
            raise UsageError(
                f"object {one} was met {n_repeats} times by {len(able)} tools, and {n_tools} were asked for; ask for "
                "fewer."
            )
        for _ in range(N_DRAWS):
            chosen = rng.choice(len(able), n_tools, replace=False)
            rows = np.concatenate([rng.choice(able[number], n_repeats, replace=False) for number in chosen])
            together = Beliefs(beliefs.objects[rows]).combined().objects
            hits.append(rank_of_truth(together, np.array([one]))[0])
    ranks = np.array(hits)
    return GraspsSeen(n_tools, n_repeats, float((ranks <= 1).mean()), float((ranks <= 3).mean()))
