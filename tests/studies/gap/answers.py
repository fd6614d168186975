"""What gap discovery answers in a world of known truth, and how much of the held-out gap its name closes."""

import time
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np

import models
from models.gap.data import GapData
from models.ids import content_id
from models.records import EffectValue, Record
from models.solver_code import source_id
from models.traces.step_features import N_STEPS

if TYPE_CHECKING:
    from models.gap.naming.name import NamingResult
    from models.gap.naming.thresholds import Statistics, Thresholds

MAX_ROUNDS = 3
LIFT_STEPS = 2 * N_STEPS // 3  # 40 mm: beyond, little is in the fingers
_DIGITS = 4


class Said(Record):
    """One round: what was named, how sure, and all candidates' probabilities."""

    kind: Literal["effect", "set", "none", "unknown"]
    effects: tuple[str, ...] = ()
    probability: float = 0.0
    parameters: dict[str, float] = {}
    candidates: dict[str, float] = {}


class Closing(Record):
    """Root mean square difference of held-out traces (N): theta alone, with what was named, with the truth.

    floor_n: scatter of repeats, or what other meshes of the bank change, whichever is larger.
    """

    before_n: float
    after_n: float
    oracle_n: float | None = None
    floor_n: float


class Answer(Record):
    """The answer to a world. statistics: of the first round; evidence: its gains in nats, for tempering."""

    code: str
    thresholds: str
    rounds: tuple[Said, ...]
    statistics: dict[str, float]
    closing: Closing | None = None
    evidence: tuple[tuple[tuple[float, ...], ...], ...] = ()
    priors: tuple[float, ...] = ()
    cpu_s: float = 0.0

    @property
    def answer_hash(self) -> str:
        """Hash of the answer, which is kept before a key is looked at."""
        return content_id("U", self.model_dump(mode="json"))

    @property
    def named(self) -> tuple[str, ...]:
        """Effects that were named one by one, over all rounds."""
        return tuple(name for said in self.rounds if said.kind == "effect" for name in said.effects)

    @property
    def is_alarm(self) -> bool:
        """Whether anything was said to be wrong."""
        return self.rounds[0].kind != "none"


@cache
def naming_code() -> str:
    """Id of the code that names effects; lines have one of their own (`thresholds_id`)."""
    root = Path(models.__file__).parent
    naming = [file.relative_to(root).as_posix() for file in (root / "gap").rglob("*.py") if file.stem != "thresholds"]
    return source_id(root, (*naming, "simulation/effects", "calibration/traces"))


def answer(
    problem: GapData,
    thresholds: "Thresholds",
    *,
    without: Sequence[str] = (),
    truth: Sequence[str] = (),
    keep_evidence: bool = False,
    max_rounds: int = MAX_ROUNDS,
) -> Answer:
    """Name effects round by round until nothing more is said; a set goes on with its first.

    without: effects taken out of the catalogue. truth: names of the true effects, for the oracle's share of the gap
    only. keep_evidence: for `models.gap.naming.thresholds.fit_temperature`.
    """
    from models.gap.naming.name import name_effect

    started = time.process_time()
    catalogue = [name for name in problem.surrogate.names if name not in without]
    results: list[NamingResult] = []
    in_model: tuple[EffectValue, ...] = ()
    for _ in range(max_rounds):
        result = name_effect(problem, in_model, thresholds, catalogue)
        results.append(result)
        if not result.taken:
            break
        in_model = tuple(result.best.effects)
    cpu_s = time.process_time() - started
    first = results[0]
    return Answer(
        code=naming_code(),
        thresholds=thresholds_id(thresholds),
        rounds=tuple(_said(result) for result in results),
        statistics={name: float(value) for name, value in first.statistics.model_dump().items()},
        closing=_closing(problem, results, truth),
        evidence=_rounded(first.evidence_nats) if keep_evidence else (),
        priors=first.priors if keep_evidence else (),
        cpu_s=round(cpu_s, 2),
    )


def thresholds_id(thresholds: "Thresholds") -> str:
    """Id of the lines that an answer was decided with."""
    return content_id("H", thresholds.model_dump(mode="json"))


def statistics_of(answer: Answer) -> "Statistics":
    """The statistics of an answer's first round."""
    from models.gap.naming.thresholds import Statistics

    return Statistics(**answer.statistics)


def _rounded(gains: Sequence[np.ndarray]) -> tuple[tuple[tuple[float, ...], ...], ...]:
    return tuple(tuple(tuple(row) for row in np.round(gain, 3).tolist()) for gain in gains)


def _said(result: "NamingResult") -> Said:
    named = result.named
    return Said(
        kind=named.kind,
        effects=named.effects,
        probability=round(named.probability, _DIGITS),
        parameters={name: float(f"{value.median:.4g}") for name, value in named.parameters.items()},
        candidates={one.effect: round(one.probability, _DIGITS) for one in result.candidates},
    )


def _closing(problem: GapData, results: Sequence["NamingResult"], truth: Sequence[str]) -> Closing | None:
    """How much of the gap on held-out grasps the named effects close; None if nothing is held out."""
    from models.gap.fit.fit import Fit
    from models.gap.naming.candidates import fit_effect

    is_out = problem.is_held_out & problem.surrogate.is_usable
    if not is_out.any():
        return None

    def rmse_n(fit: Fit) -> float:
        predicted = problem.surrogate.predict_steps(fit.theta, fit.effects)
        return _rms((problem.grasps.steps_n - predicted)[is_out])

    first = results[0]
    oracle_n = None
    if len(truth) == 1 and truth[0] in first.ranking.names:
        oracle_n = rmse_n(fit_effect(first.fit, first.ranking, truth[0]))
    named = [result for result in results if result.values]
    return Closing(
        before_n=rmse_n(first.fit),
        after_n=rmse_n(named[-1].best if named else first.fit),
        oracle_n=oracle_n,
        floor_n=max(_repeat_rms(problem, is_out), _numerical_rms(problem, is_out, first.theta[0])),
    )


def _repeat_rms(problem: GapData, is_chosen: np.ndarray) -> float:
    """Root mean square difference of repeats from their mean, in N: what no model can close."""
    grasps = problem.grasps
    cells: dict[tuple[int, int], list[int]] = {}
    for row in np.flatnonzero(is_chosen):
        cells.setdefault((int(grasps.tool[row]), int(grasps.obj[row])), []).append(int(row))
    parts, free = 0.0, 0
    for rows in cells.values():
        steps = grasps.steps_n[rows, :LIFT_STEPS]
        parts += float(((steps - steps.mean(axis=0)) ** 2).sum())
        free += (len(rows) - 1) * LIFT_STEPS
    return float(np.sqrt(parts / max(free, 1)))


def _numerical_rms(problem: GapData, is_chosen: np.ndarray, young_modulus_mpa: float) -> float:
    """Root mean square change of the chosen grasps by other meshes of the bank, in N."""
    bank, grasps = problem.bank, problem.grasps
    change_n = (bank.numerical_steps_n - bank.centre_steps_n[:, :, None])[grasps.tool, grasps.obj][is_chosen]
    stiffer = young_modulus_mpa / bank.centre.young_modulus_mpa
    return stiffer * float(np.sqrt(np.nanmean(change_n[..., :LIFT_STEPS] ** 2)))


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values[:, :LIFT_STEPS] ** 2)))
