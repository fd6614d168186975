"""A grasp, up to the beginning of its lift, as an input deck of CalculiX: independent code for the same mechanics.

What the deck shares with our solver: mesh, St.Venant-Kirchhoff law (*ELASTIC with NLGEOM), linear penalty contact
of the same stiffness, Coulomb friction with the same stick stiffness, prescribed base. What differs: contact
integration (face-to-face over CalculiX's own points), a faceted object, no smoothing of the pressure at first touch,
no inertia, and no mirror plane for the other finger.

`python -m tests.models.simulation.verification.calculix FOLDER` writes the deck of the sphere.
"""

import json
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fast.models.design.space import BEST_PUBLISHED
from fast.models.errors import UsageError
from fast.models.objects.catalogue import get_object
from fast.models.objects.distance import distance_and_normal
from fast.models.objects.primitives import turn_about_z
from fast.models.objects.rigid import RigidObject
from fast.models.objects.surface import surface_of
from fast.models.records import Design, GraspSetup, Placement, Theta
from fast.models.simulation.body.elasticity import REFERENCE_MODULUS_MPA
from fast.models.simulation.body.shape_functions import ElementKind
from fast.models.simulation.contact.law import ContactLaw
from fast.models.simulation.grasp import Numerics, simulate_grasp
from fast.models.simulation.mesh.build import build_mesh
from fast.models.simulation.mesh.solid import SolidMesh
from fast.models.simulation.output.recording import GraspRecording, Snapshot
from fast.models.simulation.placement import CENTRED, describe_placement, needs_full_width, offset_mm, place
from fast.models.simulation.solver.stepping import StepLimits
from fast.models.simulation.version import SimulatorVersion

SHELL_MM = 0.3  # depth of the object's layer of wedges; below the objects' edge radius of 1 mm, so none is inverted
REACH_MM = 2.0  # how far beyond the finger the object is kept
RIGID_MODULUS_MPA = 1e5  # of no effect: every node of the object is held
MAX_INCREMENTS = 1000
_NUMBERS_PER_LINE = 12

# Corner nodes of the faces S1, S2, ... of CalculiX's elements.
_FACES: dict[ElementKind, tuple[tuple[int, ...], ...]] = {
    "C3D4": ((0, 1, 2), (0, 3, 1), (1, 3, 2), (2, 3, 0)),
    "C3D10": ((0, 1, 2), (0, 3, 1), (1, 3, 2), (2, 3, 0)),
    "C3D15": ((0, 1, 2), (3, 4, 5), (0, 1, 4, 3), (1, 2, 5, 4), (2, 0, 3, 5)),
    "C3D20R": ((0, 1, 2, 3), (4, 7, 6, 5), (0, 4, 5, 1), (1, 5, 6, 2), (2, 6, 7, 3), (3, 7, 4, 0)),
}
_N_CORNERS = {3: 3, 6: 3, 8: 4}  # of a contact face, by its number of nodes
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


@dataclass(frozen=True)
class ObjectSurface:
    """Triangulated object: `vertices` (v, 3) mm, outward `normals` (v, 3), `triangles` (t, 3) counter-clockwise."""

    vertices: np.ndarray
    normals: np.ndarray
    triangles: np.ndarray

    def near(self, nodes: np.ndarray, stroke_mm: float) -> "ObjectSurface":
        """The triangles that a finger with these nodes (n, 3) may meet while its base moves by -x `stroke_mm`."""
        low, high = nodes.min(axis=0) - REACH_MM, nodes.max(axis=0) + REACH_MM
        low[0] -= stroke_mm
        corners = self.vertices[self.triangles]
        inside = ((corners.max(axis=1) > low) & (corners.min(axis=1) < high)).all(axis=1)
        kept = self.triangles[inside]
        used, compact = np.unique(kept, return_inverse=True)
        return ObjectSurface(self.vertices[used], self.normals[used], compact.reshape(-1, 3))


@dataclass(frozen=True)
class ClosingDeck:
    """One finger closing on a rigid object, and the beginning of its lift.

    Attributes:
        mesh: elements and sets of the finger.
        nodes: n x 3, undeformed, at the first touch, in the object frame.
        surface: the object.
        theta: modulus, friction, Poisson ratio.
        law: contact stiffness at the reference modulus.
        travels_mm: rising travels of the base along -x since the first touch; one step each.
        lifts_mm: rising travels of the base along +z afterwards; one step each.
    """

    mesh: SolidMesh
    nodes: np.ndarray
    surface: ObjectSurface
    theta: Theta
    law: ContactLaw
    travels_mm: Sequence[float]
    lifts_mm: Sequence[float] = ()

    def text(self) -> str:
        """The whole input deck."""
        parts = (self._finger(), self._object(), self._sets(), self._physics(), self._steps())
        return "\n".join(line for part in parts for line in part) + "\n"

    def _finger(self) -> Iterator[str]:
        yield "*HEADING\nClosing and lift of one finger on a rigid object; mm, N, MPa"
        yield "*NODE, NSET=FINGER"
        yield from _table(1, self.nodes)
        first = 1
        for block in self.mesh.blocks:
            yield f"*ELEMENT, TYPE={block.kind}, ELSET=FINGER"
            yield from _elements(first, block.connectivity + 1)
            first += len(block.connectivity)

    def _object(self) -> Iterator[str]:
        """A layer of wedges below the object's surface; their faces S2 are the surface."""
        surface, first = self.surface.near(self.nodes, self.travels_mm[-1]), len(self.nodes) + 1
        n = len(surface.vertices)
        inner = surface.vertices - SHELL_MM * surface.normals
        yield "*NODE, NSET=OBJECT"
        yield from _table(first, np.vstack([inner, surface.vertices]))
        yield "*ELEMENT, TYPE=C3D6, ELSET=OBJECT"
        wedges = np.hstack([surface.triangles, surface.triangles + n])
        yield from _elements(self.mesh.n_elements + 1, wedges + first)
        yield "*SURFACE, NAME=OBJECT_SURFACE, TYPE=ELEMENT\nOBJECT, S2"

    def _sets(self) -> Iterator[str]:
        held = np.setdiff1d(self.mesh.symmetry_nodes, self.mesh.base_nodes)
        for name, numbers in (("BASE", self.mesh.base_nodes), ("SYMMETRY", held)):
            yield f"*NSET, NSET={name}"
            yield from _wrapped([str(number + 1) for number in numbers])
        yield "*SURFACE, NAME=FINGER_SURFACE, TYPE=ELEMENT"
        yield from (f"{element}, S{face}" for element, face in contact_sides(self.mesh))

    def _physics(self) -> Iterator[str]:
        scale = self.theta.young_modulus_mpa / REFERENCE_MODULUS_MPA
        yield f"*MATERIAL, NAME=RUBBER\n*ELASTIC\n{self.theta.young_modulus_mpa:.10g}, {self.theta.poisson_ratio:.10g}"
        yield f"*MATERIAL, NAME=RIGID\n*ELASTIC\n{RIGID_MODULUS_MPA:g}, 0."
        yield "*SOLID SECTION, ELSET=FINGER, MATERIAL=RUBBER\n*SOLID SECTION, ELSET=OBJECT, MATERIAL=RIGID"
        yield "*SURFACE INTERACTION, NAME=TOUCH\n*SURFACE BEHAVIOR, PRESSURE-OVERCLOSURE=LINEAR"
        yield f"{self.law.normal_n_per_mm3 * scale:.10g}"
        if self.theta.friction > 0.0:
            yield f"*FRICTION\n{self.theta.friction:.10g}, {self.law.tangential_n_per_mm3 * scale:.10g}"
        yield "*CONTACT PAIR, INTERACTION=TOUCH, TYPE=SURFACE TO SURFACE\nFINGER_SURFACE, OBJECT_SURFACE"
        yield "*BOUNDARY\nOBJECT, 1, 3\nBASE, 2, 3"
        if self.mesh.is_half:
            yield "SYMMETRY, 2, 2"

    def _steps(self) -> Iterator[str]:
        ways = [(1, -travel) for travel in self.travels_mm] + [(3, lift) for lift in self.lifts_mm]
        for axis, at_mm in ways:
            yield f"*STEP, NLGEOM, INC={MAX_INCREMENTS}\n*STATIC\n0.1, 1., 1e-6, 0.25"
            yield f"*BOUNDARY\nBASE, {axis}, {axis}, {at_mm:.10g}"
            yield f"*NODE PRINT, NSET=BASE, TOTALS=ONLY, FREQUENCY={MAX_INCREMENTS}\nRF"
            yield f"*NODE FILE, FREQUENCY={MAX_INCREMENTS}\nU"
            yield f"*CONTACT FILE, FREQUENCY={MAX_INCREMENTS}\nCDIS, CSTR\n*END STEP"


def contact_sides(mesh: SolidMesh) -> list[tuple[int, int]]:
    """Element number and face number, both from 1, of every contact face of the mesh.

    Raises:
        ValueError: a contact face belongs to no element.
    """
    n_corners = _N_CORNERS[mesh.contact_faces.shape[1]]
    owner: dict[tuple[int, ...], tuple[int, int]] = {}
    first = 1
    for block in mesh.blocks:
        for side, corners in enumerate(_FACES[block.kind], start=1):
            if len(corners) == n_corners:
                keys = np.sort(block.connectivity[:, corners], axis=1).tolist()
                owner.update((tuple(key), (first + index, side)) for index, key in enumerate(keys))
        first += len(block.connectivity)
    wanted = [tuple(key) for key in np.sort(mesh.contact_faces[:, :n_corners], axis=1).tolist()]
    missing = [key for key in wanted if key not in owner]
    if missing:
        raise ValueError(f"{len(missing)} contact faces belong to no element, the first one is {missing[0]}")
    return [owner[key] for key in wanted]


def _table(first: int, points: np.ndarray) -> Iterator[str]:
    for number, (x, y, z) in enumerate(points, start=first):
        yield f"{number}, {x:.12g}, {y:.12g}, {z:.12g}"


def _elements(first: int, connectivity: np.ndarray) -> Iterator[str]:
    for number, nodes in enumerate(connectivity.tolist(), start=first):
        yield from _wrapped([str(number), *map(str, nodes)])


def _wrapped(words: list[str]) -> Iterator[str]:
    """Comma-separated words on lines that CalculiX can take in; a line that goes on ends with a comma."""
    lines = [", ".join(words[i : i + _NUMBERS_PER_LINE]) for i in range(0, len(words), _NUMBERS_PER_LINE)]
    yield from (f"{line}," for line in lines[:-1])
    yield from lines[-1:]


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
        UsageError: the version has effects, or the finger never touches the object.
        MeshingFailed, SimulationFailed: the grasp cannot be solved.
    """
    if version.effects:
        raise UsageError("a deck is of the simulator without effects; use a version that has none.")
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
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in texts.items():
        (folder / name).write_text(text, encoding="utf-8")
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


if __name__ == "__main__":
    write_calculix(Path(sys.argv[1]), BEST_PUBLISHED, get_object(1), SimulatorVersion(), GraspSetup(closed_gap_mm=34))
