"""A manufactured solution in finite deformation: errors of a mesh and their rate of convergence.

Take smooth positions x(X) = X + u(X) on the unit cube, compute the body force b = -Div P(F) that holds a neo-Hookean
solid there, prescribe x on the boundary, solve, and compare. With F = dx/dX, H_ijk = dF_ij/dX_k, G = F^-1, l = ln J:

    P_ij = mu F_ij + (lam l - mu) G_ji
    Div P_i = mu H_ijj + lam (G_ba H_abj) G_ji - (lam l - mu) G_ja H_abj G_bi       (repeated a, b, j are summed)

Theory for elements of degree p: the displacement converges with h^(p+1) in L2, its gradient with h^p.
"""

from dataclasses import dataclass

import numpy as np

from fast.models.simulation.body.assembly import ElasticBody, Material
from fast.models.simulation.body.elasticity import lame_constants
from fast.models.simulation.body.shape_functions import ElementKind, Quadrature, shape_of
from fast.models.simulation.mesh.solid import SolidMesh
from tests.models.simulation.verification.bricks import brick, cube_grid, equilibrium

MODULUS_MPA, POISSON = 10.0, 0.3
AMPLITUDE = 0.1
WAVE = np.array([[1.0, 0.6, 0.4], [0.5, 1.0, 0.7], [0.8, 0.3, 1.0]]) * 0.6 * np.pi
PHASE = np.array([0.3, 1.1, 2.0])


@dataclass(frozen=True)
class Errors:
    """Norms of displacement error (mm) and of the error of its gradient over the unit cube."""

    n_cells: int
    l2: float
    h1: float


def positions(X: np.ndarray) -> np.ndarray:
    """Exact positions x_i = X_i + A sin(W_ij X_j + phase_i) at X (n, 3)."""
    return X + AMPLITUDE * np.sin(X @ WAVE.T + PHASE)


def gradient(X: np.ndarray) -> np.ndarray:
    """F (n, 3, 3) at X (n, 3)."""
    return np.eye(3) + AMPLITUDE * np.cos(X @ WAVE.T + PHASE)[:, :, None] * WAVE


def body_force(X: np.ndarray) -> np.ndarray:
    """-Div P (n, 3) in N/mm3 at X (n, 3)."""
    lam, mu = lame_constants(MODULUS_MPA, POISSON)
    F = gradient(X)
    G, log = np.linalg.inv(F), np.log(np.linalg.det(F))
    H = -AMPLITUDE * np.sin(X @ WAVE.T + PHASE)[:, :, None, None] * (WAVE[:, :, None] * WAVE[:, None, :])
    pull = mu * np.einsum("nijj->ni", H)
    volume = lam * np.einsum("nba,nabj,nji->ni", G, H, G)
    turn = (lam * log - mu)[:, None] * np.einsum("nja,nabj,nbi->ni", G, H, G)
    return -(pull + volume - turn)


def solve_cube(kind: ElementKind, n_cells: int) -> Errors:
    """Solve the manufactured problem on n^3 cells and measure the error."""
    mesh = brick(kind, cube_grid(n_cells), place=_bent, base=_on_surface)
    body = ElasticBody(mesh, mesh.nodes, Material(MODULUS_MPA, POISSON), n_axial_points=3)
    exact = positions(mesh.nodes)
    x = equilibrium(body, exact, _nodal_load(mesh))
    return _errors(mesh, x, n_cells)


def observed_rates(coarse: Errors, fine: Errors) -> tuple[float, float]:
    """Rates of convergence in L2 and H1 between two meshes."""
    refinement = np.log(fine.n_cells / coarse.n_cells)
    return float(np.log(coarse.l2 / fine.l2) / refinement), float(np.log(coarse.h1 / fine.h1) / refinement)


def _on_surface(X: np.ndarray) -> np.ndarray:
    return (np.abs(X - 0.5) > 0.5 - 1e-9).any(axis=1)


def _bent(X: np.ndarray) -> np.ndarray:
    """A smooth distortion that keeps the faces of the cube plane: no two elements are alike."""
    bump = 0.05 * np.sin(2.0 * np.pi * X)
    return X + bump * np.roll(np.cos(np.pi * X), 1, axis=1)


def _fine_rule(kind: ElementKind) -> Quadrature:
    """Four Gauss points each way, collapsed onto the reference triangle or tetrahedron (Duffy 1982)."""
    points, weights = np.polynomial.legendre.leggauss(4)
    u, v, t = (grid.ravel() for grid in np.meshgrid(points, points, points, indexing="ij"))
    weight = np.einsum("i,j,k->ijk", weights, weights, weights).ravel()
    if kind == "C3D20R":
        return Quadrature(np.column_stack([u, v, t]), weight)
    a, b, c = 0.5 * (1 + u), 0.5 * (1 + v), 0.5 * (1 + t)
    if kind == "C3D15":
        return Quadrature(np.column_stack([a, (1 - a) * b, t]), 0.25 * weight * (1 - a))
    tetrahedron = np.column_stack([a, (1 - a) * b, (1 - a) * (1 - b) * c])
    return Quadrature(tetrahedron, 0.125 * weight * (1 - a) ** 2 * (1 - b))


def _mapped(mesh: SolidMesh) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Connectivity (m, k), shape values (q, k), slopes (m, q, k, 3), volumes (m, q) and points (m, q, 3)."""
    (block,) = mesh.blocks
    rule = _fine_rule(block.kind)
    values, gradients = shape_of(block.kind, rule.points)
    corners = mesh.nodes[block.connectivity]
    jacobian = np.einsum("mai,qaj->mqij", corners, gradients)
    slopes = np.einsum("qaj,mqji->mqai", gradients, np.linalg.inv(jacobian))
    volumes = np.linalg.det(jacobian) * rule.weights
    return block.connectivity, values, slopes, volumes, np.einsum("qa,mai->mqi", values, corners)


def _nodal_load(mesh: SolidMesh) -> np.ndarray:
    connectivity, values, _, volumes, points = _mapped(mesh)
    force = body_force(points.reshape(-1, 3)).reshape(points.shape)
    load = np.zeros_like(mesh.nodes)
    np.add.at(load, connectivity, np.einsum("mq,qa,mqi->mai", volumes, values, force))
    return load


def _errors(mesh: SolidMesh, x: np.ndarray, n_cells: int) -> Errors:
    connectivity, values, slopes, volumes, points = _mapped(mesh)
    found = np.einsum("qa,mai->mqi", values, x[connectivity])
    found_gradient = np.einsum("mai,mqaj->mqij", x[connectivity], slopes)
    flat = points.reshape(-1, 3)
    miss = found - positions(flat).reshape(points.shape)
    miss_gradient = found_gradient - gradient(flat).reshape(found_gradient.shape)
    return Errors(
        n_cells,
        float(np.sqrt(np.einsum("mq,mqi->", volumes, miss**2))),
        float(np.sqrt(np.einsum("mq,mqij->", volumes, miss_gradient**2))),
    )
