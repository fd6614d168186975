"""Kernels on one tile against dense algebra."""

import numba as nb
import numpy as np
import pytest

from fast.models.simulation.solver.cholesky.tiles import TILE, divide_tile, pivot_tile, product_tile

# A flat array of a panel of four tiles: rows in eights, columns `STRIDE` apart. The first eight columns, A over B, are
# done; the tiles T and U of the next eight columns lie beside them.
STRIDE, DEPTH = 2 * TILE, TILE
T, U = DEPTH * STRIDE, DEPTH * STRIDE + TILE


@nb.njit
def compute_pivot(data: np.ndarray) -> bool:
    return pivot_tile(data, T, 0, STRIDE, DEPTH)


@nb.njit
def divide(data: np.ndarray) -> None:
    divide_tile(data, U, TILE, 0, STRIDE, DEPTH)


@nb.njit
def multiply(data: np.ndarray) -> None:
    product_tile(data, U, STRIDE, TILE, 0, STRIDE, DEPTH)


def draw_panel(seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """The flat panel, and its tiles A, B, T and U; T - A A^T is positive definite."""
    rng = np.random.default_rng(seed)
    A, B, U_ = rng.normal(size=(3, TILE, TILE))
    root = rng.normal(size=(TILE, TILE)) + 3.0 * np.eye(TILE)
    T_ = A @ A.T + root @ root.T
    return np.block([[A, T_], [B, U_]]).ravel(order="F").copy(), A, B, T_, U_


def test_a_panel_is_eliminated_as_dense_algebra_has_it() -> None:
    data, A, B, T_, U_ = draw_panel(0)
    root = np.linalg.cholesky(T_ - A @ A.T)
    assert compute_pivot(data)
    divide(data)
    panel = data.reshape(2 * TILE, 2 * TILE, order="F")
    inverse = np.linalg.inv(root)
    assert np.tril(panel[:TILE, TILE:]) == pytest.approx(inverse)
    assert np.triu(panel[:TILE, TILE:], 1) == pytest.approx(np.triu(inverse.T, 1))
    assert panel[TILE:, TILE:] == pytest.approx((U_ - B @ A.T) @ inverse.T)
    multiply(data)
    assert panel[TILE:, TILE:] == pytest.approx(-B @ A.T)
    assert panel[:, :TILE] == pytest.approx(np.vstack([A, B]))  # what was done stays


def test_what_is_not_positive_is_said() -> None:
    data, A, *_ = draw_panel(1)
    data.reshape(2 * TILE, 2 * TILE, order="F")[:TILE, TILE:] = A @ A.T - 1e-3 * np.eye(TILE)
    assert not compute_pivot(data)
