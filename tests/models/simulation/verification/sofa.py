"""A scene measured in SOFA: one finger pressed 12 mm onto a rigid cylinder and pulled off over 60 mm.

SOFA v25.12 ran it with corotational linear tetrahedra and with contact at the nodes. Here the same outline carries
linear tetrahedra of the same class and our own laws and contact. The corotated law, whose stress is linear in the
stretch, lies between ours: St.Venant-Kirchhoff softens under compression, neo-Hookean stiffens.
"""

from contextlib import nullcontext
from dataclasses import dataclass
from unittest import mock

import numpy as np
import shapely
from scipy.spatial import Delaunay
from shapely.geometry import Polygon, box

from fast.models.simulation.body.assembly import Material
from fast.models.simulation.body.elasticity import MaterialLaw
from fast.models.simulation.contact import points as contact_points
from fast.models.simulation.contact.law import PointSpacing
from fast.models.simulation.mesh.build import extrude
from fast.models.simulation.mesh.section import planar_mesh
from fast.models.simulation.mesh.solid import ElementBlock, SolidMesh
from fast.models.simulation.model import to_object_frame
from tests.models.simulation.obstacles import make_rod
from tests.models.simulation.verification.rig import set_up

HEIGHT_MM, WIDTH_MM, PLATE_MM, N_LAYERS = 97.0, 30.0, 4.0, 8
OUTLINE = ((0, 0), (31, 0), (5.5, 72), (5.5, 97), (0, 97))
FRONT_MM, BACK_MM, CAVITY_TOP_MM = 2.6, 2.9, 69.2426
RIBS_MM, RIB_THICKNESS_MM = (14.874, 25.748, 36.621, 47.495, 58.369), 2.8
VOLUME_MM3 = 24554.3
MODULUS_MPA, POISSON, FRICTION = 11.5, 0.45, 0.56
# Edge in the plane (mm), nodes and tetrahedra of SOFA's meshes, and its Fx (N) at 12 mm of press with friction.
SOFA_MESHES = {"coarse": (3.0, 1980, 6600), "medium": (1.65, 5040, 19656), "fine": (1.05, 10872, 46728)}
SOFA_PRESS_N = {"coarse": 32.51, "medium": 29.18, "fine": 25.84}
# Coarse mesh in steps of 0.1 mm: press or pull in mm, Fx and Fz in N.
SOFA_PRESS = np.array(
    [
        *((0.6, 1.68, -1.08), (1.8, 5.16, -3.26), (3.0, 8.49, -5.28), (4.2, 11.71, -7.19), (5.4, 14.81, -9.01)),
        *((6.6, 18.02, -11.30), (7.8, 21.29, -13.82), (9.0, 24.42, -15.70), (10.2, 27.50, -16.88)),
        *((11.4, 30.88, -17.19), (12.0, 32.51, -16.87)),
    ]
)
SOFA_PULL = np.array(
    [
        *((5.0, 28.35, 8.67), (10.0, 23.35, 5.60), (20.0, 13.98, 3.61), (30.0, 7.88, 1.41)),
        *((40.0, 4.13, 1.01), (50.0, 2.31, -0.37)),
    ]
)
SOFA_PEAK_N, SOFA_RIPPLE_N = 10.05, 0.5
GAP_MM, PRESS_MM, PULL_MM = 0.5, 12.0, 60.0


@dataclass(frozen=True)
class Curve:
    """Force of one finger on its base: `travel_mm` (n) of press (from first touch) or pull, `force_x_n`, `force_z_n`.

    Signs of the reference: x > 0 pushes the base away from the object, z > 0 resists the pull.
    """

    travel_mm: np.ndarray
    force_x_n: np.ndarray
    force_z_n: np.ndarray


def profile() -> Polygon:
    """Outline with cavities, (x, z) in mm, base plate included."""
    back, foot = np.array([31.0, 0.0]), np.array([5.5, 72.0])
    along = (foot - back) / np.linalg.norm(foot - back)
    inner = back + BACK_MM * np.array([-along[1], along[0]])
    low, high = (inner[0] + (z - inner[1]) * along[0] / along[1] for z in (PLATE_MM, CAVITY_TOP_MM))
    cavity = Polygon([(FRONT_MM, PLATE_MM), (low, PLATE_MM), (high, CAVITY_TOP_MM), (FRONT_MM, CAVITY_TOP_MM)])
    ribs = [box(0, z - RIB_THICKNESS_MM / 2, 40, z + RIB_THICKNESS_MM / 2) for z in RIBS_MM]
    return Polygon(OUTLINE).difference(cavity.difference(shapely.union_all(ribs)))


def soft_profile() -> Polygon:
    """The part above the rigid plate, which is all that deforms."""
    above = profile().intersection(box(-1, PLATE_MM, 40, HEIGHT_MM + 1))
    return max(shapely.get_parts(above), key=shapely.area)


def linear_mesh(edge_mm: float) -> SolidMesh:
    """Linear tetrahedra: triangles with edges of about `edge_mm`, in eight layers, each prism split into three."""
    vertices, triangles = _triangulate(edge_mm)
    n = len(vertices)
    levels = np.linspace(-0.5 * WIDTH_MM, 0.5 * WIDTH_MM, N_LAYERS + 1)
    nodes = np.vstack([np.column_stack([vertices[:, 0], np.full(n, y), vertices[:, 1]]) for y in levels])
    a, b, c = np.sort(triangles, axis=1).T
    tetrahedra = np.vstack([[a, b, c, c + n], [a, b, b + n, c + n], [a, a + n, b + n, c + n]])
    prism = tetrahedra.reshape(3, 4, -1).transpose(2, 0, 1).reshape(-1, 4)
    elements = _upright(nodes, np.vstack([prism + n * layer for layer in range(N_LAYERS)]))
    return SolidMesh(
        nodes=nodes,
        blocks=(ElementBlock("C3D4", elements),),
        base_nodes=np.flatnonzero(nodes[:, 2] < PLATE_MM + 1e-6).astype(np.int32),
        symmetry_nodes=np.zeros(0, np.int32),
        contact_faces=_front_and_tip(nodes, elements),
    )


def quadratic_mesh(edge_mm: float, refine: int) -> SolidMesh:
    """Half the finger in the elements of the product."""
    levels = np.array([0.0, 0.5 * WIDTH_MM])
    return extrude(planar_mesh(soft_profile(), edge_mm, refine), levels, symmetric=True)


def press_and_pull(
    mesh: SolidMesh,
    *,
    friction: float = FRICTION,
    law: MaterialLaw = "neo_hookean",
    at_nodes: bool = False,
    pull_mm: float = PULL_MM,
    step_mm: float = 0.5,
) -> tuple[Curve, Curve]:
    """Press the finger 12 mm onto the cylinder, then pull it off; half meshes count twice.

    `at_nodes` lets only the nodes of linear tetrahedra touch, as in SOFA, instead of points all over the faces.
    """
    nodes = to_object_frame(mesh.nodes, HEIGHT_MM, 0.0)
    material = Material(MODULUS_MPA, POISSON, law)
    with mock.patch.object(contact_points, "_divide_triangle", _corners) if at_nodes else nullcontext():
        rig = set_up(
            mesh,
            nodes,
            material,
            make_rod(-20.5, HEIGHT_MM - 60.0, 20.0),
            friction=friction,
            spacing=PointSpacing(0.25, 1.0),
        )
    share = 2.0 if mesh.is_half else 1.0
    state = rig.finger.undeformed(np.array([-GAP_MM, 0.0, 0.0]), np.zeros(3))
    curves = []
    for direction, length in (([-1.0, 0.0, 0.0], PRESS_MM), ([0.0, 0.0, 1.0], pull_mm)):
        steps = rig.walk(state, np.array(direction), length, step_mm)
        samples = [(step.travel_mm, -share * step.clamp_n[0], share * step.clamp_n[2]) for step in steps]
        state = steps[-1].state
        state.v[:] = 0.0
        curves.append(Curve(*np.array(samples).T))
    return curves[0], curves[1]


def _triangulate(edge_mm: float) -> tuple[np.ndarray, np.ndarray]:
    """Delaunay triangles (t, 3) over points (v, 2): the divided boundary and a hexagonal lattice inside.

    The lattice keeps 0.3 edges away from the boundary. With edges of 3 and 1.65 mm this makes 220 and 560 points,
    275 and 819 triangles, the very numbers of the reference's coarse and medium mesh.
    """
    whole = profile()
    boundary = shapely.get_coordinates(shapely.segmentize(whole, edge_mm))
    points = np.vstack([np.unique(np.round(boundary, 9), axis=0), _lattice(whole, edge_mm)])
    triangles = Delaunay(points).simplices
    is_inside = shapely.contains_xy(whole, points[triangles].mean(axis=1))
    a, b, c = points[triangles].transpose(1, 0, 2)
    area = np.abs((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0])
    return points, triangles[is_inside & (area > 1e-6)]


def _lattice(whole: Polygon, edge_mm: float) -> np.ndarray:
    """Points (p, 2) of a hexagonal lattice inside the profile."""
    rise = edge_mm * np.sqrt(3.0) / 2.0
    rows = np.arange(0.25 * rise, HEIGHT_MM, rise)
    x = np.arange(0.5 * edge_mm, 32.0, edge_mm)
    points = np.vstack([np.column_stack([x - 0.5 * edge_mm * (j % 2), 0 * x + z]) for j, z in enumerate(rows)])
    depth = shapely.distance(whole.boundary, shapely.points(points))
    return points[shapely.contains_xy(whole, points) & (depth > 0.3 * edge_mm)]


def _corners(_: int) -> np.ndarray:
    """Contact points in the corners of the unit triangle."""
    return np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])


def _upright(nodes: np.ndarray, tetrahedra: np.ndarray) -> np.ndarray:
    """Tetrahedra (t, 4) with positive volume."""
    a, b, c, d = nodes[tetrahedra].transpose(1, 0, 2)
    volume = np.einsum("ti,ti->t", np.cross(b - a, c - a), d - a)
    return np.where((volume > 0.0)[:, None], tetrahedra, tetrahedra[:, [0, 2, 1, 3]]).astype(np.int32)


def _front_and_tip(nodes: np.ndarray, tetrahedra: np.ndarray) -> np.ndarray:
    """Three-node faces (f, 3) on the front wall and the tip plane."""
    faces = tetrahedra[:, [[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]]].reshape(-1, 3)
    on_front = (nodes[faces, 0] == 0.0).all(axis=1)
    on_tip = (nodes[faces, 2] == HEIGHT_MM).all(axis=1)
    return faces[on_front | on_tip]
