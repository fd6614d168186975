import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from fast.models.design.fin_ray import BASE_HEIGHT_MM, MIN_CAVITY_AREA_MM2, MIN_EDGE_MM, planar_profile
from fast.models.design.finger import MARK_DEPTH_MM, MARK_MARGIN_MM, finger_bodies
from fast.models.design.glyphs import _GLYPH_HEIGHT, _STROKE_WIDTH, text_outline
from fast.models.design.space import BEST_PUBLISHED, LOWER, PARAMETERS, UPPER, from_unit
from fast.models.errors import UsageError

UNIT_POINTS = st.lists(st.floats(0, 1), min_size=9, max_size=9)


@given(UNIT_POINTS)
@settings(max_examples=60, deadline=None)
def test_profile_of_any_design_is_one_valid_body_inside_its_envelope(point):
    design = from_unit(np.array([point]))[0]
    profile = planar_profile(design)
    x0, z0, x1, z1 = profile.bounds
    assert profile.is_valid
    assert (x0, z0) == (0.0, BASE_HEIGHT_MM)
    assert z1 == pytest.approx(design.height_mm)
    assert x1 <= design.length_mm
    assert all(shapely.Polygon(hole).area >= MIN_CAVITY_AREA_MM2 for hole in profile.interiors)


@given(
    st.tuples(st.sampled_from([0.0, 0.5, 1.0, 1.5]), st.integers(1, 10), st.floats(-40, 40)),
    st.lists(st.sampled_from([0.0, 0.5, 1.0]), min_size=9, max_size=9),
)
@settings(max_examples=120, deadline=None)
def test_corners_of_the_design_space_give_one_body_without_slivers(rib, point):
    fillet_mm, rib_count, rib_angle_deg = rib
    design = from_unit(np.array([point]))[0].model_copy(update={"rib_count": rib_count, "rib_angle_deg": rib_angle_deg})
    profile = planar_profile(design, fillet_mm)
    assert profile.is_valid
    assert profile.geom_type == "Polygon"
    edges = [np.diff(np.array(ring.coords), axis=0) for ring in (profile.exterior, *profile.interiors)]
    assert min(np.hypot(*edge.T).min() for edge in edges) > 0.99 * MIN_EDGE_MM
    height = design.height_mm - BASE_HEIGHT_MM
    walls = (design.front_thickness_mm + design.back_thickness_mm) * (height - design.tip_length_mm)
    assert 0.98 * walls < profile.area < 0.5 * (design.length_mm + design.front_thickness_mm + 1) * height


@pytest.mark.parametrize("corner", [LOWER, UPPER])
def test_profile_of_the_corners_of_the_design_space(corner):
    values = dict(zip(PARAMETERS, corner, strict=True)) | {"rib_count": int(corner[PARAMETERS.index("rib_count")])}
    profile = planar_profile(BEST_PUBLISHED.model_validate(values))
    assert profile.is_valid


def test_walls_have_the_thickness_that_was_asked_for():
    profile = planar_profile(BEST_PUBLISHED, fillet_mm=0)
    ribs_mm = (BEST_PUBLISHED.height_mm - BEST_PUBLISHED.tip_length_mm - BASE_HEIGHT_MM) / 6
    between_ribs = shapely.LineString([(-1, BASE_HEIGHT_MM + 1.5 * ribs_mm), (40, BASE_HEIGHT_MM + 1.5 * ribs_mm)])
    front, back = shapely.get_parts(profile.intersection(between_ribs))
    slope = np.hypot(BEST_PUBLISHED.height_mm, BEST_PUBLISHED.length_mm - BEST_PUBLISHED.front_thickness_mm - 1)
    assert front.length == pytest.approx(BEST_PUBLISHED.front_thickness_mm)
    assert back.length == pytest.approx(BEST_PUBLISHED.back_thickness_mm * slope / BEST_PUBLISHED.height_mm)


def test_best_published_design_has_five_closed_voids_and_an_open_one():
    assert len(planar_profile(BEST_PUBLISHED).interiors) == 5


def test_fillets_add_little_material_and_no_more_than_their_corners():
    sharp, round_ = planar_profile(BEST_PUBLISHED, 0.0), planar_profile(BEST_PUBLISHED, 0.5)
    n_corners = 4 * 5 + 2
    per_corner = 0.5**2 * (1 - np.pi / 4)
    assert 0 < round_.area - sharp.area < 2 * n_corners * per_corner


def test_bodies_are_watertight_and_meet_at_the_base():
    bodies = finger_bodies(BEST_PUBLISHED, "B07T8")
    assert bodies.compliant.is_volume
    assert bodies.rigid.is_volume
    assert bodies.compliant.bounds[0][2] == BASE_HEIGHT_MM == bodies.rigid.bounds[1][2]
    expected = planar_profile(BEST_PUBLISHED).area * BEST_PUBLISHED.width_mm
    assert bodies.compliant.volume == pytest.approx(expected, rel=1e-6)
    assert bodies.compliant.bounds[:, 1] == pytest.approx([-BEST_PUBLISHED.width_mm / 2, BEST_PUBLISHED.width_mm / 2])


def test_mark_is_engraved_to_its_depth():
    plain, marked = finger_bodies(BEST_PUBLISHED), finger_bodies(BEST_PUBLISHED, "B07T8")
    removed = plain.rigid.volume - marked.rigid.volume
    assert removed == pytest.approx(text_outline("B07T8", 5.0).area * MARK_DEPTH_MM, rel=0.01)


@pytest.mark.parametrize("label", ["B01T0", "B23T4", "B56T7", "B89T9"])
def test_every_label_can_be_engraved(label):
    assert finger_bodies(BEST_PUBLISHED, label).rigid.is_volume


def test_a_long_mark_keeps_clear_of_the_sides_of_the_narrowest_base():
    design = BEST_PUBLISHED.model_copy(update={"width_mm": 28.0})
    rigid = finger_bodies(design, "B100T9").rigid
    assert rigid.is_volume
    engraved = rigid.vertices[(rigid.vertices[:, 2] > 0.1) & (rigid.vertices[:, 2] < 1)]
    assert np.abs(engraved[:, 1]).max() <= 14 - MARK_MARGIN_MM + 1e-6


def test_unknown_glyph_is_refused_with_the_ones_there_are():
    with pytest.raises(UsageError, match="no glyph for `x`"):
        finger_bodies(BEST_PUBLISHED, "x1")


@pytest.mark.parametrize("text", ["8", "B07T8", "B0-T8888"])
def test_marks_are_centred_whatever_their_length(text: str) -> None:
    left, bottom, right, top = text_outline(text, 6.0).bounds
    stroke_mm = 6.0 * _STROKE_WIDTH / _GLYPH_HEIGHT
    assert top - bottom == pytest.approx(6.0 + stroke_mm, abs=0.05)
    assert top == pytest.approx(-bottom, abs=0.05)
    assert right == pytest.approx(-left, abs=0.05)
