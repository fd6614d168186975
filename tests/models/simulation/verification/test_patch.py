"""Patch tests: a distorted patch of each element kind reproduces every constant deformation and its stress exactly."""

import numpy as np
import pytest

from fast.models.simulation.body.assembly import ElasticBody, Material
from fast.models.simulation.body.elasticity import MaterialLaw, lame_constants
from fast.models.simulation.body.shape_functions import ElementKind
from tests.models.simulation.verification.bricks import KINDS, brick, cube_grid, equilibrium

MODULUS, POISSON = 11.5, 0.45
ANGLE = 1.0  # rad
ROTATION = np.array([[np.cos(ANGLE), 0, -np.sin(ANGLE)], [0, 1, 0], [np.sin(ANGLE), 0, np.cos(ANGLE)]])
STRETCH = np.array([[1.3, 0.1, 0.0], [0.1, 0.9, 0.05], [0.0, 0.05, 0.85]])
DEFORMATIONS = {
    "small strain": np.eye(3) + 1e-4 * np.array([[1.0, 0.5, 0.2], [0.3, -0.7, 0.4], [-0.1, 0.6, 0.2]]),
    "rotation": ROTATION,
    "stretch": STRETCH,
    "rotated stretch": ROTATION @ STRETCH,
}


def on_surface(points: np.ndarray) -> np.ndarray:
    return (np.abs(points - 0.5) > 0.5 - 1e-9).any(axis=1)


def distorted(points: np.ndarray) -> np.ndarray:
    """Corners of the 2 x 2 x 2 patch moved at random within the cube, by up to 0.15 of its side."""
    shift = np.random.default_rng(5).uniform(-0.15, 0.15, points.shape)
    return points + np.where((points == 0.0) | (points == 1.0), 0.0, shift)


def piola(F: np.ndarray, law: MaterialLaw) -> np.ndarray:
    """First Piola-Kirchhoff stress in MPa, straight from the definition of the law."""
    lam, mu = lame_constants(MODULUS, POISSON)
    if law == "neo_hookean":
        inverse = np.linalg.inv(F).T
        return mu * (F - inverse) + lam * np.log(np.linalg.det(F)) * inverse
    green = 0.5 * (F.T @ F - np.eye(3))
    return F @ (lam * np.trace(green) * np.eye(3) + 2.0 * mu * green)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("law", ["neo_hookean", "st_venant_kirchhoff"])
@pytest.mark.parametrize("name", DEFORMATIONS)
def test_patch_reproduces_constant_deformation(kind: ElementKind, law: MaterialLaw, name: str) -> None:
    F = DEFORMATIONS[name]
    mesh = brick(kind, cube_grid(2), place=distorted, base=on_surface)
    body = ElasticBody(mesh, mesh.nodes, Material(MODULUS, POISSON, law))
    exact = mesh.nodes @ F.T
    start = exact.copy()
    inner = ~on_surface(mesh.nodes)
    start[inner] += np.random.default_rng(1).uniform(-0.01, 0.01, (inner.sum(), 3)) * np.abs(F - np.eye(3)).max()
    x = equilibrium(body, start)
    assert np.abs(x - exact).max() < 1e-10

    force = body.force(x)
    assert force is not None
    mean_stress = np.einsum("ai,aj->ij", force, mesh.nodes)  # sum of f (x) X = integral of P over the volume of 1
    assert np.allclose(mean_stress, piola(F, law), rtol=1e-9, atol=1e-10)
