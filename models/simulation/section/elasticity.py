"""Plane-strain elements: shape functions, quadrature, internal force and exact tangent, total Lagrangian.

The same neo-Hookean law as the solid (`models.simulation.body.elasticity`) with F_yy = 1, so that J is the determinant
of the in-plane F. With g_a = F^-T dN_a, l = ln J and s_ab = dN_a . dN_b, now all in the (x, z) plane:

    P = mu F + (lam l - mu) F^-T
    K_ab = w [mu s_ab I + (mu - lam l) g_b g_a^T + lam g_a g_b^T]

Stiffening with strain is the solid's too.
"""

import numba as nb
import numpy as np

from models.errors import MeshingFailed
from models.simulation.body.shape_functions import face_shape

_CORNERS = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
# Points (q, 2) and weight of each: three of a six-node triangle, 2 x 2 of a reduced eight-node quadrilateral.
_RULES = {
    6: (np.array([[1 / 6, 1 / 6], [2 / 3, 1 / 6], [1 / 6, 2 / 3]]), 1.0 / 6.0),
    8: (_CORNERS / np.sqrt(3.0), 1.0),
}


def reference_gradients(
    connectivity: np.ndarray, nodes: np.ndarray, width_mm: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Gradients dN/dX (m, q, k, 2), weights (m, q) in mm3 and shape values (q, k) of elements (m, k).

    Raises:
        MeshingFailed: `inverted_element`.
    """
    points, weight = _RULES[connectivity.shape[1]]
    values, gradients = face_shape(connectivity.shape[1], points)
    jacobian = np.einsum("mai,qaj->mqij", nodes[connectivity], gradients)
    determinant = np.linalg.det(jacobian)
    # The object frame is a mirror image of the finger's (x, z) plane: all elements turn the other way round.
    determinant *= np.sign(determinant.flat[0])
    if not determinant.min() > 0.0:
        raise MeshingFailed(
            f"{int((determinant.min(axis=1) <= 0).sum())} of {len(determinant)} elements are inverted before any "
            "load; change the mesh settings.",
            reason="inverted_element",
        )
    slopes = np.einsum("qaj,mqji->mqai", gradients, np.linalg.inv(jacobian))
    return np.ascontiguousarray(slopes), weight * width_mm * determinant, values


@nb.njit(inline="always")
def _deformation(x: np.ndarray, nodes: np.ndarray, slopes: np.ndarray) -> tuple[float, float, float, float]:
    """F_xx, F_xz, F_zx, F_zz at one point of an element."""
    f00 = f01 = f10 = f11 = 0.0
    for a in range(len(nodes)):
        u, v = x[nodes[a], 0], x[nodes[a], 1]
        f00 += u * slopes[a, 0]
        f01 += u * slopes[a, 1]
        f10 += v * slopes[a, 0]
        f11 += v * slopes[a, 1]
    return f00, f01, f10, f11


@nb.njit(cache=True, nogil=True, fastmath={"contract", "nsz"}, error_model="numpy")
def add_force(
    x: np.ndarray,
    elements: np.ndarray,
    slopes: np.ndarray,
    weights: np.ndarray,
    lam: float,
    mu: float,
    c: float,
    force: np.ndarray,
) -> bool:
    """Add the nodal forces of all elements (m, k) to `force` (n, 2); False if one is inverted (J <= 0)."""
    m, k = elements.shape
    for e in range(m):
        nodes = elements[e]
        for q in range(weights.shape[1]):
            f00, f01, f10, f11 = _deformation(x, nodes, slopes[e, q])
            J = f00 * f11 - f01 * f10
            if not J > 0.0:
                return False
            w = weights[e, q]
            if c != 0.0:
                w *= 1.0 + c * _energy(f00, f01, f10, f11, np.log(J), lam, mu)
            v = w * (lam * np.log(J) - mu) / J
            p00, p01 = w * mu * f00 + v * f11, w * mu * f01 - v * f10
            p10, p11 = w * mu * f10 - v * f01, w * mu * f11 + v * f00
            for a in range(k):
                s0, s1 = slopes[e, q, a, 0], slopes[e, q, a, 1]
                force[nodes[a], 0] += p00 * s0 + p01 * s1
                force[nodes[a], 1] += p10 * s0 + p11 * s1
    return True


@nb.njit(cache=True, nogil=True, fastmath={"contract", "nsz"}, error_model="numpy")
def add_stiffness(
    x: np.ndarray,
    elements: np.ndarray,
    slopes: np.ndarray,
    weights: np.ndarray,
    lam: float,
    mu: float,
    c: float,
    places: np.ndarray,
    blocks: np.ndarray,
) -> bool:
    """Add the tangent to `blocks` (z, 2, 2), whose `places` are in the code of `assembly.ElasticBody`."""
    m, k = elements.shape
    g, h, K = np.zeros((2, k)), np.zeros((2, k)), np.zeros((2, 2, k, k))
    for e in range(m):
        K[:] = 0.0
        for q in range(weights.shape[1]):
            f00, f01, f10, f11 = _deformation(x, elements[e], slopes[e, q])
            J = f00 * f11 - f01 * f10
            if not J > 0.0:
                return False
            w, slope = weights[e, q], slopes[e, q]
            for a in range(k):
                g[0, a] = (f11 * slope[a, 0] - f10 * slope[a, 1]) / J
                g[1, a] = (f00 * slope[a, 1] - f01 * slope[a, 0]) / J
            if c != 0.0:
                log_J = np.log(J)
                for a in range(k):
                    s0, s1 = slope[a, 0], slope[a, 1]
                    h[0, a] = mu * (f00 * s0 + f01 * s1) + (lam * log_J - mu) * g[0, a]
                    h[1, a] = mu * (f10 * s0 + f11 * s1) + (lam * log_J - mu) * g[1, a]
                _add_stiffening(K, h, w * c)
                w *= 1.0 + c * _energy(f00, f01, f10, f11, log_J, lam, mu)
            _add_point(K, g, slope, w * (mu - lam * np.log(J)), w * lam, w * mu)
        _scatter(K, places[e], blocks)
    return True


@nb.njit(inline="always")
def _energy(f00: float, f01: float, f10: float, f11: float, log_J: float, lam: float, mu: float) -> float:
    """Neo-Hookean strain energy in MPa."""
    return 0.5 * mu * (f00 * f00 + f01 * f01 + f10 * f10 + f11 * f11 - 2.0 - 2.0 * log_J) + 0.5 * lam * log_J * log_J


@nb.njit(inline="always")
def _add_stiffening(K: np.ndarray, h: np.ndarray, w: float) -> None:
    """K_ab += w h_a h_b^T for b <= a."""
    for a in range(h.shape[1]):
        for b in range(a + 1):
            for i in range(2):
                for j in range(2):
                    K[i, j, a, b] += w * h[i, a] * h[j, b]


@nb.njit(inline="always")
def _add_point(K: np.ndarray, g: np.ndarray, slope: np.ndarray, swapped: float, straight: float, shear: float) -> None:
    """K_ab += swapped g_b g_a^T + straight g_a g_b^T + shear s_ab I for b <= a; K is (2, 2, k, k)."""
    for a in range(g.shape[1]):
        g0, g1 = g[0, a], g[1, a]
        s0, s1 = shear * slope[a, 0], shear * slope[a, 1]
        for b in range(a + 1):
            isotropic = s0 * slope[b, 0] + s1 * slope[b, 1]
            K[0, 0, a, b] += (swapped + straight) * g0 * g[0, b] + isotropic
            K[0, 1, a, b] += swapped * g1 * g[0, b] + straight * g0 * g[1, b]
            K[1, 0, a, b] += swapped * g0 * g[1, b] + straight * g1 * g[0, b]
            K[1, 1, a, b] += (swapped + straight) * g1 * g[1, b] + isotropic


@nb.njit(inline="always")
def _scatter(K: np.ndarray, places: np.ndarray, blocks: np.ndarray) -> None:
    for a in range(places.shape[0]):
        for b in range(a + 1):
            place = places[a, b]
            if place >= 0:
                for i in range(2):
                    for j in range(2):
                        blocks[place, i, j] += K[i, j, a, b]
            elif place < -1:
                for i in range(2):
                    for j in range(2):
                        blocks[-2 - place, j, i] += K[i, j, a, b]
