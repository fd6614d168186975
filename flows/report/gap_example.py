"""The worked example of docs/gap.md: `python -m flows.report.gap_example FOLDER` writes its page.

Grasps are made up in closed form (`models.gap.synthetic`), with a lag of the load cell hidden in them. All that follows
is what a real search does, but for the finite elements and the joint posterior.
"""

import sys
from pathlib import Path

import numpy as np

from flows.report.gap import write_gap_report
from flows.report.gap_evidence import GapEvidence, ThetaRow
from models.calibration.problem import THETA
from models.calibration.traces.features import N_STEPS
from models.gap.findings import Findings, Round
from models.gap.fit import Fit
from models.gap.name import NameResult, name_effect
from models.gap.predict import Predictor
from models.gap.problem import GapProblem
from models.gap.show.aliases import aliases
from models.gap.show.held_out import HeldOut, Prediction, scattered
from models.gap.show.next_experiment import next_experiment
from models.gap.show.shown import AFTER, BEFORE, Shown, show
from models.gap.synthetic import GapTruth, made_up_gap
from models.gap.where.locate import locate
from models.gap.where.residuals import Residuals
from models.records import EffectValue, Theta

HIDDEN = EffectValue(effect="load_cell_lag", parameters={"time_constant_s": 0.25})
N_TOOLS, N_OBJECTS, HELD_OUT = 14, 12, (4, 3)
_SCATTER = {"tool_sd": 0.04, "cell_sd": 0.015, "repeat_sd": 0.01}


def example_evidence(seed: int = 0) -> GapEvidence:
    """A search of one round in made-up grasps."""
    problem = made_up_gap(N_TOOLS, N_OBJECTS, seed, GapTruth(effects=(HIDDEN,)), held_out=HELD_OUT)
    found = name_effect(problem)
    predictor, fit = Predictor.of(problem), found.fit
    theta = Theta(**dict(zip(THETA, fit.theta.tolist(), strict=True)))
    before_n = predictor.steps(fit.theta, fit.effects, fit.tool_factor)
    residuals = Residuals.of(problem, before_n, theta, fit.tool_factor)
    where = locate(residuals, seed=seed)
    shown = _shown(problem, found, theta, residuals)
    one = Round(where=where.findings, candidates=found.candidates, named=found.named)
    return GapEvidence(
        findings=_findings(found, one, shown, seed),
        where=(where,),
        residuals=residuals,
        shown=shown,
        theta=tuple(_row(name, found, place) for place, name in enumerate(THETA)),
        isolated=found.isolability,
        assumed=("Made-up grasps in closed form with a lag of 0.25 s hidden in them: an example, not a measurement.",),
    )


def _shown(problem: GapProblem, found: NameResult, theta: Theta, residuals: Residuals) -> Shown:
    held_out, predictor = HeldOut.of(problem, theta), Predictor.of(problem)
    noise = problem.grasps.noise.step_covariance(N_STEPS, problem.grasps.setup.lift_speed_mm_per_s)[0, 0]

    def predicted(label: str, fit: Fit) -> Prediction:
        # Tools that were not learned from have no modulus of their own.
        factor = np.where(problem.held_out_tools, 1.0, fit.tool_factor)
        steps_n = predictor.steps(fit.theta, fit.effects, factor)[held_out.rows]
        return scattered(label, np.repeat(steps_n[None], 2, axis=0), held_out, _SCATTER, float(np.sqrt(noise)))

    return show(held_out, predicted(BEFORE, found.fit), predicted(AFTER, found.best), residuals)


def _findings(found: NameResult, one: Round, shown: Shown, seed: int) -> Findings:
    tried = {c.effect: c for c in found.candidates}
    is_set = found.named.kind == "set"
    asked = {name: tried[name].parameters for name in found.named.effects if name in tried}
    visible = {c.effect: c.visible_fraction for c in found.candidates if c.visible_fraction is not None}
    return Findings(
        alarm=found.named.kind != "none",
        rounds=(one,),
        gap=shown.gap,
        aliases=aliases(visible),
        next_experiment=next_experiment(found.named.effects, asked) if is_set else None,
        seed=seed,
        budget={"made_up_grasps": float(N_TOOLS * N_OBJECTS * 3)},
        warnings=shown.warnings,
    )


def _row(name: str, found: NameResult, place: int) -> ThetaRow:
    before, after = float(found.fit.theta[place]), float(found.best.theta[place])
    return ThetaRow(name, (before, before, before), (after, after, after))


if __name__ == "__main__":
    write_gap_report(example_evidence(), Path(sys.argv[1]), "example", "Made-up grasps: an example, not a measurement")
