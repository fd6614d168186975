"""Rounds of gap discovery, and the evaluation of what they changed.

The wide bank proposes theta and effects, and a bank around that theta answers (`settle_bank`). A round says where the
calibrated simulator disagrees and what is missing, and calibrates the simulator with it; what makes held-out grasps no
better is not added. The evaluation compares simulators on held-out grasps: not by any emulator. What an effect needs of
finite elements is simulated. What depends on the single grasp (repeat, clock) or acts on a finished trace is no other
simulation: its change, as the surrogate predicts it for each grasp, is added.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from fast.lake.store import Lake
from fast.models.gap.ask.answers import believe
from fast.models.gap.ask.hypotheses import list_hypotheses
from fast.models.gap.ask.settle import describe_asked, settle
from fast.models.gap.bank.bank import BankPlan
from fast.models.gap.bank.surrogate import N_BINS
from fast.models.gap.data import GapData
from fast.models.gap.evaluation.evaluate import AFTER, BEFORE, Evaluation, evaluate, find_confounds, measure_change
from fast.models.gap.evaluation.held_out import HeldOut, Prediction, PrintFactors, add_scatter
from fast.models.gap.evaluation.rest import describe_rest
from fast.models.gap.findings import Asked, Confound, Decision, RoundFindings, Verdict
from fast.models.gap.fit.fit import Fit
from fast.models.gap.fit.whitened_features import PLACEMENT_SHARE, REPEAT_SD
from fast.models.gap.local_bank import name_locally
from fast.models.gap.naming.name import NamingResult, name_effect
from fast.models.gap.where.locate import Where, locate
from fast.models.gap.where.residuals import Residuals
from fast.models.records import EffectValue
from fast.models.simulation.effects.catalogue import CATALOGUE
from fast.models.simulation.version import SimulatorVersion
from fast.models.traces.step_features import N_STEPS
from fast.tasks.gap.bank import HELD_OUT, LOCAL_BANK, note_bank, plan_bank, plan_cells, read_bank, read_simulated_steps
from fast.tasks.gap.calibrate import CalibratedSimulator, SearchInputs, admit_simulator, calibrate_simulator
from fast.tasks.gap.findings import read_questions
from fast.tasks.gap.moved import simulate_moved
from fast.tasks.simulation.plan import SimulationPlan

_N_DRAWS = 40


@dataclass(frozen=True, eq=False)
class Round:
    """A finished round.

    Of a set that was not told apart, the simulator gets the first, since its members correct alike.
    """

    search: SearchInputs
    """With the bank that answered."""
    findings: RoundFindings
    """What it found, as it is written."""
    where: Where
    """Where simulation and measurement disagree at that fit."""
    proposed: NamingResult
    """The names by the wide bank."""
    naming: NamingResult
    """The names by the bank that answered."""
    residuals: Residuals
    """Of training grasps, at the fit of the bank that answered."""
    before: CalibratedSimulator
    """The calibrated simulator before the round."""
    after: CalibratedSimulator
    """The one after it; the same if the round changed nothing."""
    asked: Asked | None = None
    """What came of earlier questions; None where nothing was answered."""

    @property
    def is_last(self) -> bool:
        """Whether another round could say nothing else."""
        return self.after is self.before

    @property
    def sentence(self) -> str:
        """The answer of the round."""
        named, dropped = self.findings.named, self.findings.dropped
        gone = f" No longer needed: {', '.join(dropped)}." if dropped else ""
        names = f" ({', '.join(named.effects)})" if named.effects else ""
        sure = f", probability {named.probability:.2f}"
        refused = f" {self.findings.refused}" if self.findings.refused else ""
        return f"{named.kind}{names}{sure}. {named.sentence}{gone}{refused}"

    @property
    def confounds(self) -> tuple[Confound, ...]:
        """What these data cannot tell from theta and tools."""
        visible = {c.effect: c.visible_fraction for c in self.findings.candidates if c.visible_fraction is not None}
        return find_confounds(visible)


@dataclass(frozen=True, eq=False)
class Settled:
    """A bank that answers: `search` with it, and the names by the wide bank (`proposed`) and by this one (`naming`).

    asked: what came of earlier questions, if anything did.
    """

    search: SearchInputs
    proposed: NamingResult
    naming: NamingResult
    asked: Asked | None = None


def settle_bank(wide: SearchInputs, in_model: Sequence[EffectValue], former: BankPlan | None = None) -> Settled:
    """Name what is missing with the wide bank, and again with one around the theta that was found, which is simulated.

    Either bank may raise the alarm, by the thresholds of the rehearsal.

    in_model: effects of the simulator, and those that are taken for granted. former: the bank of the round before,
    which stays if it can.

    Raises:
        UsageError: too few tools or objects are left to look at.
        FastError: the bank could not be simulated as a whole.
    """

    def name_in(plan: BankPlan) -> tuple[SearchInputs, NamingResult]:
        search = _with_bank(wide, plan)
        return search, name_effect(search.data, wide.rehearsal, in_model, proposed.raised_alarm)

    proposed = name_effect(wide.data, wide.rehearsal, in_model)
    search, naming, _ = name_locally(proposed, former, name_in)
    naming, asked = settle_answers(search, naming)
    return Settled(search, proposed, naming, asked)


def settle_answers(search: SearchInputs, naming: NamingResult) -> tuple[NamingResult, Asked | None]:
    """Return the names of a round with what came of earlier questions, and that in words."""
    hypotheses = list_hypotheses(naming)
    if search.answers is None or not hypotheses:
        return naming, None
    moved = simulate_moved(search, hypotheses, list(search.answers.experiments))
    likelihood = search.answers.weigh(hypotheses, moved)
    if np.ptp(likelihood) == 0.0:  # no grasp that was asked for was made
        return naming, None
    questions = [one for one in read_questions(search.lake, search.campaign_id) if not one.parameter]
    asked = describe_asked(questions, hypotheses, likelihood, search.answers)
    return settle(naming, believe(hypotheses, likelihood)), asked


def run_round(settled: Settled, before: CalibratedSimulator) -> Round:
    """Run the next round, from the simulator `before`; calibrate what it names together with the effects of that.

    What was named is added if it makes the held-out error smaller, and refused if not.

    Raises:
        FastError: the chains of the new simulator did not converge, or held-out grasps could not be simulated.
    """
    search, naming = settled.search, settled.naming
    residuals = _compute_residuals(naming.fit)
    where = locate(residuals, seed=search.settings.seed)
    kept = [value for value in before.effects if value.effect not in naming.dropped]
    after, refused, named = before, "", naming.named
    if naming.values:
        after = calibrate_simulator(search, [*kept, *naming.values], is_on_trial=True)
        named = _with_posterior(named, after)
        refused = _find_refusal(search, before, after, named.effects)
        admit_simulator(search.lake, after, refused)
    elif len(kept) < len(before.effects):
        after = calibrate_simulator(search, kept)
    if refused:
        after = before
    if named.kind == "unknown":
        named = named.model_copy(update={"rest": describe_rest(residuals)})
    found = RoundFindings(
        where=where.findings,
        candidates=naming.candidates,
        named=named,
        version=after.version.version_id if after is not before else None,
        dropped=() if refused else naming.dropped,
        refused=refused,
        patternless_n=_compute_patternless(naming.best),
    )
    return Round(search, found, where, settled.proposed, naming, residuals, before, after, settled.asked)


def plan_held_out(data: GapData, versions: Sequence[SimulatorVersion]) -> tuple[SimulationPlan, ...]:
    """Plan simulations of held-out cells by versions: held-out tools on all objects, others on held-out objects."""
    grasps = data.grasps
    solid = {found.version_id: found for found in (keep_simulated_effects(version) for version in versions)}.values()
    is_new_object = data.held_out_objects
    cells = grasps.cells
    is_new_target = np.array([is_new_object[grasps.objects.index(target.object_id)] for target in cells.targets])
    is_held_out = data.held_out_tools[:, None] | is_new_target
    return plan_cells(list(solid), replace(cells, is_wanted=cells.is_wanted & is_held_out))


def keep_simulated_effects(version: SimulatorVersion) -> SimulatorVersion:
    """Return the version with those effects alone that have simulations of their own."""
    solid = tuple(value for value in version.effects if CATALOGUE[value.effect].bank_runs)
    return version.model_copy(update={"effects": solid})


def evaluate_rounds(rounds: Sequence[Round], seed: int) -> Evaluation:
    """Compare the simulators before and after all rounds on held-out grasps.

    Grasps that either simulator could not simulate are left out of it.

    Raises:
        UsageError: there is no held-out grasp that both simulated.
    """
    search, simulators = rounds[-1].search, (rounds[0].before, rounds[-1].after)
    data = search.data
    held_out, rows, *steps_n = _compare_held_out(search, simulators)
    surrogate, noise_sd_n = data.held_out.select(rows), _step_noise_sd_n(data)

    def predict(label: str, simulator: CalibratedSimulator, simulated_n: np.ndarray) -> Prediction:
        """Predict the simulated means with intervals: draws by the surrogate, moved to the simulated means."""
        draws, prints = simulator.draw(_N_DRAWS, seed), PrintFactors.of(held_out, simulated_n)
        draws_n = np.array([surrogate.predict_steps(theta, effects) for theta, effects in draws])
        draws_n += prints.factor[:, None] * simulated_n - draws_n.mean(axis=0)
        relative_sd = np.sqrt(prints.sd**2 + PLACEMENT_SHARE**2 + REPEAT_SD**2)
        return add_scatter(label, draws_n, held_out, relative_sd, noise_sd_n)

    before, after = map(predict, (BEFORE, AFTER), simulators, steps_n)
    last = rounds[-1].findings
    patternless_n = (last.patternless_n or 0.0) if last.named.kind == "none" else 0.0
    return evaluate(held_out, before, after, seed, patternless_n)


def judge(search: SearchInputs, rounds: Sequence[Round], present: SimulatorVersion) -> Verdict:
    """Judge whether the simulator that the rounds ended with may replace the present one; the lake is told.

    What a round has named or dropped has been judged in that round. Where nothing was, theta alone is new, and is
    accepted if it makes the error of held-out grasps smaller.
    """
    before, after = rounds[0].before, rounds[-1].after
    in_use = CalibratedSimulator(present, "", (), np.zeros((0, 0)))
    search.simulate(HELD_OUT, plan_held_out(search.data, [present, before.version, after.version]))
    held_out, _, present_n, after_n = _compare_held_out(search, (in_use, after))
    change = measure_change(held_out, present_n, after_n, search.settings.seed)
    is_same, is_theta_alone = after.version == present, after is before
    is_accepted = is_same or not is_theta_alone or change.is_gain
    if is_theta_alone and not is_same:
        refused = "" if is_accepted else f"Theta is not taken over: {change.sentence}."
        admit_simulator(search.lake, after, refused)
    elif not is_theta_alone and before.version != present:
        names = ", ".join(value.effect for value in after.effects) or "no effect"
        admit_simulator(search.lake, before, f"The same search ended with another simulator, with {names}.")
    return Verdict(
        present_version_id=present.version_id,
        version_id=after.version.version_id,
        present_rmse_n=change.before_n,
        rmse_n=change.after_n,
        is_accepted=is_accepted,
        sentence=change.sentence,
    )


def _with_bank(wide: SearchInputs, plan: BankPlan) -> SearchInputs:
    """Return the search in another bank, of which what the lake lacks is simulated."""
    around = (wide.base, wide.data.grasps.cells, plan)
    note_bank(wide.lake, wide.gap_id, wide.campaign_id, plan)
    wide.simulate(LOCAL_BANK, plan_bank(*around))
    data = replace(wide.data, bank=read_bank(wide.lake, *around, wide.data.bank))
    return replace(wide, data=data, bank_plan=plan)


def _find_refusal(
    search: SearchInputs, before: CalibratedSimulator, after: CalibratedSimulator, effects: Sequence[str]
) -> str:
    """Say why effects are not added to the simulator; empty if they make the error of held-out grasps smaller."""
    search.simulate(HELD_OUT, plan_held_out(search.data, [before.version, after.version]))
    held_out, _, before_n, after_n = _compare_held_out(search, (before, after))
    change = measure_change(held_out, before_n, after_n, search.settings.seed)
    return "" if change.is_gain else f"Not added ({', '.join(effects)}): {change.sentence}."


def _compare_held_out(
    search: SearchInputs, simulators: tuple[CalibratedSimulator, CalibratedSimulator]
) -> tuple[HeldOut, np.ndarray, np.ndarray, np.ndarray]:
    """Return held-out grasps that both simulators have simulated, their rows, and step means of each (m x 120)."""
    steps_n = [_simulate_held_out(search.lake, search.data, simulator) for simulator in simulators]
    rows = np.flatnonzero(np.isfinite(np.array(steps_n)).all(axis=(0, 2)))
    held_out = HeldOut.of(search.data, simulators[0].version.theta, rows)
    return held_out, rows, steps_n[0][rows], steps_n[1][rows]


def _compute_residuals(fit: Fit) -> Residuals:
    """Compute what the calibrated simulator leaves of the grasps to learn from."""
    surrogate = fit.features.surrogate
    predicted_n = surrogate.predict_steps(fit.theta, fit.effects, fit.tool_factor)
    return Residuals.of(surrogate, predicted_n, float(fit.theta[0]))


def _with_posterior(named: Decision, simulator: CalibratedSimulator) -> Decision:
    """Return the answer with the parameters of the joint posterior instead of the fit's."""
    effect = named.effects[0]
    estimates = simulator.estimate_parameters([effect])
    found = {name.partition(".")[2]: value for name, value in estimates.items()}
    values = ", ".join(
        f"{name} = {value.median:.3g} [{value.ci90[0]:.3g}, {value.ci90[1]:.3g}]" for name, value in found.items()
    )
    if named.kind == "set":
        sentence = f"{named.sentence} In the simulator, the first stands for them: {values}."
    else:
        sentence = f"{CATALOGUE[effect].title}: {values}."
    return named.model_copy(update={"parameters": found, "sentence": sentence})


def _compute_patternless(fit: Fit) -> float:
    """Compute the root mean square of what a fit leaves of the means of cells over the force of the lift, N."""
    features = fit.features
    rest_n = (features.measured - fit.modelled)[:, :N_BINS]
    cells = [rest_n[rows].mean(axis=1) for rows in features.cells]
    return float(np.sqrt(np.mean(np.concatenate(cells) ** 2)))


def _simulate_held_out(lake: Lake, data: GapData, simulator: CalibratedSimulator) -> np.ndarray:
    """Return step means of held-out grasps by a simulator, m x 120, from the lake; NaN where missing or failed."""
    version = simulator.version
    surrogate, solid = data.held_out, keep_simulated_effects(version)
    steps_n = read_simulated_steps(lake, [solid], data.grasps.cells)[:, :, 0]
    simulated = steps_n[surrogate.grasps.tool, surrogate.column]
    if solid == version or not len(simulated):
        return np.asarray(simulated)
    with_all, with_solid = (surrogate.predict_steps(simulator.theta, of.effects) for of in (version, solid))
    return np.asarray(simulated + with_all - with_solid)


def _step_noise_sd_n(data: GapData) -> float:
    """Compute the standard deviation of a step's mean by noise of the load cell, in N."""
    grasps = data.grasps
    return float(np.sqrt(grasps.noise.step_covariance(N_STEPS, grasps.base_setup.lift_speed_mm_per_s)[0, 0]))
