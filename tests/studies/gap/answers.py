"""What gap discovery answers in a world of known truth, and how much of the held-out gap its name closes."""

import time
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np

import fast.models
from fast.models.gap.data import GapData
from fast.models.ids import content_id
from fast.models.records import EffectValue, Record
from fast.models.solver_code import source_id
from fast.models.traces.step_features import N_STEPS

if TYPE_CHECKING:
    from fast.models.gap.evidence.rehearsal import Rehearsal
    from fast.models.gap.fit.fit import Fit
    from fast.models.gap.naming.name import NamingResult
    from tests.studies.gap.local_banks import LocalBanks

MAX_ROUNDS = 3
LIFT_STEPS = 2 * N_STEPS // 3  # 40 mm: beyond, little is in the fingers
_DIGITS = 4


class Said(Record):
    """One round: what was named, how sure, and all candidates' probabilities.

    over_line: how many times over its line the evidence is. possible: of `models.gap.findings.Decision`.
    """

    kind: Literal["effect", "set", "none", "unknown"]
    effects: tuple[str, ...] = ()
    probability: float = 0.0
    parameters: dict[str, tuple[float, float, float]] = {}
    candidates: dict[str, float] = {}
    over_line: float = 0.0
    possible: tuple[str, ...] = ()


class Closing(Record):
    """Root mean square difference of held-out traces (N): with theta alone, and with what was named."""

    before_n: float
    after_n: float


class Answer(Record):
    """The answer to a world."""

    code: str
    rounds: tuple[Said, ...]
    closing: Closing | None = None
    cpu_s: float = 0.0

    @property
    def answer_hash(self) -> str:
        """Hash of the answer, which is kept before a key is looked at."""
        return content_id("U", self.model_dump(mode="json"))

    @property
    def named(self) -> tuple[str, ...]:
        """Effects that were named, of a set the first, over all rounds."""
        return tuple(said.effects[0] for said in self.rounds if said.effects)

    @property
    def is_alarm(self) -> bool:
        """Whether anything was said to be wrong."""
        return self.rounds[0].kind != "none"


@cache
def naming_code() -> str:
    """Id of the code that names effects."""
    root = Path(fast.models.__file__).parent
    kept = ("gap/bank", "gap/evidence", "gap/fit", "gap/naming", "gap/grasps.py", "gap/data.py", "gap/local_bank.py")
    files = [file.relative_to(root).as_posix() for file in (root / "gap").rglob("*.py")]
    return source_id(root, (*(f for f in files if f.startswith(kept)), "simulation/effects", "calibration/traces"))


def answer(
    problem: GapData,
    rehearsal: "Rehearsal",
    *,
    without: Sequence[str] = (),
    max_rounds: int = MAX_ROUNDS,
    banks: "LocalBanks | None" = None,
) -> Answer:
    """Name effects round by round until nothing more is said; of a set, the first stands for all.

    without: effects taken out of the catalogue. banks: around the fitted theta; none, and the wide bank answers.
    """
    from fast.models.gap.naming.name import name_effect

    started = time.process_time()
    catalogue = [name for name in problem.surrogate.names if name not in without]
    results: list[tuple[NamingResult, GapData]] = []
    in_model: tuple[EffectValue, ...] = ()
    plan = None
    for _ in range(max_rounds):
        if banks is None:
            result, data = name_effect(problem, rehearsal, in_model, catalogue=catalogue), problem
        else:
            result, data, plan = banks.name(problem, in_model, rehearsal, catalogue, plan)
        results.append((result, data))
        if not result.values:
            break
        in_model = tuple(result.best.effects)
    return Answer(
        code=naming_code(),
        rounds=tuple(_said(result) for result, _ in results),
        closing=_closing(results),
        cpu_s=round(time.process_time() - started, 2),
    )


def measure_twin(problem: GapData, rehearsal: "Rehearsal", banks: "LocalBanks | None" = None) -> float:
    """Held-out error of a world in which nothing is hidden, calibrated anew, N: what nobody can close."""
    from fast.models.gap.fit.recalibrate import recalibrate

    if banks is None:
        return _held_out_rmse_n(problem, recalibrate(problem.training))
    found, data, _ = banks.name(problem, (), rehearsal, problem.surrogate.names)
    return _held_out_rmse_n(data, found.fit)


def _said(result: "NamingResult") -> Said:
    named = result.named
    return Said(
        kind=named.kind,
        effects=named.effects,
        probability=round(named.probability, _DIGITS),
        parameters={
            name: (_rounded(value.median), _rounded(value.ci90[0]), _rounded(value.ci90[1]))
            for name, value in named.parameters.items()
        },
        candidates={one.effect: round(one.probability, _DIGITS) for one in result.candidates},
        over_line=round(result.alarm.over_threshold, _DIGITS),
        possible=named.possible,
    )


def _rounded(value: float) -> float:
    return float(f"{value:.4g}")


def _closing(results: Sequence[tuple["NamingResult", GapData]]) -> Closing | None:
    """How much of the gap on held-out grasps what was named closes; None if nothing is held out."""
    first, problem = results[0]
    if not (problem.is_held_out & problem.surrogate.is_usable).any():
        return None
    before_n = _held_out_rmse_n(problem, first.fit)
    named = [(result, data) for result, data in results if result.values]
    after_n = _held_out_rmse_n(named[-1][1], named[-1][0].best) if named else before_n
    return Closing(before_n=before_n, after_n=after_n)


def measure_held_out_n(
    problem: GapData, theta: np.ndarray, effects: Sequence[EffectValue], tool_factor: np.ndarray
) -> float:
    """Error of held-out grasps, N; tools that were seen keep the modulus that was found for them."""
    is_out = problem.is_held_out & problem.surrogate.is_usable
    predicted_n = problem.surrogate.predict_steps(theta, effects, tool_factor)
    return float(np.sqrt(np.mean((problem.grasps.steps_n - predicted_n)[is_out, :LIFT_STEPS] ** 2)))


def _held_out_rmse_n(problem: GapData, fit: "Fit") -> float:
    return measure_held_out_n(problem, fit.theta, fit.effects, fit.tool_factor)
