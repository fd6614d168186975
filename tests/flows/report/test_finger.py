"""What the best finger's page says of its parameters and of the tools that come after it."""

from fast.flows.report.campaign.finger import describe_bounds, describe_twins
from fast.models.design.space import BEST_PUBLISHED, FIN_RAYS


def test_parameters_at_the_ends_of_their_ranges_are_named():
    assert describe_bounds(FIN_RAYS, BEST_PUBLISHED) == ""
    ends = {"height_mm": 120.0, "front_thickness_mm": 2.005, "rib_count": 10}
    said = describe_bounds(FIN_RAYS, BEST_PUBLISHED.model_copy(update=ends))
    assert said.startswith(
        "3 of 9 parameters stand at an end of the allowed range: height at the upper one, front thickness at the lower "
        "one, rib count at the upper one."
    )
    one = describe_bounds(FIN_RAYS, BEST_PUBLISHED.model_copy(update={"height_mm": 120.0}))
    assert one.startswith("1 of 9 parameters stands at an end of the allowed range: height at the upper one.")


def say_twins(others):
    return describe_twins(FIN_RAYS, BEST_PUBLISHED, others)


def test_tools_that_differ_in_one_parameter_are_the_same_finger():
    turned = BEST_PUBLISHED.model_copy(update={"rib_angle_deg": -39.5, "width_mm": 33.2})
    tilted = BEST_PUBLISHED.model_copy(update={"rib_angle_deg": -24.0})
    other = BEST_PUBLISHED.model_copy(update={"rib_angle_deg": -24.0, "height_mm": 119.0})
    assert describe_twins(
        FIN_RAYS, BEST_PUBLISHED, [("B03T1", turned), ("B03T2", tilted), ("B02T0", other)]
    ).startswith("B03T1 and B03T2 are nearly the same finger but for the rib angle: ")
    assert say_twins([("B03T1", BEST_PUBLISHED)]).startswith("B03T1 is nearly the same finger: ")
    assert say_twins([("B02T0", other)]) == ""
    assert say_twins([]) == ""
