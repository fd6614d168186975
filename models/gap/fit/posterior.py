"""The posterior of theta and the parameters of effects, by NUTS on a quadratic surface around a fit.

    y = F(v) + C d + e,    d ~ N(0, P^-1),  e ~ N(0, phi),  all whitened,

v: ln E, friction, Poisson ratio and the effects' parameters on the axes of `models.gap.fit.fit`; C d: moduli of tools,
what numerical variants change and what a law may differ by beyond its parameters (`law_freedom`), integrated out with C
as it is at the fit.
The residual is a quadratic polynomial of v around the fit, found by least squares over points of the posterior's own
ellipsoid, so that the log likelihood is one quadratic form of its terms: thousands of evaluations cost what one
prediction of all grasps does. What the polynomial misses is measured at draws and said. `phi` (1 or more) is what the
fit leaves beyond its errors; with an effect, only `DEFLATION` of the data count, since features of a cell are no
independent witnesses of a law.

Data may not learn what another solver does: it looks like a little more or less of an effect, and would be believed to
be known. So draws of a fit with effects are spread in the effects' parameters: by what these have to change for the
prior of every numerical error, given back whole (a cut, Plummer 2015), and, of effects with simulations of their own,
by what two solvers are apart in them. Then they get the tails of a t distribution with a degree of freedom less than
there are tools. Medians stay those of the data, and theta that of this simulator.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from scipy.special import expit

from fast.models.calibration.inference.optimise import approximate_at_mode
from fast.models.calibration.inference.parallel_chains import sample
from fast.models.calibration.inference.result import CalibrationResult, measure_convergence
from fast.models.calibration.inference.settings import WITH_EFFECTS, CalibrationSettings, ThetaPriors
from fast.models.calibration.means.problem import THETA
from fast.models.gap.fit.fit import DEFLATION, HELD, Axis, Fit, axes_of
from fast.models.gap.fit.law_freedom import free_law
from fast.models.gap.fit.whitened_features import IS_LIFT, compute_root_weights
from fast.models.records import EffectValue
from fast.models.simulation.effects.catalogue import CATALOGUE

R_HAT_LIMIT = 1.01
_REACH_SD = 1.5  # of the points that carry the surface
_SURFACE_LIMIT_NATS = 0.5
_CHECKED_DRAWS = 24
_MOVES = 2  # of the surface to the mode that it has itself
_N_THETA = 3
# What solvers are apart in an effect that is simulated: its size, relative, and the logarithm of its shape. The limit
# of a force is read off the forces themselves. Rounded, from worlds of the study `gap-intervals`.
SIZE_APART, SHAPE_APART = 0.4, 0.6
_BESIDE = 0.03  # of a range: a fit nearer to its end is beside a bound


@dataclass(frozen=True, eq=False)
class PosteriorDensity:
    """Log posterior over unbounded coordinates u (k): logits of the shares of v between `lower` and `upper` (k).

    v = middle + spread w. gram: q x q, of the polynomial's terms 1, w, w w'. axes: of the effects' parameters.
    """

    axes: tuple[Axis, ...]
    priors: ThetaPriors
    lower: np.ndarray
    upper: np.ndarray
    middle: np.ndarray
    spread: np.ndarray
    gram: np.ndarray

    def __call__(self, u: np.ndarray) -> tuple[float, np.ndarray]:
        """Log density without its constant, and its gradient (k), at a vector (k)."""
        share = expit(u)
        v, slope = self.inside(u), (self.upper - self.lower) * share * (1.0 - share)
        w = np.linalg.solve(self.spread, v - self.middle)
        terms, slopes = _terms(w), _term_slopes(w)
        misfit = self.gram @ terms
        by_w = -slopes @ misfit
        prior, by_v = self._log_prior(v)
        value = -0.5 * float(terms @ misfit) + prior + float(np.log(np.maximum(slope, 1e-300)).sum())
        return value, (np.linalg.solve(self.spread.T, by_w) + by_v) * slope + 1.0 - 2.0 * share

    def log_likelihood(self, v: np.ndarray) -> float:
        """Return the surface's log likelihood at v (k), without its constant."""
        terms = _terms(np.linalg.solve(self.spread, v - self.middle))
        return -0.5 * float(terms @ self.gram @ terms)

    @property
    def start(self) -> np.ndarray:
        """Unbounded coordinates of the middle."""
        return self.outside(self.middle)

    def inside(self, u: np.ndarray) -> np.ndarray:
        """Return the v of unbounded coordinates, ... x k."""
        return np.asarray(self.lower + (self.upper - self.lower) * expit(u))

    def outside(self, v: np.ndarray) -> np.ndarray:
        """Return unbounded coordinates of v, ... x k; at a bound, those of a hundredth of the range from it."""
        share = np.clip((v - self.lower) / (self.upper - self.lower), 0.01, 0.99)
        return np.asarray(np.log(share) - np.log1p(-share))

    def values(self, v: np.ndarray) -> np.ndarray:
        """Return theta and parameters in their units, ... x k."""
        flat = v.reshape(-1, v.shape[-1])
        columns = [np.exp(flat[:, 0]), flat[:, 1], flat[:, 2]]
        for place, axis in enumerate(self.axes):
            columns.append(np.array([axis.value(float(inner)) for inner in flat[:, _N_THETA + place]]))
        return np.stack(columns, axis=-1).reshape(v.shape)

    def _log_prior(self, v: np.ndarray) -> tuple[float, np.ndarray]:
        """Compute priors of Table 3 and the catalogue (normal within bounds), as densities of v, and their slopes."""
        priors, slopes = self.priors, np.zeros(len(v))
        far = (v[0] - np.log(priors.young_modulus_median_mpa)) / priors.young_modulus_log_sd
        value = -0.5 * far**2 + (priors.friction_shape - 1.0) * np.log(v[1]) - priors.friction_rate * v[1]
        slopes[0] = -far / priors.young_modulus_log_sd
        slopes[1] = (priors.friction_shape - 1.0) / v[1] - priors.friction_rate
        for place, axis in enumerate(self.axes, start=_N_THETA):
            log_prior, slope = _log_prior_of(axis, float(v[place]))
            value += log_prior
            slopes[place] = slope
        return float(value), slopes


def _log_prior_of(axis: Axis, inner: float) -> tuple[float, float]:
    """Log density of an effect's parameter on its axis, from the catalogue's prior of its value, and its slope."""
    spec = next(p for p in CATALOGUE[axis.effect].parameters if p.name == axis.name)
    value, along = axis.value(inner), axis.sd
    if axis.kind == "log":
        by_inner, log_jacobian, jacobian_slope = value * along, np.log(value), along
    elif axis.kind == "inverse":
        by_inner, log_jacobian, jacobian_slope = -(value**2) * along, 2.0 * np.log(value), -2.0 * value * along
    else:
        by_inner, log_jacobian, jacobian_slope = along, 0.0, 0.0
    far = (value - spec.prior_median) / spec.prior_sd
    return float(-0.5 * far**2 + log_jacobian), float(-far / spec.prior_sd * by_inner + jacobian_slope)


def sample_posterior(
    fit: Fit, settings: CalibrationSettings, progress: Callable[[str], None] | None = None
) -> CalibrationResult:
    """Draw theta and `<effect>.<parameter>` of every effect of a fit, by NUTS from the priors of the catalogue.

    `fit`: of `models.gap.fit.recalibrate.recalibrate`, with the effects, or without any for theta alone. Theta is the
    simulator's: what numerical variants change is integrated out, but that is not all that a bench differs by
    (`models.gap.fit.theta`). Parameters of effects also hold what other solvers are worth. Uses priors, chains, draws,
    tune, target_accept, seed, workers of settings.
    """
    surface = LikelihoodSurface.around(fit, settings.priors)
    density = surface.density
    rng = np.random.default_rng([settings.seed, 3])
    start_v = surface.point + 0.5 * rng.standard_normal((settings.chains, len(surface.point))) @ density.spread.T
    scale = density.spread @ density.spread.T
    # Beside a bound a logit may go far; NUTS learns how far.
    share = np.clip((surface.point - density.lower) / (density.upper - density.lower), _BESIDE, 1.0 - _BESIDE)
    by_u = 1.0 / ((density.upper - density.lower) * share * (1.0 - share))
    samples = sample(density, density.outside(start_v), settings, scale=scale * np.outer(by_u, by_u), progress=progress)
    v = density.inside(samples.draws)
    names = (*THETA, *(f"{axis.effect}.{axis.name}" for axis in density.axes))
    r_hat, ess_bulk, ess_tail = measure_convergence(names, density.values(v))
    chosen = v.reshape(-1, v.shape[-1])[rng.choice(samples.draws[..., 0].size, _CHECKED_DRAWS, replace=False)]
    return CalibrationResult(
        names=names,
        draws=density.values(surface.spread_by_solvers(v, np.random.default_rng([settings.seed, 4]))),
        settings=settings,
        method=WITH_EFFECTS,
        r_hat=r_hat,
        ess_bulk=ess_bulk,
        ess_tail=ess_tail,
        n_divergences=samples.n_divergences,
        n_gradients=samples.n_gradients,
        cpu_s=samples.cpu_s,
        warnings=tuple(_write_warnings(r_hat, samples.n_divergences, surface.error_nats(chosen))),
    )


def effects_at(names: Sequence[str], medians: Sequence[float]) -> tuple[EffectValue, ...]:
    """Make effects from parameters named `<effect>.<parameter>`, in the order of their first parameters."""
    found: dict[str, dict[str, float]] = {}
    for name, median in zip(names, medians, strict=True):
        effect, dot, parameter = name.partition(".")
        if dot:
            found.setdefault(effect, {})[parameter] = float(f"{median:.6g}")
    return tuple(EffectValue(effect=effect, parameters=parameters) for effect, parameters in found.items())


@dataclass(frozen=True, eq=False)
class LikelihoodSurface:
    """The residual around a fit as polynomials of v.

    point: k, their middle. phi: how much wider errors are than stated. weight: m x 1, roots of the weights. nuisance:
    what tools and numerical variants change, weighted, c x (m f); inverse: c x c, of its precision with the priors.
    """

    fit: Fit
    density: PosteriorDensity
    point: np.ndarray
    phi: float
    weight: np.ndarray
    nuisance: np.ndarray
    inverse: np.ndarray

    @staticmethod
    def around(fit: Fit, priors: ThetaPriors) -> "LikelihoodSurface":
        """Make the surface of a fit; residuals that weigh little in the fit do as they do there."""
        for value in fit.effects:
            fit = free_law(fit, value.effect, is_apart=True)
        # A numerical error at its bound is known no better for that.
        fit = replace(fit, precision=np.where(fit.precision == HELD, 1.0, fit.precision))
        axes = tuple(axis for value in fit.effects for axis in axes_of(value.effect))
        point, (lower, upper) = _vector(fit, axes), _limits(fit, axes, priors)
        point = np.clip(point, lower + 1e-6 * (upper - lower), upper - 1e-6 * (upper - lower))
        n_effects = fit.n_effect_columns
        n_nuisance = len(fit.columns) - _N_THETA - n_effects
        weight = compute_root_weights(_residual(fit, axes, point))
        nuisance = (fit.columns[_N_THETA : _N_THETA + n_nuisance] * (weight / fit.weight)).reshape(n_nuisance, -1)
        inverse = np.linalg.inv(nuisance @ nuisance.T + np.diag(fit.precision[_N_THETA : _N_THETA + n_nuisance]))
        kept = [*range(_N_THETA), *range(len(fit.columns) - n_effects, len(fit.columns))]
        bare = LikelihoodSurface(
            fit,
            PosteriorDensity(axes, priors, lower, upper, point, np.eye(len(point)), np.zeros((1, 1))),
            point,
            1.0,
            weight,
            nuisance,
            inverse,
        )
        at_fit = bare.rows(point)
        phi = max(1.0, float(at_fit @ bare.project(at_fit)) / max(at_fit.size - len(point), 1))
        if fit.effects:
            phi /= DEFLATION
        surface = replace(bare, phi=phi).move(point, phi * fit.covariance[np.ix_(kept, kept)])
        for _ in range(_MOVES):
            u, covariance = approximate_at_mode(surface.density, surface.density.start)
            share = expit(u)
            slope = (upper - lower) * np.maximum(share * (1.0 - share), _BESIDE * (1.0 - _BESIDE))
            surface = surface.move(surface.density.inside(u), covariance * np.outer(slope, slope))
        return surface

    def rows(self, v: np.ndarray) -> np.ndarray:
        """Return the weighted residual at v, tools and variants as fitted, what those take up added back, (m f)."""
        fitted = np.concatenate([self.fit.tool_log, self.fit.numerical])
        nuisance = np.pad(fitted, (0, len(self.nuisance) - len(fitted)))  # laws are the catalogue's at the fit
        return np.asarray((_residual(self.fit, self.density.axes, v) * self.weight).ravel() + nuisance @ self.nuisance)

    def project(self, rows: np.ndarray) -> np.ndarray:
        """Multiply rows ((m f) x ...) by the precision of what tools and variants leave of them."""
        return np.asarray(rows - self.nuisance.T @ (self.inverse @ (self.nuisance @ rows)))

    def spread_by_solvers(self, v: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """Spread draws of v (... x k) by what other solvers are worth in the effects, as wide as few tools ask."""
        worth = self.fit.worth[len(self.fit.columns) - self.fit.n_effect_columns :]
        moved = v.copy()
        for place, axis in enumerate(self.density.axes, start=_N_THETA):
            if CATALOGUE[axis.effect].bank_runs and axis.kind != "inverse":
                apart = rng.standard_normal(v.shape[:-1])
                is_shape = axis.kind == "log"
                moved[..., place] += SHAPE_APART * apart if is_shape else SIZE_APART * apart * v[..., place]
        moved[..., _N_THETA:] += rng.standard_normal((*v.shape[:-1], worth.shape[1])) @ worth.T
        # Tools are the witnesses: intervals of few are those of a t distribution (Cameron and Miller 2015).
        freedom = max(len(np.unique(self.fit.features.tool)) - 1, 1)
        middle = np.median(moved.reshape(-1, moved.shape[-1]), axis=0)[_N_THETA:]
        wider = np.sqrt(freedom / rng.chisquare(freedom, v.shape[:-1]))[..., None]
        moved[..., _N_THETA:] = middle + wider * (moved[..., _N_THETA:] - middle)
        lower, upper = self.density.lower, self.density.upper
        return np.clip(upper - np.abs(upper - (lower + np.abs(moved - lower))), lower, upper)

    def error_nats(self, points: np.ndarray) -> float:
        """Compute the standard deviation of the surface's log likelihood error, over points (n x k)."""
        exact = []
        for v in points:
            rows = self.rows(v)
            exact.append(-0.5 * float(rows @ self.project(rows)) / self.phi - self.density.log_likelihood(v))
        return float(np.std(exact))

    def move(self, v: np.ndarray, covariance: np.ndarray) -> "LikelihoodSurface":
        """Move the surface with its polynomial to an ellipsoid about v that fits within the bounds."""
        lower, upper = self.density.lower, self.density.upper
        reach = _REACH_SD * np.sqrt(np.diag(covariance))
        shrink = np.minimum(1.0, 0.45 * (upper - lower) / reach)
        point = np.clip(v, lower + shrink * reach, upper - shrink * reach)
        spread = np.linalg.cholesky(covariance * np.outer(shrink, shrink) + 1e-14 * np.eye(len(v)))
        points = np.clip(point + _points(len(v)) @ spread.T, lower + 1e-9, upper - 1e-9)
        at = np.array([_terms(w) for w in np.linalg.solve(spread, (points - point).T).T])
        coefficients = np.linalg.lstsq(at, np.array([self.rows(one) for one in points]), rcond=None)[0]
        gram = coefficients @ self.project(coefficients.T) / self.phi
        return replace(self, point=point, density=replace(self.density, middle=point, spread=spread, gram=gram))


def _vector(fit: Fit, axes: Sequence[Axis]) -> np.ndarray:
    known = {value.effect: CATALOGUE[value.effect].neutral.parameters | value.parameters for value in fit.effects}
    inner = [axis.inner(known[axis.effect][axis.name]) for axis in axes]
    return np.array([np.log(fit.theta[0]), *fit.theta[1:], *inner])


def _limits(fit: Fit, axes: Sequence[Axis], priors: ThetaPriors) -> tuple[np.ndarray, np.ndarray]:
    surfaces = fit.features.surrogate.surfaces
    low, high = zip(*(axis.limits for axis in axes), strict=True) if axes else ((), ())
    lower_ratio = max(float(surfaces.lower[1]), priors.poisson_ratio_lower)
    upper_ratio = min(float(surfaces.upper[1]), priors.poisson_ratio_upper)
    lower = np.array([np.log(0.5), surfaces.lower[0], lower_ratio, *low])
    return lower, np.array([np.log(200.0), surfaces.upper[0], upper_ratio, *high])


def _residual(fit: Fit, axes: Sequence[Axis], v: np.ndarray) -> np.ndarray:
    """Compute the whitened residual (m x f) at v, with tools and numerical errors of the fit."""
    values: dict[str, dict[str, float]] = {value.effect: {} for value in fit.effects}
    for place, axis in enumerate(axes, start=_N_THETA):
        values[axis.effect][axis.name] = axis.value(float(v[place]))
    effects = [EffectValue(effect=name, parameters=row) for name, row in values.items()]
    theta, features = np.array([np.exp(v[0]), v[1], v[2]]), fit.features
    stiffer = theta[0] / features.surrogate.centre.young_modulus_mpa
    numerical = features.numerical * np.where(IS_LIFT, 1.0, stiffer)
    predicted = features.surrogate.predict_features(theta, effects, fit.tool_factor) + np.tensordot(
        fit.numerical, numerical, 1
    )
    return features.whiten(features.measured - predicted)


def _terms(w: np.ndarray) -> np.ndarray:
    """Return 1, w and the products w_i w_j with i <= j."""
    return np.concatenate([[1.0], w, np.outer(w, w)[np.triu_indices(len(w))]])


def _term_slopes(w: np.ndarray) -> np.ndarray:
    """Compute the slopes of `_terms` by w, k x q."""
    k = len(w)
    i, j = np.triu_indices(k)
    products = np.zeros((k, len(i)))
    places = np.arange(len(i))
    np.add.at(products, (i, places), w[j])
    np.add.at(products, (j, places), w[i])
    return np.concatenate([np.zeros((k, 1)), np.eye(k), products], axis=1)


def _points(k: int) -> np.ndarray:
    """List points that determine a quadratic polynomial: the middle, both ends of each axis, one in each plane."""
    axes = _REACH_SD * np.eye(k)
    planes = [(axes[i] + axes[j]) / np.sqrt(2.0) for i, j in combinations(range(k), 2)]
    return np.array([np.zeros(k), *axes, *-axes, *planes])


def _write_warnings(r_hat: dict[str, float], n_divergences: int, error_nats: float) -> list[str]:
    worst = max(r_hat, key=r_hat.__getitem__)
    found = []
    if not r_hat[worst] <= R_HAT_LIMIT:
        found.append(f"R-hat of {worst} is {r_hat[worst]:.3f}, above {R_HAT_LIMIT}; draw more.")
    if n_divergences:
        found.append(f"{n_divergences} draws diverged; raise target_accept.")
    if error_nats > _SURFACE_LIMIT_NATS:
        found.append(
            f"intervals of material, friction and parameters are rough: the surface under their posterior is off by "
            f"{error_nats:.1f} in its logarithm, limit {_SURFACE_LIMIT_NATS:g}."
        )
    return found
