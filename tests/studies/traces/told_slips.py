"""Questions about what people tell: how many sound files get one, and how many planted slips of each kind do.

Grasps are those of the world `lab`, which the simulator knows nothing of; each made-up campaign has its own tools,
objects, noise and repeats. Walls, hardness, lots and readings are drawn as `tests.studies.traces.told_facts` says.
"""

from collections.abc import Callable, Sequence

import numpy as np

from fast.models.errors import UsageError
from fast.models.objects.catalogue import OBJECTS
from fast.models.question import Kind, Question
from fast.models.records import Trace
from fast.models.traces import flags, peak_force_n
from fast.models.traces.anomalies import TURNED
from fast.models.traces.questions import UNITS_N, Told, find_questions
from fast.models.traces.trace_questions import ToldTrace, find_trace_questions
from tests.studies.benchmarks.base import Options, Tables
from tests.studies.traces.anomalies import FIRST_TOOL, wilson
from tests.studies.traces.planted import PLANTS
from tests.studies.traces.told_facts import measure_facts
from tests.studies.traces.world_grasps import (
    Spoil,
    WorldGrasp,
    bench_world,
    leave_alone,
    measure_world,
    simulate_cells,
    solve_world,
)

N_CAMPAIGNS = 40
N_TOOLS, N_OBJECTS = 6, 4
N_SOLVED = 12  # tools, of which each campaign draws its own
OF_OBJECTS = tuple(range(2, len(OBJECTS), 4))  # those before each of them chose the limits
WORLD = "lab"

Cells = dict[tuple[int, int], WorldGrasp]
_Case = tuple[int, int, int]


def measure_told_slips(options: Options) -> Tables:
    """Questions about sound files and about planted slips, in made-up campaigns of 6 tools on 4 objects; --worlds."""
    tools = range(FIRST_TOOL, FIRST_TOOL + (options.designs or N_SOLVED))
    objects = options.objects or OF_OBJECTS
    simulated = {(one.tool, one.object_id): one for one in simulate_cells(tools, objects, options) if one.time_s}
    grasps = {(g.tool, g.object_id): g for g in solve_world(bench_world(WORLD), tools, objects, options) if g.time_s}
    if len(set(grasps) & set(simulated)) < N_TOOLS * N_OBJECTS:
        raise UsageError("too few grasps are solved yet; give more time, or --results to continue.")
    outcomes: dict[tuple[str, str], list[bool | None]] = {}
    for seed in range(options.worlds or N_CAMPAIGNS):
        options.tell(f"campaign {seed + 1}")
        rng = np.random.default_rng(seed)
        chosen_tools = rng.choice(sorted({tool for tool, _ in grasps}), N_TOOLS, replace=False)
        chosen_objects = rng.choice(sorted({object_id for _, object_id in grasps}), N_OBJECTS, replace=False)
        cells = {key: grasps[key] for key in _pairs(chosen_tools, chosen_objects) if key in grasps and key in simulated}
        for name, found in (*_tell_peaks(cells, simulated, seed), *_tell_traces(cells, simulated, seed)):
            outcomes.setdefault(name, []).append(found)
    named = {name: sum(map(bool, found)) for (where, name), found in outcomes.items() if where == "named"}
    peaks = [_row(name, found) for (where, name), found in outcomes.items() if where == "peaks"]
    traces = [
        _row(name, found) | {"by its name": named.get(name)}
        for (where, name), found in outcomes.items()
        if where == "traces"
    ]
    facts = [_row(name, found) for name, found in measure_facts(options.worlds or N_CAMPAIGNS).items()]
    return {"peaks": peaks, "traces": traces, "facts": facts}


def _pairs(tools: np.ndarray, objects: np.ndarray) -> list[tuple[int, int]]:
    return [(int(tool), int(object_id)) for tool in tools for object_id in objects]


def _row(name: str, found: Sequence[bool | None]) -> dict[str, object]:
    """Share of the campaigns in which it can be seen, with its 95 % interval (Wilson 1927)."""
    seen = [one for one in found if one is not None]
    low, high = wilson(sum(seen), len(seen)) if seen else (0.0, 1.0)
    return {"planted": name, "asked": sum(seen), "of": len(seen), "low": round(low, 2), "high": round(high, 2)}


def _measure(cells: Cells, seed: int, spoil: Spoil = leave_alone) -> dict[_Case, Trace]:
    world = bench_world(WORLD).model_copy(update={"seed": seed})
    made = measure_world(world, list(cells.values()), spoil=spoil)
    cases = zip(made.tool.tolist(), made.object_id.tolist(), made.repeat.tolist(), strict=True)
    return dict(zip(cases, made.traces, strict=True))


_Outcome = tuple[tuple[str, str], bool | None]


def _tell_peaks(cells: Cells, simulated: Cells, seed: int) -> list[_Outcome]:
    told = [
        Told(
            f"row {n}",
            f"B01T{tool}",
            obj,
            repeat,
            max(round(peak_force_n(trace), 2), 0.01),
            _peak(simulated, tool, obj),
        )
        for n, ((tool, obj, repeat), trace) in enumerate(_measure(cells, seed).items())
    ]
    number = seed % len(told)
    found: list[_Outcome] = [(("peaks", "nothing"), bool(find_questions(told)))]
    blind = [one._replace(expected_n=None) for one in told]
    found.append((("peaks", "nothing, without a simulator"), bool(find_questions(blind))))
    for factor, name in ((10.0, "tenfold"), (0.1, "a tenth"), (100.0, "hundredfold")):
        slipped = _change(told, [number], lambda one, by=factor: round(one.force_n * by, 4))
        asked = any(q.kind == "decimal point" and number in q.numbers for q in find_questions(slipped))
        found.append((("peaks", f"a decimal point: {name}"), asked))
    for unit in UNITS_N:
        slipped = _change(told, range(len(told)), lambda one, by=UNITS_N[unit]: one.force_n / by)
        found.append((("peaks", f"all forces in {unit}"), _has(find_questions(slipped), "unit", f"{unit}?")))
    start = seed % (len(told) - 12)
    found.append(
        (("peaks", "12 copied"), _has(find_questions(_change(told, range(start, start + 12), lambda _: 8.0)), "copied"))
    )
    found.append((("peaks", "exchanged tools"), _exchange(told, "exchanged tools", lambda one: one.tool)))
    found.append((("peaks", "exchanged objects"), _exchange(told, "exchanged objects", lambda one: one.object_id)))
    return found


def _peak(simulated: Cells, tool: int, object_id: int) -> float:
    return max(peak_force_n(simulated[tool, object_id].trace), 1e-3)


def _change(told: list[Told], numbers: Sequence[int], force: Callable[..., float]) -> list[Told]:
    return [one._replace(force_n=force(one)) if n in set(numbers) else one for n, one in enumerate(told)]


def _has(questions: Sequence[Question], kind: Kind, words: str = "") -> bool:
    return any(question.kind == kind and words in question.sentence for question in questions)


def _exchange(told: list[Told], kind: Kind, name_of: Callable[[Told], object]) -> bool | None:
    """Whether the two with most and least force, exchanged, are asked about; None where they are too alike to be seen.

    They differ by more than four times the scatter of a cell about the simulator.
    """
    rest = {name: [] for name in map(name_of, told)}  # type: dict[object, list[float]]
    level = {name: [] for name in rest}  # type: dict[object, list[float]]
    for one in told:
        level[name_of(one)].append(float(np.log(one.force_n)))
        rest[name_of(one)].append(float(np.log(one.force_n / (one.expected_n or 1.0))))
    scatter = float(np.std([value for values in rest.values() for value in values]))
    means = {name: float(np.mean(values)) for name, values in level.items()}
    first, last = min(means, key=means.__getitem__), max(means, key=means.__getitem__)
    if means[last] - means[first] < 4 * scatter:
        return None
    other = {first: last, last: first}

    def key_of(one: Told, name: object) -> tuple[object, ...]:
        return (name, one.object_id if kind == "exchanged tools" else one.tool, one.repeat)

    force = {key_of(one, name_of(one)): one.force_n for one in told}
    slipped = [
        one._replace(force_n=force.get(key_of(one, other.get(name_of(one), name_of(one))), one.force_n)) for one in told
    ]
    return _has(find_questions(slipped), kind)


def _tell_traces(cells: Cells, simulated: Cells, seed: int) -> list[_Outcome]:
    """Whether anything was asked, under `traces`, and whether by the right name, under `named`."""
    rng = np.random.default_rng(1000 + seed)
    cell = list(cells)[int(rng.integers(len(cells)))]
    sound = _measure(cells, seed)
    found: list[_Outcome] = [(("traces", "nothing"), bool(_ask(sound, simulated)))]

    def tell(name: str, kind: Kind, told: dict[_Case, Trace]) -> None:
        questions = _ask(told, simulated)
        found.append((("traces", name), bool(questions)))
        found.append((("named", name), _has(questions, kind)))

    offset_n = float(rng.uniform(1.0, 4.0))
    lifted = {case: Trace(t.time_s, t.lift_mm, t.force_n + offset_n) for case, t in sound.items()}
    tell("whole file: zero not taken", "zero", lifted)
    exchanged = {case: _exchange_axes(trace) for case, trace in sound.items()}
    tell("whole file: force and lift exchanged, up to the peak", "exchanged axes", exchanged)
    tell("whole file: cut off", "cut off", {case: _cut(trace, rng) for case, trace in sound.items()})
    cut = {case: _cut(trace, rng) if case[:2] == cell else trace for case, trace in sound.items()}
    tell("a cell: cut off", "cut off", cut)
    plants: tuple[tuple[flags.Kind, Kind], ...] = (
        ("stuck_valve", "no grip"),
        ("early_loss", "lost early"),
        ("negative_preload", "pressed down"),
    )
    for plant, kind in plants:
        words = plant.replace("_", " ")

        def of_all(case: _Case, true: Trace, plant: flags.Kind = plant) -> np.ndarray:
            return PLANTS[plant](true, rng)

        if plant != "negative_preload":  # no simulator knows the push of a whole rig
            tell(f"whole file: {words}", kind, _measure(cells, seed, of_all))

        def of_cell(case: _Case, true: Trace, plant: flags.Kind = plant) -> np.ndarray:
            return PLANTS[plant](true, rng) if case[:2] == cell else true.force_n

        tell(f"a cell: {words}", kind, _measure(cells, seed, of_cell))
    return found


def _ask(made: dict[_Case, Trace], simulated: Cells) -> list[Question]:
    return find_trace_questions(
        [
            ToldTrace(
                f"row {n}", f"B01T{tool}", obj, OBJECTS[obj].orientation == TURNED, trace, simulated[tool, obj].trace
            )
            for n, ((tool, obj, _), trace) in enumerate(made.items())
        ]
    )


def _exchange_axes(trace: Trace) -> Trace:
    """Up to the peak of the lift, so that both channels rise."""
    top = int(np.where(trace.is_lift, trace.force_n, -np.inf).argmax())
    lift = trace.is_lift & (np.arange(len(trace.force_n)) <= max(top, int(np.flatnonzero(trace.is_lift)[0]) + 10))
    return Trace(trace.time_s[lift], np.maximum.accumulate(np.maximum(trace.force_n[lift], 0.0)), trace.lift_mm[lift])


def _cut(trace: Trace, rng: np.random.Generator) -> Trace:
    """It ends on its way to the peak, or soon after."""
    top_mm = float(trace.lift_mm[int(trace.force_n.argmax())])
    kept = trace.lift_mm <= max(rng.uniform(0.5, 1.05) * top_mm, 3.5)
    return Trace(*(channel[kept] for channel in (trace.time_s, trace.lift_mm, trace.force_n)))
