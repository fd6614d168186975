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

from typing import Any, Literal, NamedTuple

import numba as nb
import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

MaterialLaw = Literal["neo_hookean", "st_venant_kirchhoff"]

# All grasps are solved at this modulus and their forces scaled by E / REFERENCE: a quasi-static, displacement-
# controlled grasp of a linear-elastic finger with Coulomb friction is proportional to E. Contact stiffness, density
# and tolerances are given at the reference too, so they scale along and F(2E) = 2 F(E) holds to the last bit.
REFERENCE_MODULUS_MPA = 11.5

VECTOR = 4  # rows of the tangent are filled in whole vectors of this many nodes,
WIDTH = 20  # in rows for the largest element: a length that the compiler knows, or it does not vectorise

ELEMENTS = 16  # how many elements of one kind lie side by side while their forces are computed: a few whole vectors

LAW_CODE: dict[MaterialLaw, int] = {"neo_hookean": 0, "st_venant_kirchhoff": 1}


class Constants(NamedTuple):
    """Of a material: the code of its law, Lame's constants lam and mu in MPa, and c in 1/MPa (neo-Hookean law only)."""

    law: int
    lam: float
    mu: float
    c: float


class Elements(NamedTuple):
    """One element block ready for assembly.

    `connectivity` (m, k); `gradients` (q, 3, k') dN/dxi, with zeros up to whole vectors of nodes; `inverses` (q, 9, m)
    dxi_i/dX_j in 3 i + j, in 1/mm; `volumes` (q, m) in mm3, and `weights`, the same times the element's factor on the
    modulus; `values` (q, k) of the shape functions; `places` (m, k, k) of the blocks in the pattern.
    """

    connectivity: np.ndarray
    gradients: np.ndarray
    inverses: np.ndarray
    volumes: np.ndarray
    weights: np.ndarray
    values: np.ndarray
    places: np.ndarray


def lame_constants(young_modulus_mpa: float, poisson_ratio: float) -> tuple[float, float]:
    """Return the Lame constants (lam, mu) in MPa."""
    shear = young_modulus_mpa / (2.0 * (1.0 + poisson_ratio))
    return 2.0 * shear * poisson_ratio / (1.0 - 2.0 * poisson_ratio), shear


@intrinsic
def _add_product(typing: Any, total: Any, left: Any, right: Any) -> tuple[Any, Any]:
    """Add left * right to total, rounded once, in the loops that do nearly all of the work.

    Left to itself, the compiler chooses which products it contracts with a sum, in one caller these and in another
    those, and the same grasp would differ in its last bits from process to process.
    """

    def emit(_context: Any, builder: Any, _signature: Any, values: Any) -> Any:
        double = ir.DoubleType()
        fused = cgutils.get_or_insert_function(builder.module, ir.FunctionType(double, [double] * 3), "llvm.fma.f64")
        return builder.call(fused, [values[1], values[2], values[0]])

    return types.float64(types.float64, types.float64, types.float64), emit


# What `add_tangents` keeps of a point, a row per component: g_a, dN_a, `straight` g_a, `swapped` g_a, S dN_a, each (3),
# and h_a (3), of which the law that stiffens adds h_a h_b^T.
_G, _SLOPE, _STRAIGHT, _SWAPPED, _STRESS, _STIFF, _N_ROWS = 0, 3, 6, 9, 12, 15, 18


@nb.njit(cache=True, nogil=True, error_model="numpy")
def add_tangents(x: np.ndarray, part: Elements, constants: Constants, blocks: np.ndarray) -> bool:
    """Add the tangents of elements (m, k) of one kind at deformed nodes x to `blocks`; False if one is inverted.

    Blocks (z, 3, 3) are at `part.places`.
    """
    elements, gradients, inverses, weights = part.connectivity, part.gradients, part.inverses, part.weights
    (law, lam, mu, c), n_points, k = constants, len(gradients), elements.shape[1]
    local, rows, row = np.zeros((3, WIDTH)), np.zeros((n_points, _N_ROWS, WIDTH)), np.zeros((10, WIDTH))
    F, inverse, A = np.zeros((3, 3)), np.zeros((3, 3)), np.zeros((n_points, 3, 3))
    for e in range(len(elements)):
        for a in range(k):
            for i in range(3):
                local[i, a] = x[elements[e, a], i]
        for q in range(n_points):
            _find_slopes(gradients[q], inverses[q], e, rows[q])
            _gradient(local, rows[q], F)
            J = _determinant(F)
            if not J > 0.0:
                return False
            if law == 0:
                _inverse(F, J, inverse)
                _linearise_neo_hookean(F, J, inverse, weights[q, e], lam, mu, c, rows[q])
            else:
                _linearise_st_venant(F, weights[q, e], lam, mu, rows[q], A[q])
        for a in range(k):
            _tangent_row(a, rows, row)
            if law != 0:
                _add_moduli(a, rows, A, row)
            elif c != 0.0:
                _add_stiffening(a, rows, row)
            _add_row(a, row, part.places[e, a], blocks)
    return True


@nb.njit(inline="always")
def _find_slopes(gradients: np.ndarray, inverses: np.ndarray, e: int, rows: np.ndarray) -> None:
    """Put dN_a/dX of element e into `rows`, from dN_a/dxi (3, k') and dxi_i/dX_j in `inverses` (9, m)."""
    for j in range(3):
        a0, a1, a2 = inverses[j, e], inverses[3 + j, e], inverses[6 + j, e]
        for a in range(gradients.shape[1]):
            one = _add_product(gradients[0, a] * a0, gradients[1, a], a1)
            rows[_SLOPE + j, a] = _add_product(one, gradients[2, a], a2)


@nb.njit(inline="always")
def _gradient(local: np.ndarray, rows: np.ndarray, F: np.ndarray) -> None:
    """Compute F = sum x_a dN_a/dX over all nodes, from x_a in column a of `local` (3, WIDTH)."""
    for i in range(3):
        f0 = f1 = f2 = 0.0
        for a in range(WIDTH):
            f0 = _add_product(f0, local[i, a], rows[_SLOPE, a])
            f1 = _add_product(f1, local[i, a], rows[_SLOPE + 1, a])
            f2 = _add_product(f2, local[i, a], rows[_SLOPE + 2, a])
        F[i, 0], F[i, 1], F[i, 2] = f0, f1, f2


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
def _linearise_neo_hookean(
    F: np.ndarray, J: float, inverse: np.ndarray, weight: float, lam: float, mu: float, c: float, rows: np.ndarray
) -> None:
    """Fill the rows of a point from its slopes; the stress is multiplied by 1 + c W, for c = 0 exactly by 1."""
    pressure, w = lam * np.log(J) - mu, weight
    if c != 0.0:
        first, log_J, size = 0.0, np.log(J), np.sqrt(weight * c)
        for i in range(3):
            for j in range(3):
                first += F[i, j] * F[i, j]
        w = weight * (1.0 + c * (0.5 * mu * (first - 3.0 - 2.0 * log_J) + 0.5 * lam * log_J * log_J))
    swapped, straight, stress = -w * pressure, w * lam, w * mu
    for i in range(3):
        b0, b1, b2 = inverse[0, i], inverse[1, i], inverse[2, i]
        for a in range(WIDTH):
            g = _add_product(_add_product(b0 * rows[_SLOPE, a], b1, rows[_SLOPE + 1, a]), b2, rows[_SLOPE + 2, a])
            rows[_G + i, a] = g
            rows[_STRAIGHT + i, a] = straight * g
            rows[_SWAPPED + i, a] = swapped * g
            rows[_STRESS + i, a] = stress * rows[_SLOPE + i, a]
        if c != 0.0:
            for a in range(WIDTH):
                Fa = F[i, 0] * rows[_SLOPE, a] + F[i, 1] * rows[_SLOPE + 1, a] + F[i, 2] * rows[_SLOPE + 2, a]
                rows[_STIFF + i, a] = size * (mu * Fa + pressure * rows[_G + i, a])


@nb.njit(inline="always")
def _linearise_st_venant(F: np.ndarray, weight: float, lam: float, mu: float, rows: np.ndarray, A: np.ndarray) -> None:
    """Fill the rows of a point from its slopes, g_a = F dN_a, and the moduli A = w mu F F^T (3, 3)."""
    S, trace = np.zeros((3, 3)), 0.0
    for i in range(3):
        for j in range(3):
            S[i, j] = F[0, i] * F[0, j] + F[1, i] * F[1, j] + F[2, i] * F[2, j] - (1.0 if i == j else 0.0)
            A[i, j] = weight * mu * (F[i, 0] * F[j, 0] + F[i, 1] * F[j, 1] + F[i, 2] * F[j, 2])
        trace += S[i, i]
    for i in range(3):
        for j in range(3):
            S[i, j] = weight * (mu * S[i, j] + (0.5 * lam * trace if i == j else 0.0))
    for i in range(3):
        for a in range(WIDTH):
            u0, u1, u2 = rows[_SLOPE, a], rows[_SLOPE + 1, a], rows[_SLOPE + 2, a]
            g = F[i, 0] * u0 + F[i, 1] * u1 + F[i, 2] * u2
            rows[_G + i, a] = g
            rows[_STRAIGHT + i, a], rows[_SWAPPED + i, a] = weight * lam * g, weight * mu * g
            rows[_STRESS + i, a] = S[i, 0] * u0 + S[i, 1] * u1 + S[i, 2] * u2


@nb.njit(inline="always")
def _tangent_row(a: int, rows: np.ndarray, row: np.ndarray) -> None:
    """Compute tangent row a: K_ab = sum over points of swapped g_b g_a^T + straight g_a g_b^T + (dN_a . S dN_b) I.

    `row` (10, WIDTH) receives entry (i, j) of the first two terms in 3 i + j, and the third one in 9. The points run
    outside the nodes b, so that it stays in the cache.
    """
    n = (a // VECTOR + 1) * VECTOR
    row[:] = 0.0
    for q in range(len(rows)):
        a0, a1, a2 = rows[q, _STRAIGHT, a], rows[q, _STRAIGHT + 1, a], rows[q, _STRAIGHT + 2, a]
        c0, c1, c2 = rows[q, _SWAPPED, a], rows[q, _SWAPPED + 1, a], rows[q, _SWAPPED + 2, a]
        s0, s1, s2 = rows[q, _STRESS, a], rows[q, _STRESS + 1, a], rows[q, _STRESS + 2, a]
        b0, b1, b2 = a0 + c0, a1 + c1, a2 + c2
        for b in range(n):
            g0, g1, g2 = rows[q, _G, b], rows[q, _G + 1, b], rows[q, _G + 2, b]
            u0, u1, u2 = rows[q, _SLOPE, b], rows[q, _SLOPE + 1, b], rows[q, _SLOPE + 2, b]
            row[0, b] = _add_product(row[0, b], b0, g0)
            row[1, b] = _add_product(_add_product(row[1, b], a0, g1), c1, g0)
            row[2, b] = _add_product(_add_product(row[2, b], a0, g2), c2, g0)
            row[3, b] = _add_product(_add_product(row[3, b], a1, g0), c0, g1)
            row[4, b] = _add_product(row[4, b], b1, g1)
            row[5, b] = _add_product(_add_product(row[5, b], a1, g2), c2, g1)
            row[6, b] = _add_product(_add_product(row[6, b], a2, g0), c0, g2)
            row[7, b] = _add_product(_add_product(row[7, b], a2, g1), c1, g2)
            row[8, b] = _add_product(row[8, b], b2, g2)
            row[9, b] = _add_product(_add_product(_add_product(row[9, b], s0, u0), s1, u1), s2, u2)


@nb.njit(inline="always")
def _add_moduli(a: int, rows: np.ndarray, A: np.ndarray, row: np.ndarray) -> None:
    """Add sum over points of (dN_a . dN_b) A to the row of `_tangent_row`; A (q, 3, 3)."""
    for q in range(len(A)):
        for b in range(a + 1):
            s = 0.0
            for i in range(3):
                s += rows[q, _SLOPE + i, a] * rows[q, _SLOPE + i, b]
            for i in range(3):
                for j in range(3):
                    row[3 * i + j, b] += s * A[q, i, j]


@nb.njit(inline="always")
def _add_stiffening(a: int, rows: np.ndarray, row: np.ndarray) -> None:
    """Add sum over points of h_a h_b^T to the row of `_tangent_row`."""
    for q in range(len(rows)):
        for i in range(3):
            for j in range(3):
                for b in range(a + 1):
                    row[3 * i + j, b] += rows[q, _STIFF + i, a] * rows[q, _STIFF + j, b]


@nb.njit(inline="always")
def _add_row(a: int, row: np.ndarray, places: np.ndarray, blocks: np.ndarray) -> None:
    """Add the blocks b <= a of a row to where they belong; -2 - z stands for the transpose of block z, -1 for none."""
    for b in range(a + 1):
        place, third = places[b], row[9, b]
        if place == -1:
            continue
        block = blocks[place if place >= 0 else -2 - place]
        for i in range(3):
            for j in range(3):
                if place >= 0:
                    block[i, j] += row[3 * i + j, b]
                else:
                    block[j, i] += row[3 * i + j, b]
            block[i, i] += third


@nb.njit(cache=True, nogil=True, error_model="numpy")
def add_forces(x: np.ndarray, part: Elements, constants: Constants, force: np.ndarray) -> bool:
    """Add the nodal forces (n, 3) of elements (m, k) of one kind at deformed nodes x (n, 3); False if one is inverted.

    Elements are taken `ELEMENTS` at a time and lie side by side, coordinate i of all of them in a row; where fewer are
    left, the last one is taken again and counts once. All arrays have lengths that the compiler knows.
    """
    elements, gradients, inverses, weights = part.connectivity, part.gradients, part.inverses, part.weights
    (law, lam, mu, c), k, m = constants, elements.shape[1], len(elements)
    local, local_force = np.zeros((gradients.shape[2], 3 * ELEMENTS)), np.zeros((k, 3 * ELEMENTS))
    g, inverse, weight = np.zeros((3, 3 * ELEMENTS)), np.zeros((9, ELEMENTS)), np.zeros(ELEMENTS)
    F, J, log_J = np.zeros((9, ELEMENTS)), np.zeros(ELEMENTS), np.zeros(ELEMENTS)
    for first in range(0, m, ELEMENTS):
        n = min(ELEMENTS, m - first)
        for e in range(ELEMENTS):
            for a in range(k):
                node = elements[first + min(e, n - 1), a]
                for i in range(3):
                    local[a, i * ELEMENTS + e] = x[node, i]
        local_force[:] = 0.0
        for q in range(len(gradients)):
            for e in range(ELEMENTS):
                weight[e] = weights[q, first + min(e, n - 1)]
                for i in range(9):
                    inverse[i, e] = inverses[q, i, first + min(e, n - 1)]
            _sum_nodes(gradients[q], local, g)
            _deform(inverse, g, F, J)
            for e in range(ELEMENTS):
                if not J[e] > 0.0:
                    return False
            if law == 0:
                for e in range(ELEMENTS):
                    log_J[e] = np.log(J[e])
                _press_neo_hookean(inverse, weight, lam, mu, c, F, J, log_J, g)
            else:
                _press_st_venant(inverse, weight, lam, mu, F, g)
            _spread_to_nodes(gradients[q], g, local_force)
        for e in range(n):
            for a in range(k):
                for i in range(3):
                    force[elements[first + e, a], i] += local_force[a, i * ELEMENTS + e]
    return True


@nb.njit(inline="always")
def _sum_nodes(gradients: np.ndarray, local: np.ndarray, g: np.ndarray) -> None:
    """Sum into row j of g, over nodes a, gradients (3, k') times row a of `local`."""
    for j in range(3):
        g[j, :] = 0.0
        for a in range(0, gradients.shape[1], VECTOR):
            d0, d1, d2, d3 = gradients[j, a], gradients[j, a + 1], gradients[j, a + 2], gradients[j, a + 3]
            for b in range(3 * ELEMENTS):
                two = _add_product(_add_product(g[j, b], d0, local[a, b]), d1, local[a + 1, b])
                g[j, b] = _add_product(_add_product(two, d2, local[a + 2, b]), d3, local[a + 3, b])


@nb.njit(inline="always")
def _spread_to_nodes(gradients: np.ndarray, g: np.ndarray, local_force: np.ndarray) -> None:
    """Add to row a of `local_force` the sum over j of gradients (3, k') times row j of g."""
    for a in range(len(local_force)):
        d0, d1, d2 = gradients[0, a], gradients[1, a], gradients[2, a]
        for b in range(3 * ELEMENTS):
            two = _add_product(_add_product(local_force[a, b], d0, g[0, b]), d1, g[1, b])
            local_force[a, b] = _add_product(two, d2, g[2, b])


@nb.njit(inline="always")
def _deform(A: np.ndarray, g: np.ndarray, F: np.ndarray, J: np.ndarray) -> None:
    """Compute F_ij in row 3 i + j, and J = det F, from dx_i/dxi_j in row j of g and dxi_j/dX_k in row 3 j + k of A."""
    for e in range(ELEMENTS):
        g0, g1, g2 = g[0, e], g[1, e], g[2, e]
        f00 = g0 * A[0, e] + g1 * A[3, e] + g2 * A[6, e]
        f01 = g0 * A[1, e] + g1 * A[4, e] + g2 * A[7, e]
        f02 = g0 * A[2, e] + g1 * A[5, e] + g2 * A[8, e]
        g0, g1, g2 = g[0, ELEMENTS + e], g[1, ELEMENTS + e], g[2, ELEMENTS + e]
        f10 = g0 * A[0, e] + g1 * A[3, e] + g2 * A[6, e]
        f11 = g0 * A[1, e] + g1 * A[4, e] + g2 * A[7, e]
        f12 = g0 * A[2, e] + g1 * A[5, e] + g2 * A[8, e]
        g0, g1, g2 = g[0, 2 * ELEMENTS + e], g[1, 2 * ELEMENTS + e], g[2, 2 * ELEMENTS + e]
        f20 = g0 * A[0, e] + g1 * A[3, e] + g2 * A[6, e]
        f21 = g0 * A[1, e] + g1 * A[4, e] + g2 * A[7, e]
        f22 = g0 * A[2, e] + g1 * A[5, e] + g2 * A[8, e]
        F[0, e], F[1, e], F[2, e] = f00, f01, f02
        F[3, e], F[4, e], F[5, e] = f10, f11, f12
        F[6, e], F[7, e], F[8, e] = f20, f21, f22
        J[e] = f00 * (f11 * f22 - f12 * f21) + f01 * (f12 * f20 - f10 * f22) + f02 * (f10 * f21 - f11 * f20)


@nb.njit(inline="always")
def _press_neo_hookean(
    A: np.ndarray,
    weight: np.ndarray,
    lam: float,
    mu: float,
    c: float,
    F: np.ndarray,
    J: np.ndarray,
    log_J: np.ndarray,
    g: np.ndarray,
) -> None:
    """Put w sum_k P_ik dxi_j/dX_k, which works on dx_i/dxi_j, in row j of g; A, F and J as in `_deform`."""
    for e in range(ELEMENTS):
        f00, f01, f02 = F[0, e], F[1, e], F[2, e]
        f10, f11, f12 = F[3, e], F[4, e], F[5, e]
        f20, f21, f22 = F[6, e], F[7, e], F[8, e]
        squares = f00 * f00 + f01 * f01 + f02 * f02 + f10 * f10 + f11 * f11 + f12 * f12 + f20 * f20 + f21 * f21
        squares += f22 * f22
        energy = 0.5 * mu * (squares - 3.0 - 2.0 * log_J[e]) + 0.5 * lam * log_J[e] * log_J[e]
        w = weight[e] * (1.0 + c * energy)
        m, p = w * mu, w * (lam * log_J[e] - mu) / J[e]
        # The factors of p are the cofactors J F^-T.
        p0 = m * f00 + p * (f11 * f22 - f12 * f21)
        p1 = m * f01 + p * (f12 * f20 - f10 * f22)
        p2 = m * f02 + p * (f10 * f21 - f11 * f20)
        g[0, e] = p0 * A[0, e] + p1 * A[1, e] + p2 * A[2, e]
        g[1, e] = p0 * A[3, e] + p1 * A[4, e] + p2 * A[5, e]
        g[2, e] = p0 * A[6, e] + p1 * A[7, e] + p2 * A[8, e]
        p0 = m * f10 + p * (f02 * f21 - f01 * f22)
        p1 = m * f11 + p * (f00 * f22 - f02 * f20)
        p2 = m * f12 + p * (f01 * f20 - f00 * f21)
        g[0, ELEMENTS + e] = p0 * A[0, e] + p1 * A[1, e] + p2 * A[2, e]
        g[1, ELEMENTS + e] = p0 * A[3, e] + p1 * A[4, e] + p2 * A[5, e]
        g[2, ELEMENTS + e] = p0 * A[6, e] + p1 * A[7, e] + p2 * A[8, e]
        p0 = m * f20 + p * (f01 * f12 - f02 * f11)
        p1 = m * f21 + p * (f02 * f10 - f00 * f12)
        p2 = m * f22 + p * (f00 * f11 - f01 * f10)
        g[0, 2 * ELEMENTS + e] = p0 * A[0, e] + p1 * A[1, e] + p2 * A[2, e]
        g[1, 2 * ELEMENTS + e] = p0 * A[3, e] + p1 * A[4, e] + p2 * A[5, e]
        g[2, 2 * ELEMENTS + e] = p0 * A[6, e] + p1 * A[7, e] + p2 * A[8, e]


@nb.njit(inline="always")
def _press_st_venant(A: np.ndarray, weight: np.ndarray, lam: float, mu: float, F: np.ndarray, g: np.ndarray) -> None:
    """Do as `_press_neo_hookean` does: P = F S with S = lam tr(E) I + 2 mu E."""
    for e in range(ELEMENTS):
        f00, f01, f02 = F[0, e], F[1, e], F[2, e]
        f10, f11, f12 = F[3, e], F[4, e], F[5, e]
        f20, f21, f22 = F[6, e], F[7, e], F[8, e]
        c00, c11, c22 = (
            f00 * f00 + f10 * f10 + f20 * f20,
            f01 * f01 + f11 * f11 + f21 * f21,
            f02 * f02 + f12 * f12 + f22 * f22,
        )
        m, p = weight[e] * mu, weight[e] * (0.5 * lam * (c00 + c11 + c22 - 3.0) - mu)
        s00, s11, s22 = m * c00 + p, m * c11 + p, m * c22 + p
        s01 = m * (f00 * f01 + f10 * f11 + f20 * f21)
        s02 = m * (f00 * f02 + f10 * f12 + f20 * f22)
        s12 = m * (f01 * f02 + f11 * f12 + f21 * f22)
        for i in range(3):
            f0, f1, f2 = F[3 * i, e], F[3 * i + 1, e], F[3 * i + 2, e]
            p0, p1, p2 = (
                f0 * s00 + f1 * s01 + f2 * s02,
                f0 * s01 + f1 * s11 + f2 * s12,
                f0 * s02 + f1 * s12 + f2 * s22,
            )
            g[0, i * ELEMENTS + e] = p0 * A[0, e] + p1 * A[1, e] + p2 * A[2, e]
            g[1, i * ELEMENTS + e] = p0 * A[3, e] + p1 * A[4, e] + p2 * A[5, e]
            g[2, i * ELEMENTS + e] = p0 * A[6, e] + p1 * A[7, e] + p2 * A[8, e]
