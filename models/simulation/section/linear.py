"""Sparse Cholesky factorisation of 2 x 2 node blocks, for sections of a few hundred nodes."""

import numba as nb
import numpy as np

from models.simulation.solver.cholesky import BlockPattern


class PlaneCholesky:
    """Right-looking Cholesky factorisation L L^T of a 2 x 2 block matrix; a `LinearSolver`."""

    def __init__(self, pattern: BlockPattern) -> None:
        self._pattern = pattern
        self._indptr, self._indices = _symbolic(pattern)
        self._factor = np.zeros((len(self._indices), 2, 2))

    def factorise(self, blocks: np.ndarray) -> bool:
        """Factorise; False if the matrix is not positive definite (the factor is then unusable)."""
        pattern = self._pattern
        return bool(_numeric(pattern.indptr, pattern.indices, blocks, self._indptr, self._indices, self._factor))

    def solve(self, right_side: np.ndarray) -> np.ndarray:
        """Solve with the last factor; right-hand side and solution (n, 2) in pattern order."""
        solution = np.array(right_side, dtype=float)
        _solve(self._indptr, self._indices, self._factor, solution)
        return solution


def _symbolic(pattern: BlockPattern) -> tuple[np.ndarray, np.ndarray]:
    """Pattern of the factor: column j holds its own rows and those of its children in the elimination tree."""
    columns: list[np.ndarray] = []
    children: list[list[int]] = [[] for _ in range(pattern.n)]
    for j in range(pattern.n):
        own = pattern.indices[pattern.indptr[j] : pattern.indptr[j + 1]]
        rows = np.unique(np.concatenate([own, *(columns[c][1:] for c in children[j])]))
        columns.append(rows)
        if len(rows) > 1:
            children[rows[1]].append(j)
    indptr = np.concatenate([[0], np.cumsum([len(c) for c in columns])]).astype(np.int32)
    return indptr, np.concatenate(columns).astype(np.int32)


@nb.njit(cache=True, nogil=True, fastmath={"contract", "nsz"}, error_model="numpy")
def _numeric(
    a_ptr: np.ndarray, a_rows: np.ndarray, a: np.ndarray, l_ptr: np.ndarray, l_rows: np.ndarray, factor: np.ndarray
) -> bool:
    """Right-looking on the factor's own pattern: each finished column updates the columns that it reaches."""
    n = len(l_ptr) - 1
    place = np.zeros(n, dtype=np.int32)
    factor[:] = 0.0
    for j in range(n):
        for p in range(l_ptr[j], l_ptr[j + 1]):
            place[l_rows[p]] = p
        for p in range(a_ptr[j], a_ptr[j + 1]):
            factor[place[a_rows[p]]] = a[p]
    for j in range(n):
        top, end = l_ptr[j], l_ptr[j + 1]
        if not _scale_column(factor, top, end):
            return False
        for q in range(top + 1, end):
            k = l_rows[q]
            b00, b01, b10, b11 = factor[q, 0, 0], factor[q, 0, 1], factor[q, 1, 0], factor[q, 1, 1]
            # The rows of column j from k on are a subset of column k's, both ascending.
            t = l_ptr[k]
            for p in range(q, end):
                while l_rows[t] != l_rows[p]:
                    t += 1
                c00, c01, c10, c11 = factor[p, 0, 0], factor[p, 0, 1], factor[p, 1, 0], factor[p, 1, 1]
                factor[t, 0, 0] -= c00 * b00 + c01 * b01
                factor[t, 0, 1] -= c00 * b10 + c01 * b11
                factor[t, 1, 0] -= c10 * b00 + c11 * b01
                factor[t, 1, 1] -= c10 * b10 + c11 * b11
    return True


@nb.njit(inline="always")
def _scale_column(factor: np.ndarray, top: int, end: int) -> bool:
    """Factorise the pivot block and divide the column by it; False if the pivot is not positive definite."""
    d0 = factor[top, 0, 0]
    if not d0 > 0.0:
        return False
    l00 = np.sqrt(d0)
    l10 = factor[top, 1, 0] / l00
    d1 = factor[top, 1, 1] - l10 * l10
    if not d1 > 0.0:
        return False
    i00, i11 = 1.0 / l00, 1.0 / np.sqrt(d1)
    # The pivot keeps the inverses of its diagonal, which is all that the solution needs.
    factor[top, 0, 0], factor[top, 0, 1], factor[top, 1, 0], factor[top, 1, 1] = i00, 0.0, l10, i11
    for p in range(top + 1, end):
        for s in range(2):
            x0 = factor[p, s, 0] * i00
            factor[p, s, 0] = x0
            factor[p, s, 1] = (factor[p, s, 1] - x0 * l10) * i11
    return True


@nb.njit(cache=True, nogil=True, error_model="numpy")
def _solve(l_ptr: np.ndarray, l_rows: np.ndarray, factor: np.ndarray, x: np.ndarray) -> None:
    """Forward and backward substitution in place."""
    n = len(l_ptr) - 1
    for j in range(n):
        top = l_ptr[j]
        x0 = x[j, 0] * factor[top, 0, 0]
        x1 = (x[j, 1] - factor[top, 1, 0] * x0) * factor[top, 1, 1]
        x[j, 0], x[j, 1] = x0, x1
        for p in range(top + 1, l_ptr[j + 1]):
            i = l_rows[p]
            x[i, 0] -= factor[p, 0, 0] * x0 + factor[p, 0, 1] * x1
            x[i, 1] -= factor[p, 1, 0] * x0 + factor[p, 1, 1] * x1
    for j in range(n - 1, -1, -1):
        top = l_ptr[j]
        x0, x1 = x[j, 0], x[j, 1]
        for p in range(top + 1, l_ptr[j + 1]):
            i = l_rows[p]
            x0 -= factor[p, 0, 0] * x[i, 0] + factor[p, 1, 0] * x[i, 1]
            x1 -= factor[p, 0, 1] * x[i, 0] + factor[p, 1, 1] * x[i, 1]
        x1 = x1 * factor[top, 1, 1]
        x0 = (x0 - factor[top, 1, 0] * x1) * factor[top, 0, 0]
        x[j, 0], x[j, 1] = x0, x1
