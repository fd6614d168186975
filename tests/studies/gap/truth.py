"""True grasps of the hidden-effect study, in sets of a whole panel, kept in a results file and continued from there."""

import time
from collections.abc import Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from flows.benchmarks.base import Options, Tables
from flows.benchmarks.outcomes import RecordFile, read_records
from models.errors import SimulationFailed
from models.records import Record, Theta, Trace
from tasks.simulation.pool import WorkerPool
from tests.studies.hidden.truth import TrueGrasp, solve_truth

DESIGNS = tuple(range(14))
OBJECTS = (1, 3, 6, 10, 14, 21, 22, 25, 28, 30, 32, 34)
MODULUS_MPA = 9.2
# Friction and Poisson's ratio of the bases, none of them a point of the simulator's grid. The last are kept for
# sealed worlds: no threshold has seen them.
THETAS = ((0.62, 0.43), (0.45, 0.36), (0.83, 0.40), (0.52, 0.46), (0.72, 0.38), (0.50, 0.43))
SEALED_THETAS = ((0.57, 0.39), (0.76, 0.45))
_DIGITS = 4


@dataclass(frozen=True)
class TrueSet:
    """A panel of true grasps at one theta: what it is called, and its law with parameters (none: a base)."""

    name: str
    theta: tuple[float, float] = THETAS[0]
    law: str = ""
    parameters: dict[str, float] = field(default_factory=dict)
    raised_mm: float = 0.0

    def grasps(self, designs: Sequence[int] = DESIGNS, objects: Sequence[int] = OBJECTS) -> list[list[TrueGrasp]]:
        """Grasps by design, since a design's grasps share a mesh."""
        theta = Theta(young_modulus_mpa=MODULUS_MPA, friction=self.theta[0], poisson_ratio=self.theta[1])
        return [
            [
                TrueGrasp(
                    theta=theta,
                    design=design,
                    object_id=obj,
                    law=self.law,
                    parameters=self.parameters,
                    raised_mm=self.raised_mm,
                )
                for obj in objects
            ]
            for design in designs
        ]


def _base(number: int, theta: tuple[float, float]) -> TrueSet:
    return TrueSet(f"base-{number}", theta)


def _law(effect: str, size: str, **parameters: float) -> TrueSet:
    return TrueSet(f"{effect}-{size}", law=effect, parameters=parameters)


# In the order in which they are worth having.
SETS: tuple[TrueSet, ...] = (
    *(_base(number, theta) for number, theta in enumerate(THETAS[:3])),
    _law("static_kinetic_friction", "strong", kinetic_ratio=0.91, slip_scale_mm=1.5),
    _law("object_edge_radius", "strong", extra_radius_mm=1.2),
    _law("force_limited_closing", "strong", max_force_n=3.2),
    _law("wall_thickness_offset", "strong", offset_mm=0.12),
    *(_base(number + 3, theta) for number, theta in enumerate(THETAS[3:5])),
    _law("shear_adhesion", "strong", shear_strength_mpa=0.0015),
    _law("finger_finger_contact", "strong", half_gap_mm=7.5),
    _law("base_compliance", "strong", compliance_mm_per_n=0.05),
    _law("scaled_objects", "strong", scale=1.03),
    _law("pressure_dependent_friction", "strong", strength=0.15),
    *(TrueSet(f"base-{len(THETAS) + number}", theta) for number, theta in enumerate(SEALED_THETAS)),
    _law("static_kinetic_friction", "weak", kinetic_ratio=0.97, slip_scale_mm=1.5),
    _law("print_anisotropy", "strong", excess=0.3),
    _law("other_material_law", "strong"),
    _law("object_edge_radius", "weak", extra_radius_mm=0.5),
    _law("wall_thickness_offset", "weak", offset_mm=0.05),
    _law("hyperelastic_stiffening", "strong", stiffening=18.0),
    _law("wider_closing", "strong", wider_mm=2.0),
    _base(5, THETAS[5]),
    TrueSet("raised-objects", raised_mm=1.0),
    _law("rib_imperfection", "strong", bow_mm=0.4),
    _law("force_limited_closing", "weak", max_force_n=4.2),
    _law("shear_adhesion", "weak", shear_strength_mpa=0.0005),
    _law("finger_finger_contact", "weak", half_gap_mm=6.0),
    _law("base_compliance", "weak", compliance_mm_per_n=0.02),
    _law("pressure_dependent_friction", "weak", strength=0.06),
)


class TrueTrace(Record):
    """A true grasp and its samples; without any where it failed. `grasp_id` holds the id of the code, too."""

    grasp: TrueGrasp
    grasp_id: str
    time_s: tuple[float, ...] = ()
    lift_mm: tuple[float, ...] = ()
    force_n: tuple[float, ...] = ()
    cpu_s: float = 0.0

    @property
    def trace(self) -> Trace | None:
        """The samples, if there are any."""
        if not self.time_s:
            return None
        return Trace(np.array(self.time_s), np.array(self.lift_mm), np.array(self.force_n))


def read_truth(path: Path | None) -> dict[str, TrueTrace]:
    """True grasps of a results file by id; those of other code are never asked for."""
    return {record.grasp_id: record for record in read_records(path, TrueTrace, "true grasp")}


def measure_gap_truth(options: Options) -> Tables:
    """True grasps that hide the effects of the gap study: panels by law, their share of failures, and their cost."""
    known = read_truth(options.results)
    designs, objects = DESIGNS[: options.designs], options.objects or OBJECTS
    wanted = [(one, chunk) for one in SETS for chunk in one.grasps(designs, objects)]
    missing = [chunk for _, chunk in wanted if any(grasp.grasp_id not in known for grasp in chunk)]
    with RecordFile(options.results) as file:
        for record in _solved(missing, known, options):
            known[record.grasp_id] = record
            file.append(record)
    rows = []
    for one in SETS:
        grasps = [grasp for chunk in one.grasps(designs, objects) for grasp in chunk]
        made = [known[grasp.grasp_id] for grasp in grasps if grasp.grasp_id in known]
        cost = sum(record.cpu_s for record in made)
        n_failed = sum(record.trace is None for record in made)
        rows.append({"set": one.name, "grasps": len(grasps), "made": len(made), "failed": n_failed, "cpu_s": cost})
    return {"true grasps": rows}


def _solved(
    chunks: Sequence[Sequence[TrueGrasp]], known: dict[str, TrueTrace], options: Options
) -> Iterable[TrueTrace]:
    """Records as their chunks end, in the order of the sets but for what runs at the same time."""
    n_workers, started = options.workers or 1, time.monotonic()
    pool = WorkerPool(n_workers)

    def work(chunk: Sequence[TrueGrasp]) -> list[TrueTrace]:
        if time.monotonic() - started > 60.0 * options.limit_minutes:
            return []
        return pool.call(solve_chunk, [grasp for grasp in chunk if grasp.grasp_id not in known])

    try:
        with ThreadPoolExecutor(n_workers) as threads:
            futures = [threads.submit(work, chunk) for chunk in chunks]
            for n_done, future in enumerate(as_completed(futures), start=1):
                yield from future.result()
                options.tell(f"{n_done} of {len(chunks)} designs under a law")
    finally:
        pool.close()


def solve_chunk(grasps: Sequence[TrueGrasp]) -> list[TrueTrace]:
    """Solve grasps of one design. Runs in a worker process."""
    return [_solve(grasp) for grasp in grasps]


def _solve(grasp: TrueGrasp) -> TrueTrace:
    started = time.process_time()
    try:
        trace = solve_truth(grasp).trace
    except SimulationFailed:
        return TrueTrace(grasp=grasp, grasp_id=grasp.grasp_id, cpu_s=round(time.process_time() - started, 3))
    channels = {name: tuple(np.round(getattr(trace, name), _DIGITS).tolist()) for name in CHANNELS}
    return TrueTrace(grasp=grasp, grasp_id=grasp.grasp_id, cpu_s=round(time.process_time() - started, 3), **channels)


CHANNELS = ("time_s", "lift_mm", "force_n")
