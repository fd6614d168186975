"""Held-out grasps as the real simulator predicts them, with what was named and without: not by any emulator.

What an effect needs of finite elements is simulated. What depends on the single grasp (repeat, clock) or acts on a
finished trace is no other simulation: its change, as the bank predicts it for each grasp, is added.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from lake.store import Lake
from models.gap.bank.predict import Predictor
from models.gap.evaluation.held_out import HeldOut, Prediction, scattered
from models.gap.evaluation.show import AFTER, BEFORE, Shown, show
from models.gap.fit.fit import TOOL_SD
from models.gap.fit.whiten import PLACEMENT_SHARE, REPEAT_SD
from models.gap.problem import GapProblem
from models.gap.where.residuals import Residuals
from models.records import SimulatorVersion
from models.traces.step_features import N_STEPS
from tasks.gap.bank import simulated_steps
from tasks.gap.model import GapModel
from tasks.simulation.plan import SimulationPlan

_N_DRAWS = 40
_SCATTER = {"tool_sd": TOOL_SD, "cell_sd": PLACEMENT_SHARE, "repeat_sd": REPEAT_SD}


@dataclass(frozen=True, eq=False)
class Comparison:
    """What SHOW compared: before and after on held-out grasps, and where the gap was before."""

    shown: Shown
    residuals: Residuals


def show_plans(problem: GapProblem, versions: Sequence[SimulatorVersion]) -> tuple[SimulationPlan, ...]:
    """Simulations of the held-out cells by versions: held-out tools on all objects, the others on held-out objects."""
    grasps = problem.grasps
    solid = {found.version_id: found for found in (solid_version(problem, version) for version in versions)}.values()
    is_new, is_new_object = problem.held_out_tools, problem.held_out_objects
    plans = []
    for tools, objects in ((is_new, np.ones_like(is_new_object)), (~is_new, is_new_object)):
        designs = list(dict.fromkeys(grasps.designs[tool] for tool in np.flatnonzero(tools)))
        points = tuple((design, version) for version in solid for design in designs)
        ids = tuple(grasps.objects[obj] for obj in np.flatnonzero(objects))
        if points and ids:
            plans.append(SimulationPlan(points, ids, grasps.setup))
    return tuple(plans)


def solid_version(problem: GapProblem, version: SimulatorVersion) -> SimulatorVersion:
    """The version with those effects alone that have simulations of their own."""
    solid = tuple(value for value in version.effects if value.effect in problem.bank.fields)
    return version.model_copy(update={"effects": solid})


def compare(
    lake: Lake, problem: GapProblem, before: GapModel, after: GapModel, residuals: Residuals, seed: int
) -> Comparison:
    """Compare two calibrated simulators, and what any machine would have learnt, on the held-out grasps.

    Grasps that either simulator could not simulate are left out of it.

    Raises:
        UsageError: there is no held-out grasp that both simulated.
    """
    predictor = Predictor.of(problem)
    models = (before, after)
    steps_n = [_simulated(lake, problem, predictor, model.version) for model in models]
    is_usable = predictor.is_usable & np.isfinite(problem.grasps.steps_n).all(axis=1)
    is_usable &= np.isfinite(np.array(steps_n)).all(axis=(0, 2))
    held_out = HeldOut.of(problem, before.version.theta, is_usable)
    first, last = (
        _prediction(label, problem, held_out, model, rows_n, seed)
        for label, model, rows_n in zip((BEFORE, AFTER), models, steps_n, strict=True)
    )
    return Comparison(show(held_out, first, last, residuals, seed), residuals)


def _simulated(lake: Lake, problem: GapProblem, predictor: Predictor, version: SimulatorVersion) -> np.ndarray:
    """Step means of all grasps as a version predicts them, n x 120; NaN where it was not simulated or failed."""
    grasps, solid = problem.grasps, solid_version(problem, version)
    steps_n = simulated_steps(lake, [solid], grasps.designs, grasps.objects, grasps.setup)[:, :, 0]
    simulated = steps_n[grasps.tool, grasps.obj]
    if solid == version:
        return np.asarray(simulated)
    theta = np.array([version.theta.young_modulus_mpa, version.theta.friction, version.theta.poisson_ratio])
    return np.asarray(simulated + predictor.steps(theta, version.effects) - predictor.steps(theta, solid.effects))


def _prediction(
    label: str, problem: GapProblem, held_out: HeldOut, model: GapModel, simulated_n: np.ndarray, seed: int
) -> Prediction:
    """The simulated means with intervals: draws as the bank predicts them, moved to the simulated means."""
    rows, grasps = held_out.rows, problem.grasps
    predictor = Predictor.of(_only(problem, rows))
    draws_n = np.array([predictor.steps(theta, effects) for theta, effects in model.drawn(_N_DRAWS, seed)])
    draws_n += simulated_n[rows] - draws_n.mean(axis=0)
    noise = grasps.noise.step_covariance(N_STEPS, grasps.setup.lift_speed_mm_per_s)[0, 0]
    return scattered(label, draws_n, held_out, _SCATTER, float(np.sqrt(noise)))


def _only(problem: GapProblem, rows: np.ndarray) -> GapProblem:
    grasps = problem.grasps
    kept = replace(
        grasps,
        tool=grasps.tool[rows],
        obj=grasps.obj[rows],
        contexts=tuple(grasps.contexts[row] for row in rows),
        steps_n=grasps.steps_n[rows],
        grasp_ids=tuple(grasps.grasp_ids[row] for row in rows),
    )
    return replace(problem, grasps=kept)
