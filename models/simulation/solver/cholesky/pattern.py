"""Patterns of symmetric matrices of 3 x 3 node blocks, ordered for factorisation."""

from dataclasses import dataclass

import numpy as np
import qdldl
import scipy.sparse as sp

from fast.models.simulation.solver.cholesky.elimination import column_counts, elimination_tree, group_columns, postorder


@dataclass(frozen=True)
class BlockPattern:
    """Lower triangle of a symmetric n x n block matrix in compressed columns, diagonal block first.

    `indptr` (n + 1), `indices` (z): block rows in ascending order. Node i of the FEM is row `position[i]`. Columns
    `panels[s]` to `panels[s + 1]` are factorised together; `over[s]` is the panel of the first row below them, -1 for
    none.
    """

    indptr: np.ndarray
    indices: np.ndarray
    position: np.ndarray
    panels: np.ndarray
    over: np.ndarray

    @property
    def n(self) -> int:
        """Number of block rows."""
        return len(self.indptr) - 1


def block_pattern(n: int, pairs: np.ndarray) -> BlockPattern:
    """Make the pattern of a node graph with edges `pairs` (m, 2), ordered to keep the factor sparse."""
    graph = _graph(n, pairs)
    order, panels, over = _ordered_panels(graph, _minimum_degree(graph))
    lower = sp.tril(_permuted(graph, order), format="csc")
    return BlockPattern(lower.indptr, lower.indices, _inverse(order), panels, over)


def _graph(n: int, pairs: np.ndarray) -> sp.csc_matrix:
    """Return the symmetric pattern with a full diagonal."""
    nodes = np.arange(n)
    first, second = np.concatenate([pairs[:, 0], nodes]), np.concatenate([pairs[:, 1], nodes])
    half = sp.csc_matrix((np.ones(len(first), dtype=bool), (first, second)), shape=(n, n))
    return sp.csc_matrix(half + half.T)


def _minimum_degree(graph: sp.csc_matrix) -> np.ndarray:
    """Find an approximate minimum degree order (n); qdldl gives it in factorising, here a dominant diagonal."""
    n = graph.shape[0]
    dominant = graph.astype(float) + n * sp.eye(n, format="csc")
    return np.asarray(qdldl.Solver(sp.csc_matrix(dominant)).factors()[2])


def _ordered_panels(graph: sp.csc_matrix, order: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Order so that every panel is contiguous (n, equivalent); first columns (s + 1) and `over` (s) of the panels."""
    permuted = _permuted(graph, order)
    parent = elimination_tree(permuted.indptr, permuted.indices)
    rising = postorder(parent)
    order, parent = order[rising], _renumbered(parent, rising)
    permuted = _permuted(graph, order)
    panel, over = group_columns(parent, column_counts(permuted.indptr, permuted.indices, parent))
    names, panel = np.unique(panel, return_inverse=True)
    over = np.where(over[names] < 0, -1, np.searchsorted(names, over[names]))
    rising = postorder(over)
    panel, over = _inverse(rising)[panel], _renumbered(over, rising)
    panels = np.concatenate([[0], np.cumsum(np.bincount(panel))])
    return order[np.argsort(panel, kind="stable")], panels, over


def _permuted(graph: sp.csc_matrix, order: np.ndarray) -> sp.csc_matrix:
    permuted = sp.csc_matrix(graph[:, order][order])
    permuted.sort_indices()
    return permuted


def _inverse(order: np.ndarray) -> np.ndarray:
    position = np.zeros(len(order), dtype=np.int32)
    position[order] = np.arange(len(order), dtype=np.int32)
    return position


def _renumbered(parent: np.ndarray, order: np.ndarray) -> np.ndarray:
    """Return the tree after its nodes are put in this order."""
    above = parent[order]
    return np.where(above < 0, -1, _inverse(order)[above])
