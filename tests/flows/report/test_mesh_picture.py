import numpy as np
import pytest
import trimesh

from fast.flows.report.mesh_picture import Body, render


def test_sphere_covers_its_disc_and_is_lit_from_above():
    image = render([Body(trimesh.creation.icosphere(subdivisions=3, radius=7.0), "#808080")], 20.0, 10.0, 120)
    assert image.shape == (120, 120, 4)
    covered = image[..., 3].sum() / 120**2
    assert covered == pytest.approx(np.pi / 4 * (0.94 + 1 / 120) ** 2, rel=0.01)  # half a pixel of outline all round
    assert image[30, 60, :3].mean() > image[95, 60, :3].mean() + 0.1


def test_the_nearer_body_hides_the_farther_one_in_any_order():
    near = trimesh.creation.box([4, 1, 4])
    near.apply_translation([0, -5, 0])  # the eye at azimuth 0 looks from -y
    bodies = [Body(near, "#ff0000"), Body(trimesh.creation.box([8, 1, 8]), "#0000ff")]
    for order in (bodies, bodies[::-1]):
        image = render(order, 0.0, 0.0, 60)
        assert image[30, 30, 0] > 0.5
        assert image[30, 30, 2] == 0.0
        assert image[30, 6, 2] > 0.5


def test_picture_is_upright_and_not_mirrored():
    tower = trimesh.creation.box([2, 2, 10])
    tower.apply_translation([9, 0, 5])  # to the right of the eye, upwards
    floor = trimesh.creation.box([20, 2, 1])
    image = render([Body(tower, "#ff0000"), Body(floor, "#0000ff")], 0.0, 0.0, 110)
    rows, columns = np.nonzero(image[..., 0] > 0.3)
    assert columns.mean() > 0.8 * image.shape[1]
    assert rows.mean() < 0.6 * image.shape[0]
