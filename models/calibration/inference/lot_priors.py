"""Priors of theta from what was measured of a lot of material, the same for calibrations on means and on traces."""

import math

import numpy as np

from fast.models.calibration.inference.settings import ThetaPriors
from fast.models.errors import UsageError
from fast.models.material import MaterialLot, MaterialMeasurement

TAIL = 0.05  # of the friction prior on either side of what was measured
_Z = 1.6448536269514722  # standard deviations of a normal distribution with this tail
_LEAST_RATIO = 1.05  # of the ends: a narrower prior claims more than a friction test can say


def make_lot_priors(name: str, lot: MaterialLot) -> ThetaPriors:
    """Make the priors of Table 3, with Young's modulus and friction from a lot where it has them.

    **Young's modulus**: the log-normal with mean m and standard deviation s of the tensile tests,

        sd of ln E = sqrt(ln(1 + (s/m)^2)),    median = m / sqrt(1 + (s/m)^2)

    s is that of single specimens and not of their mean: a finger is another print than the specimens, bent instead of
    pulled, at other strains.

    **Friction**: the simulator has one coefficient for sticking and sliding. Measured static and dynamic coefficients
    are its ends: the gamma distribution with 5 % below the lower and 5 % above the higher one. A stated standard
    deviation moves the ends out by 1.645 of it, and makes ends of a single coefficient.

    Raises:
        UsageError: the lot has neither quantity, or no scatter to make a width of.
    """
    changes: dict[str, float] = {}
    if lot.young_modulus is not None:
        changes |= _modulus(name, lot.young_modulus)
    frictions = [
        (words, found)
        for words, found in (("static", lot.static_friction), ("dynamic", lot.dynamic_friction))
        if found is not None
    ]
    if frictions:
        changes |= _friction(name, frictions)
    if not changes:
        raise UsageError(
            f"material lot `{name}` has neither young_modulus nor friction and gives no prior; add one, or use `none`."
        )
    return ThetaPriors(**changes)


def _modulus(name: str, measured: MaterialMeasurement) -> dict[str, float]:
    if measured.sd is None:
        raise UsageError(
            f"young_modulus of material lot `{name}` has no sd, so its prior would have no width; "
            "add the standard deviation of the single tests, in MPa."
        )
    spread = 1.0 + (measured.sd / measured.value) ** 2
    return {
        "young_modulus_median_mpa": measured.value / math.sqrt(spread),
        "young_modulus_log_sd": math.sqrt(math.log(spread)),
    }


def _friction(name: str, frictions: list[tuple[str, MaterialMeasurement]]) -> dict[str, float]:
    lower, upper = math.inf, -math.inf
    for words, measured in frictions:
        reach = _Z * (measured.sd or 0.0)
        if reach >= measured.value:
            raise UsageError(
                f"{words}_friction of material lot `{name}` is {measured.value:g} with sd {measured.sd:g}, which "
                f"reaches below 0; the sd must be below {measured.value / _Z:.2g}."
            )
        lower, upper = min(lower, measured.value - reach), max(upper, measured.value + reach)
    if upper < _LEAST_RATIO * lower:
        raise UsageError(
            f"friction of material lot `{name}` is {lower:g} to {upper:g}, less than 5 % apart, so its prior would "
            "have no width; add the sd of the tests, or the other coefficient."
        )
    shape = _find_shape(upper / lower)
    from scipy.special import gammaincinv

    return {"friction_shape": shape, "friction_rate": float(gammaincinv(shape, TAIL)) / lower}


def _find_shape(ratio: float) -> float:
    """Find the shape of the gamma distributions whose 95 % quantile is `ratio` times the 5 % quantile."""
    from scipy.optimize import brentq  # not with the priors, which commands read that never calibrate
    from scipy.special import gammaincinv

    def excess(log_shape: float) -> float:
        low, high = gammaincinv(math.exp(log_shape), [TAIL, 1.0 - TAIL])
        return float(np.log(high / low) - math.log(ratio))

    return math.exp(brentq(excess, math.log(0.05), math.log(1e5)))
