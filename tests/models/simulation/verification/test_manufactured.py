"""Rates of convergence on a manufactured finite deformation of a neo-Hookean cube."""

import numpy as np
import pytest

from fast.models.simulation.body.elasticity import lame_constants
from fast.models.simulation.body.shape_functions import ElementKind
from tests.models.simulation.verification.manufactured import (
    MODULUS_MPA,
    POISSON,
    body_force,
    gradient,
    observed_rates,
    solve_cube,
)

# Theory is asymptotic: on these meshes the last rates may still be this much short of it.
SHORTFALL = 0.15


def piola(X: np.ndarray) -> np.ndarray:
    lam, mu = lame_constants(MODULUS_MPA, POISSON)
    F = gradient(X)
    inverse = np.linalg.inv(F).transpose(0, 2, 1)
    return mu * F + (lam * np.log(np.linalg.det(F)) - mu)[:, None, None] * inverse


def test_body_force_balances_the_stress() -> None:
    X, h = np.random.default_rng(0).random((20, 3)), 1e-5
    divergence = sum((piola(X + h * e) - piola(X - h * e))[:, :, j] / (2 * h) for j, e in enumerate(np.eye(3)))
    assert np.allclose(divergence, -body_force(X), atol=1e-7)


@pytest.mark.parametrize(
    ("kind", "degree", "n_cells"),
    [("C3D4", 1, (8, 12)), ("C3D10", 2, (4, 6)), ("C3D15", 2, (4, 6)), ("C3D20R", 2, (4, 6))],
)
def test_error_falls_at_the_rate_of_theory(kind: ElementKind, degree: int, n_cells: tuple[int, int]) -> None:
    coarse, fine = (solve_cube(kind, n) for n in n_cells)
    l2, h1 = observed_rates(coarse, fine)
    assert l2 > degree + 1 - SHORTFALL
    assert h1 > degree - SHORTFALL
