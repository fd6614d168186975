"""The panel of a gap study: its bank and its sets of true grasps, kept beside each other and continued from there."""

import secrets
import time
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from pathlib import Path

import numpy as np

from fast.flows.challenge.hidden.panels import CHANNELS, LOWER, RAISED, WIDER, Panels, TrueSet
from fast.lake.store import Lake
from fast.lake.tables.campaign import SimulationRow
from fast.models.design.space import numbered_design
from fast.models.errors import SimulationFailed, UsageError
from fast.models.gap.grasps import Cells
from fast.models.ids import seed_from
from fast.models.objects.catalogue import get_object
from fast.models.records import GraspSetup, Record, Trace
from fast.models.simulation.version import SimulatorVersion
from fast.models.traces.step_features import is_usable
from fast.tasks.gap.bank import plan_bank
from fast.tasks.simulation.plan import simulate_plan
from fast.tasks.simulation.pool import WorkerPool
from tests.studies.benchmarks.base import Options, Rows, Tables
from tests.studies.benchmarks.outcomes import RecordFile, read_records
from tests.studies.gap.grasp_laws.truth import OTHER_GRASP_LAWS, TrueGrasp, list_grasps, solve_truth
from tests.studies.gap.small_panel import write_small

FRICTIONS, RATIOS = (0.38, 0.95), (0.32, 0.47)  # of true thetas: the bulk of the priors, not the bank's centre
N_BASES = 4
PANEL_DESIGNS, PANEL_OBJECTS = 9, 6  # each world takes some of them
_DIGITS = 4


# Parameters of hidden laws: where an amplitude is drawn from, and what shapes it. In the order of their worth.
LAWS: Mapping[str, Mapping[str, tuple[float, float]]] = {
    "static_kinetic_friction": {"kinetic_ratio": (0.86, 0.95), "slip_scale_mm": (0.8, 3.0)},
    "object_edge_radius": {"extra_radius_mm": (0.5, 1.4)},
    "pressure_dependent_friction": {"strength": (0.08, 0.2)},
    "force_limited_closing": {"max_force_n": (2.5, 6.0)},
    "wall_thickness_offset": {"offset_mm": (0.07, 0.16)},
    "other_material_law": {},
    "shear_adhesion": {"shear_strength_mpa": (0.0007, 0.002)},
    "scaled_objects": {"scale": (1.02, 1.05)},
    "base_compliance": {"compliance_mm_per_n": (0.03, 0.07)},
    "print_anisotropy": {"excess": (0.2, 0.4)},
    "hyperelastic_stiffening": {"stiffening": (10.0, 20.0)},
    "object_surfaces": {"spread": (0.06, 0.15)},
    "soft_objects": {"foundation_n_per_mm3": (0.04, 0.15)},
    "weak_finger": {"thinner_mm": (0.15, 0.35)},
    "rib_imperfection": {"bow_mm": (0.25, 0.5)},
    "finger_finger_contact": {"half_gap_mm": (6.5, 8.0)},
}
# Of the second laws of `tests.studies.gap.grasp_laws.truth.OTHER_GRASP_LAWS`: those that are not as for the first.
OTHER_LAWS: Mapping[str, Mapping[str, tuple[float, float]]] = {
    "pressure_dependent_friction": {"strength": (0.1, 0.26)},
    "base_compliance": {"compliance_mm_per_n": (0.05, 0.12)},
    "wall_thickness_offset": {"offset_mm": (0.14, 0.3)},
    "shear_adhesion": {"shear_strength_mpa": (0.001, 0.003)},
}


class Panel(Record):
    """What the worlds of a study are made of: designs (numbers of the fixed random sequence), objects, and true sets.

    `seed`: what it was drawn from; a secret until the worlds are judged.
    """

    seed: str
    designs: tuple[int, ...]
    objects: tuple[int, ...]
    sets: tuple[TrueSet, ...]

    @staticmethod
    def draw(seed: str, designs: Sequence[int] = (), objects: Sequence[int] = ()) -> "Panel":
        """Draw thetas and amplitudes, and designs and objects of different classes if none are given.

        The law of an effect is drawn from two. Sets come in the order of their worth: a run that is stopped lacks the
        last of them.
        """
        rng = np.random.default_rng(seed_from("gap panel", seed))
        drawn_designs = tuple(int(n) for n in rng.choice(np.arange(40, 400), PANEL_DESIGNS, replace=False))
        thetas = [(round(float(rng.uniform(*FRICTIONS)), 3), round(float(rng.uniform(*RATIOS)), 3)) for _ in range(4)]
        first = thetas[0]
        sets = [TrueSet(name=f"base-{number}", theta=theta) for number, theta in enumerate(thetas)]
        for law in LAWS:
            is_other = law in OTHER_GRASP_LAWS and bool(rng.uniform() < 0.5)
            sets.append(draw_set(law, is_other, thetas[int(rng.integers(N_BASES))], rng))
        sets += [
            TrueSet(name=LOWER, theta=(round(0.7 * first[0], 3), first[1])),
            TrueSet(name=WIDER, theta=first, law="wider_closing", parameters={"wider_mm": 2.0}),
            TrueSet(name=RAISED, theta=first, raised_mm=1.0),
        ]
        return Panel(
            seed=seed,
            designs=tuple(designs) or drawn_designs,
            objects=tuple(objects) or _draw_objects(rng),
            sets=tuple(sets),
        )

    @staticmethod
    def read(folder: Path) -> "Panel":
        """The panel of a study's folder.

        Raises:
            UsageError: there is none.
        """
        path = folder / "panel.json"
        if not path.exists():
            raise UsageError(f"{path} is missing; `python -m tests.studies gap-truth` draws the panel of a folder.")
        return Panel.model_validate_json(path.read_text())

    def write(self, folder: Path) -> None:
        """Keep the panel in a study's folder."""
        (folder / "panel.json").write_text(self.model_dump_json(indent=1) + "\n")


def draw_set(law: str, is_other: bool, theta: tuple[float, float], rng: np.random.Generator) -> TrueSet:
    """The true set of a law, first or second, with amplitudes from its ranges."""
    ranges = OTHER_LAWS.get(law, LAWS[law]) if is_other else LAWS[law]
    parameters = {key: round(float(rng.uniform(*ends)), 5) for key, ends in ranges.items()}
    return TrueSet(name=law, theta=theta, law=law, is_other=is_other, parameters=parameters)


PUBLIC_SEED = "development"  # of panels whose designs or objects are given


def _draw_objects(rng: np.random.Generator) -> tuple[int, ...]:
    """Objects of as many classes as there are."""
    numbers = [int(number) for number in rng.permutation(36)]
    by_class = {get_object(number).object_class: number for number in reversed(numbers)}
    others = [number for number in numbers if number not in by_class.values()]
    return tuple(sorted([*by_class.values(), *others][:PANEL_OBJECTS]))


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


LEAST_SHARE = 0.97  # of a panel that must have been solved before worlds are made of it


def read_panels(path: Path, panel: Panel) -> Panels:
    """Panels of a results file of `python -m tests.studies gap-truth`.

    Raises:
        UsageError: not one base is complete.
    """
    known, designs, objects = read_truth(path), panel.designs, panel.objects
    sets, cells = {}, {}
    for one in panel.sets:
        found: dict[tuple[int, int], Trace] = {}
        for tool, chunk in enumerate(list_grasps(one, designs, objects)):
            for obj, grasp in enumerate(chunk):
                record = known.get(grasp.grasp_id)
                trace = None if record is None else record.trace
                if trace is not None and is_usable(trace):
                    found[tool, obj] = trace
        if len(found) >= LEAST_SHARE * len(designs) * len(objects):
            sets[one.name], cells[one.name] = one, found
    panels = Panels(designs, objects, sets, cells)
    if not panels.bases:
        raise UsageError(f"{path} holds no complete base of true grasps; the study `gap-truth` makes them.")
    return panels


def measure_gap_truth(options: Options) -> Tables:
    """What a gap study compares: the simulator's bank of a panel, and true grasps that hide its effects.

    The bank comes first: a run that is stopped lacks the last sets of true grasps, which are worth the least.
    """
    folder, end = results_folder(options), time.monotonic() + 60.0 * options.limit_minutes
    if not (folder / "panel.json").exists():
        folder.mkdir(parents=True, exist_ok=True)
        _draw_panel(options).write(folder)
    panel = Panel.read(folder)
    filled = _fill_bank(panel, folder / "lake", options, end)
    solved = _solve_panel(panel, options, end)
    if time.monotonic() < end:
        _write_panel_file(folder)
    return {"bank": filled, "true grasps": solved}


def _write_panel_file(folder: Path) -> None:
    """Pack panels and bank into `panel.npz`, of which `fast challenge make` makes worlds."""
    from tests.studies.gap.development import open_panels

    panels, bank = open_panels(folder)
    write_small(folder / "panel.npz", panels, bank, list(panels.cells))


def _draw_panel(options: Options) -> Panel:
    """The panel of these designs (the first ones of the fixed sequence) and objects; of none given, from a secret."""
    if options.designs is None and options.objects is None:
        return Panel.draw(secrets.token_hex(16))
    return Panel.draw(PUBLIC_SEED, tuple(range(options.designs or 0)), options.objects or ())


def _solve_panel(panel: Panel, options: Options, end: float) -> Rows:
    """Solve the true grasps that the results file lacks; how many there are, failed, and cost, by set."""
    known = read_truth(options.results)
    sets, designs, objects = panel.sets, panel.designs, panel.objects
    wanted = [(one, chunk) for one in sets for chunk in list_grasps(one, designs, objects)]
    missing = [chunk for _, chunk in wanted if any(grasp.grasp_id not in known for grasp in chunk)]
    with RecordFile(options.results) as file:
        for record in _solved(missing, known, options, end):
            known[record.grasp_id] = record
            file.append(record)
    rows = []
    for one in sets:
        grasps = [grasp for chunk in list_grasps(one, designs, objects) for grasp in chunk]
        made = [known[grasp.grasp_id] for grasp in grasps if grasp.grasp_id in known]
        cost = sum(record.cpu_s for record in made)
        n_failed = sum(record.trace is None for record in made)
        rows.append({"set": one.name, "grasps": len(grasps), "made": len(made), "failed": n_failed, "cpu_s": cost})
    return rows


def _fill_bank(panel: Panel, root: Path, options: Options, end: float) -> Rows:
    """Simulate what the lake lacks of the panel's wide bank; how many there are, and how many failed now."""
    lake = Lake.open(root, create=True)
    cells = Cells.full([numbered_design(number) for number in panel.designs], panel.objects, GraspSetup())
    n_grasps = n_failed = 0
    for plan in plan_bank(SimulatorVersion(), cells):
        n_grasps += plan.n_grasps
        n_failed += simulate_plan(
            lake,
            plan,
            options.workers or 1,
            lambda done: options.tell(f"bank: {done.n_done} of {done.n_grasps} grasps"),
            lambda: time.monotonic() > end,
        )
    return [{"grasps": n_grasps, "made": len(lake.ids(SimulationRow)), "failed": n_failed}]


def results_folder(options: Options) -> Path:
    """The folder of the results file, with `panel.json`, `truth.jsonl` and the simulator's `lake` beside it.

    Raises:
        UsageError: no results file was named.
    """
    if options.results is None:
        raise UsageError(
            "studies of gap discovery need --results FOLDER/FILE; the folder gets the panel, true grasps and a lake."
        )
    return options.results.parent


def _solved(
    chunks: Sequence[Sequence[TrueGrasp]], known: dict[str, TrueTrace], options: Options, end: float
) -> Iterable[TrueTrace]:
    """Records as their chunks end, in the order of the sets but for what runs at the same time."""
    n_workers = options.workers or 1
    pool = WorkerPool(n_workers)

    def work(chunk: Sequence[TrueGrasp]) -> list[TrueTrace]:
        if time.monotonic() > end:
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
