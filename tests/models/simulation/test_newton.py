"""Newton's method with secant corrections, and the model that a design's grasps share."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from fast.models.design.space import BEST_PUBLISHED, numbered_design
from fast.models.objects.catalogue import get_object
from fast.models.records import GraspSetup
from fast.models.simulation.body.assembly import Material
from fast.models.simulation.contact.law import ContactLaw, PointSpacing
from fast.models.simulation.grasp import Numerics, simulate_grasp
from fast.models.simulation.mesh.build import build_mesh
from fast.models.simulation.model import FingerModel, finger_model
from fast.models.simulation.solver.broyden import SecantMemory
from fast.models.simulation.solver.newton import NewtonSettings, NewtonSolver
from fast.models.simulation.version import MeshSettings

# What is compared holds for every finger and lift.
ONE_RIB, COARSE, SHORT_LIFT = numbered_design(1), MeshSettings(edge_mm=12), GraspSetup(max_lift_mm=10)
N_ROWS = 12
RANK = 3


class DenseSolver:
    """A `LinearSolver` for one full matrix, which stands for the blocks."""

    def __init__(self, matrix: np.ndarray) -> None:
        self.matrix = matrix

    def factorise(self, blocks: np.ndarray) -> bool:
        return True

    def solve(self, right_side: np.ndarray) -> np.ndarray:
        return np.linalg.solve(self.matrix, right_side.ravel()).reshape(right_side.shape)


class SlidingContact:
    """Linear equations A u = b whose tangent K leaves out an unsymmetric part of low rank, as friction's does."""

    def __init__(self) -> None:
        rng = np.random.default_rng(1)
        n = 3 * N_ROWS
        root = rng.normal(size=(n, n))
        self.K = root @ root.T / n + np.diag(rng.uniform(0.1, 100.0, n))
        self.A = self.K + 2.0 * rng.normal(size=(n, RANK)) @ rng.normal(size=(RANK, n)) / np.sqrt(n)
        self.b = rng.normal(size=n)

    def residual(self, u: np.ndarray) -> np.ndarray | None:
        return (self.b - self.A @ u.ravel()).reshape(u.shape)

    def tangent(self, u: np.ndarray, blocks: np.ndarray) -> bool:
        return True

    def shift(self, blocks: np.ndarray, amount: float) -> None:
        raise AssertionError("K is positive definite")


def solve(settings: NewtonSettings) -> tuple[NewtonSolver, float]:
    problem = SlidingContact()
    newton = NewtonSolver(DenseSolver(problem.K), np.zeros(0), settings)
    u = np.zeros((N_ROWS, 3))
    assert newton.solve(problem, u) == "converged"
    exact = np.linalg.solve(problem.A, problem.b)
    return newton, float(np.abs(u.ravel() - exact).max())


def test_correction_maps_the_change_of_the_residual_to_the_step() -> None:
    problem, rng = SlidingContact(), np.random.default_rng(2)
    memory, linear = SecantMemory(3 * N_ROWS), DenseSolver(problem.K)
    old, new = rng.normal(size=(2, N_ROWS, 3))
    first = memory.direction(linear.solve(old), old, 1.0)
    memory.direction(linear.solve(new), new, 0.3)
    memory.begin()
    change = old - new
    assert np.allclose(memory.direction(linear.solve(change), change, 1.0), 0.3 * first)


def test_one_factor_and_low_rank_corrections_solve_an_unsymmetric_problem() -> None:
    newton, error = solve(NewtonSettings(tolerance_n=1e-8, patience=np.inf))
    assert newton.n_factorisations == 1
    # Broyden's method ends after twice the rank of what the factor leaves out (Gay 1979).
    assert newton.n_iterations <= 2 * RANK + 1
    assert error < 1e-8


def test_without_patience_every_iteration_has_its_own_factor() -> None:
    newton, _ = solve(NewtonSettings(tolerance_n=1e-8, patience=0.0, max_iterations=500))
    assert newton.n_factorisations == newton.n_iterations > 2 * RANK + 1


def test_result_does_not_depend_on_what_was_computed_before() -> None:
    mesh = build_mesh(ONE_RIB, COARSE)

    def force(*object_ids: int) -> list[np.ndarray]:
        met = [get_object(i) for i in object_ids]
        return [simulate_grasp(ONE_RIB, obj, setup=SHORT_LIFT, mesh=mesh).trace.force_n for obj in met]

    cone, block = force(24, 31)
    again, other = force(31, 24)
    with ThreadPoolExecutor(1) as pool:
        alone = pool.submit(force, 31).result()[0]
    assert np.array_equal(cone, other)
    assert np.array_equal(block, again)
    assert np.array_equal(block, alone)


def test_model_is_built_once_per_finger() -> None:
    mesh = build_mesh(BEST_PUBLISHED, MeshSettings())

    def model(poisson_ratio: float, factors: list[np.ndarray] | None = None) -> FingerModel:
        return finger_model(
            mesh,
            height_mm=BEST_PUBLISHED.height_mm,
            tip_below_mm=5.0,
            material=Material(11.5, poisson_ratio),
            law=ContactLaw(),
            spacing=PointSpacing(),
            factors=factors,
        )

    first = model(0.45)
    assert model(0.45) is first
    assert model(0.3) is not first
    assert model(0.45) is first
    softer = [np.full(len(part), 0.9) for part in mesh.connectivities]
    assert model(0.45, softer) is not first
    assert model(0.45, [part.copy() for part in softer]) is model(0.45, softer)
    with ThreadPoolExecutor(1) as pool:
        assert pool.submit(model, 0.45).result() is not first


@pytest.mark.parametrize("object_id", [1, 30])
def test_secant_corrections_change_nothing_but_the_cost(object_id: int) -> None:
    mesh, obj = build_mesh(BEST_PUBLISHED, MeshSettings()), get_object(object_id)
    exact = Numerics(newton=NewtonSettings(tolerance_n=1e-3, patience=0.0))
    quasi = simulate_grasp(BEST_PUBLISHED, obj, setup=SHORT_LIFT, mesh=mesh)
    newton = simulate_grasp(BEST_PUBLISHED, obj, setup=SHORT_LIFT, mesh=mesh, numerics=exact)
    assert quasi.peak_force_n == pytest.approx(newton.peak_force_n, rel=3e-3)
    assert quasi.work_j == pytest.approx(newton.work_j, rel=3e-3)
    assert quasi.n_factorisations < 0.4 * newton.n_factorisations
