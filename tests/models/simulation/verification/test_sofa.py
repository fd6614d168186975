"""The SOFA scene: its mesh class with linear tetrahedra gives its forces; quadratic elements lie far below."""

import numpy as np
import pytest

from tests.models.simulation.verification import sofa


@pytest.mark.parametrize("size", ["coarse", "medium"])
def test_meshes_are_of_the_class_of_the_reference(size: str) -> None:
    edge_mm, n_nodes, n_elements = sofa.SOFA_MESHES[size]
    mesh = sofa.linear_mesh(edge_mm)
    assert (len(mesh.nodes), mesh.n_elements) == (n_nodes, n_elements)
    assert sofa.profile().area * sofa.WIDTH_MM == pytest.approx(sofa.VOLUME_MM3, abs=0.1)


@pytest.fixture(scope="module")
def coarse() -> tuple[sofa.Curve, sofa.Curve]:
    return sofa.press_and_pull(sofa.linear_mesh(3.0), at_nodes=True)


def test_press_follows_sofa(coarse: tuple[sofa.Curve, sofa.Curve]) -> None:
    press, _ = coarse
    depth, force_x, _ = sofa.SOFA_PRESS.T
    assert np.interp(depth, press.travel_mm, press.force_x_n) == pytest.approx(force_x, rel=0.03, abs=0.3)
    assert press.force_x_n[-1] == pytest.approx(sofa.SOFA_PRESS_N["coarse"], rel=0.03)


def test_medium_mesh_lands_on_sofa() -> None:
    press, _ = sofa.press_and_pull(sofa.linear_mesh(1.65), at_nodes=True, step_mm=2.0, pull_mm=0.1)
    assert press.force_x_n[-1] == pytest.approx(sofa.SOFA_PRESS_N["medium"], rel=0.03)


def test_pull_follows_sofa(coarse: tuple[sofa.Curve, sofa.Curve]) -> None:
    _, pull = coarse
    lift, force_x, force_z = sofa.SOFA_PULL.T
    assert np.interp(lift, pull.travel_mm, pull.force_x_n) == pytest.approx(force_x, rel=0.03, abs=0.3)
    assert np.interp(lift, pull.travel_mm, pull.force_z_n) == pytest.approx(force_z, abs=0.2 + sofa.SOFA_RIPPLE_N)


def test_peak_agrees_with_sofa(coarse: tuple[sofa.Curve, sofa.Curve]) -> None:
    """SOFA keeps the normals of the last step, which at its 0.1 mm steps adds 0.25 N to the peak."""
    _, pull = coarse
    assert pull.force_z_n.max() == pytest.approx(sofa.SOFA_PEAK_N, abs=0.25 + sofa.SOFA_RIPPLE_N)


def test_sofa_lies_between_our_two_laws(coarse: tuple[sofa.Curve, sofa.Curve]) -> None:
    """The corotated law softens less under compression than St.Venant-Kirchhoff and stiffens less than neo-Hooke."""
    stiff, _ = coarse
    soft, _ = sofa.press_and_pull(
        sofa.linear_mesh(3.0), law="st_venant_kirchhoff", at_nodes=True, step_mm=1.0, pull_mm=0.1
    )
    _, force_x, force_z = sofa.SOFA_PRESS[-1]
    assert soft.force_x_n[-1] < force_x < stiff.force_x_n[-1]
    assert stiff.force_z_n[-1] < force_z < soft.force_z_n[-1]


def test_quadratic_elements_lie_below() -> None:
    """SOFA's own extrapolation of its meshes is 23.5 N, 28 % below its coarse mesh."""
    press, _ = sofa.press_and_pull(sofa.quadratic_mesh(6.0, 1), pull_mm=0.1)
    assert 0.68 < press.force_x_n[-1] / sofa.SOFA_PRESS_N["coarse"] < 0.73
