"""Simulate a file of designs on objects in one call: the same grasps as `fast simulate`, in worker processes."""

import os
from collections.abc import Callable, Sequence
from concurrent.futures import BrokenExecutor, CancelledError, ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from fast.flows.progress import Bar, ProgressReporter, RateEstimate
from fast.models.errors import UsageError, spell_reason
from fast.models.objects.rigid import RigidObject
from fast.models.records import GraspSetup, Placement
from fast.models.show import html_table, load_pandas
from fast.models.simulation.version import SimulatorVersion
from fast.tasks.campaign.own_designs import OwnDesign
from fast.tasks.simulation.attempt import Attempt, GraspJob, attempt_grasp, await_attempt
from fast.tasks.simulation.pool import WorkerPool

if TYPE_CHECKING:
    import pandas

_DEADLINE_S = 120.0  # of one grasp, as in a campaign


@dataclass(frozen=True)
class SimulatedDesign:
    """A design with its outcome on each object, in the order of the objects."""

    own: OwnDesign
    objects: tuple[RigidObject, ...]
    attempts: tuple[Attempt, ...]

    @property
    def forces_n(self) -> list[float | None]:
        """Peak pull-off force on each object; None where the simulation failed."""
        return [None if one.result is None else one.result.peak_force_n for one in self.attempts]

    @property
    def row(self) -> dict[str, object]:
        """A line of the table: mean and range over the objects that could be simulated, and why others could not."""
        known = [force_n for force_n in self.forces_n if force_n is not None]
        failed = sorted({one.reason for one in self.attempts if one.result is None})
        return {
            "name": self.own.name,
            "design": self.own.design.design_id,
            "objects": len(known),
            "mean_n": sum(known) / len(known) if known else None,
            "min_n": min(known, default=None),
            "max_n": max(known, default=None),
            "failed": ", ".join(failed),
        }


@dataclass(frozen=True)
class SimulatedGrasps:
    """What `fast.simulate_many` gives: n designs on m objects. It shows itself in a notebook."""

    designs: tuple[SimulatedDesign, ...]
    """The n designs, in the order in which they were given."""

    @property
    def peak_force_n(self) -> np.ndarray:
        """Peak pull-off forces, n x m, in N; NaN where a grasp could not be simulated."""
        return np.array([[np.nan if force is None else force for force in one.forces_n] for one in self.designs])

    def to_pandas(self) -> "pandas.DataFrame":
        """Return a row per grasp: design, object, peak (N), contact force (N), work (J), and why it failed."""
        rows = [
            {
                "design": one.own.name,
                "design_id": one.own.design.design_id,
                "object": obj.name,
                "peak_force_n": attempt.result and attempt.result.peak_force_n,
                "contact_force_n": attempt.result and attempt.result.contact_force_n,
                "work_j": attempt.result and attempt.result.work_j,
                "failed": attempt.reason,
            }
            for one in self.designs
            for obj, attempt in zip(one.objects, one.attempts, strict=True)
        ]
        return load_pandas().DataFrame(rows)

    def _repr_html_(self) -> str:
        names = [obj.name for obj in self.designs[0].objects] if self.designs else []
        rows = [(one.own.name, *map(_force_text, one.forces_n)) for one in self.designs]
        return html_table(("peak pull-off force, N", *names), rows)


def _force_text(force_n: float | None) -> str:
    return "failed" if force_n is None else f"{force_n:.1f}"


def simulate_designs(
    designs: Sequence[OwnDesign],
    objects: Sequence[RigidObject],
    version: SimulatorVersion,
    setup: GraspSetup,
    placement: Placement,
    n_workers: int,
    reporter: ProgressReporter,
) -> list[SimulatedDesign]:
    """Simulate every design on every object, the designs side by side and in their order.

    A grasp that fails is left out of the mean of its design, and counted.

    Raises:
        UsageError: no process can be started, as each reads the script that starts it.
    """
    total, done, rate, is_given_up = len(designs) * len(objects), 0, RateEstimate(), False
    pool = WorkerPool(n_workers)

    def note(own: OwnDesign, obj: RigidObject, attempt: Attempt) -> None:
        nonlocal done
        if is_given_up:
            raise CancelledError  # ends the thread, which has other objects to come
        done += 1
        found = spell_reason(attempt.reason) if attempt.result is None else f"{attempt.result.peak_force_n:.1f} N"
        bar = Bar("simulated", done, total, rate.seconds_left(total - done))
        reporter.report(f"{own.name} on {obj.name} ({obj.object_id}): {found}", [bar])

    job = partial(GraspJob, version=version, setup=setup, deadline_s=_DEADLINE_S, placement=placement)
    try:
        _try_start(pool)
        with ThreadPoolExecutor(n_workers) as threads:
            try:
                return list(threads.map(partial(_simulate, pool, job, tuple(objects), note), designs))
            except BaseException:  # Ctrl-C too: only grasps that are under way are waited for
                is_given_up = True
                raise
    finally:
        pool.close()


def _try_start(pool: WorkerPool) -> None:
    try:
        pool.call(os.getpid)
    except BrokenExecutor as error:
        raise UsageError(
            "no process for simulations can be started, because each reads your script again; write the script into a "
            'file, and call `fast.simulate_many` there below `if __name__ == "__main__":`.'
        ) from error


def _simulate(
    pool: WorkerPool,
    job: Callable[..., GraspJob],
    objects: tuple[RigidObject, ...],
    note: Callable[[OwnDesign, RigidObject, Attempt], None],
    own: OwnDesign,
) -> SimulatedDesign:
    """Simulate all objects of a design in one worker, which keeps its mesh."""
    attempts = []
    with pool.lend() as worker:
        for obj in objects:
            wanted = job(own.design, obj)
            attempts.append(await_attempt(worker, wanted, worker.submit(attempt_grasp, wanted)))
            note(own, obj, attempts[-1])
    return SimulatedDesign(own, objects, tuple(attempts))
