"""The block Cholesky solver against dense algebra, on random matrices and on a finger's tangent."""

import numpy as np
import pytest

from fast.models.design.space import BEST_PUBLISHED
from fast.models.simulation.body.assembly import ElasticBody, Material, decouple_y
from fast.models.simulation.mesh.build import build_mesh
from fast.models.simulation.solver.cholesky import (
    BlockPattern,
    Factor,
    block_pattern,
    factorise,
    make_factor,
    solve_in_place,
)
from fast.models.simulation.version import MeshSettings


def random_pairs(n: int, n_pairs: int, seed: int) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, n, (n_pairs, 2))


def random_blocks(pattern: BlockPattern, seed: int) -> np.ndarray:
    """Blocks of a diagonally dominant, hence positive definite, matrix."""
    blocks = np.random.default_rng(seed).uniform(-1.0, 1.0, (len(pattern.indices), 3, 3))
    diagonal = pattern.indptr[:-1]
    blocks[diagonal] += blocks[diagonal].transpose(0, 2, 1) + 6.0 * pattern.n * np.eye(3)
    return blocks


def dense(pattern: BlockPattern, blocks: np.ndarray) -> np.ndarray:
    matrix = np.zeros((pattern.n, 3, pattern.n, 3))
    columns = np.repeat(np.arange(pattern.n), np.diff(pattern.indptr))
    matrix[columns, :, pattern.indices, :] = blocks.transpose(0, 2, 1)
    matrix[pattern.indices, :, columns, :] = blocks
    return matrix.reshape(3 * pattern.n, 3 * pattern.n)


def solve(factor: Factor, right: np.ndarray) -> np.ndarray:
    solution = right.copy()
    solve_in_place(factor, solution.reshape(-1))
    return solution


def assert_solves(factor: Factor, pattern: BlockPattern, blocks: np.ndarray) -> None:
    right = np.random.default_rng(9).standard_normal((pattern.n, 3))
    expected = np.linalg.solve(dense(pattern, blocks), right.ravel()).reshape(-1, 3)
    assert np.allclose(solve(factor, right), expected, rtol=1e-9, atol=1e-12 * np.abs(expected).max())


@pytest.fixture(scope="module")
def tangent() -> tuple[BlockPattern, np.ndarray, np.ndarray]:
    """Pattern and blocks of the tangent of a bent finger, and its contact nodes' rows."""
    mesh = build_mesh(BEST_PUBLISHED, MeshSettings())
    body = ElasticBody(mesh, mesh.nodes, Material(11.5, 0.45))
    x = mesh.nodes.copy()
    x[:, 0] += 1e-3 * x[:, 2] ** 2
    blocks = np.zeros((len(body.pattern.indices), 3, 3))
    assert body.stiffness(x, blocks)
    decouple_y(body.symmetry, blocks)
    rows = body.row_of_node[np.unique(mesh.contact_faces)]
    return body.pattern, blocks, rows[rows >= 0]


# Sizes around whole tiles of eight, no edges at all, one clique, and several components.
@pytest.mark.parametrize(("n", "n_pairs"), [(1, 0), (2, 1), (3, 9), (8, 12), (9, 300), (40, 0), (70, 60), (150, 400)])
@pytest.mark.parametrize("seed", [0, 1])
def test_solves_random_systems_like_a_dense_solver(n: int, n_pairs: int, seed: int) -> None:
    pattern = block_pattern(n, random_pairs(n, n_pairs, seed))
    blocks, factor = random_blocks(pattern, seed), make_factor(pattern)
    assert factorise(factor, blocks)
    assert_solves(factor, pattern, blocks)


def test_solves_the_tangent_of_a_finger(tangent: tuple[BlockPattern, np.ndarray, np.ndarray]) -> None:
    pattern, blocks, _ = tangent
    factor = make_factor(pattern)
    assert factorise(factor, blocks)
    assert_solves(factor, pattern, blocks)


def test_pattern_holds_the_edges_once_and_orders_its_panels() -> None:
    n, pairs = 60, random_pairs(60, 150, 2)
    pattern = block_pattern(n, pairs)
    columns = np.repeat(np.arange(n), np.diff(pattern.indptr))
    rows = pattern.position[np.vstack([pairs, np.column_stack([np.arange(n)] * 2)])]
    expected = {(int(low), int(high)) for low, high in np.sort(rows, axis=1)}
    found = list(zip(columns.tolist(), pattern.indices.tolist(), strict=True))
    assert found == sorted(expected)
    assert sorted(pattern.position) == list(range(n))
    assert pattern.panels[0] == 0
    assert pattern.panels[-1] == n
    assert ((pattern.over > np.arange(len(pattern.over))) | (pattern.over == -1)).all()


@pytest.mark.parametrize("row", [0, 31, 69])
def test_reports_an_indefinite_matrix_and_recovers(row: int) -> None:
    pattern = block_pattern(70, random_pairs(70, 200, 3))
    blocks, factor = random_blocks(pattern, 3), make_factor(pattern)
    for spoiled in (-1e3, 0.0, np.nan):
        wrong = blocks.copy()
        wrong[pattern.indptr[row], 1, 1] = spoiled
        assert not factorise(factor, wrong)
    assert factorise(factor, blocks)
    assert_solves(factor, pattern, blocks)


def test_sign_of_the_smallest_eigenvalue_decides() -> None:
    pattern = block_pattern(70, random_pairs(70, 200, 3))
    blocks, factor = random_blocks(pattern, 3), make_factor(pattern)
    smallest = np.linalg.eigvalsh(dense(pattern, blocks))[0]
    diagonal = pattern.indptr[:-1]
    for share, is_definite in ((0.999, True), (1.001, False)):
        shifted = blocks.copy()
        shifted[diagonal] -= share * smallest * np.eye(3)
        assert factorise(factor, shifted) is is_definite


def test_order_keeps_the_factor_of_a_grid_sparse() -> None:
    side = 60
    nodes = np.arange(side * side).reshape(side, side)
    right = np.column_stack([nodes[:, :-1].ravel(), nodes[:, 1:].ravel()])
    down = np.column_stack([nodes[:-1].ravel(), nodes[1:].ravel()])
    factor = make_factor(block_pattern(side * side, np.vstack([right, down])))
    width, below = factor.layout.width // 3, factor.layout.below // 3
    n_factor_blocks = (width * (width + 1) // 2 + width * below).sum()
    assert n_factor_blocks < 0.5 * side**3  # elimination row by row fills side^3


def test_results_do_not_depend_on_what_was_factorised_before(
    tangent: tuple[BlockPattern, np.ndarray, np.ndarray],
) -> None:
    pattern, blocks, _ = tangent
    right = np.random.default_rng(4).standard_normal((pattern.n, 3))
    used, fresh = make_factor(pattern), make_factor(pattern)
    for seed in range(3):
        assert factorise(used, random_blocks(pattern, seed))
        solve(used, right)
    assert not factorise(used, np.full_like(blocks, np.nan))
    assert factorise(used, blocks)
    assert factorise(fresh, blocks)
    assert (solve(used, right) == solve(fresh, right)).all()
    # A factor of four changes no rounding, not even of square roots.
    assert factorise(used, 4.0 * blocks)
    assert (solve(used, 4.0 * right) == solve(fresh, right)).all()
