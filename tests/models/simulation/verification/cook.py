"""Cook's membrane: a tapered panel in bending and shear, plane strain, the usual test for volumetric locking.

Corners (0, 0), (48, 44), (48, 60), (0, 44) mm, clamped on the left, sheared upwards on the right (Cook 1974). The
load is small, so the deflection is that of linear elasticity.
"""

import numpy as np

from fast.models.simulation.body.assembly import ElasticBody, Material
from fast.models.simulation.body.shape_functions import ElementKind
from tests.models.simulation.verification.bricks import brick, equilibrium, everything, face_load

MODULUS_MPA, SHEAR_MPA = 1.0, 1e-5
END_MM = 48.0


def tapered(points: np.ndarray) -> np.ndarray:
    """Unit square (x, z) to the panel."""
    x, y, z = points.T
    low, high = 44.0 * x, 44.0 + 16.0 * x
    return np.column_stack([END_MM * x, y, low + (high - low) * z])


def tip_deflection(kind: ElementKind, n_cells: int, poisson: float) -> float:
    """Upward displacement of the upper right corner in mm per MPa of end shear, with n x n cells."""
    lines = np.linspace(0.0, 1.0, n_cells + 1)
    mesh = brick(
        kind,
        (lines, np.array([0.0, END_MM / n_cells]), lines),
        place=tapered,
        base=lambda p: p[:, 0] == 0.0,
        symmetry=everything,
        contact=lambda p: p[:, 0] == END_MM,
    )
    body = ElasticBody(mesh, mesh.nodes, Material(MODULUS_MPA, poisson))
    x = equilibrium(body, mesh.nodes, face_load(mesh, np.array([0.0, 0.0, SHEAR_MPA])))
    corner = np.flatnonzero((mesh.nodes[:, 0] == END_MM) & (mesh.nodes[:, 1] == 0.0) & (mesh.nodes[:, 2] == 60.0))
    return float((x - mesh.nodes)[corner[0], 2] / SHEAR_MPA)
