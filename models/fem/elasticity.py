"""Hyperelastic material laws and the element kernel: internal force and exact tangent, total Lagrangian.

With F = sum x_a (x) dN_a/dX, J = det F, l = ln J, S the second and P the first Piola-Kirchhoff stress:

- neo-Hookean W = mu/2 (I1 - 3 - 2 l) + lam/2 l^2 (Bonet & Wood 2008, Eq. 6.27), P = mu F + (lam l - mu) F^-T.
  With g_a = F^-T dN_a and s_ab = dN_a . dN_b the tangent block is
  K_ab = w [mu s_ab I + (mu - lam l) g_b g_a^T + lam g_a g_b^T].
- St.Venant-Kirchhoff S = lam tr(E) I + 2 mu E, P = F S. It is what CalculiX computes for *ELASTIC with NLGEOM, so
  it is the law of the reference tests.
  K_ab = w [lam Fa (Fb)^T + mu Fb (Fa)^T + mu s_ab F F^T + (a . S b) I], a = dN_a, b = dN_b.

The two laws differ by less than 2 % in the pull-off force (notes/fem.md section 1); neo-Hookean is cheaper and
stays stable in compression, so it is the default.
"""

from typing import Literal

import numba as nb
import numpy as np

MaterialLaw = Literal["neo_hookean", "st_venant_kirchhoff"]

# All grasps are solved at this modulus and their forces scaled by E / REFERENCE: a quasi-static, displacement-
# controlled grasp of a linear-elastic finger with Coulomb friction is proportional to E. Contact stiffness, density
# and tolerances are given at the reference too, so they scale along and F(2E) = 2 F(E) holds to the last bit.
REFERENCE_MODULUS_MPA = 11.5

LAW_CODE: dict[MaterialLaw, int] = {"neo_hookean": 0, "st_venant_kirchhoff": 1}


def lame_constants(young_modulus_mpa: float, poisson_ratio: float) -> tuple[float, float]:
    """Lame constants (lam, mu) in MPa."""
    shear = young_modulus_mpa / (2.0 * (1.0 + poisson_ratio))
    return 2.0 * shear * poisson_ratio / (1.0 - 2.0 * poisson_ratio), shear


@nb.njit(inline="always")
def _gradient(x: np.ndarray, slopes: np.ndarray, F: np.ndarray) -> None:
    F[:] = 0.0
    for a in range(x.shape[0]):
        for i in range(3):
            for j in range(3):
                F[i, j] += x[a, i] * slopes[a, j]


@nb.njit(inline="always")
def _determinant(F: np.ndarray) -> float:
    return (
        F[0, 0] * (F[1, 1] * F[2, 2] - F[1, 2] * F[2, 1])
        - F[0, 1] * (F[1, 0] * F[2, 2] - F[1, 2] * F[2, 0])
        + F[0, 2] * (F[1, 0] * F[2, 1] - F[1, 1] * F[2, 0])
    )


@nb.njit(inline="always")
def _inverse(F: np.ndarray, J: float, inverse: np.ndarray) -> None:
    for i in range(3):
        for j in range(3):
            a, b, c, d = (j + 1) % 3, (i + 1) % 3, (j + 2) % 3, (i + 2) % 3
            inverse[i, j] = (F[a, b] * F[c, d] - F[a, d] * F[c, b]) / J


@nb.njit(inline="always")
def _neo_hookean(
    F: np.ndarray, J: float, slopes: np.ndarray, w: float, lam: float, mu: float, g: np.ndarray, force: np.ndarray
) -> None:
    """Add the neo-Hookean nodal forces; `g` (3, k) receives F^-T dN_a."""
    inverse = np.zeros((3, 3))
    _inverse(F, J, inverse)
    factor = lam * np.log(J) - mu
    for a in range(slopes.shape[0]):
        for i in range(3):
            g_ia = inverse[0, i] * slopes[a, 0] + inverse[1, i] * slopes[a, 1] + inverse[2, i] * slopes[a, 2]
            Fa = F[i, 0] * slopes[a, 0] + F[i, 1] * slopes[a, 1] + F[i, 2] * slopes[a, 2]
            g[i, a] = g_ia
            force[a, i] += w * (mu * Fa + factor * g_ia)


@nb.njit(inline="always")
def _st_venant(
    F: np.ndarray, slopes: np.ndarray, w: float, lam: float, mu: float, S: np.ndarray, g: np.ndarray, force: np.ndarray
) -> None:
    """Add the St.Venant-Kirchhoff nodal forces; `S` receives the stress, `g` (3, k) receives F dN_a."""
    trace = 0.0
    for i in range(3):
        for j in range(3):
            S[i, j] = F[0, i] * F[0, j] + F[1, i] * F[1, j] + F[2, i] * F[2, j] - (1.0 if i == j else 0.0)
        trace += S[i, i]
    for i in range(3):
        for j in range(3):
            S[i, j] = mu * S[i, j] + (0.5 * lam * trace if i == j else 0.0)
    for a in range(slopes.shape[0]):
        s0 = S[0, 0] * slopes[a, 0] + S[0, 1] * slopes[a, 1] + S[0, 2] * slopes[a, 2]
        s1 = S[1, 0] * slopes[a, 0] + S[1, 1] * slopes[a, 1] + S[1, 2] * slopes[a, 2]
        s2 = S[2, 0] * slopes[a, 0] + S[2, 1] * slopes[a, 1] + S[2, 2] * slopes[a, 2]
        for i in range(3):
            g[i, a] = F[i, 0] * slopes[a, 0] + F[i, 1] * slopes[a, 1] + F[i, 2] * slopes[a, 2]
            force[a, i] += w * (F[i, 0] * s0 + F[i, 1] * s1 + F[i, 2] * s2)


@nb.njit(inline="always")
def _add_dyads(K: np.ndarray, g: np.ndarray, k: int, swapped: float, straight: float) -> None:
    """K_ab += swapped g_b g_a^T + straight g_a g_b^T for b <= a; K is (3, 3, k, k) to vectorise over b."""
    for i in range(3):
        for j in range(3):
            for a in range(k):
                c, d = swapped * g[j, a], straight * g[i, a]
                for b in range(a + 1):
                    K[i, j, a, b] += c * g[i, b] + d * g[j, b]


@nb.njit(inline="always")
def _add_isotropic(K: np.ndarray, slopes: np.ndarray, k: int, A: np.ndarray, S: np.ndarray) -> None:
    """K_ab += (dN_a . dN_b) A + (dN_a . S dN_b) I for b <= a, symmetric A and S (3, 3)."""
    for a in range(k):
        u0, u1, u2 = slopes[a, 0], slopes[a, 1], slopes[a, 2]
        t0 = S[0, 0] * u0 + S[0, 1] * u1 + S[0, 2] * u2
        t1 = S[1, 0] * u0 + S[1, 1] * u1 + S[1, 2] * u2
        t2 = S[2, 0] * u0 + S[2, 1] * u1 + S[2, 2] * u2
        for b in range(a + 1):
            s = u0 * slopes[b, 0] + u1 * slopes[b, 1] + u2 * slopes[b, 2]
            geometric = t0 * slopes[b, 0] + t1 * slopes[b, 1] + t2 * slopes[b, 2]
            for i in range(3):
                for j in range(3):
                    K[i, j, a, b] += s * A[i, j]
                K[i, i, a, b] += geometric


@nb.njit(inline="always")
def _add_shear(K: np.ndarray, slopes: np.ndarray, k: int, c: float) -> None:
    """K_ab += c (dN_a . dN_b) I for b <= a."""
    for a in range(k):
        u0, u1, u2 = c * slopes[a, 0], c * slopes[a, 1], c * slopes[a, 2]
        for b in range(a + 1):
            s = u0 * slopes[b, 0] + u1 * slopes[b, 1] + u2 * slopes[b, 2]
            K[0, 0, a, b] += s
            K[1, 1, a, b] += s
            K[2, 2, a, b] += s


@nb.njit(cache=True, nogil=True, fastmath={"contract", "nsz"}, error_model="numpy")
def element_stiffness(
    x: np.ndarray,
    slopes: np.ndarray,
    weights: np.ndarray,
    law: int,
    lam: float,
    mu: float,
    force: np.ndarray,
    K: np.ndarray,
) -> bool:
    """Nodal forces (k, 3) and tangent K (3, 3, k, k; lower triangle b <= a) of one element.

    x (k, 3) deformed nodes in mm, slopes (q, k, 3) = dN/dX in 1/mm, weights (q) in mm3. Returns False if the
    element is inverted at a point (J <= 0).
    """
    k = x.shape[0]
    F, S, A = np.zeros((3, 3)), np.zeros((3, 3)), np.zeros((3, 3))
    g = np.zeros((3, k))
    force[:] = 0.0
    K[:] = 0.0
    for q in range(len(weights)):
        w = weights[q]
        _gradient(x, slopes[q], F)
        J = _determinant(F)
        if not J > 0.0:
            return False
        if law == 0:
            _neo_hookean(F, J, slopes[q], w, lam, mu, g, force)
            _add_dyads(K, g, k, w * (mu - lam * np.log(J)), w * lam)
            _add_shear(K, slopes[q], k, w * mu)
        else:
            _st_venant(F, slopes[q], w, lam, mu, S, g, force)
            _add_dyads(K, g, k, w * mu, w * lam)
            for i in range(3):
                for j in range(3):
                    A[i, j] = w * mu * (F[i, 0] * F[j, 0] + F[i, 1] * F[j, 1] + F[i, 2] * F[j, 2])
            S *= w
            _add_isotropic(K, slopes[q], k, A, S)
    return True


@nb.njit(cache=True, nogil=True, fastmath={"contract", "nsz"}, error_model="numpy")
def element_force(
    x: np.ndarray, slopes: np.ndarray, weights: np.ndarray, law: int, lam: float, mu: float, force: np.ndarray
) -> bool:
    """Nodal forces of one element, without the tangent; arguments as `element_stiffness`."""
    k = x.shape[0]
    F, S, g = np.zeros((3, 3)), np.zeros((3, 3)), np.zeros((3, k))
    force[:] = 0.0
    for q in range(len(weights)):
        _gradient(x, slopes[q], F)
        J = _determinant(F)
        if not J > 0.0:
            return False
        if law == 0:
            _neo_hookean(F, J, slopes[q], weights[q], lam, mu, g, force)
        else:
            _st_venant(F, slopes[q], weights[q], lam, mu, S, g, force)
    return True
