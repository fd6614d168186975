"""Where the dense panels of a multifrontal factorisation lie in memory, and how they pass on to each other.

Panel s is a column-major matrix with its own rows first, then the rows below, each padded to whole tiles. Its update,
the square matrix that it contributes to the rows below, stays on one of two stacks until the panel over it has
taken it in: one stack is for even depths of the tree, the other for odd ones, so that a panel's own update never lies
on those of its children.
"""

from typing import NamedTuple

import numba as nb
import numpy as np

from fast.models.simulation.solver.cholesky.pattern import BlockPattern
from fast.models.simulation.solver.cholesky.tiles import TILE


class Layout(NamedTuple):
    """Places in one array of `size` doubles; rows and columns are counted in doubles unless said otherwise.

    Lists for every panel are in compressed form: those of panel s are from `ptr[s]` to `ptr[s + 1]`.
    """

    starts: np.ndarray
    """First block column of each panel (p), and the number of all."""
    width: np.ndarray
    """(p) columns, which are its own rows."""
    own: np.ndarray
    """(p) own rows with the padding."""
    below: np.ndarray
    """(p) rows below them."""
    stride: np.ndarray
    """(p) between its columns."""
    place: np.ndarray
    """(p + 1) where it starts, and where the last one ends."""
    update: np.ndarray
    """(p) where its update starts."""
    row_ptr: np.ndarray
    """(p + 1) of `rows`."""
    rows: np.ndarray
    """The block rows below every panel, ascending."""
    run_ptr: np.ndarray
    """(p + 1) of `runs`."""
    runs: np.ndarray
    """(r, 3) where the rows below a panel are in the panel over it: first row below the panel, its row there, and for
    how many rows this holds."""
    child_ptr: np.ndarray
    """(p + 1) of `children`."""
    children: np.ndarray
    """The panels that it is over."""
    block_ptr: np.ndarray
    """(p + 1) of `block`."""
    block: np.ndarray
    """Where the blocks of the pattern start in the array."""
    vector: int
    """Where one panel's part of a vector is."""
    size: int
    """Doubles in all."""


def panel_layout(pattern: BlockPattern) -> Layout:
    """Make the layout for the panels of a pattern."""
    starts, over = pattern.panels, pattern.over
    row_ptr, rows = _rows_below(pattern.indptr, pattern.indices, starts, over)
    width, below = 3 * np.diff(starts), 3 * np.diff(row_ptr)
    own = _padded(width)
    stride = own + _padded(below)
    place = np.concatenate([[0], np.cumsum(stride * own)])
    update, end = _stacks(over, (stride - own) ** 2, place[-1])
    run_ptr, runs = _runs(starts, own, over, row_ptr, rows)
    children = np.argsort(over, kind="stable")
    return Layout(
        starts=starts,
        width=width,
        own=own,
        below=below,
        stride=stride,
        place=place,
        update=update,
        row_ptr=row_ptr,
        rows=rows,
        run_ptr=run_ptr,
        runs=runs,
        child_ptr=np.searchsorted(over[children], np.arange(len(starts))),
        children=children,
        block_ptr=pattern.indptr[starts].astype(np.int64),
        block=_block_places(pattern.indptr, pattern.indices, starts, own, row_ptr, rows, place, stride),
        vector=int(end),
        size=int(end + stride.max()),
    )


def _padded(counts: np.ndarray) -> np.ndarray:
    """Return the next multiples of the tile size."""
    return (counts + TILE - 1) // TILE * TILE


@nb.njit(cache=True, nogil=True)
def _rows_below(
    ptr: np.ndarray, indices: np.ndarray, starts: np.ndarray, over: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Block rows below every panel, ascending: those of its columns and of its children."""
    n, n_panels = len(ptr) - 1, len(over)
    child, sibling, mark = np.full(n_panels, -1), np.full(n_panels, -1), np.full(n, -1)
    row_ptr, rows, k = np.zeros(n_panels + 1, np.int64), np.zeros(8 * n, np.int64), 0
    for s in range(n_panels):
        if k + n > len(rows):
            rows = np.concatenate((rows, np.zeros(len(rows) + n, np.int64)))
        end = starts[s + 1]
        for i in indices[ptr[starts[s]] : ptr[end]]:
            if i >= end and mark[i] != s:
                mark[i], rows[k] = s, i
                k += 1
        c = child[s]
        while c >= 0:
            for i in rows[row_ptr[c] : row_ptr[c + 1]]:
                if i >= end and mark[i] != s:
                    mark[i], rows[k] = s, i
                    k += 1
            c = sibling[c]
        rows[row_ptr[s] : k].sort()
        row_ptr[s + 1] = k
        if over[s] >= 0:
            sibling[s], child[over[s]] = child[over[s]], s
    return row_ptr, rows[:k].copy()


@nb.njit(cache=True, nogil=True)
def _stacks(over: np.ndarray, sizes: np.ndarray, start: int) -> tuple[np.ndarray, int]:
    """Return the places of the updates on two stacks that begin at `start`, and their end."""
    n = len(over)
    parity, lowest, update = np.zeros(n, np.int64), np.full(n, -1), np.zeros(n, np.int64)
    for s in range(n - 1, -1, -1):
        if over[s] >= 0:
            parity[s] = 1 - parity[over[s]]
    top, peak = np.zeros(2, np.int64), np.zeros(2, np.int64)
    for s in range(n):
        k = parity[s]
        update[s] = top[k]
        top[k] += sizes[s]
        peak[k] = max(peak[k], top[k])
        if lowest[s] >= 0:
            top[1 - k] = lowest[s]
        if over[s] >= 0 and lowest[over[s]] < 0:
            lowest[over[s]] = update[s]
    return start + update + parity * peak[0], start + peak[0] + peak[1]


@nb.njit(cache=True, nogil=True)
def _runs(
    starts: np.ndarray, own: np.ndarray, over: np.ndarray, row_ptr: np.ndarray, rows: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """See `Layout`; a run does not go on from the own rows of a panel to those below it."""
    n_panels, k = len(over), 0
    run_ptr, runs = np.zeros(n_panels + 1, np.int64), np.zeros((len(rows), 3), np.int64)
    for s in range(n_panels):
        t, is_own = over[s], False
        q = row_ptr[t] if t >= 0 else 0
        for p in range(row_ptr[s], row_ptr[s + 1]):
            was_own, is_own = is_own, rows[p] < starts[t + 1]
            while not is_own and rows[q] != rows[p]:
                q += 1
            low = 3 * (rows[p] - starts[t]) if is_own else own[t] + 3 * (q - row_ptr[t])
            if p > row_ptr[s] and is_own == was_own and low == runs[k - 1, 1] + runs[k - 1, 2]:
                runs[k - 1, 2] += 3
            else:
                runs[k, 0], runs[k, 1], runs[k, 2] = 3 * (p - row_ptr[s]), low, 3
                k += 1
        run_ptr[s + 1] = k
    return run_ptr, runs[:k].copy()


@nb.njit(cache=True, nogil=True)
def _block_places(
    ptr: np.ndarray,
    indices: np.ndarray,
    starts: np.ndarray,
    own: np.ndarray,
    row_ptr: np.ndarray,
    rows: np.ndarray,
    place: np.ndarray,
    stride: np.ndarray,
) -> np.ndarray:
    """Find the place of the first entry of every block of the pattern in its panel."""
    places = np.zeros(len(indices), np.int64)
    for s in range(len(stride)):
        for j in range(starts[s], starts[s + 1]):
            q = row_ptr[s]
            for p in range(ptr[j], ptr[j + 1]):
                i = indices[p]
                while i >= starts[s + 1] and rows[q] != i:
                    q += 1
                low = 3 * (i - starts[s]) if i < starts[s + 1] else own[s] + 3 * (q - row_ptr[s])
                places[p] = place[s] + 3 * (j - starts[s]) * stride[s] + low
    return places
