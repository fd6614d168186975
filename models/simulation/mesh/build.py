"""From a design to a volume mesh: the one interface to both meshers.

The usual one sweeps a planar mesh over the width in quadratic layers: triangles become wedges, quadrilaterals become
hexahedra.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from shapely.geometry import LinearRing, Polygon
from shapely.geometry.polygon import orient

from fast.models.errors import MeshingFailed
from fast.models.records import Design
from fast.models.simulation.effects.base import Effect
from fast.models.simulation.mesh.planar import PlanarMesh
from fast.models.simulation.mesh.section import planar_mesh
from fast.models.simulation.mesh.solid import ElementBlock, SolidMesh
from fast.models.simulation.version import MeshSettings

TETWILD_TIME_LIMIT_S = 60.0
IN_SECTION = [0, 2]  # x and z of a node of the solid
PLANE_TOLERANCE_MM = 1e-6


def build_mesh(
    design: Design, settings: MeshSettings, *, full_width: bool = False, effects: Sequence[Effect] = ()
) -> SolidMesh:
    """Mesh the compliant body of a finger in the finger frame; half the width (y >= 0) unless `full_width`.

    The geometry hooks of `effects` are applied to the profile in order.

    Raises:
        MeshingFailed: with the reason.
    """
    profile = printed_profile(design, settings, effects)
    if settings.mesher == "tetwild":
        # pytetwild is heavy and only needed here.
        from fast.models.simulation.mesh.tetwild import tetwild_mesh

        solid = tetwild_mesh(
            profile, design.width_mm, settings.edge_mm, full_width=full_width, time_limit_s=TETWILD_TIME_LIMIT_S
        )
        nodes = solid.nodes.copy()
        nodes[:, IN_SECTION] = printed_points(nodes[:, IN_SECTION], design, effects)
        return replace(solid, nodes=nodes)
    return _sweep(profile, design, settings, full_width, effects)


def build_moved_mesh(
    mesh: SolidMesh, before: Polygon, design: Design, settings: MeshSettings, effects: Sequence[Effect]
) -> SolidMesh | None:
    """Build the extruded mesh of a finger that differs a little from that of `mesh`, whose profile is `before`.

    The same elements at other places; None where the difference is not little enough for that.
    """
    profile = _ordered_as(before, printed_profile(design, settings, effects))
    if profile is None or settings.mesher != "extruded":
        return None
    try:
        moved = _sweep(profile, design, settings, not mesh.is_half, effects)
    except MeshingFailed:
        return None
    own, other = moved.to_arrays(), mesh.to_arrays()
    is_same = own.keys() == other.keys() and own["nodes"].shape == other["nodes"].shape
    return moved if is_same and all(np.array_equal(own[k], other[k]) for k in own if k != "nodes") else None


def _sweep(
    profile: Polygon, design: Design, settings: MeshSettings, full_width: bool, effects: Sequence[Effect]
) -> SolidMesh:
    half, layers = 0.5 * design.width_mm, settings.layers
    levels = np.linspace(-half, half, 2 * layers + 1) if full_width else np.linspace(0.0, half, layers + 1)
    section = printed_section(planar_mesh(profile, settings.edge_mm, settings.refine), design, effects)
    return extrude(section, levels, symmetric=not full_width)


def _ordered_as(before: Polygon, after: Polygon) -> Polygon | None:
    """Order a profile's corners and voids as those of another that is nearly the same; None if it is not."""
    before, after = orient(before), orient(after)
    if len(before.interiors) != len(after.interiors):
        return None
    middles = np.array([ring.centroid.coords[0] for ring in after.interiors]).reshape(-1, 2)
    rings = [_ring_as(before.exterior, after.exterior)]
    for void in before.interiors:
        nearest = int(np.argmin(np.hypot(*(middles - void.centroid.coords[0]).T)))
        rings.append(_ring_as(void, after.interiors[nearest]))
    outline, *voids = rings
    return None if any(ring is None for ring in rings) else Polygon(outline, voids)


def _ring_as(before: LinearRing, after: LinearRing) -> np.ndarray | None:
    """Order corners (n, 2) of a ring, each the nearest to that in its place of another ring; None if one is missing."""
    old, new = np.array(before.coords)[:-1], np.array(after.coords)[:-1]
    nearest = np.argmin(((old[:, None] - new[None]) ** 2).sum(axis=2), axis=1)
    return new[nearest] if len(old) == len(new) == len(np.unique(nearest)) else None


def printed_section(section: PlanarMesh, design: Design, effects: Sequence[Effect]) -> PlanarMesh:
    """Return the mesh of the section after the geometry effects that act on points."""
    return replace(section, points=printed_points(section.points, design, effects))


def printed_points(points: np.ndarray, design: Design, effects: Sequence[Effect]) -> np.ndarray:
    """Return where points (n, 2) of the section, x and z in mm, are after the geometry effects that act on points."""
    for effect in effects:
        points = effect.modify_section(points, design)
    return points


def printed_profile(design: Design, settings: MeshSettings, effects: Sequence[Effect]) -> Polygon:
    """Return the planar profile (x, z in mm) with fillets, after the geometry effects.

    A coarse mesh shows a fillet as one chamfer, a refined one as an arc of as many sides.
    """
    profile = design.draw_section(settings.fillet_mm, arc_segments=2**settings.refine)
    for effect in effects:
        profile = effect.modify_profile(profile, design)
    return profile


def extrude(planar: PlanarMesh, levels: np.ndarray, *, symmetric: bool) -> SolidMesh:
    """Extrude to C3D15 and C3D20R between consecutive `levels` of y (mm); the first is symmetry plane if `symmetric`.

    Levels between layers carry all planar points, the middles of the layers only the vertices (serendipity).
    """
    n_points, n_vertices, n_layers = len(planar.points), planar.n_vertices, len(levels) - 1
    stride = n_points + n_vertices
    full = [_at_level(planar.points, y) for y in levels]
    middle = [_at_level(planar.points[:n_vertices], y) for y in 0.5 * (levels[1:] + levels[:-1])]
    nodes = np.vstack([part for pair in zip(full, middle, strict=False) for part in pair] + [full[-1]])
    blocks = [
        ElementBlock("C3D15", _stacked(_swept(planar.triangles, n_points, stride), stride, n_layers)),
        ElementBlock("C3D20R", _stacked(_swept(planar.quadrilaterals, n_points, stride), stride, n_layers)),
    ]
    base_z = planar.points[:, 1].min()
    return SolidMesh(
        nodes=nodes,
        blocks=tuple(block for block in blocks if len(block.connectivity)),
        base_nodes=np.flatnonzero(nodes[:, 2] < base_z + PLANE_TOLERANCE_MM).astype(np.int32),
        symmetry_nodes=np.flatnonzero(nodes[:, 1] == 0.0).astype(np.int32) if symmetric else np.zeros(0, np.int32),
        contact_faces=_stacked(_faces(contact_edges(planar), n_points, stride), stride, n_layers),
    )


def contact_edges(planar: PlanarMesh) -> np.ndarray:
    """List the edges (e, 3) on the front wall x = 0 and on the tip plane z = max."""
    x, z = planar.points[planar.edges].transpose(2, 0, 1)
    apex = planar.points[:, 1].max()
    on_front = (np.abs(x) < PLANE_TOLERANCE_MM).all(axis=1)
    on_tip = (z > apex - PLANE_TOLERANCE_MM).all(axis=1)
    return planar.edges[on_front | on_tip]


def _swept(elements: np.ndarray, n_points: int, stride: int) -> np.ndarray:
    """Make solid elements of one layer from planar ones (m, 2 k): corners and middles below, above, then between."""
    k = elements.shape[1] // 2
    # Counter-clockwise in (x, z) looks along -y, so the corners are taken clockwise to extrude towards +y.
    corners = np.roll(elements[:, :k][:, ::-1], 1, axis=1)
    sides = elements[:, k:][:, ::-1]
    return np.hstack([corners, corners + stride, sides, sides + stride, corners + n_points])


def _faces(edges: np.ndarray, n_points: int, stride: int) -> np.ndarray:
    """Make the eight-node faces over the edges (e, 3) of one layer."""
    a, b, middle = edges.T
    return np.column_stack([a, b, b + stride, a + stride, middle, b + n_points, middle + stride, a + n_points])


def _stacked(layer: np.ndarray, stride: int, n_layers: int) -> np.ndarray:
    return np.vstack([layer + stride * i for i in range(n_layers)]).astype(np.int32)


def _at_level(points: np.ndarray, y: float) -> np.ndarray:
    return np.column_stack([points[:, 0], np.full(len(points), y), points[:, 1]])
