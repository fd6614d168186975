"""Energy over a grasp: the work of the base against what is stored and what is lost.

Per finger and in mJ (N mm): work of the clamp = elastic energy + energy in the contact penalty and in the stuck
friction springs + friction loss + rest. The rest is what implicit Euler takes out (all of the energy set free in a
snap, and of first order in the step elsewhere), kinetic energy (below 1e-3 of the rest of the balance) and the
trapezoidal rule for the work.
"""

from dataclasses import dataclass

import numpy as np

from fast.models.design.space import BEST_PUBLISHED
from fast.models.objects.catalogue import get_object
from fast.models.records import GraspSetup, Placement, Theta
from fast.models.simulation.body.assembly import Material
from fast.models.simulation.body.elasticity import REFERENCE_MODULUS_MPA, lame_constants
from fast.models.simulation.body.shape_functions import quadrature_of, shape_of
from fast.models.simulation.contact.law import ContactLaw, ContactState, Obstacle
from fast.models.simulation.grasp import INWARD, UPWARD
from fast.models.simulation.mesh.build import build_mesh
from fast.models.simulation.mesh.solid import SolidMesh
from fast.models.simulation.model import roll, to_object_frame
from fast.models.simulation.placement import needs_full_width
from fast.models.simulation.solver.stepping import Step, travel_to_touch
from fast.models.simulation.version import MeshSettings
from tests.models.simulation.verification.rig import Rig, set_up


@dataclass(frozen=True)
class Balance:
    """Energies (n) in mJ after each step: supplied since the start, stored, and lost to friction since the start."""

    work: np.ndarray
    elastic: np.ndarray
    contact: np.ndarray
    friction: np.ndarray

    @property
    def rest(self) -> np.ndarray:
        """What the other terms leave open."""
        return self.work - self.elastic - self.contact - self.friction


def balance(rig: Rig, mesh: SolidMesh, material: Material, start: np.ndarray, steps: list[Step]) -> Balance:
    """Balance over consecutive steps from rest, undeformed and free of contact, with the base at `start` (3)."""
    law, areas = rig.surface.law, rig.surface.areas
    rows, work, friction = [], 0.0, 0.0
    last_force, last_base, last_slip = np.zeros(3), start, np.zeros(len(areas))
    for step in steps:
        state = step.state
        work += 0.5 * (last_force + step.clamp_n) @ (state.base - last_base)
        own = state.contact.points
        slip = (state.contact.slip - last_slip)[own]
        friction += float(areas[own] @ (np.linalg.norm(state.contact.traction, axis=1) * slip))
        elastic = elastic_energy(mesh, rig.nodes, state.x, material)
        rows.append((work, elastic, contact_energy(law, areas, state.contact), friction))
        last_force, last_base, last_slip = step.clamp_n, state.base, state.contact.slip
    return Balance(*np.array(rows).T)


def elastic_energy(mesh: SolidMesh, nodes: np.ndarray, x: np.ndarray, material: Material) -> float:
    """Neo-Hookean energy of a mesh in mJ: integral of mu/2 (tr F^T F - 3 - 2 l) + lam/2 l^2 with l = ln det F."""
    lam, mu = lame_constants(material.young_modulus_mpa, material.poisson_ratio)
    energy = 0.0
    for block in mesh.blocks:
        rule = quadrature_of(block.kind)
        _, gradients = shape_of(block.kind, rule.points)
        jacobian = np.einsum("mai,qaj->mqij", nodes[block.connectivity], gradients)
        F = np.einsum("mai,qaj->mqij", x[block.connectivity], gradients) @ np.linalg.inv(jacobian)
        log = np.log(np.linalg.det(F))
        density = 0.5 * mu * ((F**2).sum(axis=(2, 3)) - 3.0 - 2.0 * log) + 0.5 * lam * log**2
        energy += float((density * np.linalg.det(jacobian) * rule.weights).sum())
    return energy


def contact_energy(law: ContactLaw, areas: np.ndarray, state: ContactState) -> float:
    """Energy in mJ of the penalty, the integral of p(d), and of the friction springs, t^2 / (2 kt)."""
    kn, d0, p = law.normal_n_per_mm3, law.smoothing_mm, state.pressure
    depth = np.where(p < 0.5 * kn * d0, np.sqrt(2.0 * d0 * p / kn), p / kn + 0.5 * d0)
    shallow = kn * depth**3 / (6.0 * d0)
    deep = kn * (depth**2 / 2.0 - d0 * depth / 2.0 + d0**2 / 6.0)
    springs = (state.traction**2).sum(axis=1) / (2.0 * law.tangential_n_per_mm3)
    return float(areas[state.points] @ (np.where(depth < d0, shallow, deep) + springs))


def grasp(
    object_id: int,
    step_mm: float,
    placement: Placement = Placement(),  # noqa: B008 - frozen record
    lift_mm: float = 65.0,
) -> tuple[Balance, int]:
    """Balance of the right finger of the best published design over a grasp, and its number of closing steps."""
    obj = get_object(object_id)
    mesh = build_mesh(BEST_PUBLISHED, MeshSettings(), full_width=needs_full_width(obj, placement))
    setup, material = GraspSetup(), Material(REFERENCE_MODULUS_MPA, Theta().poisson_ratio)
    nodes = to_object_frame(mesh.nodes, BEST_PUBLISHED.height_mm, setup.tip_below_mm)
    nodes = roll(nodes, mesh.base_nodes, placement.roll_deg)
    obstacle = Obstacle.of(obj, placement, is_mirrored=False)
    rig = set_up(mesh, nodes, material, obstacle, friction=Theta().friction)
    open_mm, stroke_mm = 0.5 * setup.open_gap_mm, 0.5 * (setup.open_gap_mm - setup.closed_gap_mm)
    free_mm = travel_to_touch(rig.finger.distance_to_object, -open_mm * INWARD, INWARD, stroke_mm)
    start = rig.finger.undeformed((free_mm - open_mm) * INWARD, np.zeros(3))
    closing = rig.walk(start, INWARD, stroke_mm - free_mm, step_mm)
    held = closing[-1].state
    held.v[:] = 0.0
    lifting = rig.walk(held, UPWARD, lift_mm, step_mm)
    return balance(rig, mesh, material, start.base, closing + lifting), len(closing)
