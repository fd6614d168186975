"""The likelihood of a panel: theta, moduli of prints and the simulator's own errors fitted, then integrated out.

At the fit everything is linear: what is measured less what is predicted is a sum of columns with normal weights (theta,
moduli, variants, a small smooth error that all grasps share) and of normal errors by cell, whose tails are wide: a cell
counts less the larger its misfit (a multivariate t with `TAILS` degrees of freedom). A change of the forces by anything
else is weighed with what these columns can make up for taken out.

An effect that the simulator has, or has on trial, is fitted along: its amplitude, and its law, which is never exactly
the catalogue's (`laws`). The evidence of two fits of the same data may be compared (Laplace's approximation).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from fast.models.gap.bank.surrogate import Surrogate
from fast.models.gap.evidence.errors import PLACEMENT_SD_MM, TAILS, TARE_SD_N, Errors, Scatter
from fast.models.gap.evidence.facts import Fact, compare_facts, weigh_rest
from fast.models.gap.evidence.laws import N_KNOTS, count_law_changes, has_memory, list_law_changes, scale_value
from fast.models.gap.evidence.reading import N_BINS, OF_BINS, OF_CONTRASTS, SMOOTH, Reading
from fast.models.gap.fit.recalibrate import TOOL_SD
from fast.models.records import EffectValue, GraspContext

SHARED_SD = 0.005  # of the force: a smooth error over the lift that all grasps share
LARGEST_SOLVER = 2.0  # how many times larger than the bank's variants a simulator's errors may be, and still be errors
_MOST_STEPS = 20  # of Gauss-Newton
_STILL_NATS, _STILL = 0.05, 0.1  # it ends where a step changes evidence, and ln of amplitudes, by less
THETA_STEPS = (0.02, 0.01)  # of finite differences in friction and Poisson's ratio
_LARGEST = np.array([0.5, 0.1, 0.05])  # step of ln E, friction, Poisson's ratio
_PRIOR_SD = np.array([3.0, 0.5, 0.15])  # of the same from where the fit began: next to none
_LEAST_REPEAT, _CELL = 0.002, (0.01, 0.05)  # ends of estimated scatters
_AMPLITUDE_SD = 0.7  # of ln of an effect's amplitude about its start
_LARGER = 0.1  # step of ln of an amplitude, of a finite difference
_FINE = 1e-3  # step of the same, of a finite difference
_LARGEST_AMPLITUDE, _SHORTER = 1.0, 0.85  # first step of the same, and by what factor each next one is shorter at least
_SMALL = 12  # rows of a triangular matrix that is inverted as a whole
_AMPLITUDES = (0.05, 1.7)  # of where an effect starts: farther it is not fitted


@dataclass(frozen=True, eq=False)
class Problem:
    """What is measured, and what it is compared with."""

    surrogate: Surrogate
    """Of all grasps, n."""
    reading: Reading
    """The grasps as c cells and r contrasts."""
    errors: Errors
    """What honest simulators, placements and sensors differ by."""
    means_n: np.ndarray
    """Means of cells over bins, c x b."""
    contrasts_n: np.ndarray
    """What repeats of a cell differ by, r x d."""
    of_cells: Surrogate
    """Of one grasp of each cell that nothing came before."""
    effects: tuple[EffectValue, ...] = ()
    """That the simulator has; their amplitudes and laws are fitted along."""
    facts: tuple[Fact, ...] = ()
    """What persons measured of effects."""

    @staticmethod
    def of(surrogate: Surrogate, effects: Sequence[EffectValue] = (), facts: Sequence[Fact] = ()) -> "Problem":
        """Make the problem of the grasps of a surrogate, all of them usable."""
        reading = Reading.of(surrogate.grasps)
        errors = Errors.of(surrogate, reading)
        of_cells = surrogate.select(reading.rows)
        fresh = replace(of_cells.grasps, contexts=(GraspContext(),) * reading.n_cells)
        of_cells = replace(of_cells, grasps=fresh)
        nothing = np.zeros(0)
        blank = Problem(surrogate, reading, errors, nothing, nothing, of_cells, tuple(effects), tuple(facts))
        return blank.measured(surrogate.grasps.steps_n, blank.facts)

    def measured(self, steps_n: np.ndarray, facts: Sequence[Fact] = ()) -> "Problem":
        """Return the same problem with other forces of the grasps, n x 120, and other facts."""
        means_n, contrasts_n = self.reading.average(steps_n), self.reading.contrast(steps_n)
        return replace(self, means_n=means_n, contrasts_n=contrasts_n, facts=tuple(facts))

    @cached_property
    def tool(self) -> np.ndarray:
        """Tool of each cell, c."""
        return np.asarray(self.reading.grasps.tool[self.reading.rows])

    @cached_property
    def obj(self) -> np.ndarray:
        """Object of each cell, c."""
        return np.asarray(self.reading.grasps.obj[self.reading.rows])

    def scale_effects(self, scales: np.ndarray) -> tuple[EffectValue, ...]:
        """Return the effects with other amplitudes."""
        return tuple(scale_value(value, float(scale)) for value, scale in zip(self.effects, scales, strict=True))

    def predict_steps(self, theta: np.ndarray, effects: Sequence[EffectValue]) -> np.ndarray:
        """Predict the step means of every grasp with these effects, n x 120."""
        return self.surrogate.predict_steps(theta, effects)

    def predict_cells(self, theta: np.ndarray, effects: Sequence[EffectValue] = ()) -> np.ndarray:
        """Predict step means of one grasp of each cell that nothing came before, with these effects, c x 120."""
        return self.of_cells.predict_steps(theta, effects)

    def predict_means(self, theta: np.ndarray, effects: Sequence[EffectValue]) -> np.ndarray:
        """Predict the means of cells with these effects, c x b."""
        if any(has_memory(value.effect) for value in effects):
            return self.reading.average(self.predict_steps(theta, effects))
        return np.asarray(self.predict_cells(theta, effects) @ OF_BINS.T)

    def predict_contrasts(self, theta: np.ndarray, effects: Sequence[EffectValue]) -> np.ndarray:
        """Predict the contrasts of repeats with these effects, r x ...; none without a memory."""
        if any(has_memory(value.effect) for value in effects):
            return self.reading.contrast(self.predict_steps(theta, effects))
        return np.zeros((len(self.reading.mix), len(OF_CONTRASTS)))


@dataclass(frozen=True, eq=False)
class EvidenceFit:
    """A problem at its fit; what is measured is one vector of d values: means of cells, contrasts, and then facts."""

    problem: Problem
    """That is fitted."""
    scatter: Scatter
    """Of cells and repeats as the data have it, and the size of the simulator's own errors."""
    theta: np.ndarray
    """3, Young's modulus in MPa, friction, Poisson ratio."""
    began: np.ndarray
    """3, theta about which it is held."""
    moduli: np.ndarray
    """t, ln of each print's modulus over Young's."""
    scales: np.ndarray
    """Amplitudes of the problem's effects over those they were given with."""
    nats: float
    """Log of the evidence, to be compared with that of another fit of the same data."""
    cell_nats: np.ndarray
    """c, the cells' part of it."""
    force_n: np.ndarray
    """c x b, means of cells as predicted."""
    weights: np.ndarray
    """c, how much each cell counts, 0 to 1."""
    columns: np.ndarray
    """k x d, whitened, of what is free, with prior standard deviation 1."""
    from_prior: np.ndarray
    """k, how many of these what is free is from the middle of its prior."""
    gap: np.ndarray
    """d, what is measured less what is predicted, whitened."""
    rest_n: np.ndarray
    """c x b, what is left of the means."""
    misfit: np.ndarray
    """c, chi squared per value by the bank's own errors."""
    mean_roots: np.ndarray
    """c x b x b, whiten means."""
    contrast_roots: np.ndarray
    """r x q x q, whiten contrasts of q values."""

    @property
    def effects(self) -> tuple[EffectValue, ...]:
        """The simulator's effects, as fitted."""
        return self.problem.scale_effects(self.scales)

    @property
    def omnibus(self) -> float:
        """How much is left as a whole: the geometric mean of the cells' misfits, so that one that snaps is one."""
        return float(np.exp(np.log(np.maximum(self.misfit, 1e-12)).mean()))

    @property
    def law_departure(self) -> float:
        """How far the law of the last effect had to go along the lift: chi squared of its `N_KNOTS` numbers."""
        n_effects, n_tools = len(self.problem.effects), len(self.problem.surrogate.grasps.tools)
        first = len(self.columns) - n_effects - count_law_changes(n_tools)
        law = np.linalg.solve(self._root.T, self._own)[first : first + N_KNOTS]
        return float(law @ law)

    @property
    def factor(self) -> np.ndarray:
        """Modulus of the print of each cell over Young's, c."""
        return np.asarray(np.exp(self.moduli)[self.problem.tool])

    @property
    def of_contrasts(self) -> slice:
        """Where contrasts are among the d values."""
        return slice(self.force_n.size, self.force_n.size + self.problem.contrasts_n.size)

    def whiten(self, means_n: np.ndarray, contrasts_n: np.ndarray | None = None) -> np.ndarray:
        """Divide changes of means (k x c x b) and contrasts (k x r x ...; none by default) by errors, k x d."""
        found = np.zeros((len(means_n), len(self.gap)))
        found[:, : self.force_n.size] = _whiten(self.mean_roots, means_n)
        if contrasts_n is not None:
            found[:, self.of_contrasts] = self.whiten_contrasts(contrasts_n)
        return found

    def whiten_contrasts(self, contrasts_n: np.ndarray) -> np.ndarray:
        """Divide changes of contrasts alone by their errors, k x (r ...)."""
        return _whiten(self.contrast_roots, contrasts_n)

    def multiply(self, white: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Multiply k changes: with each other (k x k) and with the gap (k), what is free integrated out."""
        heavy = white * self.value_weights
        inner = self._white_columns @ heavy.T
        return np.asarray(white @ heavy.T - inner.T @ inner), np.asarray(heavy @ self.gap - inner.T @ self._own)

    def multiply_contrasts(self, white: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Do the same for changes of contrasts alone, k x (r ...)."""
        columns = self._white_columns[:, self.of_contrasts]
        products, along = white @ white.T, white @ self.gap[self.of_contrasts]
        if columns.any():
            inner = columns @ white.T
            products, along = products - inner.T @ inner, along - inner.T @ self._own
        return np.asarray(products), np.asarray(along)

    @cached_property
    def value_weights(self) -> np.ndarray:
        """How much each of the d values counts."""
        return _spread_weights(self.weights, len(self.gap))

    @cached_property
    def _root(self) -> np.ndarray:
        return np.linalg.cholesky((self.columns * self.value_weights) @ self.columns.T + np.eye(len(self.columns)))

    @cached_property
    def _white_columns(self) -> np.ndarray:
        return np.asarray(np.linalg.solve(self._root, self.columns))

    @cached_property
    def _own(self) -> np.ndarray:
        own = self._white_columns @ (self.value_weights * self.gap)
        return np.asarray(own - np.linalg.solve(self._root, self.from_prior))


def _weigh_cells(chi: np.ndarray) -> np.ndarray:
    return np.minimum(1.0, (TAILS + N_BINS) / (TAILS + chi))


def _spread_weights(weights: np.ndarray, n: int) -> np.ndarray:
    """Spread weights of cells to those of n values; contrasts all count."""
    found = np.ones(n)
    found[: len(weights) * N_BINS] = np.repeat(weights, N_BINS)
    return found


def fit_evidence(problem: Problem) -> EvidenceFit:
    """Fit theta, moduli and the simulator's errors at the most probable point, with scatters as the data have them."""
    fit = _fit(problem, Scatter(), _start(problem))
    scatter = Scatter(_estimate_cell(fit), _estimate_repeat(fit), 1.0)
    fit = _fit(problem, scatter, _Start.of(fit))
    solver = float(np.clip(np.sqrt(fit.omnibus), 1.0, LARGEST_SOLVER))
    found = _fit(problem, replace(scatter, solver=solver), _Start.of(fit))
    return replace(found, misfit=fit.misfit)


def add_effect(fit: EvidenceFit, value: EffectValue, stiffer: float = 1.0) -> EvidenceFit:
    """Return the fit with one more effect in the simulator, everything fitted again but scatters.

    value: where it starts; stiffer: how many times stiffer than fitted the finger is then.
    """
    problem = replace(fit.problem, effects=(*fit.problem.effects, value))
    start = _Start.of(fit)
    theta = start.theta * np.array([stiffer, 1.0, 1.0])
    return _fit(problem, fit.scatter, replace(start, theta=theta, scales=np.append(start.scales, 1.0)))


@dataclass(frozen=True, eq=False)
class _Start:
    """Where a fit begins. began: theta about which it is held; scales: of the problem's effects."""

    theta: np.ndarray
    began: np.ndarray
    moduli: np.ndarray
    weights: np.ndarray
    scales: np.ndarray

    @staticmethod
    def of(fit: EvidenceFit) -> "_Start":
        """Start where a fit has ended."""
        return _Start(fit.theta, fit.began, fit.moduli, fit.weights, fit.scales)


def _start(problem: Problem) -> _Start:
    bank = problem.surrogate.bank
    theta = np.array([bank.centre.young_modulus_mpa, bank.centre.friction, bank.centre.poisson_ratio])
    theta[0] *= _find_scale(problem, theta)
    moduli, weights = np.zeros(len(problem.surrogate.grasps.tools)), np.ones(problem.reading.n_cells)
    return _Start(theta, theta, moduli, weights, np.ones(len(problem.effects)))


def _fit(problem: Problem, scatter: Scatter, start: _Start) -> EvidenceFit:
    """Take Gauss-Newton steps until the evidence stands still."""
    before, largest = -np.inf, _LARGEST_AMPLITUDE
    for _ in range(_MOST_STEPS):
        found, moved = _weigh(problem, scatter, start)
        start = _move(found, moved, largest)
        by = np.abs(np.log(start.scales / found.scales)).max(initial=0.0)
        if abs(found.nats - before) < _STILL_NATS and by < _STILL:
            break
        before, largest = found.nats, _SHORTER * largest
    return found


def _move(fit: EvidenceFit, moved: np.ndarray, largest: float) -> _Start:
    """Return where the next step begins. moved: k, of what is free; largest: change of ln of an amplitude."""
    grid, n_effects = fit.problem.surrogate.bank.grid, len(fit.scales)
    by = np.clip(moved[:3] * _PRIOR_SD, -_LARGEST, _LARGEST)
    inside = np.clip(fit.theta[1:] + by[1:], grid.min(axis=0), grid.max(axis=0))
    own = np.clip(_AMPLITUDE_SD * moved[len(moved) - n_effects :], -largest, largest)
    return _Start(
        theta=np.array([fit.theta[0] * np.exp(by[0]), *inside]),
        began=fit.began,
        moduli=fit.moduli + TOOL_SD * moved[3 : 3 + len(fit.moduli)],
        weights=_weigh_cells(fit.misfit * N_BINS),
        scales=np.clip(fit.scales * np.exp(own), *_AMPLITUDES),
    )


def _weigh(problem: Problem, scatter: Scatter, start: _Start) -> tuple[EvidenceFit, np.ndarray]:
    """Weigh the evidence as it is linear about the start, and tell how far what is free would go from there (k)."""
    errors, reading, tool = problem.errors, problem.reading, problem.tool
    theta, moduli, weights, scales = start.theta, start.moduli, start.weights, start.scales
    factor, effects = np.exp(moduli)[tool][:, None], problem.scale_effects(scales)
    force_n = problem.predict_means(theta, effects) * factor
    columns, contrast_columns = _list_columns(problem, theta, effects, force_n, factor)
    contrast_n = problem.predict_cells(theta) @ OF_CONTRASTS.T * factor
    roots = _invert(errors.cover_means(force_n, reading.n_repeats, scatter))
    contrast_roots = _invert(errors.cover_contrasts(contrast_n[reading.of_cell], scatter))
    from_prior = np.zeros(len(columns))
    from_prior[:3] = np.array([np.log(theta[0] / start.began[0]), *(theta[1:] - start.began[1:])]) / _PRIOR_SD
    from_prior[3 : 3 + len(moduli)] = moduli / TOOL_SD
    gap = _whiten(roots, (problem.means_n - force_n)[None])[0].reshape(force_n.shape)
    known_n = problem.predict_contrasts(theta, effects)
    of_contrasts = _whiten(contrast_roots, (problem.contrasts_n - known_n)[None])[0]
    white, white_contrasts = _whiten(roots, columns), _whiten(contrast_roots, contrast_columns)
    of_facts, white_facts, fact_weights = _list_facts(problem, effects, scales, len(columns))
    white = np.concatenate([white, white_contrasts, white_facts], axis=1)
    all_gap = np.concatenate([gap.ravel(), of_contrasts, of_facts])
    root_weights = np.sqrt(_spread_weights(weights, len(all_gap)))
    heavy = white * root_weights
    precision = heavy @ heavy.T + np.eye(len(white))
    moved = np.linalg.solve(precision, heavy @ (root_weights * all_gap) - from_prior)
    left = all_gap - moved @ white
    chi = (left[: gap.size].reshape(gap.shape) ** 2).sum(axis=1)
    cell_nats = -0.5 * (TAILS + N_BINS) * np.log1p(chi / TAILS)
    nats = float(
        cell_nats.sum()
        - 0.5 * (left[gap.size :][: of_contrasts.size] ** 2).sum()
        + weigh_rest(left[gap.size + of_contrasts.size :] / fact_weights)
        - 0.5 * ((from_prior + moved) ** 2).sum()
        - 0.5 * np.linalg.slogdet(precision)[1]
        + sum(np.log(np.diagonal(one, axis1=1, axis2=2)).sum() for one in (roots, contrast_roots))
    )
    found = EvidenceFit(
        problem=problem,
        scatter=scatter,
        theta=theta,
        began=start.began,
        moduli=moduli,
        scales=scales,
        nats=nats,
        cell_nats=cell_nats,
        force_n=force_n,
        weights=weights,
        columns=white,
        from_prior=from_prior,
        gap=all_gap,
        rest_n=problem.means_n - force_n - np.tensordot(moved, columns, 1),
        misfit=chi / N_BINS,
        mean_roots=roots,
        contrast_roots=contrast_roots,
    )
    return found, moved


def _list_facts(
    problem: Problem, effects: Sequence[EffectValue], scales: np.ndarray, n_columns: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """List what facts leave (f), how it goes with what is free (k x f), and the weights (f) by which both are times.

    The amplitudes of effects alone, which are free last, have to do with facts.
    """
    rest = compare_facts(problem.facts, effects)
    columns = np.zeros((n_columns, len(rest)))
    for place in range(len(effects) if len(rest) else 0):
        larger = scales * np.where(np.arange(len(scales)) == place, np.exp(_FINE), 1.0)
        slope = (rest - compare_facts(problem.facts, problem.scale_effects(larger))) / _FINE
        columns[n_columns - len(effects) + place] = _AMPLITUDE_SD * slope
    weights = np.sqrt((TAILS + 1.0) / (TAILS + rest**2))
    return weights * rest, weights * columns, weights


def _whiten(roots: np.ndarray, changes_n: np.ndarray) -> np.ndarray:
    """Multiply changes (k x m x b) by the matrices of their parts (m x b x b), k x (m b)."""
    found = (roots @ changes_n.transpose(1, 2, 0)).transpose(2, 0, 1)
    return np.asarray(found.reshape(len(changes_n), -1))


def _invert(covariances: np.ndarray) -> np.ndarray:
    """Compute matrices (m x b x b) that whiten values with these covariances."""
    return _invert_lower(np.linalg.cholesky(covariances))


def _invert_lower(roots: np.ndarray) -> np.ndarray:
    """Invert lower triangular matrices (m x b x b), by halves: those of the halves, and what joins them."""
    n = roots.shape[-1]
    if n <= _SMALL:
        return np.asarray(np.linalg.inv(roots))
    half, found = n // 2, np.zeros_like(roots)
    first, last = _invert_lower(roots[:, :half, :half]), _invert_lower(roots[:, half:, half:])
    found[:, :half, :half], found[:, half:, half:] = first, last
    found[:, half:, :half] = -last @ (roots[:, half:, :half] @ first)
    return found


def _list_columns(
    problem: Problem, theta: np.ndarray, effects: Sequence[EffectValue], force_n: np.ndarray, factor: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """List changes of means (k x c x b) and of contrasts (k x r x ...) by what is free, one prior sd each.

    Theta first, then moduli of prints, variants of the simulator, smooth errors of all grasps, heights of objects, laws
    of effects, and their amplitudes. force_n: c x b, as predicted; factor: c x 1, moduli of prints.
    """
    errors, grasps = problem.errors, problem.surrogate.grasps
    grows = errors.grow(force_n)[:, None]
    peak_n = np.abs(force_n).max(axis=1)[:, None]
    slopes_n = []
    for place, by in enumerate(THETA_STEPS, start=1):
        more_n, less_n = (problem.predict_means(_moved(theta, place, side * by), effects) for side in (1.0, -1.0))
        slopes_n.append(factor * (more_n - less_n) / (2.0 * by))
    is_tool, is_object = (
        (own == np.arange(n)[:, None])[:, :, None]
        for own, n in ((problem.tool, len(grasps.tools)), (problem.obj, len(grasps.objects)))
    )
    columns = [
        _PRIOR_SD[:, None, None] * np.array([force_n, *slopes_n]),
        TOOL_SD * force_n * is_tool,
        np.moveaxis(errors.variants_n @ OF_BINS.T, 1, 0) * grows,
        SHARED_SD * SMOOTH[:, None] * force_n,
        SHARED_SD * SMOOTH[:, None] * peak_n,
        PLACEMENT_SD_MM * (errors.placed_n @ OF_BINS.T) * grows * is_object,
    ]
    own_n, own_contrasts_n = [], []
    contrasts_n = problem.predict_contrasts(theta, effects)
    for place, value in enumerate(effects):
        others = [*effects[:place], *effects[place + 1 :]]
        change_n = force_n - factor * problem.predict_means(theta, others)
        columns.append(list_law_changes(problem.tool, len(grasps.tools), force_n, change_n))
        larger = [*effects[:place], scale_value(value, np.exp(_LARGER)), *effects[place + 1 :]]
        more_n = factor * problem.predict_means(theta, larger) - force_n
        own_n.append(_AMPLITUDE_SD / _LARGER * more_n)
        own_contrasts_n.append(
            _AMPLITUDE_SD / _LARGER * (problem.predict_contrasts(theta, larger) - contrasts_n)
            if has_memory(value.effect)
            else np.zeros_like(contrasts_n)
        )
    all_n = np.concatenate([*columns, np.array(own_n).reshape(len(own_n), *force_n.shape)])
    of_contrasts = np.zeros((len(all_n), *contrasts_n.shape))
    if own_contrasts_n:
        of_contrasts[len(all_n) - len(own_n) :] = own_contrasts_n
    return all_n, of_contrasts


def _estimate_cell(fit: EvidenceFit) -> float:
    """Estimate the scatter of cells: how much the factors on their forces differ, tools and objects apart."""
    own = (fit.force_n**2).sum(axis=1)
    share = (fit.rest_n * fit.force_n).sum(axis=1) / np.maximum(own, 1e-12)
    for group in (fit.problem.tool, fit.problem.obj, fit.problem.tool):
        for one in np.unique(group):
            share[group == one] -= np.median(share[group == one])
    return float(np.clip(_spread(share), *_CELL))


def _estimate_repeat(fit: EvidenceFit) -> float:
    """Estimate the scatter of repeats: how much the factors on their forces differ, less what noise does to them."""
    problem = fit.problem
    if not len(problem.contrasts_n):
        return Scatter().repeat
    force_n = (problem.predict_cells(fit.theta) @ OF_CONTRASTS.T * fit.factor[:, None])[problem.reading.of_cell]
    noise = problem.errors.contrast_noise + TARE_SD_N**2
    along = np.linalg.solve(noise, force_n.T).T
    own = np.maximum((along * force_n).sum(axis=1), 1e-12)
    share = (along * problem.contrasts_n).sum(axis=1) / own
    place = np.concatenate(
        [np.arange(np.count_nonzero(problem.reading.of_cell == one)) for one in np.unique(problem.reading.of_cell)]
    )
    for one in np.unique(place):
        share[place == one] -= np.median(share[place == one])
    return float(np.sqrt(max(_spread(share) ** 2 - float(np.median(1.0 / own)), _LEAST_REPEAT**2)))


def _spread(values: np.ndarray) -> float:
    return 1.4826 * float(np.median(np.abs(values)))


def _moved(theta: np.ndarray, place: int, by: float) -> np.ndarray:
    moved = theta.copy()
    moved[place] += by
    return moved


def _find_scale(problem: Problem, theta: np.ndarray) -> float:
    """Compute measured over predicted force, the median of cells."""
    force_n = problem.predict_means(theta, problem.effects)
    along = (force_n * problem.means_n).sum(axis=1) / np.maximum((force_n**2).sum(axis=1), 1e-9)
    return float(np.clip(np.median(along), 0.05, 20.0))
