"""Rules of printing: against bodies that are really built, and by what a person would see."""

import numpy as np
import pytest
import shapely

from fast.models.design.fin_ray import BASE_HEIGHT_MM
from fast.models.design.finger import finger_bodies
from fast.models.design.printability import PrintingRules, broken_rules, printable
from fast.models.design.space import BEST_PUBLISHED, random_designs, to_unit
from fast.models.records import Design

DENSE = BEST_PUBLISHED.model_copy(update={"rib_count": 10, "rib_angle_deg": 40.0, "rib_thickness_mm": 3.0,
                                          "height_mm": 90.0, "tip_length_mm": 30.0})  # fmt: skip


def narrowest_mm(design: Design) -> float:
    """Diameter of the largest circle in the narrowest cavity, by another algorithm."""
    return 2 * min(shapely.maximum_inscribed_circle(void, tolerance=1e-3).length for void in design.list_voids())


def test_narrow_gaps_between_ribs_are_named():
    assert broken_rules(BEST_PUBLISHED, PrintingRules()) == []
    (phrase,) = broken_rules(DENSE, PrintingRules())
    assert phrase.endswith("cavities narrower than 3 mm")


@pytest.mark.parametrize("design", [*random_designs(8, np.random.default_rng(3)), BEST_PUBLISHED, DENSE])
def test_the_limit_is_the_circle_of_the_narrowest_cavity(design):
    limit_mm = narrowest_mm(design)
    assert broken_rules(design, PrintingRules(min_cavity_mm=0.99 * limit_mm)) == []
    assert broken_rules(design, PrintingRules(min_cavity_mm=1.01 * limit_mm)) != []


def test_between_level_ribs_it_is_the_free_height():
    level = DENSE.model_copy(update={"rib_angle_deg": 0.0})
    pitch_mm = (level.height_mm - level.tip_length_mm - BASE_HEIGHT_MM) / (level.rib_count + 1)
    assert narrowest_mm(level) == pytest.approx(pitch_mm - level.rib_thickness_mm, abs=0.01)


@pytest.mark.parametrize("design", [BEST_PUBLISHED, *random_designs(3, np.random.default_rng(4))])
def test_the_mass_is_that_of_the_printed_bodies(design):
    mass_g = finger_bodies(design, fillet_mm=0.0).mass_g
    assert broken_rules(design, PrintingRules(min_cavity_mm=0.0, max_mass_g=1.01 * mass_g)) == []
    assert broken_rules(design, PrintingRules(min_cavity_mm=0.0, max_mass_g=0.99 * mass_g)) != []


def test_the_mask_is_of_points():
    assert printable(to_unit([BEST_PUBLISHED, DENSE]), PrintingRules()).tolist() == [True, False]
