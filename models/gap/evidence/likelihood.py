"""The likelihood of a panel: theta, moduli of prints and numerical variants fitted, then integrated out.

At the fit everything is linear: what is measured less what is predicted is a sum of columns with normal weights (theta,
moduli, variants) and of normal errors by cell, whose tails are wide: a cell counts less the larger its misfit (a
multivariate t with `TAILS` degrees of freedom). A change of the forces by anything else is weighed with what these
columns can make up for taken out.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from fast.models.gap.bank.surrogate import Surrogate
from fast.models.gap.evidence.errors import TOOL_SD, Errors, Scatter
from fast.models.gap.evidence.reading import N_BINS, Reading
from fast.models.records import EffectValue, GraspContext

TAILS = 8.0  # degrees of freedom of a cell's errors
_N_STEPS = 8  # of Gauss-Newton; the last two change weights alone
_STEP = (0.02, 0.01)  # of finite differences in friction and Poisson's ratio
_LARGEST = np.array([0.5, 0.1, 0.05])  # step of ln E, friction, Poisson's ratio
COMMON = 0.005
from fast.models.gap.evidence.reading import MIDDLES_MM
_KN = np.array([0.0, 1.5, 5.0, 12.0, 25.0, 45.0])
HATS = np.array([np.interp(MIDDLES_MM, _KN, row) for row in np.eye(len(_KN))])
_SD = np.array([3.0, 0.5, 0.15])  # prior of a step from the centre: next to none


@dataclass(frozen=True, eq=False)
class Problem:
    """What is measured (means c x b, contrasts r x d), and what it is compared with."""

    surrogate: Surrogate
    reading: Reading
    errors: Errors
    means_n: np.ndarray
    contrasts_n: np.ndarray
    in_model: tuple[EffectValue, ...] = ()
    scatter: Scatter = Scatter()

    @staticmethod
    def of(surrogate: Surrogate, in_model: Sequence[EffectValue] = ()) -> "Problem":
        """The problem of the usable grasps of a surrogate, with effects that the simulator has already."""
        reading = Reading.of(surrogate.grasps)
        steps_n = surrogate.grasps.steps_n
        return Problem(
            surrogate, reading, Errors.of(surrogate, reading), reading.average(steps_n), reading.contrast(steps_n),
            tuple(in_model),
        )

    @property
    def tool(self) -> np.ndarray:
        """Tool of each cell, c."""
        return np.asarray(self.reading.grasps.tool[self.reading.rows])

    @property
    def obj(self) -> np.ndarray:
        """Object of each cell, c."""
        return np.asarray(self.reading.grasps.obj[self.reading.rows])

    @cached_property
    def first(self) -> Surrogate:
        """The surrogate of the first grasp of each cell, without a history."""
        found = self.surrogate.select(self.reading.rows)
        return replace(found, grasps=replace(found.grasps, contexts=(GraspContext(),) * self.reading.n_cells))

    def predict_steps(self, theta: np.ndarray, effects: Sequence[EffectValue] = ()) -> np.ndarray:
        """Step means of every grasp with the model's effects and these, n x 120."""
        return self.surrogate.predict_steps(theta, [*self.in_model, *effects])

    def predict_means(self, theta: np.ndarray) -> np.ndarray:
        """Means of cells, c x b."""
        return self.reading.average(self.predict_steps(theta))


@dataclass(frozen=True, eq=False)
class EvidenceFit:
    """A problem at its fit.

    theta: 3. moduli: t, ln of each print's modulus over Young's. force_n: c x b, predicted with moduli. roots: Cholesky
    factors of the errors, means (c x b x b) and contrasts (r x d x d); weights: c, and 1 for contrasts. columns: K x
    (c b), whitened and weighted, of nuisances, prior standard deviation 1; rest: c b, rest_of_contrasts: r d. misfit:
    c, chi squared per value. loss: minus log posterior.
    """

    problem: Problem
    theta: np.ndarray
    moduli: np.ndarray
    force_n: np.ndarray
    roots: np.ndarray
    contrast_roots: np.ndarray
    weights: np.ndarray
    columns: np.ndarray
    rest: np.ndarray
    rest_of_contrasts: np.ndarray
    misfit: np.ndarray
    loss: float

    @cached_property
    def _root(self) -> np.ndarray:
        """Cholesky factor of the nuisances' precision."""
        return np.linalg.cholesky(self.columns @ self.columns.T + np.eye(len(self.columns)))

    def free(self, whitened: np.ndarray) -> np.ndarray:
        """Whitened changes (... x c b) less what nuisances make up for, in the metric of `measure`."""
        inner = np.linalg.solve(self._root, self.columns @ whitened.T)
        return np.asarray(inner)

    def whiten(self, change_n: np.ndarray) -> np.ndarray:
        """Changes of means (k x c x b) as the likelihood counts them, k x (c b)."""
        found = np.einsum("cij,kcj->kci", self._inverse_roots, change_n) * np.sqrt(self.weights)[:, None]
        return np.asarray(found.reshape(len(change_n), -1))

    def whiten_contrasts(self, change_n: np.ndarray) -> np.ndarray:
        """Changes of contrasts (k x r x d), k x (r d)."""
        return np.asarray(np.einsum("rij,krj->kri", self._inverse_contrast_roots, change_n).reshape(len(change_n), -1))

    @cached_property
    def _inverse_roots(self) -> np.ndarray:
        return np.linalg.inv(self.roots)

    @cached_property
    def _inverse_contrast_roots(self) -> np.ndarray:
        return np.linalg.inv(self.contrast_roots)

    def gram(self, whitened: np.ndarray, of_contrasts: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Of k changes: their products (k x k) and those with the rest (k), nuisances integrated out."""
        inner = self.free(whitened)
        own = self.free(self.rest[None])[:, 0]
        products = whitened @ whitened.T - inner.T @ inner
        along = whitened @ self.rest - inner.T @ own
        if of_contrasts is not None and of_contrasts.size:
            products = products + of_contrasts @ of_contrasts.T
            along = along + of_contrasts @ self.rest_of_contrasts
        return products, along


def fit_evidence(problem: Problem, start: np.ndarray | None = None) -> EvidenceFit:
    """Theta, moduli and variants at the most probable point, from the centre of the bank or `start`."""
    bank = problem.surrogate.bank
    low, high = bank.grid.min(axis=0), bank.grid.max(axis=0)
    theta = np.array([bank.centre.young_modulus_mpa, bank.centre.friction, bank.centre.poisson_ratio]) if start is None else start.copy()
    if start is None:
        theta[0] *= _scale_of(problem, theta)
    centre = theta.copy()
    n_tools = len(problem.surrogate.grasps.tools)
    tool, n_cells = problem.tool, problem.reading.n_cells
    moduli, weights = np.zeros(n_tools), np.ones(n_cells)
    variants = problem.errors.variants.shape[1]
    errors, reading = problem.errors, problem.reading
    for step in range(_N_STEPS):
        theta[1:] = np.clip(theta[1:], low, high)
        bare = problem.predict_means(theta)
        factor = np.exp(moduli)[tool][:, None]
        force = bare * factor
        slopes = [(problem.predict_means(_moved(theta, 1 + i, d)) - problem.predict_means(_moved(theta, 1 + i, -d))) / (2 * d) for i, d in enumerate(_STEP)]
        grows = np.sqrt((force**2).mean(axis=1)) / errors.size_n
        covariance = errors.of_means(force, grows, reading.n_repeats, problem.scatter)
        roots = np.linalg.cholesky(covariance)
        inverse = np.linalg.inv(roots)
        n_common = 2 * len(HATS) if COMMON else 0
        columns = np.zeros((3 + n_tools + variants + n_common, n_cells, N_BINS))
        peak = np.abs(force).max(axis=1)
        if COMMON:
            at = 3 + n_tools + variants
            columns[at : at + len(HATS)] = COMMON * HATS[:, None] * force
            columns[at + len(HATS) :] = COMMON * HATS[:, None] * peak[:, None]
        columns[0] = force
        columns[1:3] = np.array(slopes) * factor
        for t in range(n_tools):
            columns[3 + t][tool == t] = TOOL_SD * force[tool == t]
        columns[3 + n_tools : 3 + n_tools + variants] = np.moveaxis(errors.variants, 1, 0) * grows[:, None]
        columns[:3] *= _SD[:, None, None]
        gone = np.concatenate([(np.array([np.log(theta[0] / centre[0]), *(theta[1:] - centre[1:])])) / _SD, moduli / TOOL_SD, np.zeros(variants + n_common)])
        plain = np.einsum("cij,kcj->kci", inverse, columns)
        u = np.einsum("cij,cj->ci", inverse, problem.means_n - force)
        a = (plain * np.sqrt(weights)[:, None]).reshape(len(columns), -1)
        uw = (u * np.sqrt(weights)[:, None]).ravel()
        x = np.linalg.solve(a @ a.T + np.eye(len(a)), a @ uw - gone)
        left = u - np.tensordot(x, plain, 1)
        chi = (left**2).sum(axis=1)
        if step < _N_STEPS - 2:
            move = np.clip(x[:3] * _SD, -_LARGEST, _LARGEST)
            theta[0] *= np.exp(move[0])
            theta[1:] += move[1:]
            moduli = moduli + TOOL_SD * x[3 : 3 + n_tools]
        if step < _N_STEPS - 1:
            weights = np.minimum(1.0, (TAILS + N_BINS) / (TAILS + chi))
    contrast_force = (OFC(problem, theta) * np.exp(moduli)[tool][:, None])[reading.of_cell]
    contrast_roots = np.linalg.cholesky(errors.of_contrasts(contrast_force, problem.scatter))
    predicted = problem.reading.contrast(problem.predict_steps(theta)) if problem.in_model else 0.0
    rest_c = np.einsum("rij,rj->ri", np.linalg.inv(contrast_roots), problem.contrasts_n - predicted).ravel() if len(contrast_roots) else np.zeros(0)
    loss = 0.5 * (TAILS + N_BINS) * np.log1p(chi / TAILS).sum() + 0.5 * ((gone + x) ** 2).sum() + np.log(np.diagonal(roots, axis1=1, axis2=2)).sum()
    return EvidenceFit(problem, theta, moduli, force, roots, contrast_roots, weights, a, uw, rest_c, chi / N_BINS, float(loss))


def OFC(problem, theta):
    from fast.models.gap.evidence.reading import OF_CONTRASTS
    return problem.predict_steps(theta)[problem.reading.rows] @ OF_CONTRASTS.T


def _moved(theta: np.ndarray, place: int, by: float) -> np.ndarray:
    moved = theta.copy()
    moved[place] += by
    return moved


def _scale_of(problem: Problem, theta: np.ndarray) -> float:
    """Measured over predicted force, the median of cells."""
    force = problem.predict_means(theta)
    return float(np.median((force * problem.means_n).sum(axis=1) / np.maximum((force**2).sum(axis=1), 1e-9)))
