"""Newton's method with secant corrections, and the model that a design's grasps share."""

import sys
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from fast.models.design.space import BEST_PUBLISHED, numbered_design
from fast.models.objects.catalogue import get_object
from fast.models.records import GraspSetup
from fast.models.simulation import grasp
from fast.models.simulation.body.assembly import Material
from fast.models.simulation.contact.law import ContactLaw, PointSpacing
from fast.models.simulation.grasp import Numerics, simulate_grasp
from fast.models.simulation.mesh.build import build_mesh
from fast.models.simulation.model import FingerModel, Stance, finger_model
from fast.models.simulation.solver.broyden import (
    MEMORY,
    Secants,
    begin_load,
    correct_direction,
    forget_all,
    make_secants,
)
from fast.models.simulation.solver.newton import NewtonSettings
from fast.models.simulation.version import MeshSettings

# What is compared holds for every finger and lift.
ONE_RIB, COARSE, SHORT_LIFT = numbered_design(1), MeshSettings(edge_mm=12), GraspSetup(max_lift_mm=10)
N_ROWS = 12
RANK = 3


class SlidingContact:
    """Linear equations A u = b whose tangent K leaves out an unsymmetric part of low rank, as friction's does."""

    def __init__(self) -> None:
        rng = np.random.default_rng(1)
        n = 3 * N_ROWS
        root = rng.normal(size=(n, n))
        self.K = root @ root.T / n + np.diag(rng.uniform(0.1, 100.0, n))
        self.A = self.K + 2.0 * rng.normal(size=(n, RANK)) @ rng.normal(size=(RANK, n)) / np.sqrt(n)
        self.b = rng.normal(size=n)

    def direction(self, secants: Secants, residual: np.ndarray, step: float) -> np.ndarray:
        direction = np.linalg.solve(self.K, residual)
        correct_direction(secants, direction, residual, step)
        return direction


def test_correction_maps_the_change_of_the_residual_to_the_step() -> None:
    problem, rng, secants = SlidingContact(), np.random.default_rng(2), make_secants(3 * N_ROWS)
    old, new = rng.normal(size=(2, 3 * N_ROWS))
    first = problem.direction(secants, old, 1.0)
    problem.direction(secants, new, 0.3)
    begin_load(secants)
    assert np.allclose(problem.direction(secants, old - new, 1.0), 0.3 * first)


def test_one_factor_and_low_rank_corrections_solve_an_unsymmetric_problem() -> None:
    """Broyden's method ends after twice the rank of what the factor leaves out (Gay 1979)."""
    problem, secants = SlidingContact(), make_secants(3 * N_ROWS)
    u = np.zeros(3 * N_ROWS)
    for _ in range(2 * RANK + 1):
        u += problem.direction(secants, problem.b - problem.A @ u, 1.0)
    assert np.abs(u - np.linalg.solve(problem.A, problem.b)).max() < 1e-8


def test_corrections_are_dropped_with_the_factor_and_when_they_are_used_up() -> None:
    problem, rng, secants = SlidingContact(), np.random.default_rng(3), make_secants(3 * N_ROWS)
    for _ in range(MEMORY + 1):
        problem.direction(secants, rng.normal(size=3 * N_ROWS), 1.0)
    residual = rng.normal(size=3 * N_ROWS)
    plain = np.linalg.solve(problem.K, residual)
    assert np.allclose(problem.direction(secants, residual, 1.0), plain)
    assert not np.allclose(problem.direction(secants, rng.normal(size=3 * N_ROWS), 1.0), plain)
    forget_all(secants)
    assert np.allclose(problem.direction(secants, residual, 1.0), plain)


def test_another_process_compiles_and_where_it_cannot_this_one_does(monkeypatch: pytest.MonkeyPatch) -> None:
    called: list[str] = []
    monkeypatch.setattr(grasp, "call_kernels", lambda: called.append("here"))
    grasp._compile_elsewhere()
    assert not called
    monkeypatch.setattr(sys, "executable", "/bin/false")
    grasp._compile_elsewhere()
    assert called == ["here"]


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
            Stance(BEST_PUBLISHED.height_mm, tip_below_mm=5.0),
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
    # The first iteration of a step has the factor of the step before.
    assert newton.n_factorisations > 0.7 * newton.n_newton
    assert quasi.n_factorisations < 0.5 * quasi.n_newton
