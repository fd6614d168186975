"""A surrogate of the values on every object, for outcomes that one of the objects decides.

Which object is held worst changes from design to design, so the least of the forces has kinks that a Gaussian process
smooths away. The logarithms of the forces on single objects have none, and few principal components tell them all. Each
component gets a surrogate of its own (a linear model of coregionalisation with orthogonal loadings); the outcome is
taken of the forces that they draw. Decision 043 compares.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from fast.models.scientist.acquisition.paths import real_paths
from fast.models.scientist.surrogate.fit import fit_surrogate
from fast.models.scientist.surrogate.imputation import fill_objects
from fast.models.scientist.surrogate.observations import LOG_UNIT_N, REAL, ObjectValues, ObservationSet
from fast.models.scientist.surrogate.posterior import Surrogate

N_COMPONENTS = 3


@dataclass(frozen=True, eq=False)
class ObjectsSurrogate:
    """Surrogates of the principal components over the objects.

    parts: k surrogates of scores. loadings: k x m. middle: m, logarithms of a usual measured design. over_objects: see
    `fit_objects`. data: the outcome of every observed design.
    """

    parts: tuple[Surrogate, ...]
    loadings: np.ndarray
    middle: np.ndarray
    over_objects: Callable[[np.ndarray], np.ndarray]
    data: ObservationSet

    def mean(self, x: np.ndarray, s: np.ndarray | int) -> np.ndarray:
        """Return the outcome of the predicted values at m points `x` (m x d), m; of measured designs alone."""
        assert np.all(s == REAL)
        scores = np.array([part.mean(x, REAL) for part in self.parts])
        return self._outcome(scores[:, :, None])[:, 0]

    def draw(self, x: np.ndarray, n: int, rng: np.random.Generator) -> np.ndarray:
        """Draw jointly the measured outcome at m points `x` (m x d): m x n."""
        return self._outcome(np.array([real_paths(part, x, n, rng) for part in self.parts]))

    def _outcome(self, scores: np.ndarray) -> np.ndarray:
        logs = np.einsum("kpn,km->pmn", scores, self.loadings) + self.middle[:, None]
        return self.over_objects(LOG_UNIT_N * np.expm1(logs))


def fit_objects(
    known: ObjectValues, over_objects: Callable[[np.ndarray], np.ndarray], seed: int = 0
) -> ObjectsSurrogate:
    """Fit the surrogates of the components.

    Objects that a fidelity has never seen are left out, and so are designs that have no other.

    over_objects: the outcome of values on all objects, n x m (x any) to n (x any).

    Raises:
        UsageError: fewer than three observations.
    """
    fidelities = np.unique(known.s)
    seen = np.all([np.isfinite(known.values[known.s == s]).any(axis=0) for s in fidelities], axis=0)
    known = known.take(np.isfinite(known.values[:, seen]).any(axis=1))
    values, variance = np.zeros((2, len(known.s), int(seen.sum())))
    for s in fidelities:
        rows = known.s == s
        filled = fill_objects(known.values[rows][:, seen])
        values[rows], variance[rows] = filled.values, filled.variance
    logs = np.log1p(np.maximum(values, 0.0) / LOG_UNIT_N)
    middles = {s: logs[known.s == s].mean(axis=0) for s in fidelities}
    centred = logs - np.array([middles[s] for s in known.s])
    loadings = np.linalg.svd(centred, full_matrices=False)[2][:N_COMPONENTS]
    noise = (variance * np.exp(-2.0 * logs)) @ loadings.T**2
    parts = [
        fit_surrogate(ObservationSet(known.x, known.s, scores, own_noise), None, seed)
        for scores, own_noise in zip((centred @ loadings.T).T, noise.T, strict=True)
    ]
    data = ObservationSet(known.x, known.s, over_objects(values), np.zeros(len(known.s)))
    return ObjectsSurrogate(tuple(parts), loadings, middles[REAL], over_objects, data)
