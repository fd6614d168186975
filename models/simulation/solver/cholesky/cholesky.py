"""Multifrontal Cholesky factorisation of matrices of 3 x 3 node blocks.

The columns are taken panel by panel: a panel starts from the blocks of the matrix and the updates of the panels it
is over, is factorised as a dense matrix, and leaves the update -L L^T of the rows below it. See Liu, "The multifrontal
method for sparse matrix solution" (SIAM Review 34, 1992).
"""

from typing import NamedTuple

import numba as nb
import numpy as np

from fast.models.simulation.solver.cholesky.layout import Layout, panel_layout
from fast.models.simulation.solver.cholesky.pattern import BlockPattern
from fast.models.simulation.solver.cholesky.tiles import (
    TILE,
    add_block,
    backward_strip,
    divide_tile,
    forward_strip,
    pivot_tile,
    place_block,
    product_tile,
)


class Factor(NamedTuple):
    """Where a factor lies, and the numbers of the last one."""

    layout: Layout
    data: np.ndarray


def make_factor(pattern: BlockPattern) -> Factor:
    """Make room for the factor of a matrix with this pattern."""
    layout = panel_layout(pattern)
    return Factor(layout, _aligned_zeros(layout.size))


def _aligned_zeros(size: int) -> np.ndarray:
    """Make zeros that start at a cache line, as tiles are read fastest."""
    array = np.zeros(size + TILE)
    start = -(array.ctypes.data // array.itemsize) % TILE
    return array[start : start + size]


@nb.njit(cache=True, nogil=True, error_model="numpy")
def factorise(factor: Factor, blocks: np.ndarray) -> bool:
    """Factorise the matrix with these blocks (z, 3, 3), from the leaves of the elimination tree to its root.

    False if it is not positive definite; the factor is then unusable.
    """
    layout, data, entries = factor.layout, factor.data, blocks.reshape(-1)
    for s in range(len(layout.width)):
        _assemble(layout, s, entries, data)
        for c in layout.children[layout.child_ptr[s] : layout.child_ptr[s + 1]]:
            _add_update(layout, s, c, True, data)
        if not _factorise_panel(layout, s, data):
            return False
        for c in layout.children[layout.child_ptr[s] : layout.child_ptr[s + 1]]:
            _add_update(layout, s, c, False, data)
    return True


@nb.njit(forceinline=True, error_model="numpy")
def _assemble(layout: Layout, s: int, blocks: np.ndarray, data: np.ndarray) -> None:
    """Start panel s from the blocks of the matrix; columns that pad it are those of the identity."""
    place, stride = layout.place[s], layout.stride[s]
    data[place : layout.place[s + 1]] = 0.0
    for diagonal in range(place + layout.width[s] * (stride + 1), layout.place[s + 1], stride + 1):
        data[diagonal] = 1.0
    for z in range(layout.block_ptr[s], layout.block_ptr[s + 1]):
        place_block(data, blocks, layout.block[z], stride, 9 * z)


@nb.njit(forceinline=True, error_model="numpy")
def _factorise_panel(layout: Layout, s: int, data: np.ndarray) -> bool:
    """Factorise panel s densely, and compute its update; False if it is not positive definite."""
    place, stride, own, update = layout.place[s], layout.stride[s], layout.own[s], layout.update[s]
    for j in range(0, own, TILE):
        strip = place + j * stride
        if not pivot_tile(data, strip + j, place + j, stride, j):
            return False
        for i in range(j + TILE, stride, TILE):
            divide_tile(data, strip + i, place + i, place + j, stride, j)
    below = stride - own
    low = place + own
    for j in range(0, below, TILE):
        for i in range(j, below, TILE):
            product_tile(data, update + j * below + i, below, low + i, low + j, stride, layout.width[s])
    return True


@nb.njit(forceinline=True, error_model="numpy")
def _add_update(layout: Layout, s: int, child: int, to_own: bool, data: np.ndarray) -> None:
    """Add the columns of a child's update that are own columns of panel s, or the others to the update of s."""
    own, spacing = layout.own[s], layout.stride[child] - layout.own[child]
    if to_own:
        step, corner = layout.stride[s], layout.place[s]
    else:
        step = layout.stride[s] - own
        corner = layout.update[s] - own * (step + 1)
    runs = layout.runs[layout.run_ptr[child] : layout.run_ptr[child + 1]]
    for r in range(len(runs)):
        row, target, length = runs[r, 0], runs[r, 1], runs[r, 2]
        if (target < own) != to_own:
            continue
        source, column = layout.update[child] + row * spacing, corner + target * step
        # The block on the diagonal is added in strips; what they reach above the diagonal is never read.
        for k in range(0, length, TILE):
            at, come = column + target + k * (step + 1), source + row + k * (spacing + 1)
            add_block(data, at, step, come, spacing, length - k, min(TILE, length - k))
        for q in range(r + 1, len(runs)):
            add_block(data, column + runs[q, 1], step, source + runs[q, 0], spacing, runs[q, 2], length)


@nb.njit(cache=True, nogil=True, error_model="numpy")
def solve_in_place(factor: Factor, x: np.ndarray) -> None:
    """Turn a right-hand side (3 n), in pattern order, into the solution by the last factor.

    The rows of one panel are gathered in `layout.vector`.
    """
    layout, data = factor.layout, factor.data
    for s in range(len(layout.width)):
        own = _gather_own(layout, s, data, x)
        data[layout.vector + own : layout.vector + layout.stride[s]] = 0.0
        for j in range(0, own, TILE):
            forward_strip(data, layout.vector, layout.place[s] + j * layout.stride[s], layout.stride[s], j)
        _scatter_own(layout, s, data, x)
        at = layout.vector + own
        for i in layout.rows[layout.row_ptr[s] : layout.row_ptr[s + 1]]:
            for k in range(3):
                x[3 * i + k] += data[at + k]
            at += 3
    for s in range(len(layout.width) - 1, -1, -1):
        own = _gather_own(layout, s, data, x)
        at = layout.vector + own
        for i in layout.rows[layout.row_ptr[s] : layout.row_ptr[s + 1]]:
            for k in range(3):
                data[at + k] = x[3 * i + k]
            at += 3
        data[at : layout.vector + layout.stride[s]] = 0.0
        for j in range(own - TILE, -1, -TILE):
            backward_strip(data, layout.vector, layout.place[s] + j * layout.stride[s], layout.stride[s], j)
        _scatter_own(layout, s, data, x)


@nb.njit(forceinline=True, error_model="numpy")
def _gather_own(layout: Layout, s: int, data: np.ndarray, x: np.ndarray) -> int:
    """Copy the own rows of panel s from x, padded with zeros to whole tiles; returns their padded number."""
    own = layout.own[s]
    for k in range(layout.width[s]):
        data[layout.vector + k] = x[3 * layout.starts[s] + k]
    data[layout.vector + layout.width[s] : layout.vector + own] = 0.0
    return own


@nb.njit(forceinline=True, error_model="numpy")
def _scatter_own(layout: Layout, s: int, data: np.ndarray, x: np.ndarray) -> None:
    for k in range(layout.width[s]):
        x[3 * layout.starts[s] + k] = data[layout.vector + k]
