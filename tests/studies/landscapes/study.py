"""Many runs on landscapes in worker processes, each kept in a file that a killed comparison continues."""

import time
from collections.abc import Callable, Collection, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path

import numpy as np

from fast.flows.progress import describe_duration
from fast.models.ids import seed_from
from tests.studies.benchmarks.outcomes import RecordFile, read_records
from tests.studies.landscapes.bank import EFFECT, THETA, LandscapeBank
from tests.studies.landscapes.landscape import read_landscape
from tests.studies.landscapes.run import LandscapeRun, RunSchedule, run_strategy
from tests.studies.landscapes.strategies import LANDSCAPE_STRATEGIES, LOOP, LOOP_DISCOVERED

# The third and second panel of sealed worlds (their files are in older versions of docs/benchmarks): with two effects
# both came out in 11 of 16, and in 8 of 12; with one, alarm where 2 % is visible, right family, right member of it in
# 0.67, and in 0.84. A wrong name counts as none: a version that does not predict held-out tools better is not accepted.
NAMED_SHARE = 8 / 12
Key = tuple[str, str, int, RunSchedule]  # landscape, strategy, seed, schedule


@dataclass(frozen=True)
class PlannedRun:
    """One strategy on the landscape of a truth, by its number in a bank; `landscape`: what it is called."""

    strategy: str
    seed: int
    schedule: RunSchedule
    bank: Path
    truth: int
    landscape: str

    @property
    def key(self) -> Key:
        """What the outcome will be known by."""
        return self.landscape, self.strategy, self.seed, self.schedule


def plan_runs(path: Path, seeds: int, strategies: Sequence[str], schedule: RunSchedule) -> list[PlannedRun]:
    """Every strategy on every truth of a bank, seed after seed.

    Raises:
        UsageError: the file is no bank.
    """
    bank = LandscapeBank.read(path)
    return [
        PlannedRun(name, seed, schedule, path, number, bank.landscape_name(number))
        for seed in range(seeds)
        for number in range(len(bank.truths))
        for name in strategies
    ]


def run_one(planned: PlannedRun) -> LandscapeRun:
    """Run one strategy on one landscape, and say what it cost."""
    landscape = read_landscape(planned.bank, planned.truth)
    start = time.process_time()
    strategy = LANDSCAPE_STRATEGIES[planned.strategy]
    run = run_strategy(landscape, strategy, planned.schedule, planned.seed)
    return run.model_copy(update={"cpu_s": round(time.process_time() - start, 2)})


def run_planned(
    plan: Sequence[PlannedRun], results: Path | None, n_workers: int, tell: Callable[[str], None]
) -> list[LandscapeRun]:
    """The runs of a plan in its order: from the results file, else run now.

    Raises:
        UsageError: the results file holds something else or cannot be written.
    """
    known = read_runs(results, {planned.key for planned in plan})
    missing = [planned for planned in plan if planned.key not in known]
    if missing:
        tell(f"{len(plan) - len(missing)} runs known, {len(missing)} to run")
        with RecordFile(results) as file:
            for run in _run_all(missing, n_workers, tell):
                file.append(run)
                known[run_key(run)] = run
    return [known[planned.key] for planned in plan]


def with_discovery(runs: Sequence[LandscapeRun]) -> list[LandscapeRun]:
    """The runs, and the loop as gap discovery makes it: with the effects where it names them, else with theta alone.

    Whether it does is drawn for every landscape and seed, as often as in sealed worlds. Needs no run of its own.
    """
    loops = {(run.landscape, run.seed, run.strategy): run for run in runs if run.strategy in LOOP.values()}
    found = []
    for landscape, seed in dict.fromkeys(key[:2] for key in loops):
        is_named = np.random.default_rng(seed_from("named", landscape, seed)).random() < NAMED_SHARE
        run = loops.get((landscape, seed, LOOP[EFFECT if is_named else THETA]))
        if run is not None:
            found.append(run.model_copy(update={"strategy": LOOP_DISCOVERED}))
    return [*runs, *found]


def run_key(run: LandscapeRun) -> Key:
    """What a run is known by."""
    return run.landscape, run.strategy, run.seed, run.schedule


def read_runs(path: Path | None, wanted: Collection[Key]) -> dict[Key, LandscapeRun]:
    """Runs of a results file by key, those wanted; the last of each.

    Raises:
        UsageError: the file holds something else.
    """
    found: dict[Key, LandscapeRun] = {}
    for run in read_records(path, LandscapeRun, "run of a comparison"):
        if (key := run_key(run)) in wanted:
            found[key] = run
    return found


def _run_all(plan: Sequence[PlannedRun], n_workers: int, tell: Callable[[str], None]) -> Iterator[LandscapeRun]:
    started = time.monotonic()
    with ProcessPoolExecutor(n_workers, mp_context=get_context("spawn")) as pool:
        for n_done, future in enumerate(as_completed([pool.submit(run_one, planned) for planned in plan]), start=1):
            run = future.result()
            left_s = (time.monotonic() - started) / n_done * (len(plan) - n_done)
            tell(
                f"{run.landscape}, {run.strategy}: best {run.best_n[-1]:.1f} of {run.optimum_n:.1f} N; "
                f"{n_done} of {len(plan)}, about {describe_duration(left_s)} left"
            )
            yield run
