"""A grasp walked in given steps, each solved nearly to rounding: the discrete force as a function of its inputs."""

import numpy as np

from fast.models.simulation.contact.law import Obstacle
from fast.models.simulation.finger import FingerStep
from fast.models.simulation.inputs import GraspInputs
from fast.models.simulation.mesh.build import build_moved_mesh, printed_profile
from fast.models.simulation.placement import needs_full_width
from fast.models.simulation.problem import FingerProblem, find_numerics
from fast.models.simulation.solver.newton import NewtonSettings, NewtonSolver
from fast.models.simulation.solver.stepping import Step

EXACT = NewtonSettings(tolerance_n=1e-8, max_iterations=400)


def problem_of(inputs: GraspInputs, like: FingerProblem) -> FingerProblem:
    """The problem of a symmetric grasp, on the elements of another."""
    actual = inputs.with_effects()
    settings = inputs.version.mesh
    before = printed_profile(like.design, settings, like.effects)
    mesh = build_moved_mesh(like.mesh, before, inputs.design, settings, actual.effects)
    assert mesh is not None
    return FingerProblem(mesh, inputs.design, actual.theta, actual.setup, actual.effects, find_numerics(inputs.version))


def walk_frozen(
    inputs: GraspInputs, problem: FingerProblem, steps: list[Step], n_closing: int, further_mm: float = 0.0
) -> np.ndarray:
    """Clamp forces (s, 3) at the ends of the steps of a grasp with half a finger; its jaw closes a little further.

    `steps` are those of the production run, of which `n_closing` belong to the closing.
    """
    assert not needs_full_width(inputs.obj, inputs.placement)
    model = problem.model()
    finger: FingerStep = model.against(Obstacle.of(inputs.obj, inputs.placement, is_mirrored=False))
    state = finger.undeformed(steps[0].before.base, steps[0].before.v[0].copy())
    newton, forces = NewtonSolver(model.workspace, EXACT), []
    for number, step in enumerate(steps):
        if step.finger.ribs_touch:
            raise ValueError("a grasp whose ribs touch cannot be walked here")
        if number == n_closing:
            state.v[:] = 0.0
        shift = further_mm * np.array([-1.0, 0.0, 0.0]) if number >= n_closing - 1 else np.zeros(3)
        u = finger.begin(state, step.state.base + shift, step.dt_s, problem.friction(state))
        assert newton.solve(finger, u) == "converged", number
        state, clamp_n = finger.finish(state, u, step.state.base + shift, step.dt_s)
        forces.append(clamp_n)
    return np.array(forces)
