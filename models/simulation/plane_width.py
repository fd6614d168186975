"""What free edges take from the bending stiffness of a wall: the finite width of a plane-strain section.

In a section of finite width the two free edges curl (anticlastic bending), so a wall is softer than its plane-strain
modulus E / (1 - nu^2) says, and stiffer than E. Between the two, a wall is a plate strip |y| <= W/2 that bends in
sin(k x): its deflection is w0 [1 + A cosh ky + B ky sinh ky] sin kx with free edges, M_y = V_y = 0 (Timoshenko &
Woinowsky-Krieger, Theory of Plates and Shells, art. 41). Its mean over the width exceeds the plane-strain
deflection w0 by the share, with q = k W/2, s = sinh q, c = cosh q,

    gain = 2 nu^2 s^2 / ((1 - nu) q ((3 + nu) s c - (1 - nu) q)),

which goes from nu^2 / (1 - nu^2) for narrow strips (plane stress) to 0 for wide ones (plane strain).
"""

import math

from models.simulation.body.elasticity import lame_constants


def compliance_gain(width_mm: float, half_wave_mm: float, poisson_ratio: float) -> float:
    """How much more a strip deflects than in plane strain, as a share; k = pi / half wave."""
    q, nu = 0.5 * math.pi * width_mm / half_wave_mm, poisson_ratio
    # Divided by s^2; beyond a q of 50 its inverse is lost in rounding, and far beyond it s overflows.
    inverse_square = math.sinh(min(q, 50.0)) ** -2
    return 2.0 * nu**2 / ((1.0 - nu) * q * ((3.0 + nu) / math.tanh(q) - (1.0 - nu) * q * inverse_square))


def section_lame_constants(
    young_modulus_mpa: float, poisson_ratio: float, width_mm: float, half_wave_mm: float
) -> tuple[float, float]:
    """Lame constants (lam, mu) in MPa of a section whose bending modulus is that of the strip.

    mu is the material's; lam follows from E / (1 - nu^2) / (1 + gain) = 4 mu (lam + mu) / (lam + 2 mu). In the limit
    of plane stress this is the known lam' = 2 lam mu / (lam + 2 mu).
    """
    _, mu = lame_constants(young_modulus_mpa, poisson_ratio)
    gain = compliance_gain(width_mm, half_wave_mm, poisson_ratio)
    ratio = young_modulus_mpa / (1.0 - poisson_ratio**2) / (1.0 + gain) / (4.0 * mu)
    return (2.0 * ratio - 1.0) / (1.0 - ratio) * mu, mu
