"""How far a grasp departs from its repeats and from what its tool and object lead to expect, as p-values."""

import numpy as np
from scipy.stats import t as student

_BIN = 60  # departures that a scale is estimated from
_MOST_BINS = 8
_NORMAL_MAD = 1.4826  # standard deviation of a normal distribution over its median absolute deviation
_TAIL, _BULK = 0.975, 0.75  # quantiles whose ratio tells how heavy the tails are
_FREEDOMS = np.concatenate([np.arange(1.0, 6.0, 0.25), np.arange(6.0, 31.0, 1.0), [1e6]])
_N_POLISH = 10


def shortfall_to_repeats(values: np.ndarray, group: np.ndarray) -> np.ndarray:
    """How much less each of n values is than the nearest of its repeats, which have the same `group`; NaN: it has none.

    The nearest, so that of three repeats the odd one departs and the other two do not.
    """
    order = np.argsort(group, kind="stable")
    edges = np.flatnonzero(np.diff(group[order])) + 1
    found = np.full(len(values), np.nan)
    for places in np.split(order, edges):
        if len(places) < 2:
            continue
        gaps = values[places][None, :] - values[places][:, None]
        np.fill_diagonal(gaps, np.inf)
        found[places] = gaps[np.arange(len(places)), np.abs(gaps).argmin(axis=1)]
    return found


def shortfall_to_peers(values: np.ndarray, tool: np.ndarray, object_id: np.ndarray) -> np.ndarray:
    """How much less each of n values is than its tool and its object together lead to expect; NaN without peers.

    Expected is a + b(tool) + c(object), by Tukey's median polish of the medians over the repeats (Exploratory Data
    Analysis, 1977, chapter 11): a few odd cells do not move it.
    """
    tools, row = np.unique(tool, return_inverse=True)
    objects, column = np.unique(object_id, return_inverse=True)
    if min(len(tools), len(objects)) < 3:
        return np.full(len(values), np.nan)
    cell = row * len(objects) + column
    table = np.full(len(tools) * len(objects), np.nan)
    order = np.argsort(cell, kind="stable")
    for places in np.split(order, np.flatnonzero(np.diff(cell[order])) + 1):
        table[cell[places[0]]] = np.median(values[places])
    rest = table.reshape(len(tools), len(objects))
    expected = np.zeros_like(rest)
    for _ in range(_N_POLISH):
        for axis in (1, 0):
            middle = np.nanmedian(rest, axis=axis, keepdims=True)
            rest, expected = rest - middle, expected + middle
    return np.asarray(expected.ravel()[cell] - values)


def p_values(shortfalls: np.ndarray, level: np.ndarray, least_scale: float) -> np.ndarray:
    """Probability (n) that so large a shortfall, or a larger, comes by chance; NaN where there is no shortfall.

    All shortfalls together say what chance is: most grasps are as they should be. Their scale, a robust one, may depend
    on `level` (n; such as the force); over it they follow a t-distribution whose degrees of freedom match the ratio of
    two of their quantiles.

    Args:
        shortfalls: n, of one unit; positive is suspicious.
        level: n, what their scale may depend on.
        least_scale: of the shortfalls' unit; what is smaller is not told apart.
    """
    found, is_known = np.full(len(shortfalls), np.nan), np.isfinite(shortfalls)
    if is_known.sum() < _BIN:
        return found
    scores = shortfalls[is_known] / np.maximum(_scale(shortfalls[is_known], level[is_known]), least_scale)
    found[is_known] = student.sf(scores, _freedom(scores))
    return found


def _scale(values: np.ndarray, level: np.ndarray) -> np.ndarray:
    """Scale of each of n values: of its bin of like level, linear between the middles of bins."""
    n_bins = int(np.clip(len(values) // _BIN, 1, _MOST_BINS))
    parts = np.array_split(np.argsort(level, kind="stable"), n_bins)
    middles = np.array([np.median(level[part]) for part in parts])
    scales = np.array([_NORMAL_MAD * np.median(np.abs(values[part])) for part in parts])
    return np.interp(level, middles, scales)


def _freedom(scores: np.ndarray) -> float:
    """Degrees of freedom of the t-distribution with as heavy tails as the scores, 1 to (in effect) infinite."""
    bulk, tail = np.quantile(np.abs(scores), [2.0 * _BULK - 1.0, 2.0 * _TAIL - 1.0])
    if bulk <= 0.0:
        return 1.0
    ratios = student.ppf(_TAIL, _FREEDOMS) / student.ppf(_BULK, _FREEDOMS)
    return float(_FREEDOMS[np.argmin(np.abs(ratios - tail / bulk))])
