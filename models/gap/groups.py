"""Grasps that are left out together: designs in folds, objects by class."""

import numpy as np

from models.gap.problem import Grasps
from models.objects.catalogue import get_object

N_DESIGN_FOLDS = 5
N_OBJECT_FOLDS = 6


def design_folds(grasps: Grasps, n_folds: int = N_DESIGN_FOLDS) -> np.ndarray:
    """Fold of each grasp by its tool, n; tools of equal designs stay together."""
    ids = [design.design_id for design in grasps.designs]
    present = sorted({ids[tool] for tool in grasps.tool})
    fold = {name: place % n_folds for place, name in enumerate(present)}
    return np.array([fold[ids[tool]] for tool in grasps.tool])


def object_folds(grasps: Grasps, n_folds: int = N_OBJECT_FOLDS) -> np.ndarray:
    """Fold of each grasp by its object's class, n; the largest classes are spread first."""
    classes = [get_object(number).object_class for number in grasps.objects]
    names, counts = np.unique([classes[obj] for obj in np.unique(grasps.obj)], return_counts=True)
    load = np.zeros(min(n_folds, len(names)))
    fold = {}
    for place in np.argsort(-counts, kind="stable"):
        fold[str(names[place])] = int(np.argmin(load))
        load[fold[str(names[place])]] += counts[place]
    return np.array([fold[classes[obj]] for obj in grasps.obj])


def halves(grasps: Grasps) -> np.ndarray:
    """Whether the grasp's object is in the first half of its tool's objects, n: they tell a new tool's modulus."""
    objects = np.unique(grasps.obj)
    first = dict(zip(objects.tolist(), (np.arange(len(objects)) % 2 == 0).tolist(), strict=True))
    return np.array([first[obj] for obj in grasps.obj.tolist()])
