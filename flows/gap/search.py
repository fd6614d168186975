"""Gap discovery on a lake: freeze what is held out, fill the bank, find, name and add effects, show what it changed.

All that costs anything is in the lake: simulations, calibrations, the finished answer. A killed search is continued by
the same call, and one that has ended is told again without computing it.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

from flows.campaign.launch import Voice
from flows.campaign.progress import in_words
from flows.simulation.progress import n_missing, simulate_missing
from lake.provenance import current_provenance
from lake.store import Lake
from lake.tables.rows_of import missing_version_rows
from models.calibration.inference.settings import CalibrationSettings
from models.errors import FastError
from models.gap.evaluation.power import power_sentence
from models.gap.findings import Findings
from models.gap.problem import GapProblem
from models.ids import content_id
from models.records import EffectValue, SimulatorVersion
from tasks.calibration.mean_data import find_base_version
from tasks.campaign.requests import exclusive
from tasks.campaign.simulator_versions import newest_calibrated
from tasks.gap.bank import bank_of, bank_plans
from tasks.gap.data import MeasuredGrasps, problem_of, read_grasps, split_of, unit_sentences
from tasks.gap.findings import GapRun, find_run, gap_id_of, starting_effects, write_run, write_start
from tasks.gap.held_out import Split
from tasks.simulation.plan import SimulationPlan

if TYPE_CHECKING:
    from tasks.gap.compare import Comparison
    from tasks.gap.model import GapModel
    from tasks.gap.round import Turn

MOST_ROUNDS = 4


@dataclass(frozen=True)
class GapOrder:
    """What is asked for. `campaign_id` None: all measurements of the lake. `budget_minutes`: of simulating the bank."""

    campaign_id: str | None = None
    seed: int = 0
    rounds: int = MOST_ROUNDS
    budget_minutes: float | None = None
    settings: CalibrationSettings = field(
        default_factory=lambda: CalibrationSettings(chains=4, draws=1000, tune=1000, target_accept=0.95)
    )

    def with_workers(self, n: int) -> "GapOrder":
        """The same order with other worker processes, which change no result."""
        return replace(self, settings=self.settings.model_copy(update={"workers": n}))


@dataclass(frozen=True, eq=False)
class GapOutcome:
    """A finished search. `is_new`: it was made just now; then `turns` and `comparison` are what it rests on."""

    run: GapRun
    is_new: bool
    turns: "tuple[Turn, ...]" = ()
    comparison: "Comparison | None" = None

    @property
    def sentence(self) -> str:
        """What was found, for people and for the state of a flow run."""
        run = self.run
        if not self.is_new:
            return f"nothing new since gap search {run.gap_id}: {answer(run.findings)}"
        return f"gap search {run.gap_id} of {run.n_grasps} grasps: {answer(run.findings)}"


def run_gap(lake: Lake, order: GapOrder, voice: Voice, should_stop: Callable[[], bool] = lambda: False) -> GapOutcome:
    """Search for the gap of what a lake has measured; killed, the same order continues.

    Raises:
        UsageError: measurements are missing, too few, not of one kind, or not in N.
        FastError: the budget ended before the bank was complete, or another process searches in this lake.
    """
    with exclusive(lake, "gap", f"the lake {lake.address} is already being searched for a gap"):
        search = _prepared(lake, order)
        known = find_run(lake, search.gap_id)
        if known is not None:
            return GapOutcome(known, False)
        voice.progress(f"{search.summary}; held out: {search.split.words}, {search.split.split_id}")
        version_rows = missing_version_rows(lake, search.version)  # an imported lake has never simulated with it
        if version_rows:
            lake.append(version_rows, current_provenance(seed=order.seed))
        _fill_bank(lake, search, voice, should_stop)
        return _searched(lake, search, voice)


@dataclass(frozen=True, eq=False)
class _Search:
    """What a search begins with; `version`: the simulator that is asked about, `base` the same without effects."""

    order: GapOrder
    split: Split
    measured: MeasuredGrasps
    version: SimulatorVersion
    gap_id: str

    @property
    def base(self) -> SimulatorVersion:
        return self.version.model_copy(update={"effects": ()})

    @property
    def plans(self) -> tuple[SimulationPlan, ...]:
        grasps = self.measured.grasps
        return bank_plans(self.base, grasps.designs, grasps.objects, grasps.setup)

    @property
    def summary(self) -> str:
        grasps = self.measured.grasps
        return f"{len(grasps.grasp_ids)} grasps of {len(grasps.tools)} tools on {len(grasps.objects)} objects"


def _prepared(lake: Lake, order: GapOrder) -> _Search:
    """Freeze the split, then read what was measured."""
    split = split_of(lake, order.campaign_id, order.seed)
    measured = read_grasps(lake, order.campaign_id)
    version = find_base_version(lake, measured.campaigns, None)
    settings = {
        "rounds": order.rounds,
        "seed": order.seed,
        **order.settings.model_dump(mode="json", exclude={"workers"}),
    }
    return _Search(order, split, measured, version, gap_id_of(measured, version, split, settings))


def _fill_bank(lake: Lake, search: _Search, voice: Voice, should_stop: Callable[[], bool]) -> None:
    """Simulate what the bank lacks, as long as the budget lasts.

    Raises:
        FastError: it is not complete.
    """
    minutes, began = search.order.budget_minutes, time.monotonic()

    def is_over() -> bool:
        return should_stop() or (minutes is not None and time.monotonic() - began > 60.0 * minutes)

    n_all = sum(plan.n_grasps for plan in search.plans)
    n_left = n_missing(lake, search.plans)
    voice.progress(f"bank: {n_all - n_left} of {n_all} simulations are in the lake")
    simulate_missing(lake, search.plans, search.order.settings.workers, voice, is_over)
    n_left = n_missing(lake, search.plans)
    if n_left:
        raise FastError(
            f"the bank lacks {n_left} of {n_all} simulations after {in_words(time.monotonic() - began)}; run the same "
            "command again to go on from here."
        )


def _searched(lake: Lake, search: _Search, voice: Voice) -> GapOutcome:
    """Round after round, then what it changed; writes the answer."""
    from tasks.gap.compare import compare, show_plans
    from tasks.gap.round import starting_model

    order, grasps, began = search.order, search.measured.grasps, time.monotonic()
    bank = bank_of(lake, search.base, grasps.designs, grasps.objects, grasps.setup)
    problem = problem_of(search.measured, bank, search.split)
    warnings = [*search.measured.warnings, *unit_sentences(problem), *_failed(problem)]
    effects = _effects_so_far(lake, search)
    voice.progress(f"theta{' and ' if effects else ''}{', '.join(value.effect for value in effects)}: NUTS")
    model = starting_model(lake, problem, search.base, order.campaign_id, effects, order.settings, voice.progress)
    turns = _turns(lake, search, problem, model, voice)
    if not turns[-1].is_last:
        warnings.append(f"{len(turns)} rounds were made and the last one still found something; make more rounds.")
    before, after = turns[0].before, turns[-1].after
    voice.progress("held-out grasps in the simulator, before and after")
    plans = show_plans(problem, [before.version, after.version])
    simulate_missing(lake, plans, order.settings.workers, voice)
    comparison = compare(lake, problem, before, after, turns[0].residuals, order.seed)
    warnings += [*after.warnings, *comparison.shown.warnings]
    findings = Findings(
        alarm=any(turn.round.named.kind != "none" for turn in turns),
        rounds=tuple(turn.round for turn in turns),
        gap=comparison.shown.gap,
        aliases=turns[0].aliases,
        next_experiment=next((turn.next_experiment for turn in turns if turn.next_experiment), None),
        seed=order.seed,
        budget=_spent(search, plans, time.monotonic() - began),
        warnings=tuple(dict.fromkeys(warnings)),
        power=_power(problem),
    )
    run = GapRun(
        gap_id=search.gap_id,
        campaign_id=order.campaign_id,
        seed=order.seed,
        split_id=search.split.split_id,
        n_grasps=len(grasps.grasp_ids),
        base_version_id=search.version.version_id,
        before_version_id=before.version.version_id,
        after_version_id=after.version.version_id,
        calibration_ids=tuple(turn.after.calibration_id for turn in turns),
        findings=findings,
    )
    parents = list(dict.fromkeys([before.calibration_id, *(turn.after.calibration_id for turn in turns)]))
    write_run(lake, run, answer(findings), current_provenance(content_id("H", search.gap_id), order.seed, parents))
    return GapOutcome(run, True, tuple(turns), comparison)


def _turns(lake: Lake, search: _Search, problem: GapProblem, model: "GapModel", voice: Voice) -> "list[Turn]":
    """Rounds until one changes nothing, or as many as are asked for."""
    from tasks.gap.round import next_turn

    order = search.order
    turns: list[Turn] = []
    while len(turns) < order.rounds and not (turns and turns[-1].is_last):
        voice.progress(f"round {len(turns) + 1}: where, and by what name")
        assumed = turns[-1].assumed if turns else ()
        turn = next_turn(lake, problem, search.base, order.campaign_id, model, order.settings, voice.progress, assumed)
        voice.announce(f"round {len(turns) + 1}: {turn.sentence}")
        turns.append(turn)
        model = turn.after
    return turns


def _effects_so_far(lake: Lake, search: _Search) -> tuple[EffectValue, ...]:
    """Effects of the simulator now, which are tested again: what earlier searches added, else what it began with.

    Written down when the search begins: one that is killed after it added an effect begins again without.
    """
    known = starting_effects(lake, search.gap_id)
    if known is not None:
        return known
    found = newest_calibrated(lake, search.base.version_id, search.order.campaign_id or "")
    effects = found[0].effects if found is not None else search.version.effects
    write_start(lake, search.gap_id, search.order.campaign_id, effects, search.order.seed)
    return effects


def _power(problem: GapProblem) -> str:
    return power_sentence(int((~problem.held_out_tools).sum()), int((~problem.held_out_objects).sum()))


def _failed(problem: GapProblem) -> list[str]:
    share = problem.bank.failed_share
    return [f"{100 * share:.1f} % of the simulations of the bank failed; they are left out."] if share > 0 else []


def _spent(search: _Search, plans: Sequence[SimulationPlan], seconds: float) -> dict[str, float]:
    return {
        "bank_simulations": float(sum(plan.n_grasps for plan in search.plans)),
        "held_out_simulations": float(sum(plan.n_grasps for plan in plans)),
        "analysis_minutes": round(seconds / 60.0, 2),
    }


def answer(findings: Findings) -> str:
    """What was found, in a sentence."""
    named = [turn.named for turn in findings.rounds]
    effects = [name for found in named if found.kind == "effect" for name in found.effects]
    parts = [f"found {', '.join(effects)}"] if effects else []
    parts += [f"one of {', '.join(found.effects)}, not told apart" for found in named if found.kind == "set"]
    if named[-1].kind == "unknown":
        parts.append("something that is not in the catalogue")
    if not parts:
        return "no gap beyond noise and numerical error"
    gap = findings.gap
    shown = f"held-out error {gap.rmse_before_n:.2f} -> {gap.rmse_after_n:.2f} N, floor {gap.rmse_floor_n:.2f} N"
    return f"{'; '.join(parts)}; {shown}"
