"""Hyperelastic material laws and the element kernel: internal force and exact tangent, total Lagrangian.

With F = sum x_a (x) dN_a/dX, J = det F, l = ln J, S the second and P the first Piola-Kirchhoff stress:

- neo-Hookean W = mu/2 (I1 - 3 - 2 l) + lam/2 l^2 (Bonet & Wood 2008, Eq. 6.27), P = mu F + (lam l - mu) F^-T.
  With g_a = F^-T dN_a and s_ab = dN_a . dN_b the tangent block is
  K_ab = w [mu s_ab I + (mu - lam l) g_b g_a^T + lam g_a g_b^T].
- St.Venant-Kirchhoff S = lam tr(E) I + 2 mu E, P = F S. It is what CalculiX computes for *ELASTIC with NLGEOM, so
  it is the law of the reference tests.
  K_ab = w [lam Fa (Fb)^T + mu Fb (Fa)^T + mu s_ab F F^T + (a . S b) I], a = dN_a, b = dN_b.

The neo-Hookean law may stiffen with strain, as W + c W^2 / 2 instead of W: the stress P is multiplied by 1 + c W, and
the tangent too, which gains w c (P dN_a) (P dN_b)^T.

The two laws differ by 2 to 3 % in the median peak of a grasp, and by 8 to 11 % at the 95th percentile (decision 021).
Neo-Hookean is a little cheaper and stays stable in strong compression, so it is the default.
"""

from typing import Literal

import numba as nb
import numpy as np

MaterialLaw = Literal["neo_hookean", "st_venant_kirchhoff"]

# All grasps are solved at this modulus and their forces scaled by E / REFERENCE: a quasi-static, displacement-
# controlled grasp of a linear-elastic finger with Coulomb friction is proportional to E. Contact stiffness, density
# and tolerances are given at the reference too, so they scale along and F(2E) = 2 F(E) holds to the last bit.
REFERENCE_MODULUS_MPA = 11.5

VECTOR = 4  # rows of the tangent are filled in whole vectors of this many nodes,
WIDTH = 20  # in rows for the largest element: a length that the compiler knows, or it does not vectorise

ELEMENTS = 32  # how many elements of one kind lie side by side while their forces are computed: they fit in the cache

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
def _stiffened(F: np.ndarray, J: float, w: float, lam: float, mu: float, c: float) -> float:
    """Weight of a point times 1 + c W of the neo-Hookean energy W; exactly the weight for c = 0."""
    if c == 0.0:
        return w
    first, log_J = 0.0, np.log(J)
    for i in range(3):
        for j in range(3):
            first += F[i, j] * F[i, j]
    return w * (1.0 + c * (0.5 * mu * (first - 3.0 - 2.0 * log_J) + 0.5 * lam * log_J * log_J))


@nb.njit(inline="always")
def _add_stiffening(a: int, row: np.ndarray, h: np.ndarray) -> None:
    """Add sum over points of h_a h_b^T to the row of `_tangent_row`; h (q, 3, k)."""
    for q in range(len(h)):
        for i in range(3):
            for j in range(3):
                for b in range(a + 1):
                    row[3 * i + j, b] += h[q, i, a] * h[q, j, b]


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
def _tangent_row(
    a: int, row: np.ndarray, g: np.ndarray, S: np.ndarray, swapped: np.ndarray, straight: np.ndarray
) -> None:
    """Row a of the tangent: K_ab = sum over points of swapped g_b g_a^T + straight g_a g_b^T + (dN_a . S dN_b) I.

    `row` (9, k') receives entry (i, j) of the blocks in 3 i + j. g (q, 6, k') holds the vectors g_a, then dN_a; S
    (q, 3, 3). k' is k rounded up to whole vectors. The points run outside the nodes b, so a row stays in the cache.
    """
    n = (a // VECTOR + 1) * VECTOR
    row[:] = 0.0
    for q in range(len(S)):
        a0, a1, a2 = straight[q] * g[q, 0, a], straight[q] * g[q, 1, a], straight[q] * g[q, 2, a]
        c0, c1, c2 = swapped[q] * g[q, 0, a], swapped[q] * g[q, 1, a], swapped[q] * g[q, 2, a]
        u0, u1, u2 = g[q, 3, a], g[q, 4, a], g[q, 5, a]
        s0 = S[q, 0, 0] * u0 + S[q, 0, 1] * u1 + S[q, 0, 2] * u2
        s1 = S[q, 1, 0] * u0 + S[q, 1, 1] * u1 + S[q, 1, 2] * u2
        s2 = S[q, 2, 0] * u0 + S[q, 2, 1] * u1 + S[q, 2, 2] * u2
        for b in range(n):
            geometric = s0 * g[q, 3, b] + s1 * g[q, 4, b] + s2 * g[q, 5, b]
            g0, g1, g2 = g[q, 0, b], g[q, 1, b], g[q, 2, b]
            row[0, b] += geometric + (a0 + c0) * g0
            row[4, b] += geometric + (a1 + c1) * g1
            row[8, b] += geometric + (a2 + c2) * g2
            row[1, b] += a0 * g1 + c1 * g0
            row[2, b] += a0 * g2 + c2 * g0
            row[5, b] += a1 * g2 + c2 * g1
            row[3, b] += a1 * g0 + c0 * g1
            row[6, b] += a2 * g0 + c0 * g2
            row[7, b] += a2 * g1 + c1 * g2


@nb.njit(inline="always")
def _add_moduli(a: int, row: np.ndarray, g: np.ndarray, A: np.ndarray) -> None:
    """Add sum over points of (dN_a . dN_b) A to the row of `_tangent_row`; A (q, 3, 3)."""
    for q in range(len(A)):
        for b in range(a + 1):
            s = 0.0
            for i in range(3):
                s += g[q, 3 + i, a] * g[q, 3 + i, b]
            for i in range(3):
                for j in range(3):
                    row[3 * i + j, b] += s * A[q, i, j]


@nb.njit(cache=True, nogil=True, fastmath={"contract", "nsz"}, error_model="numpy")
def element_stiffness(
    x: np.ndarray,
    slopes: np.ndarray,
    weights: np.ndarray,
    law: int,
    lam: float,
    mu: float,
    c: float,
    force: np.ndarray,
    K: np.ndarray,
) -> bool:
    """Nodal forces (k, 3) and tangent K (k, 9, k; blocks b <= a, entry (i, j) in 3 i + j) of one element.

    x (k, 3) deformed nodes in mm, slopes (q, k, 3) = dN/dX in 1/mm, weights (q) in mm3, c in 1/MPa (neo-Hookean law
    only). Returns False if the
    element is inverted at a point (J <= 0).
    """
    n_points, k = slopes.shape[:2]
    g, row = np.zeros((n_points, 6, WIDTH)), np.zeros((9, WIDTH))
    S, A = np.zeros((n_points, 3, 3)), np.zeros((n_points, 3, 3))
    h = np.zeros((n_points if c != 0.0 else 0, 3, k))
    swapped, straight, F = np.zeros(n_points), np.zeros(n_points), np.zeros((3, 3))
    force[:] = 0.0
    for q in range(n_points):
        w = weights[q]
        _gradient(x, slopes[q], F)
        J = _determinant(F)
        if not J > 0.0:
            return False
        for a in range(k):
            for i in range(3):
                g[q, 3 + i, a] = slopes[q, a, i]
        if law == 0:
            w = _stiffened(F, J, w, lam, mu, c)
            _neo_hookean(F, J, slopes[q], w, lam, mu, g[q], force)
            if c != 0.0:
                size, pressure = np.sqrt(weights[q] * c), lam * np.log(J) - mu
                for a in range(k):
                    for i in range(3):
                        Fa = 0.0
                        for j in range(3):
                            Fa += F[i, j] * slopes[q, a, j]
                        h[q, i, a] = size * (mu * Fa + pressure * g[q, i, a])
            swapped[q], straight[q] = w * (mu - lam * np.log(J)), w * lam
            for i in range(3):
                S[q, i, i] = w * mu
        else:
            _st_venant(F, slopes[q], w, lam, mu, S[q], g[q], force)
            swapped[q], straight[q] = w * mu, w * lam
            for i in range(3):
                for j in range(3):
                    S[q, i, j] *= w
                    A[q, i, j] = w * mu * (F[i, 0] * F[j, 0] + F[i, 1] * F[j, 1] + F[i, 2] * F[j, 2])
    for a in range(k):
        _tangent_row(a, row, g, S, swapped, straight)
        if law != 0:
            _add_moduli(a, row, g, A)
        if c != 0.0:
            _add_stiffening(a, row, h)
        for entry in range(9):
            for b in range(a + 1):
                K[a, entry, b] = row[entry, b]
    return True


@nb.njit(cache=True, nogil=True, fastmath={"contract", "nsz"}, error_model="numpy")
def add_forces(
    x: np.ndarray,
    elements: np.ndarray,
    gradients: np.ndarray,
    inverses: np.ndarray,
    weights: np.ndarray,
    law: int,
    lam: float,
    mu: float,
    c: float,
    force: np.ndarray,
) -> bool:
    """Add the nodal forces (n, 3) of elements (m, k) of one kind at deformed nodes x (n, 3); False if one is inverted.

    gradients (q, 3, k') = dN/dxi, filled up with zeros to whole vectors of nodes; inverses (q, 9, m): dxi_i/dX_j in
    3 i + j, in 1/mm; weights (q, m) in mm3; the law as in `element_stiffness`.

    Elements are taken `ELEMENTS` at a time and lie side by side in vectors, coordinate i of all of them in a row.
    """
    k = elements.shape[1]
    local, local_force = np.zeros((gradients.shape[2], 3 * ELEMENTS)), np.zeros((k, 3 * ELEMENTS))
    g = np.zeros((3, 3 * ELEMENTS))
    for first in range(0, len(elements), ELEMENTS):
        n = min(ELEMENTS, len(elements) - first)
        for e in range(n):
            for a in range(k):
                for i in range(3):
                    local[a, i * n + e] = x[elements[first + e, a], i]
        local_force[:] = 0.0
        for q in range(len(gradients)):
            _sum_nodes(gradients[q], local, 3 * n, g)
            for e in range(n):
                if not _stress_of_point(inverses[q], weights[q, first + e], first + e, law, lam, mu, c, g, e, n):
                    return False
            _spread_to_nodes(gradients[q], g, 3 * n, local_force)
        for e in range(n):
            for a in range(k):
                for i in range(3):
                    force[elements[first + e, a], i] += local_force[a, i * n + e]
    return True


@nb.njit(inline="always")
def _sum_nodes(gradients: np.ndarray, local: np.ndarray, n: int, g: np.ndarray) -> None:
    """Row j of g is the sum over nodes a of gradients (3, k') times row a of `local`; n columns."""
    for j in range(3):
        g[j, :n] = 0.0
        for a in range(0, gradients.shape[1], VECTOR):
            d0, d1, d2, d3 = gradients[j, a], gradients[j, a + 1], gradients[j, a + 2], gradients[j, a + 3]
            for b in range(n):
                g[j, b] += d0 * local[a, b] + d1 * local[a + 1, b] + d2 * local[a + 2, b] + d3 * local[a + 3, b]


@nb.njit(inline="always")
def _spread_to_nodes(gradients: np.ndarray, g: np.ndarray, n: int, local_force: np.ndarray) -> None:
    """Add to row a of `local_force` the sum over j of gradients (3, k') times row j of g; n columns."""
    for a in range(len(local_force)):
        d0, d1, d2 = gradients[0, a], gradients[1, a], gradients[2, a]
        for b in range(n):
            local_force[a, b] += d0 * g[0, b] + d1 * g[1, b] + d2 * g[2, b]


@nb.njit(inline="always")
def _stress_of_point(
    inverse: np.ndarray,
    weight: float,
    element: int,
    law: int,
    lam: float,
    mu: float,
    c: float,
    g: np.ndarray,
    e: int,
    n: int,
) -> bool:
    """Replace dx_i/dxi_j of column e (in row j and column i n + e of g) by its work-conjugate w sum_k P_ik dxi_j/dX_k.

    `inverse` (9, m) of all elements, this one is number `element`. False if J <= 0.
    """
    a00, a01, a02 = inverse[0, element], inverse[1, element], inverse[2, element]
    a10, a11, a12 = inverse[3, element], inverse[4, element], inverse[5, element]
    a20, a21, a22 = inverse[6, element], inverse[7, element], inverse[8, element]
    g0, g1, g2 = g[0, e], g[1, e], g[2, e]
    f00, f01, f02 = g0 * a00 + g1 * a10 + g2 * a20, g0 * a01 + g1 * a11 + g2 * a21, g0 * a02 + g1 * a12 + g2 * a22
    g0, g1, g2 = g[0, n + e], g[1, n + e], g[2, n + e]
    f10, f11, f12 = g0 * a00 + g1 * a10 + g2 * a20, g0 * a01 + g1 * a11 + g2 * a21, g0 * a02 + g1 * a12 + g2 * a22
    g0, g1, g2 = g[0, 2 * n + e], g[1, 2 * n + e], g[2, 2 * n + e]
    f20, f21, f22 = g0 * a00 + g1 * a10 + g2 * a20, g0 * a01 + g1 * a11 + g2 * a21, g0 * a02 + g1 * a12 + g2 * a22
    # The cofactors are J F^-T.
    c00, c01, c02 = f11 * f22 - f12 * f21, f12 * f20 - f10 * f22, f10 * f21 - f11 * f20
    c10, c11, c12 = f02 * f21 - f01 * f22, f00 * f22 - f02 * f20, f01 * f20 - f00 * f21
    c20, c21, c22 = f01 * f12 - f02 * f11, f02 * f10 - f00 * f12, f00 * f11 - f01 * f10
    J = f00 * c00 + f01 * c01 + f02 * c02
    if not J > 0.0:
        return False
    squares = f00 * f00 + f01 * f01 + f02 * f02 + f10 * f10 + f11 * f11 + f12 * f12 + f20 * f20 + f21 * f21 + f22 * f22
    if law == 0:
        log_J = np.log(J)
        w = weight
        if c != 0.0:
            w *= 1.0 + c * (0.5 * mu * (squares - 3.0 - 2.0 * log_J) + 0.5 * lam * log_J * log_J)
        m, p = w * mu, w * (lam * log_J - mu) / J
        p00, p01, p02 = m * f00 + p * c00, m * f01 + p * c01, m * f02 + p * c02
        p10, p11, p12 = m * f10 + p * c10, m * f11 + p * c11, m * f12 + p * c12
        p20, p21, p22 = m * f20 + p * c20, m * f21 + p * c21, m * f22 + p * c22
    else:
        m, p = weight * mu, weight * (0.5 * lam * (squares - 3.0) - mu)
        s00, s11, s22 = (
            m * (f00 * f00 + f10 * f10 + f20 * f20) + p,
            m * (f01 * f01 + f11 * f11 + f21 * f21) + p,
            m * (f02 * f02 + f12 * f12 + f22 * f22) + p,
        )
        s01 = m * (f00 * f01 + f10 * f11 + f20 * f21)
        s02 = m * (f00 * f02 + f10 * f12 + f20 * f22)
        s12 = m * (f01 * f02 + f11 * f12 + f21 * f22)
        p00, p01, p02 = (
            f00 * s00 + f01 * s01 + f02 * s02,
            f00 * s01 + f01 * s11 + f02 * s12,
            f00 * s02 + f01 * s12 + f02 * s22,
        )
        p10, p11, p12 = (
            f10 * s00 + f11 * s01 + f12 * s02,
            f10 * s01 + f11 * s11 + f12 * s12,
            f10 * s02 + f11 * s12 + f12 * s22,
        )
        p20, p21, p22 = (
            f20 * s00 + f21 * s01 + f22 * s02,
            f20 * s01 + f21 * s11 + f22 * s12,
            f20 * s02 + f21 * s12 + f22 * s22,
        )
    g[0, e], g[1, e], g[2, e] = (
        p00 * a00 + p01 * a01 + p02 * a02,
        p00 * a10 + p01 * a11 + p02 * a12,
        p00 * a20 + p01 * a21 + p02 * a22,
    )
    g[0, n + e], g[1, n + e], g[2, n + e] = (
        p10 * a00 + p11 * a01 + p12 * a02,
        p10 * a10 + p11 * a11 + p12 * a12,
        p10 * a20 + p11 * a21 + p12 * a22,
    )
    g[0, 2 * n + e], g[1, 2 * n + e], g[2, 2 * n + e] = (
        p20 * a00 + p21 * a01 + p22 * a02,
        p20 * a10 + p21 * a11 + p22 * a12,
        p20 * a20 + p21 * a21 + p22 * a22,
    )
    return True
