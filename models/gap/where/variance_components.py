"""How much of the gap goes with the tool, the object, both, the repeat and the order of the grasps.

Crossed random effects in the relative residual u of a phase,

    u = m + b_tool + b_object + b_tool_object + repeat + order + e,

estimated by moments: products of two grasps that share only the tool have the mean m^2 + s_tool^2, and so on. The
estimates are unbiased for any number of grasps a cell, and are sums over groups, so that intervals come from leaving
out tools and objects one by one (jackknife; Koch 1967 for the moments).
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.stats import t as student

from fast.models.gap.where.residuals import PHASES, Residuals

LEAST_OWN = 0.3  # of the spread of repeat or order: if tool and object know more, nothing can be said of it
SOURCES = ("common", "tool", "object", "tool x object", "repeat", "order", "noise")


@dataclass(frozen=True)
class PhaseComponents:
    """Where the squares of one phase come from: relative to the predicted peak, squared.

    `parts`: by `SOURCES`, with 90 % intervals; they add up to the mean square but for noise. `noise`: repeat to repeat.
    `numerical`: mean square of what numerical variants change. `order_confounding`: how much of the order is known from
    the object and the tool (1: nothing can be said about it).
    """

    phase: str
    mean_square: float
    parts: dict[str, float]
    intervals: dict[str, tuple[float, float]]
    numerical: float
    order_confounding: float

    @property
    def gap(self) -> float:
        """Mean square above repeat noise and numerical error, never negative."""
        return max(self.mean_square - self.parts["noise"] - self.numerical, 0.0)


def estimate_variance_components(residuals: Residuals) -> tuple[PhaseComponents, ...]:
    """Components of every phase that was seen in enough grasps."""
    found = []
    for place, phase in enumerate(PHASES):
        u = residuals.relative[:, place]
        is_there = np.isfinite(u)
        if is_there.sum() < 0.5 * len(u):
            continue
        rows = _Rows(u, residuals.tool, residuals.obj, residuals.repeat, residuals.order).select(is_there)
        value, low, high = jackknife(_parts_of(rows), rows.tool, rows.obj)
        numerical = residuals.numerical_relative[:, is_there, place]
        found.append(
            PhaseComponents(
                phase=phase,
                mean_square=float(np.mean(rows.u**2)),
                parts=dict(zip(SOURCES, np.maximum(value, 0.0).tolist(), strict=True)),
                intervals={s: (max(a, 0.0), max(b, 0.0)) for s, a, b in zip(SOURCES, low, high, strict=True)},
                numerical=float(np.nanmean(numerical**2)),
                order_confounding=_measure_confounding(rows),
            )
        )
    return tuple(found)


def jackknife(
    statistic: Callable[[np.ndarray], np.ndarray], tool: np.ndarray, obj: np.ndarray, level: float = 0.9
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Value of a statistic (k) of a mask of grasps (n) and the ends of its interval, k each.

    Tools and objects are left out one by one and both variances added: too wide rather than too narrow. Student's t
    with as many degrees of freedom as there are tools or objects, whichever is fewer, less one.
    """
    value = statistic(np.ones(len(tool), dtype=bool))
    variance, fewest = np.zeros_like(value), np.inf
    for cluster in (tool, obj):
        names = np.unique(cluster)
        if len(names) < 2:
            continue
        left = np.stack([statistic(cluster != name) for name in names])
        left = left[np.isfinite(left).all(axis=1)]
        if len(left) > 1:
            variance = variance + (len(left) - 1) / len(left) * ((left - left.mean(axis=0)) ** 2).sum(axis=0)
            fewest = min(fewest, len(left) - 1)
    half = student.ppf(0.5 + level / 2, max(fewest, 1) if np.isfinite(fewest) else 1) * np.sqrt(variance)
    return value, value - half, value + half


@dataclass(frozen=True, eq=False)
class _Rows:
    """Grasps of one phase, n each."""

    u: np.ndarray
    tool: np.ndarray
    obj: np.ndarray
    repeat: np.ndarray
    order: np.ndarray

    def select(self, rows: np.ndarray) -> "_Rows":
        return _Rows(*(getattr(self, name)[rows] for name in ("u", "tool", "obj", "repeat", "order")))


def _parts_of(rows: _Rows) -> Callable[[np.ndarray], np.ndarray]:
    """The sources' mean squares as a function of which grasps are used."""

    def parts(chosen: np.ndarray) -> np.ndarray:
        some = rows.select(chosen)
        repeats, order, rest = _repeat_and_order(some)
        common, tool, obj, cell, noise = _moments(rest, some.tool, some.obj)
        return np.array([common, tool, obj, cell, repeats, order, noise])

    return parts


def _moments(u: np.ndarray, tool: np.ndarray, obj: np.ndarray) -> tuple[float, float, float, float, float]:
    """Common, tool, object, tool x object and noise from means of products of pairs of grasps.

    With one repeat a cell the last two cannot be told apart; what there is then counts as tool x object.
    """
    cell = tool * (obj.max() + 1) + obj
    sums = [_squares(u, group) for group in (np.zeros_like(tool), tool, obj, cell)]
    (s_all, n_all), (s_tool, n_tool), (s_obj, n_obj), (s_cell, n_cell) = sums
    s_own, n_own = float((u**2).sum()), float(len(u))
    unrelated = _mean(s_all - s_tool - s_obj + s_cell, n_all - n_tool - n_obj + n_cell)
    same_tool, same_obj = _mean(s_tool - s_cell, n_tool - n_cell), _mean(s_obj - s_cell, n_obj - n_cell)
    own = s_own / n_own
    same_cell = _mean(s_cell - s_own, n_cell - n_own) if n_cell > n_own else own
    of_tool, of_obj = same_tool - unrelated, same_obj - unrelated
    return unrelated, of_tool, of_obj, same_cell - of_tool - of_obj - unrelated, own - same_cell


def _squares(u: np.ndarray, group: np.ndarray) -> tuple[float, float]:
    """Sum over groups of the squared sum, and of the squared number."""
    sums, counts = np.bincount(group, weights=u), np.bincount(group)
    return float(sums @ sums), float(counts @ counts)


def _mean(total: float, count: float) -> float:
    return total / count if count > 0 else 0.0


def _repeat_and_order(rows: _Rows) -> tuple[float, float, np.ndarray]:
    """Mean squares that repeat and order explain beyond tool and object, less what noise would; u without them."""
    repeats = np.unique(rows.repeat)
    columns = [(rows.repeat == r).astype(float) for r in repeats[1:]]
    n_repeat = len(columns)
    spread = rows.order.std()
    if spread > 0:
        columns.append((rows.order - rows.order.mean()) / spread)
    if not columns:
        return 0.0, 0.0, rows.u
    X = np.column_stack(columns)
    within = np.column_stack([_absorb(c, rows.tool, rows.obj) for c in X.T])
    y = _absorb(rows.u, rows.tool, rows.obj)
    scale = np.sqrt((within**2).mean(axis=0))
    kept = scale > LEAST_OWN
    beta = np.zeros(X.shape[1])
    beta[kept] = np.linalg.lstsq(within[:, kept], y, rcond=None)[0]
    left = float(np.mean((y - within @ beta) ** 2))
    centred = X - X.mean(axis=0)
    parts = []
    for some in (slice(0, n_repeat), slice(n_repeat, None)):
        effect = centred[:, some] @ beta[some]
        by_noise = left * np.count_nonzero(kept[some]) / len(y)
        parts.append(float(np.mean(effect**2)) - by_noise)
    return parts[0], parts[1], rows.u - centred @ beta


def _absorb(values: np.ndarray, tool: np.ndarray, obj: np.ndarray) -> np.ndarray:
    """Values without what tools and objects explain, by alternating means."""
    left = values - values.mean()
    for _ in range(20):
        for group in (tool, obj):
            left = left - (np.bincount(group, weights=left) / np.maximum(np.bincount(group), 1))[group]
    return np.asarray(left)


def _measure_confounding(rows: _Rows) -> float:
    total = float(np.var(rows.order))
    return 1.0 if total == 0 else 1.0 - float(np.mean(_absorb(rows.order, rows.tool, rows.obj) ** 2)) / total
