"""One body against one rigid obstacle, driven by its base: the solver's own contact, Newton and stepping."""

from dataclasses import dataclass

import numpy as np

from fast.models.simulation.body.assembly import ElasticBody, Material
from fast.models.simulation.contact.law import NO_STOP, ContactLaw, ContactSurface, Obstacle, PointSpacing
from fast.models.simulation.contact.self_contact import SelfContact
from fast.models.simulation.finger import FingerState, FingerStep
from fast.models.simulation.mesh.cavities import cavity_faces
from fast.models.simulation.mesh.solid import SolidMesh
from fast.models.simulation.solver.newton import NewtonSettings, NewtonSolver, make_workspace
from fast.models.simulation.solver.stepping import Path, Step, StepLimits, Stepper

SPEED_MM_PER_S = 10.0


@dataclass(frozen=True)
class Rig:
    """Everything that moves one body: `nodes` (n, 3) undeformed; `friction` of every contact point."""

    nodes: np.ndarray
    body: ElasticBody
    surface: ContactSurface
    finger: FingerStep
    newton: NewtonSolver
    friction: float

    def coefficients(self) -> np.ndarray:
        """Friction coefficient of every contact point (n)."""
        return np.full(len(self.surface.areas), self.friction)

    def walk(
        self,
        state: FingerState,
        direction: np.ndarray,
        length_mm: float,
        step_mm: float,
        speed_mm_per_s: float = SPEED_MM_PER_S,
    ) -> list[Step]:
        """All converged steps of a straight motion of the base from `state`."""
        stepper = Stepper(self.finger, self.newton, StepLimits(), lambda _: self.coefficients())
        path = Path(state.base, direction, length_mm, speed_mm_per_s, lambda _: step_mm)
        return list(stepper.walk(state, path))


def set_up(
    mesh: SolidMesh,
    nodes: np.ndarray,
    material: Material,
    obstacle: Obstacle,
    *,
    friction: float,
    law: ContactLaw = ContactLaw(),  # noqa: B008 - frozen record
    spacing: PointSpacing = PointSpacing(),  # noqa: B008 - frozen record
    newton: NewtonSettings = NewtonSettings(),  # noqa: B008 - frozen record
) -> Rig:
    """Put a body, in the frame of the obstacle at `nodes` (n, 3), before an obstacle."""
    body = ElasticBody(mesh, nodes, material)
    surface = ContactSurface(body, nodes, law, spacing)
    finger = FingerStep(
        body, surface, nodes, obstacle, stop_mm=NO_STOP, inside=SelfContact(*cavity_faces(mesh), nodes, law)
    )
    return Rig(nodes, body, surface, finger, NewtonSolver(make_workspace(body.pattern), newton), friction)
