"""One round of gap discovery: where the calibrated simulator disagrees, what is missing, and the simulator with it."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lake.store import Lake
from models.calibration.inference.settings import CalibrationSettings
from models.gap.bank.predict import Predictor
from models.gap.evaluation.aliases import aliases
from models.gap.evaluation.next_experiment import next_experiment
from models.gap.findings import Alias, Named, NamedParameter, NextExperiment, Round
from models.gap.fit.whiten import training
from models.gap.naming.name import NameResult, name_effect
from models.gap.problem import GapProblem
from models.gap.where.locate import Where, locate
from models.gap.where.residuals import Residuals
from models.records import EffectValue, SimulatorVersion
from models.simulation.effects.catalogue import CATALOGUE
from tasks.calibration.calibrate import Progress
from tasks.gap.model import GapModel, calibrated_model, theta_record

_FRICTION_STEP = 0.02  # relative, of a finite difference


@dataclass(frozen=True, eq=False)
class Turn:
    """A finished round.

    before, after: the calibrated simulator, the same if the round changed nothing. assumed: first effects of sets that
    were not told apart, which the next round takes for granted and no simulator gets.
    """

    round: Round
    where: Where
    name: NameResult
    residuals: Residuals
    before: GapModel
    after: GapModel
    assumed: tuple[EffectValue, ...] = ()

    @property
    def is_last(self) -> bool:
        """Whether another round could say nothing else."""
        return self.after is self.before and self.round.named.kind != "set"

    @property
    def sentence(self) -> str:
        """The answer of the round."""
        named, dropped = self.round.named, self.round.dropped
        gone = f" No longer needed: {', '.join(dropped)}." if dropped else ""
        names = f" ({', '.join(named.effects)})" if named.effects else ""
        # Nothing, or nothing that is known, is decided by lines of alarm; its share among candidates says little.
        sure = f", probability {named.probability:.2f}" if named.effects else ""
        return f"{named.kind}{names}{sure}. {named.sentence}{gone}"

    @property
    def next_experiment(self) -> NextExperiment | None:
        """What would separate a set that was not told apart."""
        if self.round.named.kind != "set":
            return None
        tried = {candidate.effect: candidate for candidate in self.round.candidates}
        parameters = {name: tried[name].parameters for name in self.round.named.effects if name in tried}
        probabilities = {name: tried[name].probability for name in parameters}
        return next_experiment(self.round.named.effects, parameters, probabilities)

    @property
    def aliases(self) -> tuple[Alias, ...]:
        """What these data cannot tell from theta and tools."""
        visible = {c.effect: c.visible_fraction for c in self.round.candidates if c.visible_fraction is not None}
        return aliases(visible)


def next_turn(
    lake: Lake,
    problem: GapProblem,
    base: SimulatorVersion,
    campaign_id: str | None,
    model: GapModel,
    settings: CalibrationSettings,
    progress: Progress | None = None,
    assumed: Sequence[EffectValue] = (),
) -> Turn:
    """The next round, with `model` as the simulator; what it names is calibrated together with what is in the model.

    assumed: of earlier rounds, see `Turn`.

    Raises:
        UsageError: too few tools or objects are left to look at.
        FastError: the chains of the new simulator did not converge.
    """
    name = name_effect(problem, [*model.effects, *assumed])
    residuals, friction_slope_n = _residuals(problem, name)
    where = locate(residuals, friction_slope_n, seed=settings.seed)
    kept = [value for value in model.effects if value.effect not in name.dropped]
    after = model
    if name.values or len(kept) < len(model.effects):
        after = calibrated_model(lake, training(problem), base, campaign_id, [*kept, *name.values], settings, progress)
    found = Round(
        where=where.findings,
        candidates=name.candidates,
        named=_with_posterior(name.named, after) if name.values else name.named,
        version=after.version.version_id if after is not model else None,
        dropped=name.dropped,
    )
    still = [value for value in assumed if value.effect not in name.dropped]
    if name.named.kind == "set":
        still += name.taken
    return Turn(found, where, name, residuals, model, after, tuple(still))


def starting_model(
    lake: Lake,
    problem: GapProblem,
    base: SimulatorVersion,
    campaign_id: str | None,
    effects: Sequence[EffectValue],
    settings: CalibrationSettings,
    progress: Progress | None = None,
) -> GapModel:
    """The simulator with the effects it has already, calibrated on what may be learnt from."""
    return calibrated_model(lake, training(problem), base, campaign_id, effects, settings, progress)


def _residuals(problem: GapProblem, name: NameResult) -> tuple[Residuals, np.ndarray]:
    """What the calibrated simulator leaves of the grasps to learn from, and its slope by ln friction, n x steps."""
    predictor, fit = Predictor.of(problem), name.fit
    is_usable = predictor.is_usable & (problem.grasps.steps_n == problem.grasps.steps_n).all(axis=1)

    def predicted_n(friction_factor: float) -> np.ndarray:
        return predictor.steps(fit.theta * np.array([1.0, friction_factor, 1.0]), fit.effects, fit.tool_factor)

    slope_n = (predicted_n(1.0 + _FRICTION_STEP) - predicted_n(1.0 - _FRICTION_STEP)) / (2.0 * _FRICTION_STEP)
    residuals = Residuals.of(problem, predicted_n(1.0), theta_record(fit.theta), fit.tool_factor, is_usable)
    return residuals, slope_n[~problem.is_held_out & is_usable]


def _with_posterior(named: Named, model: GapModel) -> Named:
    """The answer with the parameters of the joint posterior instead of the fit's."""
    (effect,) = named.effects
    found: dict[str, NamedParameter] = {
        name.partition(".")[2]: value for name, value in model.parameters(named.effects).items()
    }
    values = ", ".join(
        f"{name} = {value.median:.3g} [{value.ci90[0]:.3g}, {value.ci90[1]:.3g}]" for name, value in found.items()
    )
    sentence = f"{CATALOGUE[effect].title}: {values}."
    return named.model_copy(update={"parameters": found, "sentence": sentence})
