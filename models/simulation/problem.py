"""Everything about one finger in one grasp but the object: numerics, mesh, theta, setup and effects."""

from dataclasses import dataclass, replace

import numpy as np

from fast.models.records import Design, GraspSetup, Theta
from fast.models.simulation.actuation import Jaw
from fast.models.simulation.body.assembly import Material
from fast.models.simulation.body.elasticity import REFERENCE_MODULUS_MPA, MaterialLaw
from fast.models.simulation.contact.law import ContactLaw, PointSpacing
from fast.models.simulation.effects.base import Effect
from fast.models.simulation.finger import FingerState
from fast.models.simulation.mesh.build import IN_SECTION
from fast.models.simulation.mesh.solid import SolidMesh
from fast.models.simulation.model import FingerModel, Stance, finger_model, place_nodes
from fast.models.simulation.solver.newton import NewtonSettings
from fast.models.simulation.solver.stepping import FINEST_LIMITS, StepLimits
from fast.models.simulation.version import IN_ROWS, SimulatorVersion


@dataclass(frozen=True)
class Numerics:
    """Everything numerical but the mesh: contact regularisation, contact points, step sizes, Newton's limits.

    `material_law` is here because the laws agree at small strains and differ little in a grasp.
    """

    contact: ContactLaw = ContactLaw()
    spacing: PointSpacing = PointSpacing()
    limits: StepLimits = StepLimits()
    newton: NewtonSettings = NewtonSettings()
    material_law: MaterialLaw = "neo_hookean"


# Production takes steps that a campaign can afford; the reference locates events more finely and never takes long ones.
TIER_NUMERICS = {"production": Numerics(), "reference": Numerics(limits=FINEST_LIMITS)}


def find_numerics(version: SimulatorVersion) -> Numerics:
    """Find the numerics of a simulator version: those of its tier, with its stiffness and its points of contact."""
    usual, contact = TIER_NUMERICS[version.tier], version.contact
    law = replace(
        usual.contact,
        normal_n_per_mm3=contact.normal_n_per_mm3,
        tangential_n_per_mm3=contact.tangential_n_per_mm3,
    )
    return replace(usual, contact=law, spacing=PointSpacing(is_staggered=version.fem_version != IN_ROWS))


@dataclass(frozen=True)
class FingerProblem:
    """Everything about one finger in one grasp. `mesh` is in the finger frame; forces at the reference modulus.

    `roll_deg` turns the finger about its own long axis, counter-clockwise seen from above, as it stands on the +x side.
    """

    mesh: SolidMesh
    design: Design
    theta: Theta
    setup: GraspSetup
    effects: tuple[Effect, ...] = ()
    numerics: Numerics = Numerics()
    roll_deg: float = 0.0

    @property
    def force_scale(self) -> float:
        """Real forces over those at the reference modulus."""
        return self.theta.young_modulus_mpa / REFERENCE_MODULUS_MPA

    @property
    def stroke_mm(self) -> float:
        """Way of one jaw while it closes."""
        return 0.5 * (self.setup.open_gap_mm - self.setup.closed_gap_mm)

    @property
    def jaw(self) -> Jaw:
        """What holds the modelled part of the finger, at the reference modulus."""
        # Of the real closing force of one jaw, what the model's force is multiplied with to become it.
        scale = (2.0 if self.mesh.is_half else 1.0) * self.force_scale
        limit_n = min((effect.closing_force_limit_n() for effect in self.effects), default=np.inf)
        compliance = sum(effect.base_compliance_mm_per_n() for effect in self.effects)
        return Jaw(limit_n / scale, compliance * scale)

    @property
    def law(self) -> ContactLaw:
        """The contact law with the adhesion of the effects, at the reference modulus."""
        law = self.numerics.contact
        adhesion_mpa = sum(effect.adhesion_mpa() for effect in self.effects)
        scaled_mpa = adhesion_mpa * REFERENCE_MODULUS_MPA / self.theta.young_modulus_mpa
        return replace(law, adhesion_mpa=law.adhesion_mpa + scaled_mpa)

    @property
    def stance(self) -> Stance:
        """How the finger stands before its object."""
        return Stance(self.design.height_mm, self.setup.tip_below_mm, self.roll_deg)

    @property
    def finger_stop_mm(self) -> float:
        """Where the plane that stands for the other finger is."""
        return sum(effect.finger_stop_mm() for effect in self.effects)

    @property
    def material(self) -> Material:
        """The elastic law with the effects, at the reference modulus."""
        stiffening = sum(effect.strain_stiffening() for effect in self.effects)
        return Material(REFERENCE_MODULUS_MPA, self.theta.poisson_ratio, self.numerics.material_law, stiffening)

    def factors(self) -> list[np.ndarray] | None:
        """Return factors (m) of design and effects on the modulus of every element, per kind; None if all are 1."""
        nodes = self.mesh.nodes[:, IN_SECTION]
        factors = []
        for elements in self.mesh.connectivities:
            middles, factor = nodes[elements].mean(axis=1), np.ones(len(elements))
            factor *= self.design.scale_modulus(middles)
            for effect in self.effects:
                factor *= effect.stiffness_factor(middles, self.design)
            factors.append(factor)
        return None if all((factor == 1.0).all() for factor in factors) else factors

    def nodes(self) -> np.ndarray:
        """Place nodes (n, 3) of the finger as it stands before its object, undeformed, its front wall at x = 0."""
        return place_nodes(self.mesh, self.stance)

    def friction(self, state: FingerState) -> np.ndarray:
        """Return the friction coefficient per contact point (n), frozen over the step from a state, by the effects."""
        values = np.full(len(state.contact.slip), self.theta.friction)
        if self.effects:
            pressure_mpa = self.force_scale * state.contact.spread_pressure()
            for effect in self.effects:
                values *= effect.friction_factor(state.contact.slip, pressure_mpa)
        return values

    def model(self) -> FingerModel:
        """Return the finger's mechanics, shared by the grasps of a design."""
        return finger_model(
            self.mesh,
            self.stance,
            material=self.material,
            law=self.law,
            spacing=self.numerics.spacing,
            factors=self.factors(),
        )
