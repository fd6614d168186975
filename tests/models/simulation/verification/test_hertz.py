"""Contact of a rigid cylinder and a rigid sphere with an elastic block, against Hertz."""

import numpy as np
import pytest

from tests.models.simulation.verification import hertz


def test_cylinder_presses_with_the_profile_of_hertz() -> None:
    contact = hertz.press(hertz.cylinder_block(), 0.1, is_sphere=False)
    half_width, highest = hertz.line_contact(contact.force_n)
    assert 0.9 * hertz.CONTACT_MM < half_width < 1.1 * hertz.CONTACT_MM
    exact = hertz.profile(contact.distance_mm, half_width, highest)
    # Penalty pressure is compared by its mean over an element, where it swings about the exact one.
    element = np.floor(contact.distance_mm / hertz.ELEMENT_MM).astype(int)
    count = np.bincount(element)
    found, expected = (np.bincount(element, p) / count for p in (contact.pressure_mpa, exact))
    assert np.abs(found - expected).max() < 0.03 * highest
    touching = contact.distance_mm[contact.pressure_mpa > 0.0].max()
    assert touching == pytest.approx(half_width, abs=0.25 * hertz.ELEMENT_MM)


def test_sphere_resists_with_the_force_of_hertz() -> None:
    depth = hertz.CONTACT_MM**2 / hertz.RADIUS_MM
    contact = hertz.press(hertz.sphere_block(), depth, is_sphere=True)
    force, highest = hertz.point_contact(depth)
    assert contact.force_n == pytest.approx(force, rel=0.04)
    middle = contact.pressure_mpa[contact.distance_mm < 0.2 * hertz.CONTACT_MM].mean()
    assert middle == pytest.approx(highest, rel=0.04)
