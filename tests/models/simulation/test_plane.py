"""Sections in plane strain: elements, linear solver and bending against closed forms and against the solid."""

import numpy as np
import pytest

from models.design.space import BEST_PUBLISHED
from models.records import MeshSettings
from models.simulation.body.assembly import ElasticBody, Material
from models.simulation.body.elasticity import lame_constants
from models.simulation.mesh.planar import add_middles
from models.simulation.mesh.plane import PlaneMesh, plane_mesh
from models.simulation.plane_width import compliance_gain, section_lame_constants
from models.simulation.section.body import PlaneBody
from models.simulation.section.linear import PlaneCholesky
from models.simulation.solver.newton import NewtonSettings, NewtonSolver

MODULUS, POISSON, WIDTH = 11.5, 0.45, 30.0
WIDE = 1e-3  # half wave in mm, far below the width: no correction for free edges


def section(vertices: np.ndarray, triangles: np.ndarray, quads: np.ndarray, half_wave_mm: float = WIDE) -> PlaneMesh:
    return PlaneMesh(add_middles(vertices, triangles, quads), WIDTH, is_half=False, half_wave_mm=half_wave_mm)


def patch() -> PlaneMesh:
    """A unit square of four quadrilaterals, two of them cut into triangles, around a point off the middle."""
    vertices = np.array(
        [[0, 0], [0.45, 0], [1, 0], [0, 0.6], [0.55, 0.4], [1, 0.5], [0, 1], [0.6, 1], [1, 1]], dtype=float
    )
    triangles = np.array([[0, 1, 4], [0, 4, 3], [4, 5, 8], [4, 8, 7]])
    return section(vertices, triangles, np.array([[1, 2, 5, 4], [3, 4, 7, 6]]))


def strip(length: float, thickness: float, n: int, half_wave_mm: float) -> PlaneMesh:
    """A wall of n quadrilaterals that stands on its base at z = 0."""
    z = np.linspace(0.0, length, n + 1)
    vertices = np.concatenate([np.column_stack([np.full(n + 1, x), z]) for x in (0.0, thickness)])
    i = np.arange(n)
    quads = np.column_stack([i, i + n + 1, i + n + 2, i + 1])
    return section(vertices, np.zeros((0, 3), dtype=int), quads, half_wave_mm)


def body_of(mesh: PlaneMesh) -> PlaneBody:
    return PlaneBody(mesh, mesh.nodes, Material(MODULUS, POISSON))


class DeadLoad:
    """Equilibrium of a section under nodal forces (n, 2)."""

    def __init__(self, body: PlaneBody, load: np.ndarray) -> None:
        self.body, self.load = body, load
        self.free = body.row_of_node >= 0
        self.rows = body.row_of_node[self.free]

    def positions(self, u: np.ndarray) -> np.ndarray:
        x = self.body.mesh.nodes.copy()
        x[self.free] = u[self.rows]
        return x

    def residual(self, u: np.ndarray) -> np.ndarray | None:
        force, rows = self.body.force(self.positions(u)), np.zeros_like(u)
        if force is None:
            return None
        rows[self.rows] = (self.load - force)[self.free]
        return rows

    def tangent(self, u: np.ndarray, blocks: np.ndarray) -> bool:
        return self.body.stiffness(self.positions(u), blocks)

    def shift(self, blocks: np.ndarray, amount: float) -> None:
        blocks[self.body.pattern.indptr[:-1]] += 1e-3 * amount * np.eye(2)

    def solve(self) -> np.ndarray:
        u = np.zeros((self.body.pattern.n, 2))
        u[self.rows] = self.body.mesh.nodes[self.free]
        blocks = np.zeros((len(self.body.pattern.indices), 2, 2))
        settings = NewtonSettings(tolerance_n=1e-9, max_iterations=200, patience=0.0)
        assert NewtonSolver(PlaneCholesky(self.body.pattern), blocks, settings).solve(self, u) == "converged"
        return self.positions(u)


def test_patch_carries_every_constant_deformation() -> None:
    mesh = patch()
    F = np.array([[1.3, 0.25], [-0.2, 0.9]])
    force = body_of(mesh).force(mesh.nodes @ F.T)
    assert force is not None
    is_inner = ((mesh.nodes > 1e-9) & (mesh.nodes < 1 - 1e-9)).all(axis=1)
    assert is_inner.sum() == 7
    assert np.abs(force[is_inner]).max() < 1e-12 * np.abs(force).max()
    lam, mu = section_lame_constants(MODULUS, POISSON, WIDTH, WIDE)
    inverse = np.linalg.inv(F).T
    stress = mu * (F - inverse) + lam * np.log(np.linalg.det(F)) * inverse
    assert np.allclose(np.einsum("ai,aj->ij", force, mesh.nodes), WIDTH * stress, rtol=1e-12)


def test_inverted_section_is_found() -> None:
    mesh = patch()
    assert body_of(mesh).force(mesh.nodes * [-1.0, 1.0]) is None


def test_tangent_is_the_derivative_of_the_force() -> None:
    mesh, rng = patch(), np.random.default_rng(2)
    body = body_of(mesh)
    x = mesh.nodes @ np.array([[1.1, 0.1], [-0.2, 0.95]]).T + 0.01 * rng.standard_normal(mesh.nodes.shape)
    blocks = np.zeros((len(body.pattern.indices), 2, 2))
    assert body.stiffness(x, blocks)
    K = dense(body, blocks)
    direction = np.where((body.row_of_node >= 0)[:, None], rng.standard_normal(x.shape), 0.0)
    after, before = body.force(x + 1e-6 * direction), body.force(x - 1e-6 * direction)
    assert after is not None
    assert before is not None
    free = body.row_of_node >= 0
    rows, expected = np.zeros((body.pattern.n, 2)), np.zeros((body.pattern.n, 2))
    rows[body.row_of_node[free]] = direction[free]
    expected[body.row_of_node[free]] = ((after - before) / 2e-6)[free]
    assert np.allclose(K @ rows.ravel(), expected.ravel(), rtol=1e-6, atol=1e-5)


def dense(body: PlaneBody, blocks: np.ndarray) -> np.ndarray:
    n = body.pattern.n
    full = np.zeros((n, 2, n, 2))
    columns = np.repeat(np.arange(n), np.diff(body.pattern.indptr))
    for row, column, block in zip(body.pattern.indices, columns, blocks, strict=True):
        full[column, :, row, :] = block.T
        full[row, :, column, :] = block
    return full.reshape(2 * n, 2 * n)


def test_cholesky_solves_and_reports_indefinite_matrices() -> None:
    body = body_of(plane_mesh(BEST_PUBLISHED, MeshSettings()))
    blocks = np.zeros((len(body.pattern.indices), 2, 2))
    assert body.stiffness(body.mesh.nodes, blocks)
    linear, right = PlaneCholesky(body.pattern), np.random.default_rng(0).standard_normal((body.pattern.n, 2))
    assert linear.factorise(blocks)
    assert np.allclose(dense(body, blocks) @ linear.solve(right).ravel(), right.ravel(), atol=1e-9)
    blocks[body.pattern.indptr[body.pattern.n // 2]] -= 1e3 * np.eye(2)
    assert not linear.factorise(blocks)


def test_section_is_the_solid_that_it_sweeps() -> None:
    mesh = plane_mesh(BEST_PUBLISHED, MeshSettings(), full_width=True)
    solid, node_of = mesh.swept()
    lam, mu = section_lame_constants(MODULUS, POISSON, mesh.width_mm, mesh.half_wave_mm)
    poisson = lam / (2.0 * (lam + mu))
    material = Material(2.0 * mu * (1.0 + poisson), poisson)
    bend = 1e-3 * mesh.nodes[:, 1] ** 2
    section_x = mesh.nodes + np.column_stack([bend, -0.02 * mesh.nodes[:, 0]])
    solid_x = np.column_stack([section_x[node_of, 0], solid.nodes[:, 1], section_x[node_of, 1]])
    solid_force = ElasticBody(solid, solid.nodes, material).force(solid_x)
    assert solid_force is not None
    summed = np.zeros_like(section_x)
    np.add.at(summed, node_of, solid_force[:, [0, 2]])
    force = body_of(mesh).force(section_x)
    assert force is not None
    assert np.allclose(force, summed, rtol=1e-10, atol=1e-10)
    assert body_of(mesh).lumped_volume().sum() == pytest.approx(
        ElasticBody(solid, solid.nodes, material).lumped_volume().sum()
    )


# Bisshopp and Drucker 1945, Large deflection of cantilever beams: F L^2 / (E I), drop and shortening over the length.
@pytest.mark.parametrize(("load", "drop", "shortening"), [(1.0, 0.30172, 0.05643), (5.0, 0.71379, 0.38763)])
@pytest.mark.parametrize("half_wave_mm", [WIDE, 50.0])
def test_wall_follows_the_elastica(load: float, drop: float, shortening: float, half_wave_mm: float) -> None:
    length, thickness = 100.0, 1.0
    mesh = strip(length, thickness, 200, half_wave_mm)
    modulus = MODULUS / (1.0 - POISSON**2) / (1.0 + compliance_gain(WIDTH, half_wave_mm, POISSON))
    stiffness = modulus * WIDTH * thickness**3 / 12.0
    forces, tip = np.zeros_like(mesh.nodes), np.isclose(mesh.nodes[:, 1], length)
    forces[tip, 0] = np.array([1.0, 1.0, 4.0]) / 6.0 * load * stiffness / length**2
    end = DeadLoad(body_of(mesh), forces).solve()[tip].mean(axis=0)
    # The clamp also holds the thickness, which stiffens a tenth of h or so; shortenings go with its square.
    assert (end[0] - thickness / 2) / length == pytest.approx(drop, rel=3e-3)
    assert 1.0 - end[1] / length == pytest.approx(shortening, rel=5e-3)


@pytest.mark.parametrize("q", [0.05, 0.7, 3.0, 20.0])
def test_compliance_gain_solves_the_plate_equation(q: float) -> None:
    """w = 1 + A cosh ky + B ky sinh ky with w'' = nu k^2 w and w''' = (2 - nu) k^2 w' at the edge."""
    nu, s, c = POISSON, np.sinh(q), np.cosh(q)
    edge = np.array([[c * (1 - nu), 2 * c + (1 - nu) * q * s], [s * (nu - 1), 3 * s + q * c - (2 - nu) * (s + q * c)]])
    a, b = np.linalg.solve(edge, [nu, 0.0])
    y, weights = np.polynomial.legendre.leggauss(40)
    ky = 0.5 * q * (y + 1.0)
    mean = float(0.5 * weights @ (a * np.cosh(ky) + b * ky * np.sinh(ky)))
    width, half_wave = 2.0 * q * 10.0, np.pi * 10.0
    assert compliance_gain(width, half_wave, nu) == pytest.approx(mean, rel=1e-8)


def test_width_correction_goes_from_plane_stress_to_plane_strain() -> None:
    lam, mu = lame_constants(MODULUS, POISSON)
    narrow, _ = section_lame_constants(MODULUS, POISSON, 1e-3, 70.0)
    wide, _ = section_lame_constants(MODULUS, POISSON, 1e9, 70.0)
    assert narrow == pytest.approx(2.0 * lam * mu / (lam + 2.0 * mu), rel=1e-6)
    assert wide == pytest.approx(lam, rel=1e-5)
