"""Outcomes of simulated grasps as JSON lines: a file that a killed benchmark leaves whole and continues."""

import threading
from collections.abc import Collection, Iterator
from pathlib import Path
from types import TracebackType
from typing import IO, Literal, Self, TypeVar

from pydantic import ValidationError

from fast.models.errors import UsageError
from fast.models.records import Record
from fast.models.solver_code import solver_id

R = TypeVar("R", bound=Record)


class Outcome(Record):
    """One simulated grasp of a benchmark.

    `design` is the number of a `models.design.space.numbered_design`. `cpu_s` includes `setup_cpu_s`, the mesh and
    the preparation of the solver. `worker` is a process id, `max_rss_mb` the most memory that process had held.
    `ended_s` counts from `part`, the time (s since 1970) at which this part of the benchmark began. `solver` is the
    `solver_id` of the code. `step_means_n`: mean pull over every half millimetre of the lift, N
    (`models.traces.step_features`); none of a lift of less than 3 mm. `flag`: see `GraspSimulation`.
    """

    simulation_id: str
    tier: str
    design: int
    object_id: int
    status: Literal["ok", "failed"]
    reason: str = ""
    message: str = ""
    peak_force_n: float | None = None
    contact_force_n: float | None = None
    work_j: float | None = None
    n_dof: int | None = None
    n_steps: int | None = None
    n_newton: int | None = None
    n_factorisations: int | None = None
    step_means_n: tuple[float, ...] = ()
    flag: str = ""
    cpu_s: float
    setup_cpu_s: float
    wall_s: float
    worker: int
    max_rss_mb: float
    part: float
    ended_s: float
    solver: str

    @property
    def is_ok(self) -> bool:
        """True if the grasp was simulated to its end."""
        return self.status == "ok"


class RecordFile:
    """Appends records to a file, a line each, as they come; keeps nothing without a path."""

    def __init__(self, path: Path | None) -> None:
        self._path = path
        self._lock = threading.Lock()
        self._file: IO[str] | None = None

    def __enter__(self) -> Self:
        """Open for appending, after the last whole line."""
        if self._path is not None:
            try:
                _drop_torn_line(self._path)
                self._file = self._path.open("a", encoding="utf-8")
            except OSError as error:
                raise UsageError(f"--results `{self._path}` cannot be written: {error.strerror}.") from error
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        """Close the file."""
        if self._file is not None:
            self._file.close()

    def append(self, record: Record) -> None:
        """Write one record; safe from several threads."""
        if self._file is not None:
            with self._lock:
                self._file.write(record.model_dump_json(exclude_defaults=True) + "\n")
                self._file.flush()


def read_outcomes(path: Path | None, lasting_tiers: Collection[str] = ()) -> dict[str, Outcome]:
    """Outcomes of a file by simulation id, the last of each; only those of the present solver code count.

    Of `lasting_tiers` older ones count too: a converged reference is worth more than its code version.

    Raises:
        UsageError: the file holds something else.
    """
    found: dict[str, Outcome] = {}
    for outcome in read_records(path, Outcome, "outcome of a benchmark"):
        if outcome.solver == solver_id() or outcome.tier in lasting_tiers:
            found[outcome.simulation_id] = outcome
    return found


def read_records(path: Path | None, record_type: type[R], what: str) -> Iterator[R]:
    """Records of a file that `RecordFile` wrote, in order; none without a file.

    Raises:
        UsageError: it is no file of text, or a line is no `what`.
    """
    if path is None or not path.exists():
        return
    try:
        lines = path.read_text(encoding="utf-8").splitlines(keepends=True)
    except (OSError, UnicodeDecodeError) as error:
        raise UsageError(f"{path} is no file of results that can be read; give another file.") from error
    for number, line in enumerate(lines, start=1):
        if not line.endswith("\n"):
            return  # written when the process was killed
        try:
            yield record_type.model_validate_json(line)
        except ValidationError as error:
            raise UsageError(f"{path}, line {number} is no {what}; give another file.") from error


def _drop_torn_line(path: Path) -> None:
    """Cut what follows the last newline, and make the folder if there is none."""
    path.parent.mkdir(parents=True, exist_ok=True)
    if path.exists():
        content = path.read_bytes()
        whole = content.rfind(b"\n") + 1
        if whole < len(content):
            with path.open("r+b") as file:
                file.truncate(whole)
