"""Near-incompressibility: Cook's membrane at nu 0.49 and 0.499 must not lock."""

import pytest

from fast.models.simulation.body.shape_functions import ElementKind
from tests.models.simulation.verification.cook import tip_deflection

# Least share of the fine deflection that 8 x 8 cells must reach. Fifteen-node wedges and ten-node tetrahedra are
# fully integrated and stiffen a little towards nu = 0.5, reduced hexahedra hardly; linear tetrahedra lock.
SHARE = {"C3D10": 0.92, "C3D15": 0.92, "C3D20R": 0.97}
FINE = 32


@pytest.fixture(scope="module", params=[0.49, 0.499])
def fine(request: pytest.FixtureRequest) -> tuple[float, float]:
    """Poisson ratio and the deflection on the finest mesh."""
    return request.param, tip_deflection("C3D20R", FINE, request.param)


@pytest.mark.parametrize("kind", SHARE)
def test_quadratic_elements_do_not_lock(kind: ElementKind, fine: tuple[float, float]) -> None:
    poisson, deflection = fine
    assert SHARE[kind] * deflection < tip_deflection(kind, 8, poisson) < deflection


def test_linear_tetrahedra_lock(fine: tuple[float, float]) -> None:
    poisson, deflection = fine
    assert tip_deflection("C3D4", 8, poisson) < 0.5 * deflection
