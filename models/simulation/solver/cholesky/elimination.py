"""Elimination tree of a symmetric matrix, and the panels of columns that are factorised as one dense matrix.

Columns are named by their place in the elimination order; the parent of a column is the first row below the diagonal
of its factor. See Davis, "Direct methods for sparse linear systems" (2006), chapter 4, and for the merging of panels
Ashcraft and Grimes, "The influence of relaxed supernode partitions on the multifrontal method" (1989).
"""

import numba as nb
import numpy as np

# Time model of one panel, fitted on an AMD EPYC (Zen 4): a fixed cost, per entry that is moved, and per multiply-add.
# Factorisation times change by less than 5 % when any of them changes by a factor of two.
PANEL_S, ENTRY_S, PRODUCT_S = 4e-7, 4e-10, 2.5e-11


@nb.njit(cache=True, nogil=True)
def elimination_tree(ptr: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Find the parent (n) of every column, -1 for a root; the pattern has both triangles. Davis, section 4.1."""
    n = len(ptr) - 1
    parent, ancestor = np.full(n, -1, np.int32), np.full(n, -1, np.int32)
    for j in range(n):
        for p in range(ptr[j], ptr[j + 1]):
            i = rows[p]
            while i != -1 and i < j:
                above = ancestor[i]
                ancestor[i] = j
                if above == -1:
                    parent[i] = j
                i = above
    return parent


@nb.njit(cache=True, nogil=True)
def postorder(parent: np.ndarray) -> np.ndarray:
    """Order (n) of a forest in which every subtree is contiguous and ends with its root."""
    n = len(parent)
    child, sibling = np.full(n + 1, -1, np.int32), np.full(n, -1, np.int32)
    for j in range(n - 1, -1, -1):
        above = parent[j] if parent[j] >= 0 else n
        sibling[j], child[above] = child[above], j
    order, path = np.zeros(n, np.int32), np.zeros(n + 1, np.int32)
    path[0], depth, k = n, 1, 0
    while depth > 0:
        j = path[depth - 1]
        if child[j] >= 0:
            path[depth] = child[j]
            child[j] = sibling[child[j]]
            depth += 1
        else:
            depth -= 1
            if j < n:
                order[k] = j
                k += 1
    return order


@nb.njit(cache=True, nogil=True)
def column_counts(ptr: np.ndarray, rows: np.ndarray, parent: np.ndarray) -> np.ndarray:
    """Count the rows (n) below the diagonal in every column of the factor. Davis, section 4.5."""
    n = len(ptr) - 1
    counts, mark = np.zeros(n, np.int32), np.full(n, -1, np.int32)
    for i in range(n):
        mark[i] = i
        for p in range(ptr[i], ptr[i + 1]):
            j = rows[p]
            while j < i and mark[j] != i:
                mark[j] = i
                counts[j] += 1
                j = parent[j]
    return counts


@nb.njit(cache=True, nogil=True)
def group_columns(parent: np.ndarray, counts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Find the panel (n) of every column of a postordered tree, and the panel over every panel, -1 for none.

    A panel is named by its last column. A column joins its neighbour when their rows are the same, and a panel joins
    the one over it when the time model says that the zeros this adds cost less than they save.
    """
    n = len(parent)
    panel, width = np.arange(n), np.ones(n, np.int64)
    for j in range(n - 2, -1, -1):
        if parent[j] == j + 1 and counts[j + 1] == counts[j] - 1:
            panel[j] = panel[j + 1]
            width[panel[j]] += 1
    over = np.full(n, -1, np.int64)
    child, sibling = np.full(n, -1, np.int64), np.full(n, -1, np.int64)
    for j in range(n):
        if panel[j] == j and parent[j] >= 0:
            over[j] = panel[parent[j]]
            sibling[j], child[over[j]] = child[over[j]], j
    for j in range(n):
        c = child[j]
        while c >= 0:
            apart = _panel_time(width[c], counts[c]) + _panel_time(width[j], counts[j])
            if _panel_time(width[c] + width[j], counts[j]) < apart:
                width[j] += width[c]
                panel[c] = j
            c = sibling[c]
    for j in range(n - 1, -1, -1):
        panel[j] = panel[panel[j]]
    for j in range(n):
        if over[j] >= 0:
            over[j] = panel[over[j]]
    return panel, over


@nb.njit(cache=True, nogil=True)
def _panel_time(width: int, below: int) -> float:
    """Estimate the time in s to factorise a panel of `width` block columns with `below` block rows below them."""
    p, m = 3.0 * width, 3.0 * below
    return PANEL_S + ENTRY_S * (p * m + 0.5 * m * m) + PRODUCT_S * (p * p * p / 3.0 + p * p * m + p * m * m)
