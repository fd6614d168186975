"""Sparse symmetric positive definite systems of 3 x 3 node blocks.

The seam between the FEM and its linear algebra: anything that has `factorise` and `solve` of `LinearSolver`
can stand here. The default is our own left-looking block Cholesky factorisation (numba, free of the GIL),
ordered by the AMD of `qdldl` (Apache-2) once per mesh. Against scalar `qdldl` it needs a ninth of the
indices, reads the FEM's blocks in place, and reports an indefinite matrix. CHOLMOD is GPL and not used.
"""

from dataclasses import dataclass
from typing import Protocol

import numba as nb
import numpy as np
import qdldl
import scipy.sparse as sp


@dataclass(frozen=True)
class BlockPattern:
    """Lower triangle of a symmetric n x n block matrix in compressed columns, diagonal block first.

    `indptr` (n + 1), `indices` (z): block rows in ascending order. Node i of the FEM is row `position[i]`.
    """

    indptr: np.ndarray
    indices: np.ndarray
    position: np.ndarray

    @property
    def n(self) -> int:
        """Number of block rows."""
        return len(self.indptr) - 1


class LinearSolver(Protocol):
    """What Newton's method needs from linear algebra."""

    def factorise(self, blocks: np.ndarray) -> bool:
        """Factorise the matrix with these blocks (z, 3, 3); False if it is not positive definite."""
        ...

    def solve(self, right_side: np.ndarray) -> np.ndarray:
        """Solution (n, 3) for a right-hand side (n, 3), both in pattern order, of the last factorised matrix."""
        ...


def block_pattern(n: int, pairs: np.ndarray) -> BlockPattern:
    """Pattern of a node graph with edges `pairs` (m, 2), ordered to keep the factor sparse."""
    first, second = pairs.T
    graph = sp.coo_matrix((np.ones(len(pairs)), (first, second)), shape=(n, n))
    graph = ((graph + graph.T) != 0).astype(float).tolil()
    graph.setdiag(1.0)
    graph = graph.tocsc()
    dominant = graph + n * sp.eye(n, format="csc")
    order = np.asarray(qdldl.Solver(sp.csc_matrix(dominant)).factors()[2])
    lower = sp.tril(graph[order][:, order], format="csc")
    lower.sort_indices()
    position = np.zeros(n, dtype=np.int32)
    position[order] = np.arange(n, dtype=np.int32)
    return BlockPattern(lower.indptr.astype(np.int32), lower.indices.astype(np.int32), position)


class BlockCholesky:
    """Left-looking Cholesky factorisation of a block matrix with a fixed pattern."""

    def __init__(self, pattern: BlockPattern) -> None:
        self._pattern = pattern
        self._indptr, self._indices = _symbolic(pattern.indptr, pattern.indices)
        self._row_ptr, self._row_entry = _rows(self._indptr, self._indices)
        self._factor = np.zeros((len(self._indices), 3, 3))
        self._work = np.zeros((pattern.n, 3, 3))

    @property
    def n_factor_blocks(self) -> int:
        """Number of 3 x 3 blocks in the factor."""
        return len(self._indices)

    def factorise(self, blocks: np.ndarray) -> bool:
        """Factorise; False if the matrix is not positive definite (the factor is then unusable)."""
        pattern = self._pattern
        return bool(
            _numeric(
                pattern.indptr,
                pattern.indices,
                blocks,
                self._indptr,
                self._indices,
                self._row_ptr,
                self._row_entry,
                self._factor,
                self._work,
            )
        )

    def solve(self, right_side: np.ndarray) -> np.ndarray:
        """Solve with the last factor; right-hand side and solution (n, 3) in pattern order."""
        solution = np.array(right_side, dtype=float)
        _solve(self._indptr, self._indices, self._factor, solution)
        return solution


def _symbolic(indptr: np.ndarray, indices: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pattern of the factor: column j holds its own rows and those of its children in the elimination tree."""
    n = len(indptr) - 1
    columns: list[np.ndarray] = []
    children: list[list[int]] = [[] for _ in range(n)]
    for j in range(n):
        parts = [indices[indptr[j] : indptr[j + 1]], *(columns[c][1:] for c in children[j])]
        rows = np.unique(np.concatenate(parts))
        columns.append(rows)
        if len(rows) > 1:
            children[rows[1]].append(j)
    factor_ptr = np.concatenate([[0], np.cumsum([len(c) for c in columns])]).astype(np.int32)
    return factor_ptr, np.concatenate(columns).astype(np.int32)


def _rows(indptr: np.ndarray, indices: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Entries of the strict lower factor by row: for row i, places of its blocks in ascending column order."""
    n = len(indptr) - 1
    entries = np.delete(np.arange(len(indices)), indptr[:-1])
    rows = indices[entries]
    order = np.argsort(rows, kind="stable")
    pointers = np.searchsorted(rows[order], np.arange(n + 1))
    return pointers.astype(np.int32), entries[order].astype(np.int32)


@nb.njit(inline="always")
def _scale_column(work: np.ndarray, l_rows: np.ndarray, factor: np.ndarray, top: int, end: int) -> bool:
    """Factorise the pivot block and divide the column by it; False if the pivot is not positive definite."""
    pivot = work[l_rows[top]]
    d0 = pivot[0, 0]
    l00 = np.sqrt(max(d0, 0.0))
    l10, l20 = pivot[1, 0] / l00, pivot[2, 0] / l00
    d1 = pivot[1, 1] - l10 * l10
    l11 = np.sqrt(max(d1, 0.0))
    l21 = (pivot[2, 1] - l20 * l10) / l11
    d2 = pivot[2, 2] - l20 * l20 - l21 * l21
    l22 = np.sqrt(max(d2, 0.0))
    if not (d0 > 0.0 and d1 > 0.0 and d2 > 0.0):
        return False
    factor[top] = 0.0
    factor[top, 0, 0], factor[top, 1, 0], factor[top, 2, 0] = l00, l10, l20
    factor[top, 1, 1], factor[top, 2, 1], factor[top, 2, 2] = l11, l21, l22
    i00, i11, i22 = 1.0 / l00, 1.0 / l11, 1.0 / l22
    for p in range(top + 1, end):
        i = l_rows[p]
        for s in range(3):
            x0 = work[i, s, 0] * i00
            x1 = (work[i, s, 1] - x0 * l10) * i11
            factor[p, s, 0] = x0
            factor[p, s, 1] = x1
            factor[p, s, 2] = (work[i, s, 2] - x0 * l20 - x1 * l21) * i22
    return True


@nb.njit(cache=True, nogil=True, fastmath={"contract", "reassoc", "nsz"}, error_model="numpy")
def _numeric(
    a_ptr: np.ndarray,
    a_rows: np.ndarray,
    a: np.ndarray,
    l_ptr: np.ndarray,
    l_rows: np.ndarray,
    row_ptr: np.ndarray,
    row_entry: np.ndarray,
    factor: np.ndarray,
    work: np.ndarray,
) -> bool:
    """Column j: work = A_j - sum_k L_k L_jk^T over the columns k that reach row j, then scale by L_jj^-T."""
    n = len(a_ptr) - 1
    column_of = np.zeros(len(l_rows), dtype=np.int32)
    for k in range(n):
        column_of[l_ptr[k] : l_ptr[k + 1]] = k
    for j in range(n):
        for p in range(l_ptr[j], l_ptr[j + 1]):
            work[l_rows[p]] = 0.0
        for p in range(a_ptr[j], a_ptr[j + 1]):
            work[a_rows[p]] = a[p]
        for r in range(row_ptr[j], row_ptr[j + 1]):
            q = row_entry[r]
            b00, b01, b02 = factor[q, 0, 0], factor[q, 0, 1], factor[q, 0, 2]
            b10, b11, b12 = factor[q, 1, 0], factor[q, 1, 1], factor[q, 1, 2]
            b20, b21, b22 = factor[q, 2, 0], factor[q, 2, 1], factor[q, 2, 2]
            for p in range(q, l_ptr[column_of[q] + 1]):
                i = l_rows[p]
                for s in range(3):
                    c0, c1, c2 = factor[p, s, 0], factor[p, s, 1], factor[p, s, 2]
                    work[i, s, 0] -= c0 * b00 + c1 * b01 + c2 * b02
                    work[i, s, 1] -= c0 * b10 + c1 * b11 + c2 * b12
                    work[i, s, 2] -= c0 * b20 + c1 * b21 + c2 * b22
        if not _scale_column(work, l_rows, factor, l_ptr[j], l_ptr[j + 1]):
            return False
    return True


@nb.njit(cache=True, nogil=True, error_model="numpy")
def _solve(l_ptr: np.ndarray, l_rows: np.ndarray, factor: np.ndarray, x: np.ndarray) -> None:
    """Forward and backward substitution in place."""
    n = len(l_ptr) - 1
    for j in range(n):
        top = l_ptr[j]
        x0 = x[j, 0] / factor[top, 0, 0]
        x1 = (x[j, 1] - factor[top, 1, 0] * x0) / factor[top, 1, 1]
        x2 = (x[j, 2] - factor[top, 2, 0] * x0 - factor[top, 2, 1] * x1) / factor[top, 2, 2]
        x[j, 0], x[j, 1], x[j, 2] = x0, x1, x2
        for p in range(top + 1, l_ptr[j + 1]):
            i = l_rows[p]
            for s in range(3):
                x[i, s] -= factor[p, s, 0] * x0 + factor[p, s, 1] * x1 + factor[p, s, 2] * x2
    for j in range(n - 1, -1, -1):
        top = l_ptr[j]
        x0, x1, x2 = x[j, 0], x[j, 1], x[j, 2]
        for p in range(top + 1, l_ptr[j + 1]):
            i = l_rows[p]
            for s in range(3):
                x0 -= factor[p, s, 0] * x[i, s]
                x1 -= factor[p, s, 1] * x[i, s]
                x2 -= factor[p, s, 2] * x[i, s]
        x2 = x2 / factor[top, 2, 2]
        x1 = (x1 - factor[top, 2, 1] * x2) / factor[top, 1, 1]
        x0 = (x0 - factor[top, 1, 0] * x1 - factor[top, 2, 0] * x2) / factor[top, 0, 0]
        x[j, 0], x[j, 1], x[j, 2] = x0, x1, x2
