"""Coulomb friction of one contact point by return mapping."""

import numba as nb
import numpy as np


@nb.njit(inline="always")
def return_mapping(
    traction: np.ndarray,
    motion: np.ndarray,
    normal: np.ndarray,
    limit: float,
    stiffness: float,
    result: np.ndarray,
    tangent: np.ndarray,
) -> float:
    """Compute the friction traction after a motion of the point, its tangent, and the slip of the step in mm.

    Predictor t* = P (t_n - kt (x - x_n)), P = I - n n^T. Stick while |t*| <= mu p: t = t*, tangent kt P. Else slip:
    t = mu p t*/|t*|, tangent kt (mu p / |t*|) (P - t* t*^T / |t*|^2) (Simo & Laursen 1992). The dependence of the
    limit on the pressure is left out of the tangent, which stays symmetric.

    Args:
        traction: t_n (3), last converged, MPa.
        motion: x - x_n (3), mm.
        normal: n (3), outward normal of the object.
        limit: mu p at the current pressure, MPa.
        stiffness: kt in N/mm3.
        result: receives t (3).
        tangent: receives -dt/dx (3, 3).
    """
    along = 0.0
    for i in range(3):
        result[i] = traction[i] - stiffness * motion[i]
        along += result[i] * normal[i]
    size = 0.0
    for i in range(3):
        result[i] -= along * normal[i]
        size += result[i] * result[i]
    size = np.sqrt(size)
    for i in range(3):
        for j in range(3):
            tangent[i, j] = stiffness * ((1.0 if i == j else 0.0) - normal[i] * normal[j])
    if size <= limit:
        return 0.0
    ratio = limit / size
    for i in range(3):
        for j in range(3):
            tangent[i, j] = ratio * (tangent[i, j] - stiffness * result[i] * result[j] / (size * size))
    for i in range(3):
        result[i] *= ratio
    return (size - limit) / stiffness
