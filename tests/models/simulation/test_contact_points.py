"""Where contact points lie: in columns that are staggered along the finger, the same way in space on all faces."""

import numpy as np
import pytest

from fast.models.design.fin_ray import FinRay
from fast.models.design.space import BEST_PUBLISHED, numbered_design
from fast.models.objects.catalogue import get_object
from fast.models.records import GraspSetup
from fast.models.simulation.contact.points import PointSpacing, contact_points
from fast.models.simulation.grasp import simulate_grasp
from fast.models.simulation.mesh.build import build_mesh
from fast.models.simulation.mesh.solid import SolidMesh
from fast.models.simulation.model import to_object_frame
from fast.models.simulation.placement import Placement
from fast.models.simulation.version import IN_ROWS, MeshSettings, SimulatorVersion

STAGGERED = SimulatorVersion()
ROWS = SimulatorVersion(fem_version=IN_ROWS)


def place_points(mesh: SolidMesh, spacing: PointSpacing) -> np.ndarray:
    """Positions (n, 3) of the contact points in the object frame, and their areas (n) as a fourth column."""
    nodes = to_object_frame(mesh.nodes, BEST_PUBLISHED.height_mm, 5.0)
    points = contact_points(mesh.contact_faces, nodes, spacing)
    of_face = np.repeat(np.arange(len(points.faces)), np.diff(points.first_point[points.first_patch]))
    at = np.einsum("nk,nki->ni", points.shape, nodes[points.faces[of_face]])
    return np.column_stack([at, points.areas])


def find_front(points: np.ndarray) -> np.ndarray:
    """The points of the front wall, x = 0, away from its ends."""
    inner = (points[:, 2] > 0.0) & (points[:, 2] < BEST_PUBLISHED.height_mm - 15.0)
    return points[(np.abs(points[:, 0]) < 1e-9) & inner]


@pytest.fixture(scope="module")
def solid() -> SolidMesh:
    return build_mesh(BEST_PUBLISHED, MeshSettings())


def test_each_height_of_a_cell_meets_as_many_columns(solid: SolidMesh) -> None:
    front = find_front(place_points(solid, PointSpacing()))
    n_columns = len(np.unique(front[:, 1].round(6)))
    rim_mm = 0.25  # a straight rim as high as a cell touches one point of every column, or nearly
    touched = [((front[:, 2] >= low) & (front[:, 2] < low + rim_mm)).sum() for low in np.arange(5.0, 40.0, 0.07)]
    assert 0.93 * n_columns <= min(touched) <= max(touched) <= 1.15 * n_columns
    half = [((front[:, 2] >= low) & (front[:, 2] < low + rim_mm / 2)).sum() for low in np.arange(5.0, 40.0, 0.07)]
    assert min(half) > 0.35 * n_columns  # in straight rows it would touch none


def test_columns_go_on_from_face_to_face_without_a_gap(solid: SolidMesh) -> None:
    front = find_front(place_points(solid, PointSpacing()))
    for column in np.unique(front[:, 1].round(6)):
        heights = np.sort(front[np.abs(front[:, 1] - column) < 1e-6, 2])
        assert np.diff(heights).max() < 0.2505
        assert np.diff(heights).min() > 0.15


def test_both_halves_of_a_full_finger_have_the_same_points() -> None:
    whole = build_mesh(BEST_PUBLISHED, MeshSettings(), full_width=True)
    front = find_front(place_points(whole, PointSpacing()))
    left, right = front[front[:, 1] < 0.0], front[front[:, 1] > 0.0]
    mirrored = left * [1.0, -1.0, 1.0, 1.0]

    def in_order(points: np.ndarray) -> np.ndarray:
        return np.array(points[np.lexsort(points[:, :3].round(6).T)])

    assert in_order(mirrored) == pytest.approx(in_order(right), abs=1e-9)


def test_staggered_points_share_the_same_surface(solid: SolidMesh) -> None:
    areas = [place_points(solid, PointSpacing(is_staggered=one))[:, 3].sum() for one in (True, False)]
    assert areas[0] == pytest.approx(areas[1], rel=1e-9)


@pytest.mark.parametrize("design", [numbered_design(3), numbered_design(11)], ids=("3", "11"))
def test_the_peak_ripples_less_than_with_points_in_rows(design: FinRay) -> None:
    z_mm = np.linspace(0.0, 0.25, 6)

    def measure_ripple(version: SimulatorVersion) -> float:
        peaks = [
            simulate_grasp(
                design, get_object(14), version, GraspSetup(), placement=Placement(offset_z_mm=float(z))
            ).peak_force_n
            for z in z_mm
        ]
        rest = peaks - np.polyval(np.polyfit(z_mm, peaks, 1), z_mm)
        return float(np.sqrt((rest**2).mean()) / np.mean(peaks))

    assert measure_ripple(STAGGERED) < 0.5 * measure_ripple(ROWS)


def test_the_code_with_points_in_rows_is_another_version() -> None:
    assert ROWS.version_id != STAGGERED.version_id
