"""Functions that the data allow, drawn from the joint posterior of measured and simulated, to be asked at any design.

Each is a way the bench may be. What all of them say is known; what they disagree about is not.

    f_i(x) = m(x) + w (g_i(x) + k(x, data) (K + noise)^-1 (0 - g_i(data) - noise_i))

with g_i a draw of the prior, by random Fourier features (Wilson et al. 2020, Eq. 13), and w >= 1 the factor by which
left-out tools say that the surrogate is too sure. Features of a finite number are a tenth too narrow or too wide where
the data leave little open, so that the spread over the points that are asked is brought to that of the posterior.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.linalg import cho_solve
from scipy.special import gammaincinv, ndtri

from fast.models.gaussian_process.matern import matern52
from fast.models.scientist.surrogate.fit import SUBSET_SIZE
from fast.models.scientist.surrogate.likelihood import log_posterior
from fast.models.scientist.surrogate.observations import REAL, SIM, ObservationSet
from fast.models.scientist.surrogate.parameters import Standardisation, SurrogateParameters, Vector, bounds
from fast.models.scientist.surrogate.posterior import Surrogate, loadings, observation_variance

N_WORLDS = 128
N_GROUPS, N_GROUPS_OF_MANY = 8, 2  # of worlds with parameters of their own; many data leave less open, and cost more
_N_FREQUENCIES = 512  # of each process: correlations of the prior are right to 4 %
_N_COMPARED = 32  # points at which the spread is compared with that of the posterior
_DEGREES = 5.0  # twice the smoothness of Matern-5/2: its spectral density is a t distribution of so many degrees
_BLOCK = 4096  # points asked at once
_STEP = 0.05  # of a parameter's logarithm (of rho, of a correlation) between two gradients
_LEAST_CURVATURE = 0.5  # the priors alone have 1 and more; noise of the differences may take it below
_DEEPEST, _SHRINK, _TRIES = 12.0, 0.7, 6  # how far below the top a draw may lie, else it is drawn closer
_WIDEST = 2.0  # a surrogate that is wrong by more is no base for advice; its health says so


class Outcomes(NamedTuple):
    """What every world says of m points, m x n each, in the units of the data: on the bench, and in the simulator."""

    real: np.ndarray
    sim: np.ndarray


@dataclass(frozen=True, eq=False)
class _Prior:
    """Draws of one process: frequencies (f x d) and weights of their cosines and sines (2 f x n)."""

    frequencies: np.ndarray
    weights: np.ndarray

    @classmethod
    def draw(cls, lengthscales: np.ndarray, sd: float, n: int, rng: np.random.Generator) -> "_Prior":
        # Every stretch of the heavy tail once: what is left of a variance near data hangs on it.
        strata = (rng.permutation(_N_FREQUENCIES) + rng.random(_N_FREQUENCIES)) / _N_FREQUENCIES
        radii = np.sqrt(_DEGREES / (2.0 * gammaincinv(0.5 * _DEGREES, strata)))
        frequencies = rng.normal(size=(_N_FREQUENCIES, len(lengthscales))) * radii[:, None] / lengthscales
        scale = sd / np.sqrt(_N_FREQUENCIES)
        return cls(frequencies, scale * rng.normal(size=(2 * _N_FREQUENCIES, n)))

    def at(self, x: np.ndarray) -> np.ndarray:
        """Return the values at m points, m x n."""
        phase = (x @ self.frequencies.T).astype(np.float32)  # cosines at a quarter of the time, right to a millionth
        features = np.empty((len(x), 2 * _N_FREQUENCIES), dtype=np.float32)
        np.cos(phase, out=features[:, :_N_FREQUENCIES])
        np.sin(phase, out=features[:, _N_FREQUENCIES:])
        return np.asarray(features @ self.weights.astype(np.float32), dtype=float)


@dataclass(frozen=True, eq=False)
class Worlds:
    """N_WORLDS functions of the design, on the bench and in the simulator, each as likely as the others.

    surrogate: the fit. widen: how much wider than the posterior they spread around its mean. Groups of them have
    parameters of their own, drawn around those of the fit, which the data do not know exactly.
    """

    surrogate: Surrogate
    widen: float
    groups: tuple["_Group", ...]

    @classmethod
    def draw(
        cls, surrogate: Surrogate, rng: np.random.Generator, n: int = N_WORLDS, widen: float | None = None
    ) -> "Worlds":
        """Draw n worlds; `widen` is `widening` of the surrogate; where it is given, all have the fit's parameters."""
        given = widening(surrogate) if widen is None else widen
        if widen is not None:
            return cls(surrogate, given, (_Group.draw(surrogate, rng, n),))
        n_groups = N_GROUPS if len(surrogate.data) <= SUBSET_SIZE else N_GROUPS_OF_MANY
        parameters = draw_parameters(surrogate, n_groups, rng)
        models = [Surrogate.condition(surrogate.data, one) for one in parameters]
        return cls(surrogate, given, tuple(_Group.draw(model, rng, n // n_groups) for model in models))

    @property
    def n(self) -> int:
        """How many there are."""
        return sum(group.n for group in self.groups)

    def at(self, x: np.ndarray) -> Outcomes:
        """Return what the worlds say of m points (m x d), without noise."""
        told = [group.at(x, self.widen) for group in self.groups]
        return Outcomes(*(np.concatenate(part, axis=1) for part in zip(*told, strict=True)))

    def forces_n(self, x: np.ndarray) -> np.ndarray:
        """Return the measured outcome of m points in every world, m x n, in N (or the unit of the outcome)."""
        return self.surrogate.data.force_n(self.at(x).real)

    def simulated_n(self, x: np.ndarray) -> np.ndarray:
        """Return the simulated outcome of m points in every world, m x n, in N."""
        return self.surrogate.data.force_n(self.at(x).sim)


@dataclass(frozen=True, eq=False)
class _Group:
    """Worlds with the parameters of one surrogate; weights: n_data x (n + 1), of every world and of the mean."""

    surrogate: Surrogate
    prior_h: _Prior
    prior_e: _Prior
    weights: np.ndarray

    @classmethod
    def draw(cls, surrogate: Surrogate, rng: np.random.Generator, n: int) -> "_Group":
        p, data = surrogate.parameters, surrogate.data
        h = _Prior.draw(np.array(p.lengthscales_h), p.sd_h, n, rng)
        e = _Prior.draw(np.array(p.lengthscales_e), p.sd_e, n, rng)
        of_h, of_e = loadings(p, data.s)
        drawn = of_h[:, None] * h.at(data.x) + of_e[:, None] * e.at(data.x)
        noise = np.sqrt(observation_variance(p, data.s) + data.noise_variance)
        drawn += noise[:, None] * rng.normal(size=drawn.shape)
        drawn += _own_of_priors(p, data, n, rng)
        weights = cho_solve((surrogate.factor, True), -drawn, check_finite=False)
        return cls(surrogate, h, e, np.column_stack([weights, surrogate.weights]))

    @property
    def n(self) -> int:
        return self.weights.shape[1] - 1

    def at(self, x: np.ndarray, widen: float) -> Outcomes:
        blocks = [self._block(x[start : start + _BLOCK]) for start in range(0, len(x), _BLOCK)]
        mean, apart = (np.concatenate(part, axis=1) for part in zip(*blocks, strict=True))
        some = np.linspace(0, len(x) - 1, min(len(x), _N_COMPARED)).astype(int)
        for s in (REAL, SIM):
            sd = self.surrogate.predict(x[some], s)[1]
            apart[s] *= widen * np.sqrt(np.mean(sd**2) / max(float(np.mean(apart[s][some] ** 2)), 1e-300))
        return Outcomes(mean[REAL] + apart[REAL], mean[SIM] + apart[SIM])

    def _block(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the mean (2 x m x 1), and how far each world is from it (2 x m x n), simulated first."""
        p, data = self.surrogate.parameters, self.surrogate.data
        of_h, of_e = loadings(p, data.s)
        h = matern52(x, data.x, np.array(p.lengthscales_h), p.sd_h) @ (of_h[:, None] * self.weights)
        rows = np.flatnonzero(of_e)
        e = matern52(x, data.x[rows], np.array(p.lengthscales_e), p.sd_e) @ (of_e[rows, None] * self.weights[rows])
        mean = np.array([p.mean_sim + h[:, -1:], p.mean_real + p.rho * h[:, -1:] + e[:, -1:]])
        h, e = h[:, :-1] + self.prior_h.at(x), e[:, :-1] + self.prior_e.at(x)
        return mean, np.array([h, p.rho * h + e])


def widening(surrogate: Surrogate) -> float:
    """Find by which factor measured tools, each predicted from the others, are further off than the model says; >= 1.

    The nine tenths of the standardised errors that are smallest end at 1.64 where the surrogate is right. Parameters of
    the surrogate were fitted with the left-out tool, so that few tools look better than they are: the factor
    sqrt(n / (n - d)) of a linear fit stands for that.
    """
    left_out, is_real = surrogate.leave_one_out(), surrogate.data.s == REAL
    n, d = int(is_real.sum()), surrogate.data.x.shape[1]
    if n < 2:
        return 1.0
    z = np.abs(surrogate.data.y - left_out.mean)[is_real] / left_out.sd[is_real]
    found = float(np.quantile(z, 0.9) / ndtri(0.95))
    return float(np.clip(max(found, 1.0) * np.sqrt(n / max(n - d, 0.5 * n)), 1.0, _WIDEST))


def _own_of_priors(p: SurrogateParameters, data: ObservationSet, n: int, rng: np.random.Generator) -> np.ndarray:
    """Draw what the tools of each prior campaign have of their own (`PriorLink`), at the data, n_data x n."""
    own = np.zeros((len(data), n))
    for place, link in enumerate(p.priors):
        rows = np.flatnonzero(data.s == REAL + 1 + place)
        h = _Prior.draw(np.array(p.lengthscales_h), p.rho * p.sd_h, n, rng).at(data.x[rows])
        e = _Prior.draw(np.array(p.lengthscales_e), p.sd_e, n, rng).at(data.x[rows])
        own[rows] = link.gain * np.sqrt(1.0 - link.correlation**2) * (h + e)
    return own


def draw_parameters(surrogate: Surrogate, n: int, rng: np.random.Generator) -> list[SurrogateParameters]:
    """Draw n times the parameters around those of the fit: how well the data know them.

    The log posterior is taken as a parabola around its top (Laplace's approximation; Rasmussen and Williams, 3.4). Its
    curvature is found from differences of the gradient, on a subset of the simulations where there are many: fewer data
    know less, so that the draws are rather too wide.
    """
    units = Standardisation.of(surrogate.data)
    data = units.apply(_thin(surrogate.data, rng))
    top = Vector.from_parameters(surrogate.parameters, units)
    lower, upper = np.array(bounds(top.n_dims, top.n_prior)).T
    highest = log_posterior(top, data)[0]
    values, vectors = np.linalg.eigh(-_curvature(top, data))
    scales = vectors / np.sqrt(np.maximum(values, _LEAST_CURVATURE))
    found = []
    for _ in range(n):
        step = scales @ rng.normal(size=len(top.values))
        for _ in range(_TRIES):
            drawn = Vector(np.clip(top.values + step, lower, upper), top.n_prior)
            if log_posterior(drawn, data)[0] > highest - _DEEPEST:
                break
            step = _SHRINK * step
        found.append(drawn.to_parameters(units))
    return found


def _curvature(top: Vector, data: ObservationSet) -> np.ndarray:
    """Return the second derivatives of the log posterior at its top, square."""
    rows = []
    for column in range(len(top.values)):
        step = np.zeros_like(top.values)
        step[column] = _STEP
        ahead, behind = (log_posterior(Vector(top.values + s * step, top.n_prior), data)[1] for s in (1.0, -1.0))
        rows.append((ahead - behind) / (2.0 * _STEP))
    found = np.array(rows)
    return 0.5 * (found + found.T)


def _thin(data: ObservationSet, rng: np.random.Generator) -> ObservationSet:
    """Keep what was measured, and so many of the simulations that there are `SUBSET_SIZE` at most."""
    sim = np.flatnonzero(data.s == SIM)
    n_left = max(SUBSET_SIZE - (len(data) - len(sim)), 0)
    kept = sim if len(sim) <= n_left else np.sort(rng.choice(sim, n_left, replace=False))
    return data.take(np.concatenate([kept, np.flatnonzero(data.s != SIM)]))
