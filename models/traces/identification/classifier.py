"""Object, class, orientation and sides of an object from the inputs of a trace, and how well unseen tools tell them."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal, get_args

import numpy as np

from fast.models.errors import UsageError
from fast.models.objects.catalogue import OBJECTS

N_OBJECTS = len(OBJECTS)
CLASSES: tuple[str, ...] = tuple(dict.fromkeys(obj.object_class for obj in OBJECTS))
ORIENTATIONS: tuple[str, ...] = tuple(dict.fromkeys(obj.orientation for obj in OBJECTS))
N_TREES = 300
SHARE_OF_INPUTS = 0.3  # that a split chooses from
LEAST_PROBABILITY = 1e-3  # of an object that no tree voted for: one grasp never rules an object out

# The four kinds of sides that the paper tells apart by their traces (Figs. 5c to 5f).
Sides = Literal["flat sides", "curved sides", "tapers inwards", "pronounced geometry"]
SIDES: tuple[Sides, ...] = get_args(Sides)

MEANINGS: dict[Sides, str] = {
    "flat sides": "holds firmly until contact is lost",
    "curved sides": "holds stably, with a steady decline",
    "tapers inwards": "unstable, a narrow peak of force",
    "pronounced geometry": "the force follows the contour",
}

# By the outline that the fingers meet, as the object stands: parallel to the lift; narrowing all the way up; with a
# waist, an overhang or separate parts; all others bulge.
_TAPERS_INWARDS = {19, 20, 24, 25}
_PRONOUNCED = {13, 22, 23, 26, 28, 29}
_FLAT = {4, 5, 7, 8, 14, 21, 30, 31, 32, 33, 34}

_CLASS_OF = np.array([CLASSES.index(obj.object_class) for obj in OBJECTS])
_ORIENTATION_OF = np.array([ORIENTATIONS.index(obj.orientation) for obj in OBJECTS])
N_FOLDS = 6  # of tools, each of which is told by what the others' grasps look like

Fit = Callable[[np.ndarray, np.ndarray], Callable[[np.ndarray], np.ndarray]]
"""From inputs and objects to a function from inputs to probabilities (n x 36, or more with own objects)."""


@dataclass(frozen=True, eq=False)
class Beliefs:
    """Probabilities (n x 36 or more) of the objects of the catalogue, and of own objects after them, for n grasps.

    Of classes, orientations and sides, own objects have one more, the last, where there are any.
    """

    objects: np.ndarray

    @cached_property
    def classes(self) -> np.ndarray:
        """Probabilities (n x len(CLASSES) or one more): sums over the objects of a class."""
        return _summed(self.objects, _CLASS_OF, len(CLASSES))

    @cached_property
    def orientations(self) -> np.ndarray:
        """Probabilities (n x len(ORIENTATIONS) or one more): sums over the objects in an orientation."""
        return _summed(self.objects, _ORIENTATION_OF, len(ORIENTATIONS))

    @cached_property
    def sides(self) -> np.ndarray:
        """Probabilities (n x len(SIDES) or one more): sums over the objects with these sides."""
        return _summed(self.objects, SIDES_OF_OBJECTS, len(SIDES))

    def combined(self) -> "Beliefs":
        """Combine what all rows say of one object (one row): the product of independent rows, with equal priors."""
        log = np.log(np.maximum(self.objects, LEAST_PROBABILITY)).sum(axis=0)
        odds = np.exp(log - log.max())
        return Beliefs((odds / odds.sum())[None])


def truth_of(object_id: np.ndarray) -> dict[str, np.ndarray]:
    """Return the columns (n) of the true object in each array of `Beliefs`, by its name."""
    return {
        "objects": object_id,
        "classes": _CLASS_OF[object_id],
        "orientations": _ORIENTATION_OF[object_id],
        "sides": SIDES_OF_OBJECTS[object_id],
    }


def _summed(objects: np.ndarray, group: np.ndarray, n_groups: int) -> np.ndarray:
    n_own = objects.shape[1] - N_OBJECTS
    groups = np.concatenate([group, np.full(n_own, n_groups)])
    return np.asarray(objects @ (groups[:, None] == np.arange(n_groups + min(n_own, 1))))


def count_columns(object_id: np.ndarray) -> int:
    """Count the columns of probabilities that hold the objects of the catalogue and these."""
    return max(N_OBJECTS, int(object_id.max()) + 1)


def train(inputs: np.ndarray, object_id: np.ndarray, seed: int = 0) -> "Identifier":
    """Train an identifier on grasps of known objects: inputs (n x len(INPUTS)) and the columns of their objects (n).

    Raises:
        UsageError: fewer than two objects, which leave nothing to tell apart.
    """
    n_objects = len(np.unique(object_id))
    if n_objects < 2:
        raise UsageError(f"grasps of {n_objects} object were given, and telling objects apart needs 2; measure more.")
    from sklearn.ensemble import ExtraTreesClassifier

    trees = ExtraTreesClassifier(N_TREES, max_features=SHARE_OF_INPUTS, random_state=seed)
    return Identifier(trees.fit(inputs, object_id))


@dataclass(frozen=True, eq=False)
class Identifier:
    """A trained classifier; `classifier` is scikit-learn's."""

    classifier: Any

    def beliefs(self, inputs: np.ndarray) -> Beliefs:
        """Return probabilities of all objects for n grasps; zero for an object not among those it learnt from."""
        objects = np.zeros((len(inputs), count_columns(self.classifier.classes_)))
        objects[:, self.classifier.classes_] = self.classifier.predict_proba(inputs)
        return Beliefs(objects)


def sides_of(object_id: int) -> Sides:
    """Return the sides that an object of the catalogue shows to the fingers."""
    if object_id in _TAPERS_INWARDS:
        return "tapers inwards"
    if object_id in _PRONOUNCED:
        return "pronounced geometry"
    return "flat sides" if object_id in _FLAT else "curved sides"


SIDES_OF_OBJECTS = np.array([SIDES.index(sides_of(obj.object_id)) for obj in OBJECTS])


def fit_trees(inputs: np.ndarray, object_id: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
    """Fit the classifier of this module as a `Fit`."""
    identifier = train(inputs, object_id)
    return lambda unseen: identifier.beliefs(unseen).objects


def folds_of(tool: np.ndarray, n_folds: int = N_FOLDS) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield the places of grasps to learn from and to test on; all grasps of a tool are on one side.

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
    """Return the beliefs about each of n grasps, by a classifier that learnt from other tools."""
    objects = np.zeros((len(inputs), count_columns(object_id)))
    for learnt, tested in folds_of(tool, n_folds):
        found = fit(inputs[learnt], object_id[learnt])(inputs[tested])
        objects[tested, : found.shape[1]] = found
    return Beliefs(objects)


def rank_of_truth(probabilities: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """Rank (n, from 1) the true column in each row; among equals the truth comes last."""
    own = np.take_along_axis(probabilities, truth[:, None], axis=1)
    return np.asarray((probabilities >= own).sum(axis=1))
