"""From a design to a volume mesh: the one interface to both meshers."""

from collections.abc import Sequence

from shapely.geometry import Polygon

from models.effects.base import Effect
from models.geometry.profile import planar_profile
from models.mesh.solid import SolidMesh
from models.mesh.wedge import wedge_mesh
from models.records import Design, MeshSettings

TETWILD_TIME_LIMIT_S = 60.0
RESOLVING_EDGE_TO_RADIUS = 4.0


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
        from models.mesh.tetwild import tetwild_mesh

        return tetwild_mesh(
            profile, design.width_mm, settings.edge_mm, full_width=full_width, time_limit_s=TETWILD_TIME_LIMIT_S
        )
    return wedge_mesh(
        profile,
        design.width_mm,
        settings.edge_mm,
        refine=settings.refine,
        n_layers=settings.layers,
        full_width=full_width,
    )


def printed_profile(design: Design, settings: MeshSettings, effects: Sequence[Effect]) -> Polygon:
    """Planar profile (x, z in mm) with fillets, after the geometry effects."""
    profile = planar_profile(design, resolved_fillet_mm(settings))
    for effect in effects:
        profile = effect.modify_profile(profile, design)
    return profile


def resolved_fillet_mm(settings: MeshSettings) -> float:
    """The fillet radius that the mesh can show, else 0.

    On coarse meshes an arc's short edges double the unknowns and change the peak by less than 1.5 %, a tenth of
    their discretisation error; from `RESOLVING_EDGE_TO_RADIUS` on the fillet matters more than the mesh.
    """
    edge_mm = settings.edge_mm / 2**settings.refine
    return settings.fillet_mm if edge_mm <= RESOLVING_EDGE_TO_RADIUS * settings.fillet_mm else 0.0
