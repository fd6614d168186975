"""Large deflection of a cantilever against the elastica."""

import pytest

from fast.models.simulation.body.shape_functions import ElementKind
from tests.models.simulation.verification.bricks import QUADRATIC
from tests.models.simulation.verification.elastica import elastica_tip, solid_shapes

# Mattiasson 1981, table 1, by elliptic integrals: drop and shortening over the length.
PUBLISHED = {1.0: (0.30172, 0.05643), 2.0: (0.49346, 0.16064), 5.0: (0.71379, 0.38763)}
# Left out of the beam: shear, (h / L)^2 = 1e-4, and the square of the fibre strain at the clamp, 6e-4 at load 5.
TOLERANCE = 2e-3


@pytest.mark.parametrize("load", PUBLISHED)
def test_elastica_solution_is_the_published_one(load: float) -> None:
    tip = elastica_tip(load)
    assert (tip.drop, tip.shortening) == pytest.approx(PUBLISHED[load], abs=2e-5)


@pytest.mark.parametrize("kind", QUADRATIC)
def test_solid_beam_follows_the_elastica(kind: ElementKind) -> None:
    loads = list(PUBLISHED)
    for load, shape in zip(loads, solid_shapes(kind, loads), strict=True):
        tip = elastica_tip(load)
        assert shape[1, -1] == pytest.approx(tip.drop, rel=TOLERANCE)
        assert 1.0 - shape[0, -1] == pytest.approx(tip.shortening, rel=TOLERANCE)
