"""Rounds of gap discovery, and the evaluation of what they changed.

A round says where the calibrated simulator disagrees and what is missing, and calibrates the simulator with it. The
evaluation compares simulators on held-out grasps: not by any emulator. What an effect needs of finite elements is
simulated. What depends on the single grasp (repeat, clock) or acts on a finished trace is no other simulation: its
change, as the surrogate predicts it for each grasp, is added.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lake.store import Lake
from models.gap.data import GapData
from models.gap.evaluation.evaluate import AFTER, BEFORE, Evaluation, evaluate
from models.gap.evaluation.held_out import HeldOut, Prediction, add_scatter
from models.gap.evaluation.next_experiment import choose_next_experiment, find_confounds
from models.gap.findings import Confound, Decision, NextExperiment, RoundFindings
from models.gap.fit.fit import Fit
from models.gap.fit.recalibrate import TOOL_SD
from models.gap.fit.whitened_features import PLACEMENT_SHARE, REPEAT_SD
from models.gap.naming.name import NamingResult, name_effect
from models.gap.where.locate import Where, locate
from models.gap.where.residuals import Residuals
from models.records import EffectValue, SimulatorVersion
from models.simulation.effects.catalogue import CATALOGUE
from models.traces.step_features import N_STEPS
from tasks.gap.bank import read_simulated_steps
from tasks.gap.calibrate import CalibratedSimulator, SearchInputs, calibrate_simulator
from tasks.simulation.plan import SimulationPlan

_FRICTION_STEP = 0.02  # relative, of a finite difference
_N_DRAWS = 40
_SCATTER = {"tool_sd": TOOL_SD, "cell_sd": PLACEMENT_SHARE, "repeat_sd": REPEAT_SD}


@dataclass(frozen=True, eq=False)
class Round:
    """A finished round.

    before, after: the calibrated simulator, the same if the round changed nothing. assumed: first effects of sets that
    were not told apart, which the next round takes for granted and no simulator gets.
    """

    findings: RoundFindings
    where: Where
    naming: NamingResult
    residuals: Residuals
    before: CalibratedSimulator
    after: CalibratedSimulator
    assumed: tuple[EffectValue, ...] = ()

    @property
    def is_last(self) -> bool:
        """Whether another round could say nothing else."""
        return self.after is self.before and self.findings.named.kind != "set"

    @property
    def sentence(self) -> str:
        """The answer of the round."""
        named, dropped = self.findings.named, self.findings.dropped
        gone = f" No longer needed: {', '.join(dropped)}." if dropped else ""
        names = f" ({', '.join(named.effects)})" if named.effects else ""
        # Nothing, or nothing that is known, is decided by lines of alarm; its share among candidates says little.
        sure = f", probability {named.probability:.2f}" if named.effects else ""
        return f"{named.kind}{names}{sure}. {named.sentence}{gone}"

    @property
    def next_experiment(self) -> NextExperiment | None:
        """What would separate a set that was not told apart."""
        if self.findings.named.kind != "set":
            return None
        candidates = {candidate.effect: candidate for candidate in self.findings.candidates}
        parameters = {name: candidates[name].parameters for name in self.findings.named.effects if name in candidates}
        probabilities = {name: candidates[name].probability for name in parameters}
        return choose_next_experiment(self.findings.named.effects, parameters, probabilities)

    @property
    def confounds(self) -> tuple[Confound, ...]:
        """What these data cannot tell from theta and tools."""
        visible = {c.effect: c.visible_fraction for c in self.findings.candidates if c.visible_fraction is not None}
        return find_confounds(visible)


def run_round(search: SearchInputs, before: CalibratedSimulator, assumed: Sequence[EffectValue] = ()) -> Round:
    """The next round, from the simulator `before`; what it names is calibrated together with the effects of that.

    assumed: of earlier rounds, see `Round`.

    Raises:
        UsageError: too few tools or objects are left to look at.
        FastError: the chains of the new simulator did not converge.
    """
    naming = name_effect(search.data, [*before.effects, *assumed])
    residuals, friction_slope_n = _compute_residuals(naming.fit)
    where = locate(residuals, friction_slope_n, seed=search.settings.seed)
    kept = [value for value in before.effects if value.effect not in naming.dropped]
    after = before
    if naming.values or len(kept) < len(before.effects):
        after = calibrate_simulator(search, [*kept, *naming.values])
    found = RoundFindings(
        where=where.findings,
        candidates=naming.candidates,
        named=_with_posterior(naming.named, after) if naming.values else naming.named,
        version=after.version.version_id if after is not before else None,
        dropped=naming.dropped,
    )
    still = [value for value in assumed if value.effect not in naming.dropped]
    if naming.named.kind == "set":
        still += naming.taken
    return Round(found, where, naming, residuals, before, after, tuple(still))


def plan_held_out(data: GapData, versions: Sequence[SimulatorVersion]) -> tuple[SimulationPlan, ...]:
    """Simulations of the held-out cells by versions: held-out tools on all objects, the others on held-out objects."""
    grasps = data.grasps
    solid = {
        found.version_id: found for found in (keep_simulated_effects(data, version) for version in versions)
    }.values()
    is_new, is_new_object = data.held_out_tools, data.held_out_objects
    plans = []
    for tools, objects in ((is_new, np.ones_like(is_new_object)), (~is_new, is_new_object)):
        designs = list(dict.fromkeys(grasps.designs[tool] for tool in np.flatnonzero(tools)))
        points = tuple((design, version) for version in solid for design in designs)
        ids = tuple(grasps.objects[obj] for obj in np.flatnonzero(objects))
        if points and ids:
            plans.append(SimulationPlan(points, ids, grasps.setup))
    return tuple(plans)


def keep_simulated_effects(data: GapData, version: SimulatorVersion) -> SimulatorVersion:
    """The version with those effects alone that have simulations of their own."""
    solid = tuple(value for value in version.effects if value.effect in data.bank.effects)
    return version.model_copy(update={"effects": solid})


def evaluate_rounds(lake: Lake, data: GapData, rounds: Sequence[Round], seed: int) -> Evaluation:
    """Compare the simulators before and after all rounds, and what any machine would have learnt, on held-out grasps.

    Grasps that either simulator could not simulate are left out of it.

    Raises:
        UsageError: there is no held-out grasp that both simulated.
    """
    simulators = (rounds[0].before, rounds[-1].after)
    steps_n = [_simulate_held_out(lake, data, simulator) for simulator in simulators]
    rows = np.flatnonzero(np.isfinite(np.array(steps_n)).all(axis=(0, 2)))
    held_out = HeldOut.of(data, simulators[0].version.theta, rows)
    surrogate, noise_sd_n = data.held_out.select(rows), _step_noise_sd_n(data)

    def predict(label: str, simulator: CalibratedSimulator, simulated_n: np.ndarray) -> Prediction:
        """The simulated means with intervals: draws as the surrogate predicts them, moved to the simulated means."""
        draws = simulator.draw(_N_DRAWS, seed)
        draws_n = np.array([surrogate.predict_steps(theta, effects) for theta, effects in draws])
        draws_n += simulated_n[rows] - draws_n.mean(axis=0)
        return add_scatter(label, draws_n, held_out, _SCATTER, noise_sd_n)

    before, after = map(predict, (BEFORE, AFTER), simulators, steps_n)
    return evaluate(held_out, before, after, rounds[0].residuals, seed)


def _compute_residuals(fit: Fit) -> tuple[Residuals, np.ndarray]:
    """What the calibrated simulator leaves of the grasps to learn from, and its slope by ln friction, n x steps."""
    surrogate = fit.features.surrogate

    def predict_n(friction_factor: float) -> np.ndarray:
        theta = fit.theta * np.array([1.0, friction_factor, 1.0])
        return surrogate.predict_steps(theta, fit.effects, fit.tool_factor)

    slope_n = (predict_n(1.0 + _FRICTION_STEP) - predict_n(1.0 - _FRICTION_STEP)) / (2.0 * _FRICTION_STEP)
    return Residuals.of(surrogate, predict_n(1.0), float(fit.theta[0]), fit.tool_factor), slope_n


def _with_posterior(named: Decision, simulator: CalibratedSimulator) -> Decision:
    """The answer with the parameters of the joint posterior instead of the fit's."""
    (effect,) = named.effects
    estimates = simulator.estimate_parameters(named.effects)
    found = {name.partition(".")[2]: value for name, value in estimates.items()}
    values = ", ".join(
        f"{name} = {value.median:.3g} [{value.ci90[0]:.3g}, {value.ci90[1]:.3g}]" for name, value in found.items()
    )
    sentence = f"{CATALOGUE[effect].title}: {values}."
    return named.model_copy(update={"parameters": found, "sentence": sentence})


def _simulate_held_out(lake: Lake, data: GapData, simulator: CalibratedSimulator) -> np.ndarray:
    """Step means of held-out grasps by a simulator, m x 120; NaN where one was not simulated or failed."""
    version = simulator.version
    surrogate, solid = data.held_out, keep_simulated_effects(data, version)
    grasps = surrogate.grasps
    steps_n = read_simulated_steps(lake, [solid], grasps.designs, grasps.objects, grasps.setup)[:, :, 0]
    simulated = steps_n[grasps.tool, grasps.obj]
    if solid == version or not len(simulated):
        return np.asarray(simulated)
    with_all, with_solid = (surrogate.predict_steps(simulator.theta, of.effects) for of in (version, solid))
    return np.asarray(simulated + with_all - with_solid)


def _step_noise_sd_n(data: GapData) -> float:
    """Standard deviation of a step's mean by noise of the load cell, in N."""
    grasps = data.grasps
    return float(np.sqrt(grasps.noise.step_covariance(N_STEPS, grasps.setup.lift_speed_mm_per_s)[0, 0]))
