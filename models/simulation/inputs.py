"""All that decides a simulated grasp but numerics, and what its effects make of it."""

from collections.abc import Sequence
from dataclasses import dataclass

from fast.models.objects.rigid import RigidObject
from fast.models.records import Design, GraspContext, GraspSetup, Placement, Theta
from fast.models.simulation.effects.base import Effect
from fast.models.simulation.effects.catalogue import build_effects
from fast.models.simulation.version import SimulatorVersion


@dataclass(frozen=True)
class GraspInputs:
    """What a grasp is simulated of. `context` is what came before it; `effects` take the place of the version's."""

    design: Design
    obj: RigidObject
    version: SimulatorVersion
    setup: GraspSetup
    placement: Placement = Placement()
    context: GraspContext = GraspContext()
    effects: Sequence[Effect] | None = None

    def with_effects(self) -> "ActualInputs":
        """Return what the effects make of them."""
        known = build_effects(self.version.effects) if self.effects is None else self.effects
        active = tuple(effect.in_grasp(self.design, self.setup, self.context) for effect in known)
        theta, setup, obj = self.version.theta, self.setup, self.obj
        for effect in active:
            theta = effect.modify_theta(theta, self.design)
            setup = effect.modify_setup(setup, self.design)
            obj = effect.modify_object(obj)
        return ActualInputs(active, theta, setup, obj)


@dataclass(frozen=True)
class ActualInputs:
    """The effects as they act in this grasp, and theta, setup and object as they make them."""

    effects: tuple[Effect, ...]
    theta: Theta
    setup: GraspSetup
    obj: RigidObject
