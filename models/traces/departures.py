"""How far a grasp departs from its repeats, as p-values."""

import numpy as np
from scipy.special import stdtr, stdtrit

_BIN = 60  # departures that a scale is estimated from
_MOST_BINS = 8
_TAIL = 0.05  # of all departures are excesses as far out as the one that the scale is taken from
FREEDOM = 5.0  # degrees of freedom; chosen on grasps of the virtual bench with nothing wrong


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


def p_values(shortfalls: np.ndarray, level: np.ndarray, least_scale: float, freedom: float = FREEDOM) -> np.ndarray:
    """Probability (n) that so large a shortfall, or a larger, comes by chance; NaN where there is no shortfall.

    Chance is as likely to give an excess, and nothing that goes wrong does: the excesses among the n say how far chance
    goes. Over their scale, which may depend on `level`, shortfalls are taken to follow a t-distribution.

    Args:
        shortfalls: n, of one unit; positive is suspicious.
        level: n, what their scale may depend on, such as the force.
        least_scale: of the shortfalls' unit; what is smaller is not told apart.
        freedom: degrees of freedom of the t-distribution; fewer, heavier tails.
    """
    found, is_known = np.full(len(shortfalls), np.nan), np.isfinite(shortfalls)
    if is_known.sum() < _BIN:
        return found
    scale = _scale(shortfalls[is_known], level[is_known], freedom)
    found[is_known] = stdtr(freedom, -shortfalls[is_known] / np.maximum(scale, least_scale))
    return found


def _scale(shortfalls: np.ndarray, level: np.ndarray, freedom: float) -> np.ndarray:
    """Scale at each of n: of the excesses in its bin of like level, linear between the middles of bins."""
    n_bins = int(np.clip(len(shortfalls) // _BIN, 1, _MOST_BINS))
    parts = np.array_split(np.argsort(level, kind="stable"), n_bins)
    middles = np.array([np.median(level[part]) for part in parts])
    far = stdtrit(freedom, 1.0 - _TAIL)
    scales = np.array([np.quantile(-np.minimum(shortfalls[part], 0.0), 1.0 - _TAIL) / far for part in parts])
    return np.interp(level, middles, scales)
