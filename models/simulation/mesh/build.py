"""From a design to a volume mesh: the one interface to both meshers."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from shapely.geometry import Polygon

from fast.models.records import Design
from fast.models.simulation.effects.base import Effect
from fast.models.simulation.mesh.extrude import extrude
from fast.models.simulation.mesh.planar import PlanarMesh
from fast.models.simulation.mesh.section import planar_mesh
from fast.models.simulation.mesh.solid import SolidMesh
from fast.models.simulation.version import MeshSettings

TETWILD_TIME_LIMIT_S = 60.0
IN_SECTION = [0, 2]  # x and z of a node of the solid


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
    half, layers = 0.5 * design.width_mm, settings.layers
    levels = np.linspace(-half, half, 2 * layers + 1) if full_width else np.linspace(0.0, half, layers + 1)
    section = printed_section(planar_mesh(profile, settings.edge_mm, settings.refine), design, effects)
    return extrude(section, levels, symmetric=not full_width)


def printed_section(section: PlanarMesh, design: Design, effects: Sequence[Effect]) -> PlanarMesh:
    """The mesh of the section after the geometry effects that act on points."""
    return replace(section, points=printed_points(section.points, design, effects))


def printed_points(points: np.ndarray, design: Design, effects: Sequence[Effect]) -> np.ndarray:
    """Where points (n, 2) of the section, x and z in mm, are after the geometry effects that act on points."""
    for effect in effects:
        points = effect.modify_section(points, design)
    return points


def printed_profile(design: Design, settings: MeshSettings, effects: Sequence[Effect]) -> Polygon:
    """Planar profile (x, z in mm) with fillets, after the geometry effects.

    A coarse mesh shows a fillet as one chamfer, a refined one as an arc of as many sides.
    """
    profile = design.draw_section(settings.fillet_mm, arc_segments=2**settings.refine)
    for effect in effects:
        profile = effect.modify_profile(profile, design)
    return profile
