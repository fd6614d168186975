"""Methods that learn what is left from the cells: a Gaussian process, boosted trees, PySINDy's sparse regression."""

import warnings
from itertools import product
from typing import Any

import numpy as np

from tests.studies.challenge.entrants.common import MIDDLES_MM, N_BINS, Columns, Fitted, measure_left_out

_N_COMPONENTS = 3
_LENGTHS, _SHARES = (1.0, 2.0, 4.0, 8.0), (0.2, 0.5, 0.8, 0.95)  # of a kernel over scaled inputs; of the variance
_THRESHOLD, _ALPHA = 0.01, 1e-3  # of PySINDy's sequentially thresholded least squares


def weigh_process(fitted: Fitted) -> float:
    """Log evidence of Kennedy and O'Hagan's discrepancy over none, nats."""
    return sum(_fit_process(fitted, row)[0] for row in _split(fitted)[0])


def foretell_process(fitted: Fitted) -> np.ndarray:
    """What the discrepancy is of the asked grasps, m x 20: a process over design and shape for each component."""
    rows, components = _split(fitted)
    return np.asarray(
        sum(np.outer(_fit_process(fitted, row)[1], part) for row, part in zip(rows, components, strict=True))
    )


def _split(fitted: Fitted) -> tuple[np.ndarray, np.ndarray]:
    """Principal components of what is left (k x 20), and their scores (k x c)."""
    u, s, components = np.linalg.svd(fitted.rest, full_matrices=False)
    return (u[:, :_N_COMPONENTS] * s[:_N_COMPONENTS]).T, components[:_N_COMPONENTS]


def _fit_process(fitted: Fitted, scores: np.ndarray) -> tuple[float, np.ndarray]:
    """Log evidence over white noise, and the mean at the asked grasps, at the likeliest length and share."""
    x, new = fitted.inputs, fitted.asked_inputs if fitted.world.asked.tool.size else fitted.inputs[:0]
    size = max(float(np.sqrt((scores**2).mean())), 1e-12)
    y, n = scores / size, len(scores)
    apart, to_new = (((left[:, None] - x) ** 2).mean(axis=2) for left in (x, new))
    best, mean = 0.0, np.zeros(len(new))
    for length, share in product(_LENGTHS, _SHARES):
        kernel = share * np.exp(-0.5 * apart / length**2)
        root = np.linalg.cholesky(kernel + (1.0 - share) * np.eye(n))
        inner = np.linalg.solve(root, y)
        nats = float(0.5 * (y @ y - inner @ inner) - np.log(np.diag(root)).sum())
        if nats > best:
            best, mean = nats, size * share * np.exp(-0.5 * to_new / length**2) @ np.linalg.solve(root.T, inner)
    return best, mean


def score_trees(fitted: Fitted) -> float:
    """Share of what is left that boosted trees foretell of cells left out."""
    return measure_left_out(fitted, _predict_trees)


def foretell_trees(fitted: Fitted) -> np.ndarray:
    """What trees add to the asked grasps, m x 20."""
    model = _grow(fitted.inputs, fitted.cells, fitted.rest)
    return _ask_trees(model, fitted.asked_inputs, fitted.asked)


def _predict_trees(fitted: Fitted, known: np.ndarray, out: np.ndarray) -> np.ndarray:
    model = _grow(fitted.inputs[known], _take(fitted.cells, known), fitted.rest[known])
    return _ask_trees(model, fitted.inputs[out], _take(fitted.cells, out))


def _grow(inputs: np.ndarray, columns: Columns, rest: np.ndarray) -> Any:
    from sklearn.ensemble import HistGradientBoostingRegressor

    model = HistGradientBoostingRegressor(
        max_iter=40, learning_rate=0.15, max_leaf_nodes=12, min_samples_leaf=40, l2_regularization=1.0, random_state=0
    )
    return model.fit(_list_rows(inputs, columns), rest.ravel())


def _ask_trees(model: Any, inputs: np.ndarray, columns: Columns) -> np.ndarray:
    found = model.predict(_list_rows(inputs, columns))
    return np.asarray(found.reshape(len(inputs), N_BINS))


def _list_rows(inputs: np.ndarray, columns: Columns) -> np.ndarray:
    return np.column_stack([np.repeat(inputs, N_BINS, axis=0), _list_terms(columns).reshape(-1, 4)])


def score_sparse(fitted: Fitted) -> float:
    """Share of what is left that PySINDy's sparse polynomial foretells of cells left out."""
    return measure_left_out(fitted, _predict_sparse)


def foretell_sparse(fitted: Fitted) -> np.ndarray:
    """What the polynomial adds to the asked grasps, m x 20."""
    return _ask_sparse(fitted.cells, fitted.rest, fitted.asked)


def _predict_sparse(fitted: Fitted, known: np.ndarray, out: np.ndarray) -> np.ndarray:
    return _ask_sparse(_take(fitted.cells, known), fitted.rest[known], _take(fitted.cells, out))


def _ask_sparse(columns: Columns, rest: np.ndarray, new: Columns) -> np.ndarray:
    """PySINDy takes what is left for a derivative of a state: lift, force, its slope, its change by friction."""
    import pysindy

    terms, asked = (_list_terms(one).reshape(-1, 4) for one in (columns, new))
    target = rest.reshape(-1, 1)
    target = np.hstack([target, np.zeros((len(target), terms.shape[1] - 1))])
    model = pysindy.SINDy(
        optimizer=pysindy.STLSQ(threshold=_THRESHOLD, alpha=_ALPHA),
        feature_library=pysindy.PolynomialLibrary(degree=2),
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a threshold that takes all terms is an answer: nothing is left
        model.fit(terms, t=1.0, x_dot=target)
        found = np.asarray(model.predict(asked))[:, 0]
    return np.asarray(found.reshape(len(new.force), N_BINS))


def _list_terms(columns: Columns) -> np.ndarray:
    """Lift over 40 mm, force, slope and change by friction of each step, n x 20 x 4."""
    lift = np.broadcast_to(MIDDLES_MM / 40.0, columns.force.shape)
    return np.stack([lift, columns.force, columns.slope, 100.0 * columns.friction], axis=2)


def _take(columns: Columns, rows: np.ndarray) -> Columns:
    return Columns(*(getattr(columns, name)[rows] for name in ("steps_n", "peak_n", "force", "slope", "friction")))
