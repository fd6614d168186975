"""Ribs and walls that meet: where they are in each other, the force between them, and grasps that fold a finger."""

from dataclasses import dataclass

import numpy as np
import pytest
import shapely
from shapely.geometry import LineString, Polygon

from fast.models.design.fin_ray import planar_profile
from fast.models.design.space import from_unit, numbered_design, random_unit
from fast.models.errors import SimulationFailed
from fast.models.objects.catalogue import get_object
from fast.models.records import GraspSetup, GraspSimulation, Placement, Theta
from fast.models.simulation.body.assembly import ElasticBody, Material
from fast.models.simulation.body.elasticity import REFERENCE_MODULUS_MPA
from fast.models.simulation.contact.law import ContactLaw, Obstacle
from fast.models.simulation.contact.self_contact import SelfContact
from fast.models.simulation.finger import FingerStep
from fast.models.simulation.grasp import INWARD, simulate_grasp
from fast.models.simulation.mesh.build import build_mesh, extrude
from fast.models.simulation.mesh.cavities import cavity_faces
from fast.models.simulation.mesh.section import planar_mesh
from fast.models.simulation.mesh.solid import ElementBlock, SolidMesh
from fast.models.simulation.model import to_object_frame
from fast.models.simulation.solver import stepping
from fast.models.simulation.solver.stepping import Path, Step, StepLimits, Stepper
from fast.models.simulation.version import MeshSettings, SimulatorVersion
from tests.models.simulation.dead_load import DeadLoad, find_equilibrium
from tests.models.simulation.verification.bricks import brick, face_load
from tests.models.simulation.verification.energy import elastic_energy
from tests.models.simulation.verification.rig import SPEED_MM_PER_S, Rig, set_up

HOURGLASS, CUBE = 28, 30
FOLDING = numbered_design(11)  # one steep rib
MATERIAL = Material(REFERENCE_MODULUS_MPA, Theta().poisson_ratio)
LAW = ContactLaw()
# Half the open gap; travel to the object; travel to the end, 7 mm after ribs and walls meet.
START_MM, FREE_MM, CLOSED_MM = 35.0, 14.0, 46.0
LENGTH_MM, WIDTH_MM, THICK_MM = 6.0, 4.0, 2.0


@dataclass(frozen=True)
class Plates:
    """Two plates, the upper one on the lower one; `lower` and `upper` are masks (n) of their nodes."""

    mesh: SolidMesh
    inside: SelfContact
    lower: np.ndarray

    @property
    def upper(self) -> np.ndarray:
        """The nodes of the upper plate."""
        return ~self.lower


def plate(n: int, bottom_mm: float, contact_mm: float) -> SolidMesh:
    """A plate of n elements from this height on, with the contact faces at that height; clamped at z = 0."""
    return brick(
        "C3D20R",
        (np.linspace(0.0, LENGTH_MM, n + 1), np.array([0.0, WIDTH_MM]), bottom_mm + np.array([0.0, THICK_MM])),
        base=lambda points: points[:, 2] == 0.0,
        contact=lambda points: points[:, 2] == contact_mm,
    )


def two_plates() -> Plates:
    """Plates of three and four elements along x: their nodes do not meet. The load is on the upper one's top."""
    lower, upper, top = plate(3, 0.0, THICK_MM), plate(4, THICK_MM, THICK_MM), plate(4, THICK_MM, 2.0 * THICK_MM)
    shift = np.int32(len(lower.nodes))
    elements = np.vstack([lower.blocks[0].connectivity, upper.blocks[0].connectivity + shift])
    mesh = SolidMesh(
        nodes=np.vstack([lower.nodes, upper.nodes]),
        blocks=(ElementBlock("C3D20R", elements),),
        base_nodes=lower.base_nodes,
        symmetry_nodes=np.zeros(0, dtype=np.int32),
        contact_faces=top.contact_faces + shift,
    )
    faces = np.vstack([lower.contact_faces, upper.contact_faces + shift])
    inside = SelfContact(faces, np.zeros(len(faces), dtype=int), mesh.nodes, LAW)
    return Plates(mesh, inside, np.arange(len(mesh.nodes)) < shift)


class PressedPlates(DeadLoad):
    """Plates under nodal forces; springs of 0.01 N/mm keep the nodes from sliding along x and y."""

    springs = np.array([0.01, 0.01, 0.0])

    def __init__(self, plates: Plates, load: np.ndarray) -> None:
        body = ElasticBody(plates.mesh, plates.mesh.nodes, MATERIAL)
        pairs = plates.inside.pairs_near(plates.mesh.nodes)
        body = body.coupled(plates.inside.nodes_of(pairs))
        super().__init__(body, plates.mesh.nodes, load)
        self.inside = plates.inside.coupled(pairs, body)

    def started(self, lift_mm: np.ndarray) -> np.ndarray:
        """Rows of the nodes lifted by so much (n) each."""
        u = self.unknowns()
        u[self._rows, 2] += lift_mm[self._free]
        return u

    def residual(self, u: np.ndarray) -> np.ndarray | None:
        """See `DeadLoad`."""
        rows, contact = super().residual(u), np.zeros_like(self._x)
        if rows is None:
            return None
        self.inside.add_force(self.positions(u), contact)
        rows[self._rows] += contact[self._free] - self.springs * (u[self._rows] - self._x[self._free])
        return rows

    def tangent(self, u: np.ndarray, blocks: np.ndarray) -> bool:
        """See `DeadLoad`."""
        is_valid = super().tangent(u, blocks)
        self.inside.add_tangent(self.positions(u), blocks)
        blocks[self.pattern.indptr[:-1]] += np.diag(self.springs)
        return is_valid


def test_pressed_plates_carry_the_load_at_the_depth_of_the_law() -> None:
    """A uniform pressure p sinks the plates in by d with p = kn (d - d0/2), wherever the elements end."""
    plates, pressure = two_plates(), 0.2
    load = face_load(plates.mesh, np.array([0.0, 0.0, -pressure]))
    problem = PressedPlates(plates, load)
    u = problem.started(np.where(plates.upper, -0.05, 0.0))
    assert find_equilibrium(problem, u, tolerance_n=1e-8) < 20
    contact = np.zeros_like(load)
    problem.inside.add_force(problem.positions(u), contact)
    total = pressure * LENGTH_MM * WIDTH_MM
    assert contact[plates.upper, 2].sum() == pytest.approx(total, rel=1e-4)
    assert contact[plates.lower, 2].sum() == pytest.approx(-total, rel=1e-4)
    assert np.abs(contact[:, 1]).max() == 0.0
    depth = pressure / LAW.normal_n_per_mm3 + LAW.smoothing_mm / 2.0
    assert problem.inside.depth_mm(problem.positions(u)) == pytest.approx(depth, rel=0.1)


def slot(*, symmetric: bool = True) -> SolidMesh:
    """A block with a slot, 14 mm by 4 mm in the section; floor and roof are at z = 4 and 8 mm."""
    profile = Polygon([(0, 0), (20, 0), (20, 12), (0, 12)], holes=[[(3, 4), (3, 8), (17, 8), (17, 4)]])
    levels = np.array([0.0, 5.0]) if symmetric else np.array([-5.0, 0.0, 5.0])
    return extrude(planar_mesh(profile, 2.0), levels, symmetric=symmetric)


def sagged(mesh: SolidMesh, sag_mm: float, slide_mm: float = 0.0) -> np.ndarray:
    """Nodes (n, 3) of the slot with its roof bent down in the middle by so much, and that then moved along x."""
    x, z = mesh.nodes[:, 0], mesh.nodes[:, 2]
    above = (z >= 8.0) & (x > 3.0) & (x < 17.0)
    shape = np.sin(np.pi * (x[above] - 3.0) / 14.0) ** 2
    nodes = mesh.nodes.copy()
    nodes[above, 2] -= sag_mm * shape
    nodes[above, 0] += slide_mm * shape
    return nodes


def test_roof_is_in_the_floor_once_it_sags_by_more_than_the_slot() -> None:
    mesh = slot()
    faces, row = cavity_faces(mesh)
    assert np.ptp(mesh.nodes[faces][..., [0, 2]].reshape(-1, 2), axis=0) == pytest.approx([14.0, 4.0])
    assert set(row) == {0}
    inside = SelfContact(faces, row, mesh.nodes, LAW)
    assert inside.depth_mm(sagged(mesh, 3.95)) == 0.0
    assert inside.depth_mm(sagged(mesh, 4.3)) == pytest.approx(
        0.25, abs=0.02
    )  # in the middle of a segment, not in its end


def test_forces_balance_and_give_back_their_work_when_faces_slide() -> None:
    """The sum and the moment of all forces vanish, and so does the work around a closed path with 2 mm of sliding."""
    mesh = slot()
    inside = SelfContact(*cavity_faces(mesh), mesh.nodes, LAW)

    def force(x: np.ndarray) -> np.ndarray:
        result = np.zeros_like(x)
        inside.add_force(x, result)
        return result

    x = sagged(mesh, 4.2, 1.0)
    assert np.abs(force(x)).max() > 0.1
    assert force(x).sum(axis=0) == pytest.approx(np.zeros(3), abs=1e-12)
    assert np.cross(x, force(x)).sum(axis=0)[1] == pytest.approx(0.0, abs=1e-9)
    corners = [(3.9, 0.0), (4.2, 0.0), (4.2, 2.0), (3.9, 2.0)]
    works = []
    for start, end in zip(corners, corners[1:], strict=False):
        path = [sagged(mesh, *np.add(start, t * np.subtract(end, start))) for t in np.linspace(0.0, 1.0, 201)]
        forces = [force(x) for x in path]
        legs = zip(path, path[1:], forces, forces[1:], strict=False)
        works.append(sum(float(np.vdot(f + g, b - a)) / 2 for a, b, f, g in legs))
    assert works[0] < -0.05
    assert sum(works) == pytest.approx(0.0, abs=0.02 * abs(works[0]))


def test_forces_are_mirror_images_in_a_finger_of_full_width() -> None:
    mesh = slot(symmetric=False)
    inside = SelfContact(*cavity_faces(mesh), mesh.nodes, LAW)
    force = np.zeros_like(mesh.nodes)
    inside.add_force(sagged(mesh, 4.1), force)
    flipped = mesh.nodes * np.array([1.0, -1.0, 1.0])
    mirror = [int(np.argmin(np.linalg.norm(flipped - node, axis=1))) for node in mesh.nodes]
    assert np.abs(force).max() > 0.01
    assert force == pytest.approx(force[mirror], abs=1e-12)


def test_printed_fingers_touch_nowhere_whatever_the_angle() -> None:
    """Not even in the sharp corners of steep ribs. Every printed cavity is found, layer by layer."""
    for unit in random_unit(12, np.random.default_rng(3)):
        design = from_unit(unit[None])[0].model_copy(update={"rib_angle_deg": 40.0 if unit[8] > 0.5 else -40.0})
        mesh = build_mesh(design, MeshSettings())
        faces, row = cavity_faces(mesh)
        profile = planar_profile(design, MeshSettings().fillet_mm, 1)
        feet = shapely.get_num_geometries(shapely.intersection(profile, LineString([(-1.0, 3.0), (99.0, 3.0)])))
        assert (
            row.max() + 1 == len(profile.interiors) + feet - 1
        )  # cavities that are open towards the base are no holes
        assert SelfContact(faces, row, mesh.nodes, LAW).depth_mm(mesh.nodes) == 0.0


@dataclass(frozen=True)
class Fold:
    """A finger without friction that is driven on past the middle of the gripper, all its steps in half a finger."""

    rig: Rig
    mesh: SolidMesh
    stepper: Stepper
    steps: list[Step]

    @property
    def depth_mm(self) -> np.ndarray:
        """How deep ribs and walls are in each other after every step (n)."""
        return np.array([self.rig.finger.rib_depth_mm(step.state) for step in self.steps])

    @property
    def force_n(self) -> np.ndarray:
        """Force (n, 3) of the clamp after every step."""
        return np.array([step.clamp_n for step in self.steps])

    def back(self) -> "Fold":
        """The way back, by steps of 0.5 mm."""
        end = self.steps[-1].state
        end.v[:] = 0.0
        path = Path(end.base, -INWARD, CLOSED_MM - FREE_MM, SPEED_MM_PER_S, lambda _: 0.5)
        return Fold(self.rig, self.mesh, self.stepper, list(self.stepper.walk(end, path)))

    def elastic_mj(self) -> float:
        """Elastic energy after the last step."""
        return elastic_energy(self.mesh, self.rig.nodes, self.steps[-1].state.x, MATERIAL)


def fold(step_mm: float) -> Fold:
    """Close the finger on an hourglass by 7 mm more than its ribs and walls need to meet."""
    mesh = build_mesh(FOLDING, MeshSettings())
    nodes = to_object_frame(mesh.nodes, FOLDING.height_mm, GraspSetup().tip_below_mm)
    obstacle = Obstacle.of(get_object(HOURGLASS), Placement(), is_mirrored=False)
    rig = set_up(mesh, nodes, MATERIAL, obstacle, friction=0.0)
    start = rig.finger.undeformed((FREE_MM - START_MM) * INWARD, np.zeros(3))
    stepper = Stepper(rig.finger, rig.newton, StepLimits(), lambda _: rig.coefficients())
    path = Path(start.base, INWARD, CLOSED_MM - FREE_MM, SPEED_MM_PER_S, lambda _: step_mm)
    return Fold(rig, mesh, stepper, list(stepper.walk(start, path)))


@pytest.fixture(scope="module")
def folded() -> Fold:
    return fold(1.0)


@pytest.fixture(scope="module")
def finely_folded() -> Fold:
    return fold(0.5)


def test_walls_of_a_folded_finger_meet_and_stay_apart(folded: Fold, monkeypatch: pytest.MonkeyPatch) -> None:
    depth = folded.depth_mm
    assert (depth > 0.0).sum() >= 2
    assert depth.max() < 0.1
    monkeypatch.setattr(FingerStep, "must_couple_ribs", lambda self, state: False)
    unguarded = fold(1.0)
    touching = depth > 0.0
    before = int(np.flatnonzero(touching)[0])
    assert unguarded.depth_mm.max() > 0.3
    assert unguarded.force_n[:before].tobytes() == folded.force_n[:before].tobytes()
    assert abs(folded.force_n[-1, 0]) > 1.02 * abs(unguarded.force_n[-1, 0])


def test_folded_finger_repeats_to_the_bit_and_converges_with_the_step(folded: Fold, finely_folded: Fold) -> None:
    assert fold(1.0).force_n.tobytes() == folded.force_n.tobytes()
    assert finely_folded.force_n[-1] == pytest.approx(folded.force_n[-1], rel=0.02, abs=0.02)


def test_folding_and_back_gives_the_work_back(finely_folded: Fold) -> None:
    """What is left is what time steps take out and never add; the finger is as printed again."""
    forth = finely_folded
    assert forth.elastic_mj() > 20.0
    back = forth.back()
    assert back.elastic_mj() < 0.02 * forth.elastic_mj()
    work, returned = work_mj(forth), work_mj(back)
    assert -returned <= work
    assert -returned == pytest.approx(work, rel=0.05)


def work_mj(fold: Fold) -> float:
    """Work of the clamp over consecutive steps, by the trapezoidal rule."""
    pairs = zip(fold.steps, fold.steps[1:], strict=False)
    return sum(float((a.clamp_n + b.clamp_n) @ (b.state.base - a.state.base)) / 2 for a, b in pairs)


def test_walls_that_sink_in_too_far_are_a_failure_with_a_reason(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stepping, "MAX_RIB_DEPTH_MM", 1e-4)
    with pytest.raises(SimulationFailed, match="No equilibrium") as failure:
        fold(1.0)
    assert failure.value.reason == "deep_penetration"


def grasp(closed_gap_mm: float) -> GraspSimulation:
    """A short grasp of a cube by a finger of one rib."""
    setup = GraspSetup(closed_gap_mm=closed_gap_mm, max_lift_mm=3.0)
    return simulate_grasp(numbered_design(1), get_object(CUBE), SimulatorVersion(), setup)


def test_a_grasp_without_touching_ribs_is_the_same_to_the_bit(monkeypatch: pytest.MonkeyPatch) -> None:
    guarded = grasp(GraspSetup().closed_gap_mm)
    monkeypatch.setattr(FingerStep, "must_couple_ribs", lambda self, state: False)
    unguarded = grasp(GraspSetup().closed_gap_mm)
    assert not guarded.ribs_touch
    assert guarded.trace.force_n.tobytes() == unguarded.trace.force_n.tobytes()
    assert guarded.n_newton == unguarded.n_newton


def test_a_grasp_says_that_its_ribs_touch() -> None:
    assert grasp(-20.0).ribs_touch
