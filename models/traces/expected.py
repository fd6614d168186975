"""What is expected of each tool on each object: the simulator, put right by what its tools and objects do elsewhere.

A quantity is measured in many cells (a tool on an object) and simulated in most of them. Measured less simulated is

    d(t, o) = a + b(t) + c(o) + e(t, o),    e ~ s * t(v)

a: what the simulator has wrong everywhere; b, c: what is special of a tool and an object; e: the rest, with wide tails.
b and c are shrunk towards 0 by as much as their own spread over the table says. A cell is held against what the others
say of it: its own value is taken out of the fit. Scale s and freedom v come from the same rest, of which a share may be
faults: these make a quantity fall and never rise, so that what rises says how far chance goes.
"""

from dataclasses import dataclass

import numpy as np
from scipy.special import gammaln, stdtr

LEAST_CELLS = 30  # fewer do not say how wide the tails are
_FIT_FREEDOM = 4.0  # of the weights of the fit; the tails that p-values use are fitted afterwards
_N_ROUNDS = 30
_FREEDOMS = np.array([2.0, 3.0, 4.0, 6.0, 10.0, 30.0])
_SHARES = np.array([1e-3, 0.01, 0.03, 0.06, 0.12, 0.2])
_N_SCALES = 60


@dataclass(frozen=True)
class Chance:
    """How far chance goes: scale (unit of the quantity), degrees of freedom of the t-distribution, share of faults."""

    scale: float
    freedom: float
    share: float

    def p_of(self, shortfall: np.ndarray) -> np.ndarray:
        """Return the probability that chance falls as short, or shorter."""
        return np.asarray(stdtr(self.freedom, -shortfall / self.scale))


def predict_cells(difference: np.ndarray, tool: np.ndarray, object_id: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Predict the difference that other cells lead to expect of each of n cells, and how its error grows so (n, >= 1).

    Args:
        difference: n, measured less simulated, finite.
        tool: n, any labels.
        object_id: n, any labels.
    """
    tools, row = np.unique(tool, return_inverse=True)
    objects, column = np.unique(object_id, return_inverse=True)
    n_tools, n_objects = len(tools), len(objects)
    at = np.stack([np.zeros_like(row), 1 + row, 1 + n_tools + column])  # the terms of a cell: all, its tool, its object
    weight, middle = np.ones(len(difference)), float(np.median(difference))
    variance = max(float(np.median(np.abs(difference - middle))) * 1.4826, 1e-6) ** 2
    spread = np.array([variance, variance])  # of tools, of objects
    for _ in range(_N_ROUNDS):
        ridge = np.concatenate([[1e-9], np.full(n_tools, 1.0 / spread[0]), np.full(n_objects, 1.0 / spread[1])])
        n_terms = len(ridge)
        pairs = (n_terms * at[:, None] + at[None, :]).reshape(9, -1)  # nine entries of the normal matrix for each cell
        normal = np.bincount(pairs.ravel(), np.tile(weight, 9), n_terms**2).reshape(n_terms, n_terms)
        inverse = np.linalg.inv(normal / variance + np.diag(ridge))
        sums = np.bincount(at.ravel(), np.tile(weight * (difference - middle), 3), n_terms)
        terms = inverse @ sums / variance
        rest = difference - middle - terms[at].sum(axis=0)
        weight = (_FIT_FREEDOM + 1.0) / (_FIT_FREEDOM + rest**2 / variance)
        diagonal = np.diag(inverse)
        unsure = inverse.ravel()[pairs].sum(axis=0)  # variance of a cell's sum of terms
        variance = max(float((weight * (rest**2 + unsure)).mean()), 1e-9)
        spread = np.array(
            [
                max(float((terms[part] ** 2 + diagonal[part]).mean()), 1e-6 * variance)
                for part in (slice(1, 1 + n_tools), slice(1 + n_tools, None))
            ]
        )
    leverage = np.clip(weight * unsure / variance, 0.0, 0.95)
    return difference - rest / (1.0 - leverage), 1.0 / np.sqrt(1.0 - leverage)


def fit_chance(shortfall: np.ndarray, least_scale: float) -> Chance:
    """Fit the chance that explains n shortfalls best: t-distributed, but for a share of faults, with any shortfalls.

    Args:
        shortfall: n, positive is suspicious.
        least_scale: what is smaller is not told apart.
    """
    far = max(float(np.abs(shortfall).max()), 10.0 * least_scale)
    usual = max(float(np.median(np.abs(shortfall))), least_scale)
    scales = np.geomspace(max(0.3 * usual, least_scale), max(6.0 * usual, 2.0 * least_scale), _N_SCALES)
    of_fault = np.where(shortfall > 0, 1.0 / far, 0.0)
    best, chance = -np.inf, Chance(usual, _FREEDOMS[0], 0.0)
    for freedom in _FREEDOMS:
        sound = _density(shortfall[None, :] / scales[:, None], freedom) / scales[:, None]
        mixed = (1.0 - _SHARES)[:, None, None] * sound + _SHARES[:, None, None] * of_fault
        likelihood = np.log(mixed).sum(axis=2)
        share, scale = np.unravel_index(int(likelihood.argmax()), likelihood.shape)
        if likelihood[share, scale] > best:
            best = likelihood[share, scale]
            chance = Chance(float(scales[scale]), float(freedom), float(_SHARES[share]))
    return chance


def find_shortfalls(
    difference: np.ndarray,
    tool: np.ndarray,
    object_id: np.ndarray,
    least_scale: float,
    usual_chance: Chance | None = None,
) -> tuple[np.ndarray, np.ndarray, Chance]:
    """Find how much less each of n cells is than expected, its own chance's scale over the common one, and chance.

    Some tools and objects are harder to predict than others. How much is read off the size of the other cells' rests,
    by the same fit on their logarithms. Shortfalls divided by that scale follow `Chance`.

    Args:
        difference: n, measured less simulated, finite.
        tool: n, any labels.
        object_id: n, any labels.
        least_scale: what is smaller is not told apart, in the unit of the difference.
        usual_chance: of fewer than `LEAST_CELLS`, which do not say how wide their tails are.
    """
    expected, growth = predict_cells(difference, tool, object_id)
    shortfall = expected - difference
    if usual_chance is not None and len(difference) < LEAST_CELLS:
        return shortfall, growth, usual_chance
    sizes = np.log(np.abs(shortfall / growth) + least_scale)
    usual, _ = predict_cells(sizes, tool, object_id)
    own = np.exp(usual - np.median(usual)) * growth
    return shortfall, own, fit_chance(shortfall / own, least_scale)


def _density(x: np.ndarray, freedom: float) -> np.ndarray:
    """Return the density of the t-distribution."""
    log_scale = gammaln(0.5 * (freedom + 1.0)) - gammaln(0.5 * freedom) - 0.5 * np.log(np.pi * freedom)
    return np.asarray(np.exp(log_scale - 0.5 * (freedom + 1.0) * np.log1p(x**2 / freedom)))
