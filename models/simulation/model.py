"""What all grasps of one finger share: its mechanics before any object, built once and kept."""

import threading
from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fast.models.objects.primitives import turn_about_z
from fast.models.simulation.body.assembly import ElasticBody, Material
from fast.models.simulation.contact.law import ContactLaw, ContactSurface, Obstacle, PointSpacing
from fast.models.simulation.contact.self_contact import SelfContact
from fast.models.simulation.finger import FingerStep
from fast.models.simulation.mesh.cavities import cavity_faces
from fast.models.simulation.mesh.solid import SolidMesh
from fast.models.simulation.solver.newton import Workspace, make_workspace

# Half and full width of one design: a design's objects come one after the other.
MAX_KEPT = 2


@dataclass(frozen=True)
class Stance:
    """How a finger stands before its object."""

    height_mm: float
    """Of the finger."""
    tip_below_mm: float
    """Of its tip below the object's bottom."""
    roll_deg: float = 0.0
    """Turn about the vertical, see `roll`."""


@dataclass(frozen=True)
class FingerModel:
    """A finger ready to be grasped with: nodes (n, 3) in the object frame at rest, and what was derived from them.

    `workspace` is storage: a grasp overwrites it and assumes nothing about it.
    """

    nodes: np.ndarray
    body: ElasticBody
    surface: ContactSurface
    inside: SelfContact
    workspace: Workspace

    def against(self, obstacle: Obstacle, stop_mm: float = 0.0) -> FingerStep:
        """Put the finger before an obstacle; the plane x = `stop_mm` stands for the other finger."""
        return FingerStep(self.body, self.surface, self.nodes, obstacle, stop_mm=stop_mm, inside=self.inside)


class _Kept(threading.local):
    """Models of this thread; a model is working storage, so threads must not share one."""

    def __init__(self) -> None:
        self.models: OrderedDict[tuple[object, ...], FingerModel] = OrderedDict()


_KEPT = _Kept()


def finger_model(
    mesh: SolidMesh,
    stance: Stance,
    *,
    material: Material,
    law: ContactLaw,
    spacing: PointSpacing,
    factors: Sequence[np.ndarray] | None = None,
) -> FingerModel:
    """Return a finger's model, from the last few built in this thread or new; forgets every grasp made with it.

    `factors`: see `ElasticBody`.
    """
    factor_bytes = None if factors is None else tuple(values.tobytes() for values in factors)
    key = mesh.mesh_id, stance, material, law, spacing, factor_bytes
    model = _KEPT.models.pop(key, None)
    if model is None:
        nodes = place_nodes(mesh, stance)
        body = ElasticBody(mesh, nodes, material, factors=factors)
        surface = ContactSurface(body, nodes, law, spacing)
        inside = SelfContact(*cavity_faces(mesh), nodes, law)
        model = FingerModel(nodes, body, surface, inside, make_workspace(body.pattern))
    _KEPT.models[key] = model
    while len(_KEPT.models) > MAX_KEPT:
        _KEPT.models.popitem(last=False)
    model.surface.forget()
    return model


def place_nodes(mesh: SolidMesh, stance: Stance) -> np.ndarray:
    """Place nodes (n, 3) of a mesh as the finger stands before its object, undeformed, with its front wall at x = 0."""
    nodes = to_object_frame(mesh.nodes, stance.height_mm, stance.tip_below_mm)
    return roll(nodes, mesh.base_nodes, stance.roll_deg)


def to_object_frame(nodes: np.ndarray, height_mm: float, tip_below_mm: float) -> np.ndarray:
    """Turn finger frame to object frame: by 180 deg about x, tip plane at z = -tip_below, front wall at x = 0."""
    x, y, z = nodes.T
    return np.ascontiguousarray(np.column_stack([x, -y, height_mm - tip_below_mm - z]))


def roll(nodes: np.ndarray, base_nodes: np.ndarray, roll_deg: float) -> np.ndarray:
    """Turn nodes (n, 3) in the object frame about the vertical line through the middle of the finger's base.

    Counter-clockwise seen from above. The jaw holds the base, so its middle stays where it is; the finger still closes
    along x.
    """
    if roll_deg == 0.0:
        return nodes
    base = nodes[base_nodes, :2]
    axis = np.array([*(0.5 * (base.min(axis=0) + base.max(axis=0))), 0.0])
    return np.ascontiguousarray((nodes - axis) @ turn_about_z(roll_deg).T + axis)
