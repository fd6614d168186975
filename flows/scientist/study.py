"""Many races in worker processes, every course kept in a file that a killed comparison continues."""

import time
from collections.abc import Callable, Collection, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path

from flows.benchmarks.outcomes import RecordFile, read_records
from flows.scientist.landscape import Landscape, emulated_landscape, synthetic_landscape
from flows.scientist.landscape_run import Course, RaceSchedule, run_race
from flows.scientist.strategies import STRATEGY_BY_NAME
from models.scientist.surrogate.observations import ObservationSet

Key = tuple[str, str, int, RaceSchedule]  # landscape, strategy, seed, schedule


@dataclass(frozen=True)
class Entry:
    """A race to run. `data`: simulated designs to emulate; None for a synthetic landscape."""

    strategy: str
    seed: int
    schedule: RaceSchedule
    data: ObservationSet | None = None

    @property
    def key(self) -> Key:
        """What the course of this race will be known by."""
        landscape = f"{'synthetic' if self.data is None else 'emulated'} {self.seed}"
        return landscape, self.strategy, self.seed, self.schedule

    def landscape(self) -> Landscape:
        """The world of this race; its seed is the race's."""
        return synthetic_landscape(self.seed) if self.data is None else emulated_landscape(self.data, self.seed)


def run_entry(entry: Entry) -> Course:
    """Run one race and say what it cost."""
    start = time.process_time()
    course = run_race(entry.landscape(), STRATEGY_BY_NAME[entry.strategy], entry.schedule, entry.seed)
    return course.model_copy(update={"cpu_s": round(time.process_time() - start, 2)})


def run_study(
    entries: Sequence[Entry], results: Path | None, n_workers: int, tell: Callable[[str], None]
) -> list[Course]:
    """Courses of the entries in their order: from the results file, else run now.

    Raises:
        UsageError: the results file holds something else or cannot be written.
    """
    known = read_courses(results, {entry.key for entry in entries})
    missing = [entry for entry in entries if entry.key not in known]
    if missing:
        tell(f"{len(entries) - len(missing)} races known, {len(missing)} to run")
        with RecordFile(results) as file:
            for course in _run(missing, n_workers, tell):
                file.append(course)
                known[key_of(course)] = course
    return [known[entry.key] for entry in entries]


def key_of(course: Course) -> Key:
    """What a course is known by."""
    return course.landscape, course.strategy, course.seed, course.schedule


def read_courses(path: Path | None, wanted: Collection[Key]) -> dict[Key, Course]:
    """Courses of a results file by key, those wanted; the last of each.

    Raises:
        UsageError: the file holds something else.
    """
    found: dict[Key, Course] = {}
    for course in read_records(path, Course, "course of a comparison"):
        if (key := key_of(course)) in wanted:
            found[key] = course
    return found


def _run(entries: Sequence[Entry], n_workers: int, tell: Callable[[str], None]) -> Iterator[Course]:
    started = time.monotonic()
    with ProcessPoolExecutor(n_workers, mp_context=get_context("spawn")) as pool:
        for n_done, future in enumerate(as_completed([pool.submit(run_entry, entry) for entry in entries]), start=1):
            course = future.result()
            left_min = (time.monotonic() - started) / n_done * (len(entries) - n_done) / 60.0
            tell(
                f"{course.landscape}, {course.strategy}: best {course.best_n[-1]:.1f} of {course.optimum_n:.1f} N; "
                f"{n_done} of {len(entries)}, about {left_min:.0f} min left"
            )
            yield course
