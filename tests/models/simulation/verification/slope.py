"""A block under gravity on a rigid slope, with the solver's own contact, friction and time step.

Coulomb: it rests while tan(angle) <= mu, else it slides with the acceleration g (sin(angle) - mu cos(angle)).
"""

from dataclasses import dataclass

import numpy as np

from fast.models.simulation.body.assembly import Material
from fast.models.simulation.contact.law import PointSpacing
from fast.models.simulation.finger import FingerState
from fast.models.simulation.solver.newton import NewtonSettings
from tests.models.simulation.obstacles import make_half_space
from tests.models.simulation.verification.bricks import brick
from tests.models.simulation.verification.rig import Rig, set_up

GRAVITY_MM_PER_S2 = 9810.0
STEP_S, N_STEPS = 5e-3, 40
SIDE_MM, HEIGHT_MM = 10.0, 4.0
MODULUS_MPA, POISSON = 11.5, 0.45


@dataclass(frozen=True)
class Slide:
    """Motion of the block down the slope: time (n) s, travel (n) mm, speed (n) mm/s, friction over normal force (n)."""

    time_s: np.ndarray
    travel_mm: np.ndarray
    speed_mm_per_s: np.ndarray
    force_ratio: np.ndarray


def slide(angle: float, friction: float) -> Slide:
    """Set a soft block on the slope without impact and follow it."""
    down, up = np.array([np.cos(angle), 0.0, -np.sin(angle)]), np.array([np.sin(angle), 0.0, np.cos(angle)])
    slope = make_half_space(np.zeros(3), up)
    grid = (np.linspace(0, SIDE_MM, 3), np.linspace(0, SIDE_MM, 3), np.linspace(0, HEIGHT_MM, 2))
    mesh = brick("C3D20R", grid, contact=lambda p: p[:, 2] == 0.0)
    turned = mesh.nodes @ np.array([down, [0.0, 1.0, 0.0], up])
    newton = NewtonSettings(tolerance_n=1e-10)
    material = Material(MODULUS_MPA, POISSON)
    rig = set_up(mesh, turned, material, slope, friction=friction, spacing=PointSpacing(1.0, 1.0), newton=newton)
    volume = rig.body.lumped_volume()[:, None] / SIDE_MM**2 / HEIGHT_MM
    samples, state = [(0.0, 0.0, 0.0, 0.0)], rig.finger.undeformed(np.zeros(3), np.zeros(3))
    for step in range(1, N_STEPS + 1):
        state = _fall(rig, state)
        travel = (volume * (state.x - turned)).sum(axis=0) @ down
        areas_mm2 = rig.surface.areas[state.contact.points]
        force = areas_mm2 @ state.contact.traction
        ratio = -(force @ down) / (areas_mm2 @ state.contact.pressure)
        samples.append((step * STEP_S, travel, (volume * state.v).sum(axis=0) @ down, ratio))
    return Slide(*np.array(samples).T)


def _fall(rig: Rig, state: FingerState) -> FingerState:
    """One step under gravity, which enters as the speed it adds within the step."""
    gravity = np.array([0.0, 0.0, -GRAVITY_MM_PER_S2])
    pulled = FingerState(state.x, state.v + STEP_S * gravity, state.contact, state.base)
    rig.finger.begin(pulled, state.base, STEP_S, rig.coefficients())
    u = rig.finger.start_from(state)  # nearer than the free fall that `begin` proposes
    outcome = rig.newton.solve(rig.finger, u)
    assert outcome == "converged"
    return rig.finger.finish(state, u, state.base, STEP_S)[0]
