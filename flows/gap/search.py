"""Gap discovery on a lake: freeze what is held out, fill the bank, find, name and add effects, show what it changed.

All that costs anything is in the lake: simulations, calibrations, the finished answer. A killed search is continued by
the same call, and one that has ended is told again without computing it.
"""

import os
import time
from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

from fast.flows.progress import ProgressReporter, describe_duration
from fast.flows.simulation.progress import n_missing, simulate_missing
from fast.lake.leases import exclusive
from fast.lake.provenance import current_provenance
from fast.lake.store import Lake
from fast.lake.tables.catalogue_rows import append_version
from fast.models.calibration.inference.settings import CalibrationSettings
from fast.models.errors import FastError
from fast.models.gap.data import GapData
from fast.models.gap.evidence import REHEARSED
from fast.models.gap.findings import Findings, Verdict
from fast.models.ids import content_id
from fast.models.records import EffectValue
from fast.models.simulation.version import SimulatorVersion
from fast.models.units import spell_count, spell_share
from fast.tasks.bench.asked import read_requests, write_requests
from fast.tasks.calibration.mean_data import find_base_version
from fast.tasks.campaign.requests import GAP_LEASE
from fast.tasks.campaign.simulator_versions import newest_calibrated
from fast.tasks.gap.bank import HELD_OUT, LOCAL_BANK, WIDE_BANK, list_plan_ids, plan_bank, plan_centre, read_bank
from fast.tasks.gap.cost import GraspCosts, choose_largest_bank, estimate_cost, plan_probe
from fast.tasks.gap.data import (
    MeasuredGrasps,
    check_prints,
    check_repeats,
    check_units,
    make_data,
    read_grasps,
    split_measurements,
)
from fast.tasks.gap.findings import (
    GapRun,
    Start,
    find_answered_run,
    find_run,
    find_start,
    make_gap_id,
    write_run,
    write_start,
)
from fast.tasks.gap.panel import WHOLE, PanelSize
from fast.tasks.gap.split import Split
from fast.tasks.simulation.plan import SimulationPlan

if TYPE_CHECKING:
    from fast.models.gap.evaluation.evaluate import Evaluation
    from fast.tasks.gap.calibrate import SearchInputs
    from fast.tasks.gap.refine import Next
    from fast.tasks.gap.rounds import Round

MOST_ROUNDS = 4
MOST_ASKED = 24  # grasps, as usual and changed


class UnfinishedError(FastError):
    """Simulations of a search are missing; the same search goes on with those that are made."""


@dataclass(frozen=True)
class GapRequest:
    """What is asked for."""

    campaign_id: str | None = None
    """None: all measurements of the lake."""
    seed: int = 0
    """Of the split and of all draws."""
    rounds: int = MOST_ROUNDS
    """At most."""
    budget_minutes: float | None = None
    """Of simulating; None: no limit."""
    panel: PanelSize = WHOLE
    """Of how many designs and objects."""
    most_asked: int = MOST_ASKED
    """Grasps that may be asked for, which changes no answer."""
    rehearsed: int = REHEARSED
    """Made-up worlds from which the lines come beyond which *none* is not said."""
    settings: CalibrationSettings = field(
        default_factory=lambda: CalibrationSettings(chains=4, draws=1000, tune=1000, target_accept=0.95)
    )
    """Of the chains."""

    def with_workers(self, n: int) -> "GapRequest":
        """Return the same order with other worker processes, which change no result."""
        return replace(self, settings=self.settings.model_copy(update={"workers": n}))


@dataclass(frozen=True, eq=False)
class GapOutcome:
    """A finished search. `is_new`: it was made just now; then `rounds` and `evaluation` are what it rests on."""

    run: GapRun
    is_new: bool
    rounds: "tuple[Round, ...]" = ()
    evaluation: "Evaluation | None" = None

    @property
    def sentence(self) -> str:
        """What was found, for people and for the state of a flow run."""
        run = self.run
        if not self.is_new:
            return f"nothing new since gap search {run.gap_id}: {describe_outcome(run.findings)}"
        return f"gap search {run.gap_id} of {run.n_grasps} grasps: {describe_outcome(run.findings)}"


def run_gap(
    lake: Lake, request: GapRequest, reporter: ProgressReporter, should_stop: Callable[[], bool] = lambda: False
) -> GapOutcome:
    """Search for the gap of what a lake has measured; killed, the same order continues.

    Raises:
        UsageError: measurements are missing, too few, not of one kind, or not in N.
        FastError: the budget ended before the bank was complete, or another process searches in this lake.
    """
    with exclusive(lake.storage, GAP_LEASE, f"the lake {lake.address} is already being searched for a gap"):
        search = _prepare(lake, request)
        known = find_run(lake, search.gap_id)
        if known is not None:
            return GapOutcome(known, False)
        reporter.progress(f"{search.summary}; held out: {search.split.words}, {search.split.split_id}")
        # An imported lake has never simulated with it.
        append_version(lake, search.version, current_provenance(seed=request.seed))
        if n_missing(lake, search.plans):
            reporter.announce(_write_cost(lake, search, reporter))
        simulator = Simulator(lake, request, reporter, should_stop)
        simulator.fill_bank(search.base, search.measured)
        return _run_rounds(lake, search, simulator, reporter)


def describe_search_cost(lake: Lake, request: GapRequest, reporter: ProgressReporter) -> str:
    """Tell what a search would simulate and how long that takes, in a sentence; the split is frozen, nothing searched.

    A lake that has never simulated such grasps makes a few of the bank's, which tell how long one takes.

    Raises:
        UsageError: measurements are missing, too few, not of one kind, or not in N.
        FastError: another process searches in this lake.
    """
    with exclusive(lake.storage, GAP_LEASE, f"the lake {lake.address} is already being searched for a gap"):
        search = _prepare(lake, request)
        known = find_run(lake, search.gap_id)
        if known is not None:
            return f"Nothing to simulate: gap search {known.gap_id} of these {known.n_grasps} grasps has ended."
        return f"{search.summary}. {_write_cost(lake, search, reporter)}"


@dataclass(frozen=True, eq=False)
class _Search:
    """What a search begins with; `version`: the simulator that is asked about, `base` the same without effects."""

    request: GapRequest
    split: Split
    measured: MeasuredGrasps
    version: SimulatorVersion
    gap_id: str

    @property
    def base(self) -> SimulatorVersion:
        return self.version.model_copy(update={"effects": ()})

    @property
    def plans(self) -> tuple[SimulationPlan, ...]:
        return plan_bank(self.base, self.measured.grasps.cells)

    @property
    def summary(self) -> str:
        grasps = self.measured.grasps
        made = spell_count(len(grasps.grasp_ids), "grasp")
        return f"{made} of {spell_count(len(grasps.tools), 'tool')} on {spell_count(len(grasps.objects), 'object')}"


def _prepare(lake: Lake, request: GapRequest) -> _Search:
    """Freeze the split, then read what was measured."""
    split = split_measurements(lake, request.campaign_id, request.seed, request.panel)
    measured = read_grasps(lake, request.campaign_id, request.panel)
    version = find_base_version(lake, measured.campaigns, None)
    settings = {
        "rounds": request.rounds,
        "seed": request.seed,
        "rehearsed": request.rehearsed,
        **request.settings.model_dump(mode="json", exclude={"workers"}),
    }
    return _Search(request, split, measured, version, make_gap_id(measured, version, split, settings))


def _write_cost(lake: Lake, search: _Search, reporter: ProgressReporter) -> str:
    """Write how many grasps the search simulates, and how long they take on its workers, held-out ones not counted."""
    n_workers = search.request.settings.workers
    around = plan_bank(search.base, search.measured.grasps.cells, choose_largest_bank())
    costs = probe_costs(lake, search.plans, n_workers, reporter)
    wide, local = (estimate_cost(lake, plans, costs) for plans in (search.plans, around))
    n_all = sum(plan.n_grasps for plan in search.plans)
    what = (
        f"To simulate: {wide.n_grasps} of the {n_all} grasps of the bank, then up to {local.n_grasps} around the "
        "fitted theta (again if it leaves them)"
    )
    cpu_s = None if wide.cpu_s is None or local.cpu_s is None else wide.cpu_s + local.cpu_s
    return f"{what}; {describe_cpu(cpu_s, n_workers)}."


def probe_costs(lake: Lake, plans: Sequence[SimulationPlan], n_workers: int, reporter: ProgressReporter) -> GraspCosts:
    """Find how long a grasp of plans takes; where the lake does not know, a few are simulated."""
    probe = plan_probe(lake, plans, GraspCosts.read(lake))
    if n_missing(lake, probe):
        simulate_missing(lake, probe, n_workers, reporter)
    return GraspCosts.read(lake)


def describe_cpu(cpu_s: float | None, n_workers: int) -> str:
    """Describe a time of CPU in words, and how long it takes on so many workers; None: not known."""
    if cpu_s is None:
        return "how long one takes is not known yet"
    n_at_once = min(n_workers, os.cpu_count() or 1)
    return (
        f"about {describe_duration(cpu_s)} of CPU, {describe_duration(cpu_s / n_at_once)} on {n_at_once} free "
        f"core{'s' if n_at_once > 1 else ''}"
    )


class Simulator:
    """Simulates what a search asks for, as long as its budget lasts."""

    def __init__(
        self, lake: Lake, request: GapRequest, reporter: ProgressReporter, should_stop: Callable[[], bool]
    ) -> None:
        self.lake, self.request, self.reporter, self.should_stop = lake, request, reporter, should_stop
        self.spent_s = 0.0
        self.asked: dict[str, set[str]] = defaultdict(set)  # ids of what was asked for, by what it is called

    def fill_bank(self, base: SimulatorVersion, measured: MeasuredGrasps) -> None:
        """Simulate the wide bank, its middle first: that says whether the measured forces are in N.

        Raises:
            UsageError: they are of another unit, or sign.
            UnfinishedError: the time was up, or somebody asked to stop.
        """
        grasps = measured.grasps
        plans = plan_bank(base, grasps.cells)
        if n_missing(self.lake, plans):
            self.simulate(f"the middle of {WIDE_BANK}", plan_centre(base, grasps.cells))
            check_units(GapData.of_all(grasps, read_bank(self.lake, base, grasps.cells)))
        self.simulate(WIDE_BANK, plans)

    def simulate(self, what: str, plans: Sequence[SimulationPlan]) -> None:
        """Simulate what the lake lacks of plans, which are called `what`.

        Raises:
            UnfinishedError: the time was up, or somebody asked to stop.
        """
        minutes, began = self.request.budget_minutes, time.monotonic()

        def is_over() -> bool:
            spent_s = self.spent_s + time.monotonic() - began
            return self.should_stop() or (minutes is not None and spent_s > 60.0 * minutes)

        n_all = sum(plan.n_grasps for plan in plans)
        n_left = n_missing(self.lake, plans)
        self.asked[what].update(list_plan_ids(plans))
        said = f"{what}: {n_all - n_left} of {n_all} simulations are in the lake"
        if not n_left:
            self.reporter.progress(said)
            return
        costs, n_workers = GraspCosts.read(self.lake), self.request.settings.workers
        cpu_s = estimate_cost(self.lake, plans, costs).cpu_s
        self.reporter.announce(f"{said}, {n_left} are made now; {describe_cpu(cpu_s, n_workers)}")
        simulate_missing(self.lake, plans, n_workers, self.reporter, is_over, costs.of)
        self.spent_s += time.monotonic() - began
        n_left = n_missing(self.lake, plans)
        if n_left:
            raise UnfinishedError(
                f"{what} lacks {n_left} of {n_all} simulations after {describe_duration(self.spent_s)} of simulating; "
                "run the same command again to go on from here."
            )


def _run_rounds(lake: Lake, search: _Search, simulator: Simulator, reporter: ProgressReporter) -> GapOutcome:
    """Run round after round, then find what it changed; write the answer."""
    from fast.tasks.gap.refine import ask_next
    from fast.tasks.gap.rounds import evaluate_rounds, judge

    request, began = search.request, time.monotonic() - simulator.spent_s
    start = _find_start(lake, search)
    wide, warnings = _gather_inputs(lake, search, start.effects, simulator, reporter)
    rounds = _repeat_rounds(wide, start.effects, request.rounds, reporter)
    following = ask_next(rounds, request.most_asked)
    said = [f"to be asked: {following.asked.sentence}"] if following.asked is not None else []
    for sentence in [*said, *([following.ranking.sentence] if following.ranking is not None else [])]:
        reporter.announce(sentence)
    reporter.progress("held-out grasps in the simulator, before and after")
    verdict = judge(rounds[-1].search, rounds, start.version or search.version)  # simulates what is compared next
    evaluation = evaluate_rounds(rounds, request.seed)
    if not rounds[-1].is_last:
        warnings.append(f"{len(rounds)} rounds were made and the last one still found something; make more rounds.")
    warnings += check_prints(rounds[-1].proposed.trials.fit)
    warnings += [*_failed(rounds[-1].search.data), *rounds[-1].after.warnings, *evaluation.warnings]
    budget = _spent(simulator, time.monotonic() - began - simulator.spent_s)
    told = {"budget": budget, "warnings": tuple(dict.fromkeys(warnings))}
    findings = _sum_up(request.seed, start, rounds, following, verdict, evaluation).model_copy(update=told)
    return GapOutcome(_keep_findings(lake, search, rounds, findings), True, tuple(rounds), evaluation)


def _gather_inputs(
    lake: Lake, search: _Search, effects: Sequence[EffectValue], simulator: Simulator, reporter: ProgressReporter
) -> "tuple[SearchInputs, list[str]]":
    """Gather what rounds on the wide bank work with, rehearsed, and what is to be warned of."""
    from fast.models.gap.evidence.rehearsal import rehearse_panel
    from fast.tasks.gap.calibrate import SearchInputs

    request = search.request
    data = make_data(search.measured, read_bank(lake, search.base, search.measured.grasps.cells), search.split)
    inputs = SearchInputs(
        lake=lake,
        gap_id=search.gap_id,
        data=data,
        base=search.base,
        campaign_id=request.campaign_id,
        settings=request.settings,
        simulate=simulator.simulate,
        answers=search.measured.answers,
        progress=reporter.progress,
        rehearsal=rehearse_panel(data, effects, request.rehearsed, request.settings.workers or 1, reporter.progress),
    )
    return inputs, [*search.measured.warnings, *check_units(data), *check_repeats(data.grasps), *_failed(data)]


def _sum_up(
    seed: int, start: Start, rounds: "Sequence[Round]", following: "Next", verdict: Verdict, evaluation: "Evaluation"
) -> Findings:
    """Sum up the answer of all rounds, but for what it took and its warnings."""
    from fast.models.gap.evidence.visible import describe_panel, find_visible_sizes

    told = (*(one.asked for one in rounds), following.refined)
    trials, rehearsal = rounds[-1].proposed.trials, rounds[0].search.rehearsal  # the wide bank has every effect
    names = sorted(one.name for one in trials.weighed if one.kind == "effect")
    return Findings(
        alarm=any(one.findings.named.kind != "none" for one in rounds),
        rounds=tuple(one.findings for one in rounds),
        gap=evaluation.gap,
        aliases=rounds[0].confounds,
        next_experiment=following.asked,
        asked=tuple(one for one in told if one is not None),
        seed=seed,
        budget={},
        verdict=verdict,
        ranking=following.ranking,
        in_use=tuple(value.effect for value in start.effects),
        panel=describe_panel(rehearsal, find_visible_sizes(trials.fit, names, rehearsal.thresholds)),
    )


def _keep_findings(lake: Lake, search: _Search, rounds: "Sequence[Round]", findings: Findings) -> GapRun:
    """Write a search's answer and the grasps that it asks for."""
    from fast.tasks.gap.ask import list_requests

    request, before, asked = search.request, rounds[0].before, findings.next_experiment
    run = GapRun(
        gap_id=search.gap_id,
        campaign_id=request.campaign_id,
        seed=request.seed,
        split_id=search.split.split_id,
        n_grasps=len(search.measured.grasps.grasp_ids),
        base_version_id=search.version.version_id,
        before_version_id=before.version.version_id,
        after_version_id=rounds[-1].after.version.version_id,
        calibration_ids=tuple(one.after.calibration_id for one in rounds),
        findings=findings,
    )
    parents = list(dict.fromkeys([before.calibration_id, *run.calibration_ids]))
    provenance = current_provenance(content_id("H", search.gap_id), request.seed, parents)
    if asked is not None and not read_requests(lake, search.gap_id):
        write_requests(
            lake, search.gap_id, list_requests(asked.grasps), request.campaign_id, provenance, asked.parameter
        )
    write_run(lake, run, describe_outcome(findings), provenance)
    return run


def _repeat_rounds(
    wide: "SearchInputs", effects: Sequence[EffectValue], most: int, reporter: ProgressReporter
) -> "list[Round]":
    """Repeat rounds until one changes nothing, or as many as are asked for."""
    from fast.tasks.gap.calibrate import calibrate_simulator
    from fast.tasks.gap.rounds import run_round, settle_bank

    rounds: list[Round] = []
    while len(rounds) < most and not (rounds and rounds[-1].is_last):
        reporter.progress(f"round {len(rounds) + 1}: where, and by what name")
        if rounds:
            last = rounds[-1]
            settled = settle_bank(wide, last.after.effects, last.search.bank_plan)
            done = run_round(settled, last.after)
        else:
            settled = settle_bank(wide, effects)
            reporter.progress(f"theta{' and ' if effects else ''}{', '.join(value.effect for value in effects)}: NUTS")
            done = run_round(settled, calibrate_simulator(settled.search, effects, is_on_trial=True))
        reporter.announce(f"round {len(rounds) + 1}: {done.sentence}")
        rounds.append(done)
    return rounds


def _find_start(lake: Lake, search: _Search) -> Start:
    """Find the simulator in use, whose effects are tested again: what earlier searches made of it, or the first one.

    Written down when the search begins: one that is killed after it added an effect begins again without. A search that
    goes on with what an earlier one asked for begins as that did: what stood for a set is no more sure than the set.
    """
    start = find_start(lake, search.gap_id)
    if start is not None:
        return start
    asking = find_answered_run(lake, search.request.campaign_id)
    start = find_start(lake, asking.gap_id) if asking is not None else None
    if start is None:
        found = newest_calibrated(lake, search.base.version_id, search.request.campaign_id or "")
        version = found[0] if found is not None else search.version
        start = Start(version.effects, version)
    write_start(lake, search.gap_id, search.request.campaign_id, start, search.request.seed)
    return start


def _failed(data: GapData) -> list[str]:
    share = data.bank.failed_share
    return [f"{spell_share(share, 1)} of the simulations of the bank failed; they are left out."] if share > 0 else []


def _spent(simulator: Simulator, seconds: float) -> dict[str, float]:
    return {
        "bank_simulations": float(len(simulator.asked[WIDE_BANK])),
        "local_bank_simulations": float(len(simulator.asked[LOCAL_BANK])),
        "held_out_simulations": float(len(simulator.asked[HELD_OUT])),
        "analysis_minutes": round(seconds / 60.0, 2),
    }


def describe_outcome(findings: Findings) -> str:
    """Write what was found, in a sentence."""
    named = [found.named for found in findings.rounds]
    effects = [(place, one) for place, one in enumerate(findings.rounds) if one.named.kind == "effect"]
    added, refused, left = (
        [
            name
            for place, one in effects
            if (bool(one.refused), findings.is_leftover(place)) == how
            for name in one.named.effects
        ]
        for how in ((False, False), (True, False), (False, True))
    )
    parts = [f"found {', '.join(added)}"] if added else []
    parts += [f"{', '.join(refused)} would explain it, but was not added" for _ in refused[:1]]
    parts += [f"{', '.join(left)} added for what that leaves over" for _ in left[:1]]
    parts += [
        f"one of {', '.join(found.effects)}, not told apart"
        for place, found in enumerate(named)
        if found.kind == "set" and not findings.is_leftover(place)
    ]
    if named[-1].kind == "unknown" and not findings.is_leftover(len(named) - 1):
        parts.append("something that is not in the catalogue")
    if not parts and findings.in_use:
        return f"no further gap; the simulator in use already has {', '.join(findings.in_use)}"
    if not parts:
        more = "; the grasps that are asked for would show an effect that is too weak for an alarm"
        return f"no gap beyond noise and numerical error{more if findings.is_suspicion else ''}"
    gap = findings.gap
    shown = f"held-out error {gap.rmse_before_n:.2f} -> {gap.rmse_after_n:.2f} N, floor {gap.rmse_floor_n:.2f} N"
    return f"{'; '.join(parts)}; {shown}"
