"""Priors from a lot of material: what was measured comes out of the distributions again."""

import pytest
from scipy import stats

from fast.models.calibration.inference.lot_priors import make_lot_priors
from fast.models.calibration.inference.settings import ThetaPriors
from fast.models.errors import ConfigError, UsageError
from fast.models.material import MaterialLot, modulus_of_hardness_mpa
from fast.models.validation import load_record


def measured(value: float, unit: str = "1", sd: float | None = None) -> dict[str, object]:
    return {"value": value, "unit": unit, "sd": sd, "method": "made up", "source": "none"}


def lot(**quantities: dict[str, object]) -> MaterialLot:
    return load_record(MaterialLot, quantities, "L7.toml")


MODULUS = measured(11.5, "MPa", 1.75)


def test_modulus_keeps_mean_and_standard_deviation_of_the_tests() -> None:
    priors = make_lot_priors("L7", lot(young_modulus=MODULUS))
    found = stats.lognorm(priors.young_modulus_log_sd, scale=priors.young_modulus_median_mpa)
    assert (found.mean(), found.std()) == (pytest.approx(11.5), pytest.approx(1.75))
    assert (priors.friction_shape, priors.friction_rate) == (ThetaPriors().friction_shape, ThetaPriors().friction_rate)


def test_nine_tenths_of_the_friction_prior_lie_between_static_and_dynamic() -> None:
    priors = make_lot_priors("L7", lot(static_friction=measured(0.41), dynamic_friction=measured(0.99)))
    found = stats.gamma(priors.friction_shape, scale=1 / priors.friction_rate)
    assert found.ppf([0.05, 0.95]) == pytest.approx([0.41, 0.99])
    assert priors.young_modulus_log_sd == ThetaPriors().young_modulus_log_sd
    swapped = make_lot_priors("L7", lot(static_friction=measured(0.99), dynamic_friction=measured(0.41)))
    assert swapped == priors


def test_a_stated_scatter_widens_the_friction_prior_and_serves_a_single_coefficient() -> None:
    priors = make_lot_priors("L7", lot(static_friction=measured(0.5, sd=0.1)))
    found = stats.gamma(priors.friction_shape, scale=1 / priors.friction_rate)
    assert found.ppf([0.05, 0.95]) == pytest.approx([0.5 - 0.164485, 0.5 + 0.164485], abs=1e-5)


@pytest.mark.parametrize(
    ("quantities", "sentence"),
    [
        ({"young_modulus": measured(11.5, "MPa")}, "young_modulus of material lot `L7` has no sd, so its prior"),
        ({"static_friction": measured(0.5)}, "friction of material lot `L7` is 0.5 to 0.5, less than 5 % apart"),
        ({"static_friction": measured(0.4, sd=0.3)}, "with sd 0.3, which reaches below 0; the sd must be below 0.24"),
        ({"hardness": measured(85, "Shore A")}, "`L7` has neither young_modulus nor friction and gives no prior"),
    ],
)
def test_what_gives_no_prior_says_why(quantities: dict[str, dict[str, object]], sentence: str) -> None:
    with pytest.raises(UsageError, match=sentence):
        make_lot_priors("L7", lot(**quantities))


@pytest.mark.parametrize(
    ("quantities", "sentence"),
    [
        ({"youngs_modulus": MODULUS}, r"unknown key `youngs_modulus`; did you mean `young_modulus`\?"),
        ({"young_modulus": measured(11500, "kPa")}, r'the unit is "kPa", it must be "MPa"; convert value and sd'),
        (
            {"young_modulus": measured(11500, "MPa")},
            r"young_modulus: 11500 MPa, a decimal point or kPa\? It would be 11.5 MPa",
        ),
        (
            {"hardness": measured(5, "Shore A")},
            r"hardness: 5 Shore A, a decimal point\? It would be 50 Shore A, .* \(it is 10 to 100\)",
        ),
        ({"static_friction": measured(0.4, sd=-0.1)}, r"`static_friction.sd` is -0.1, it must be above 0"),
        ({"static_friction": {"value": 0.4, "unit": "1"}}, r"`static_friction.method`, `static_friction.source` are"),
    ],
)
def test_a_wrong_lot_is_refused(quantities: dict[str, dict[str, object]], sentence: str) -> None:
    with pytest.raises(ConfigError, match=sentence):
        lot(**quantities)


def test_hardness_is_that_of_a_punch_of_the_tips_mean_radius() -> None:
    """E = (1 - nu^2) F / (2 r d), r between tip (0.395 mm) and shank (0.635 mm), F the spring force at depth d."""
    for hardness in (30.0, 60.0, 85.0):
        force_n, depth_mm = 0.549 + 0.0748 * hardness, 0.0254 * (100.0 - hardness)
        punch_mpa = (1.0 - 0.5**2) * force_n / (2.0 * 0.515 * depth_mm)
        assert modulus_of_hardness_mpa(hardness) == pytest.approx(punch_mpa, rel=0.002)
