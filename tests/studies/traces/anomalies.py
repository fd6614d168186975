"""Precision and recall of the flags on grasps that went wrong, in worlds where it is known which did and how."""

from typing import TYPE_CHECKING, Any

import numpy as np

from fast.models.errors import UsageError
from fast.models.objects.catalogue import OBJECTS
from fast.models.traces.anomalies import TURNED
from tests.studies.benchmarks.base import Options, Rows, Tables
from tests.studies.traces.world_grasps import (
    N_TOOLS,
    WorldGrasp,
    WorldTraces,
    bench_world,
    measure_world,
    simulate_cells,
    simulated_features,
    solve_world,
)

if TYPE_CHECKING:
    from fast.hardware.virtual.world.file import World
    from fast.models.traces.anomalies import Labels
    from fast.models.traces.flags import Anomaly, Kind

N_WORLDS = 10  # of their own noise and scatter of repeats, of each file
WORLDS = ("quick", "slip", "lab")  # the simulator is nearly right, wrong in one thing, and wrong as of a real lab
FIRST_TOOL = (
    6  # the tools before chose the constants, so they judge nothing; in `lab` these helped to choose the measure
)
PLANTED_SHARE = 0.01  # of the grasps, of each kind: half of them a single repeat, half all repeats of a tool and object
QUANTILES = (0.05, 0.01, 0.001)

_Case = tuple[int, int, int]


def measure_anomalies(options: Options) -> Tables:
    """Precision and recall by kind on a world's grasps with planted faults; false alarms without any; --worlds."""
    objects = options.objects or tuple(range(len(OBJECTS)))
    tools = range(FIRST_TOOL, FIRST_TOOL + (options.designs or N_TOOLS))
    simulated = simulate_cells(tools, objects, options)
    planted: Rows = []
    clean: Rows = []
    for name in WORLDS:
        world = bench_world(name)
        grasps = solve_world(world, tools, objects, options)
        if not any(grasp.time_s for grasp in grasps):
            raise UsageError("no grasp is solved yet; give more time, or --results to continue.")
        for seed in range(options.worlds or N_WORLDS):
            options.tell(f"world {name} {seed + 1}")
            own = world.model_copy(update={"seed": seed})
            planted += [{**row, "world": name} for row in _planted_rows(own, grasps, simulated, seed)]
            clean += [{**row, "world": name} for row in _clean_rows(own, grasps, simulated)]
    return {"kinds": _by_kind(planted), "worlds": _by_world(planted, clean), "nothing wrong": _by_measure(clean)}


def _planted_rows(world: "World", grasps: list[WorldGrasp], simulated: list[WorldGrasp], seed: int) -> Rows:
    """A row for each planted grasp (what was flagged), and for each flag on a grasp without that fault."""
    from tests.studies.traces.planted import PLANTS

    rng = np.random.default_rng(seed)
    plan, is_repeated = _plan(grasps, rng)
    measured = measure_world(
        world, grasps, spoil=lambda case, true: PLANTS[plan[case]](true, rng) if case in plan else true.force_n
    )
    cases = _cases(measured)
    flags: dict[_Case, set[Kind]] = {}
    for anomaly in _found(measured, simulated):
        flags.setdefault(cases[anomaly.place], set()).add(anomaly.kind)
    rows: Rows = [
        {
            "kind": kind,
            "is_repeated": case in is_repeated,
            "is_named": kind in flags.get(case, ()),
            "is_flagged": case in flags,
        }
        for case, kind in plan.items()
    ]
    return rows + [
        {"kind": kind, "is_false": True, "is_elsewhere": case not in plan}
        for case, kinds in flags.items()
        for kind in kinds
        if plan.get(case) != kind
    ]


def _plan(grasps: list[WorldGrasp], rng: np.random.Generator) -> tuple[dict[_Case, "Kind"], set[_Case]]:
    """What goes wrong in which grasp, and the grasps whose repeats all go wrong alike; no pair is used twice."""
    from tests.studies.traces.planted import PLANTS
    from tests.studies.traces.world_grasps import N_REPEATS

    pairs = [(grasp.tool, grasp.object_id) for grasp in grasps if grasp.time_s]
    n = max(round(PLANTED_SHARE * N_REPEATS * len(pairs)), 2)
    n_whole = max(round(0.5 * n / N_REPEATS), 1)
    plan: dict[_Case, Kind] = {}
    repeated: set[_Case] = set()
    used: set[tuple[int, int]] = set()
    for kind in PLANTS:
        able = [p for p in pairs if p not in used and (kind != "torsional_slip" or OBJECTS[p[1]].orientation == TURNED)]
        n_pairs = min(n_whole + max(n - N_REPEATS * n_whole, 1), len(able) // 2)
        for number, place in enumerate(rng.choice(len(able), n_pairs, replace=False)):
            pair = able[int(place)]
            used.add(pair)
            repeats = range(N_REPEATS) if number < n_whole else [int(rng.integers(N_REPEATS))]
            plan |= {(*pair, repeat): kind for repeat in repeats}
            repeated |= {(*pair, repeat) for repeat in repeats if number < n_whole}
    return plan, repeated


def _cases(measured: WorldTraces) -> list[_Case]:
    return list(zip(measured.tool.tolist(), measured.object_id.tolist(), measured.repeat.tolist(), strict=True))


def _labels(measured: WorldTraces) -> "Labels":
    from fast.models.traces.anomalies import Labels

    is_turned = np.array([obj.orientation == TURNED for obj in OBJECTS])
    return Labels(measured.tool, measured.object_id, is_turned[measured.object_id])


def _found(measured: WorldTraces, simulated: list[WorldGrasp]) -> "list[Anomaly]":
    from fast.models.traces.anomalies import find_anomalies

    return find_anomalies(measured.features, _labels(measured), simulated_features(measured, simulated))


def _clean_rows(world: "World", grasps: list[WorldGrasp], simulated: list[WorldGrasp]) -> Rows:
    """How often p-values against repeats are small, and grasps flagged, when nothing is wrong; a row per measure."""
    from fast.models.traces.anomalies import evidence_of

    measured = measure_world(world, grasps)
    features, labels = measured.features, _labels(measured)
    flags = _found(measured, simulated)
    n_flags = len({anomaly.place for anomaly in flags})
    n_of_expected = len({anomaly.place for anomaly in flags if anomaly.compared == "expected"})
    rows: Rows = []
    for name, evidence in evidence_of(features, labels).items():
        below = {f"p_below_{limit:g}": float((evidence.p_value < limit).mean()) for limit in QUANTILES}
        rows.append(
            {"measure": name, "n": len(evidence.p_value), "n_flagged": n_flags, "n_of_expected": n_of_expected, **below}
        )
    return rows


def _by_kind(rows: Rows) -> Rows:
    """Planted grasps found, in all and of those whose repeats all went wrong, and flags that were wrong."""
    found: Rows = []
    for kind in dict.fromkeys(row["kind"] for row in rows if "is_named" in row):
        planted = [row for row in rows if row["kind"] == kind and "is_named" in row]
        wrong = [row for row in rows if row["kind"] == kind and "is_false" in row]
        hits = sum(row["is_named"] for row in planted)
        line = {"kind": kind, "planted": len(planted), "precision": hits / max(hits + len(wrong), 1)}
        line["recall"] = hits / len(planted)
        for title, is_repeated in (("recall_single", False), ("recall_all_repeats", True)):
            part = [row["is_named"] for row in planted if row["is_repeated"] is is_repeated]
            line[title] = float(np.mean(part)) if part else None
        line["flagged_at_all"] = sum(row["is_flagged"] for row in planted) / len(planted)
        line["false_on_sound_grasps"] = sum(row["is_elsewhere"] for row in wrong)
        found.append(line)
    return found


def _by_world(planted: Rows, clean: Rows) -> Rows:
    """Faults of all repeats that were named, by kind and world, with the 95 % interval of Wilson (1927) over cells."""
    from tests.studies.traces.world_grasps import N_REPEATS

    found: Rows = []
    for name in dict.fromkeys(row["world"] for row in planted):
        line: dict[str, Any] = {"world": name}
        for kind in dict.fromkeys(row["kind"] for row in planted if "is_named" in row):
            own = [r["is_named"] for r in planted if r["world"] == name and r["kind"] == kind and r.get("is_repeated")]
            low, high = wilson(sum(own) / N_REPEATS, len(own) / N_REPEATS)
            line[kind] = f"{np.mean(own):.2f} [{low:.2f}, {high:.2f}]"
        sound = [row for row in clean if row["world"] == name and row["measure"] == "grip"]
        line["sound_flagged_per_1000"] = 1e3 * sum(r["n_flagged"] for r in sound) / sum(r["n"] for r in sound)
        line["by_expectation_per_1000"] = 1e3 * sum(r["n_of_expected"] for r in sound) / sum(r["n"] for r in sound)
        found.append(line)
    return found


def wilson(hits: float, n: float) -> tuple[float, float]:
    """Interval of a share, 95 %."""
    z = 1.96
    middle, half = (hits + z * z / 2) / (n + z * z), z * np.sqrt(hits * (n - hits) / n + z * z / 4) / (n + z * z)
    return float(middle - half), float(middle + half)


def _by_measure(rows: Rows) -> Rows:
    """Means over worlds."""
    found: Rows = []
    for name in dict.fromkeys(row["measure"] for row in rows):
        own = [row for row in rows if row["measure"] == name]
        line = {"measure": name, "grasps": sum(row["n"] for row in own)}
        line |= {key: float(np.mean([row[key] for row in own])) for key in own[0] if key.startswith("p_below")}
        found.append(line | {"flagged_per_1000": 1e3 * sum(row["n_flagged"] for row in own) / line["grasps"]})
    return found
