"""`fast simulate --export-calculix`: a folder that CalculiX can run, with our own numbers beside it."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from fast.flows.cli.simulate_output import unwritable
from fast.models.errors import UsageError
from fast.models.objects.distance import distance_and_normal
from fast.models.objects.primitives import turn_about_z
from fast.models.objects.rigid import RigidObject
from fast.models.objects.surface import surface_of
from fast.models.records import Design, GraspSetup, Placement
from fast.models.simulation.grasp import Numerics, simulate_grasp
from fast.models.simulation.mesh.build import build_mesh
from fast.models.simulation.output.export_calculix import ClosingDeck, ObjectSurface
from fast.models.simulation.output.recording import GraspRecording, Snapshot
from fast.models.simulation.placement import CENTRED, describe_placement, needs_full_width, offset_mm, place
from fast.models.simulation.solver.stepping import StepLimits
from fast.models.simulation.version import SimulatorVersion

N_LEVELS = 4
OBJECT_SPACING_MM = 1.0
# Fine steps, because the forces at the levels are read between them; the law is CalculiX's for *ELASTIC.
NUMERICS = Numerics(limits=StepLimits(closing_mm=0.5), material_law="st_venant_kirchhoff")
LIFTS_MM = (0.25, 0.5, 1.0, 2.0)

_README = """# Closing of one finger, and the beginning of its lift, in CalculiX

    ccx closing

runs `closing.inp` (CalculiX 2.20 or later) and prints, in `closing.dat`, the force of the clamp on the modelled finger
at {n} levels of closing and {n_lift} of the lift that follows. `expected.json` holds our own forces at the same levels:
{share}.

One finger (+x) of design {design} closes on object {object_id}, {name}{where}.
Units mm, N, MPa; frame of the nominal object (z up, x closing). The deck starts at the first touch, when the jaw has
travelled {touch:.3f} mm, moves the base by {stroke:.3f} mm in -x, then by {lift:g} mm in z. The object
is a layer of wedges with every node held.

Same in both codes: mesh, St.Venant-Kirchhoff law, linear penalty contact and stick stiffness, friction. Different:
contact integration, facets instead of the smooth object, and our smooth onset of pressure (which delays the force by
about 0.03 mm of travel, so the first level differs most). The mirror plane of the other finger is not in the deck;
in our run the finger came within {mirror:.1f} mm of it (it matters when this is below 0).
"""


def write_calculix(
    folder: Path,
    design: Design,
    obj: RigidObject,
    version: SimulatorVersion,
    setup: GraspSetup,
    placement: Placement = CENTRED,
) -> list[Path]:
    """Write `closing.inp`, `expected.json` and `README.md` of the right finger; returns the files.

    Raises:
        UsageError: the version has effects, the finger never touches the object, or the folder cannot be written.
        MeshingFailed, SimulationFailed: the grasp cannot be solved.
    """
    if version.effects:
        raise UsageError("--export-calculix writes the simulator without effects; use a version that has none.")
    mesh = build_mesh(design, version.mesh, full_width=needs_full_width(obj, placement))
    recording = GraspRecording()
    short = setup.model_copy(update={"max_lift_mm": LIFTS_MM[-1]})
    simulate_grasp(
        design,
        obj,
        version,
        short,
        placement=placement,
        mesh=mesh,
        numerics=NUMERICS,
        recorder=recording.add,
    )
    closing, lift = ([s for s in recording.of("right") if s.phase == phase] for phase in ("closing", "lift"))
    if not closing[-1].pressure.size:
        raise UsageError(
            f"The finger never touches object {obj.object_id}, so there is nothing to compute in CalculiX."
        )
    stroke = closing[-1].travel_mm - closing[0].travel_mm
    travels = [stroke * level / N_LEVELS for level in range(1, N_LEVELS + 1)]
    law = NUMERICS.contact
    deck = ClosingDeck(mesh, closing[0].rest_nodes, _surface(obj, placement), version.theta, law, travels, LIFTS_MM)
    expected = {"design_id": design.design_id, "object_id": obj.object_id, "version_id": version.version_id}
    expected |= {
        "setup": setup.model_dump(),
        "placement": placement.model_dump(),
        "mesh_id": mesh.mesh_id,
        "levels": _levels(closing, travels, "travel_mm"),
        "lift_levels": _levels([closing[-1], *lift], LIFTS_MM, "lift_mm"),
    }
    readme = _README.format(
        n=N_LEVELS,
        n_lift=len(LIFTS_MM),
        lift=LIFTS_MM[-1],
        share="of the modelled half, as CalculiX prints them" if mesh.is_half else "of the finger",
        design=design.design_id,
        object_id=obj.object_id,
        name=obj.name,
        where=describe_placement(placement),
        touch=closing[0].travel_mm,
        stroke=stroke,
        mirror=min(float(snapshot.nodes[:, 0].min()) for snapshot in closing),
    )
    texts = {"closing.inp": deck.text(), "expected.json": json.dumps(expected, indent=2) + "\n", "README.md": readme}
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name, text in texts.items():
            (folder / name).write_text(text, encoding="utf-8")
    except OSError as error:
        raise unwritable("--export-calculix", folder, error) from error
    return [folder / name for name in texts]


def _surface(obj: RigidObject, placement: Placement) -> ObjectSurface:
    mesh = surface_of(obj.primitives, OBJECT_SPACING_MM)
    vertices = np.asarray(mesh.vertices)
    if placement != CENTRED:
        vertices = vertices @ turn_about_z(placement.yaw_deg).T + offset_mm(placement)
    normals = distance_and_normal(place(obj, placement), vertices)[1]
    return ObjectSurface(vertices, normals, np.asarray(mesh.faces))


def _levels(seen: list[Snapshot], places_mm: Sequence[float], axis: str) -> list[dict[str, Any]]:
    """Force of the clamp on the modelled finger (half of it for a half mesh) at each travel since the first touch."""
    share = 2.0 if seen[0].mesh.is_half else 1.0
    first_mm = seen[0].travel_mm if axis == "travel_mm" else 0.0
    place = np.array([getattr(snapshot, axis) - first_mm for snapshot in seen])
    force = np.array([snapshot.clamp_force * snapshot.scale / share for snapshot in seen])
    return [{axis: at, "force_n": [float(np.interp(at, place, force[:, n])) for n in range(3)]} for at in places_mm]
