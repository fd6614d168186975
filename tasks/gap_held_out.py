"""Held-out grasps as the real simulator predicts them, with what was named and without: not by any emulator.

What an effect needs of finite elements is simulated. What depends on the single grasp (repeat, clock) or acts on a
finished trace is no other simulation: its change, as the bank predicts it for each grasp, is added.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from lake.store import Lake
from models.gap.problem import GapProblem
from models.records import SimulatorVersion
from tasks.gap_bank import simulated_steps
from tasks.hypercube import SimulationPlan


def held_out(problem: GapProblem) -> GapProblem:
    """The problem with its held-out grasps alone."""
    rows, grasps = np.flatnonzero(problem.is_held_out & np.isfinite(problem.grasps.steps_n).all(axis=1)), problem.grasps
    kept = replace(
        grasps,
        tool=grasps.tool[rows],
        obj=grasps.obj[rows],
        contexts=tuple(grasps.contexts[row] for row in rows),
        steps_n=grasps.steps_n[rows],
        grasp_ids=tuple(grasps.grasp_ids[row] for row in rows),
    )
    return replace(problem, grasps=kept)


def solid_version(problem: GapProblem, version: SimulatorVersion) -> SimulatorVersion:
    """The version with those effects alone that have simulations of their own."""
    solid = tuple(value for value in version.effects if value.effect in problem.bank.fields)
    return version.model_copy(update={"effects": solid})


def held_out_plans(problem: GapProblem, versions: Sequence[SimulatorVersion]) -> tuple[SimulationPlan, ...]:
    """Simulations of the held-out cells by versions: held-out tools on all objects, the others on held-out objects."""
    grasps = problem.grasps
    solid = list(dict.fromkeys(solid_version(problem, version) for version in versions))
    cells = {(int(tool), int(obj)) for tool, obj in zip(grasps.tool, grasps.obj, strict=True)}
    plans = []
    for is_new in (True, False):
        tools = [tool for tool in range(len(grasps.tools)) if bool(problem.held_out_tools[tool]) == is_new]
        objects = sorted({obj for tool, obj in cells if tool in tools and (is_new or problem.held_out_objects[obj])})
        designs = list(dict.fromkeys(grasps.designs[tool] for tool in tools))
        points = tuple((design, version) for version in solid for design in designs)
        if points and objects:
            plans.append(SimulationPlan(points, tuple(grasps.objects[obj] for obj in objects), grasps.setup))
    return tuple(plans)


def held_out_steps(lake: Lake, problem: GapProblem, version: SimulatorVersion) -> np.ndarray:
    """Step means of the grasps of a held-out problem as the version predicts them, n x 120; NaN where it failed."""
    from models.gap.predict import Predictor

    grasps, solid = problem.grasps, solid_version(problem, version)
    steps_n = simulated_steps(lake, [solid], grasps.designs, grasps.objects, grasps.setup)[:, :, 0]
    simulated = steps_n[grasps.tool, grasps.obj]
    if solid == version:
        return np.asarray(simulated)
    predictor = Predictor.of(problem)
    theta = np.array([version.theta.young_modulus_mpa, version.theta.friction, version.theta.poisson_ratio])
    change_n = predictor.steps(theta, version.effects) - predictor.steps(theta, solid.effects)
    return np.asarray(simulated + change_n)
