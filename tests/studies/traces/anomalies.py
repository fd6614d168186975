"""Precision and recall of the flags on grasps that went wrong, in worlds where it is known which did and how."""

from typing import TYPE_CHECKING

import numpy as np

from fast.flows.benchmarks.base import Options, Rows, Tables
from fast.models.errors import UsageError
from fast.models.objects.catalogue import OBJECTS
from fast.models.traces.anomalies import TURNED
from tests.studies.traces.world_grasps import N_TOOLS, WorldGrasp, WorldTraces, bench_world, measure_world, solve_world

if TYPE_CHECKING:
    from fast.hardware.virtual.world.file import World
    from fast.models.traces.anomalies import Labels
    from fast.models.traces.flags import Anomaly, Kind

N_WORLDS = 10  # of their own noise and scatter of repeats
PLANTED_SHARE = 0.01  # of the grasps, of each kind: half of them a single repeat, half all repeats of a tool and object
QUANTILES = (0.05, 0.01, 0.001)

_Case = tuple[int, int, int]


def measure_anomalies(options: Options) -> Tables:
    """Precision and recall by kind on a world's grasps with planted faults; false alarms without any; --worlds."""
    world = bench_world()
    objects = options.objects or tuple(range(len(OBJECTS)))
    grasps = solve_world(world, range(options.designs or N_TOOLS), objects, options)
    if not any(grasp.time_s for grasp in grasps):
        raise UsageError("no grasp is solved yet; give more time, or --results to continue.")
    planted: Rows = []
    clean: Rows = []
    for seed in range(options.worlds or N_WORLDS):
        options.tell(f"world {seed + 1}")
        own = world.model_copy(update={"seed": seed})
        planted += _planted_rows(own, grasps, seed)
        clean += _clean_rows(own, grasps)
    return {"kinds": _by_kind(planted), "nothing wrong": _by_measure(clean)}


def _planted_rows(world: "World", grasps: list[WorldGrasp], seed: int) -> Rows:
    """A row for each planted grasp (what was flagged), and for each flag on a grasp without that fault."""
    from tests.studies.traces.planted import PLANTS

    rng = np.random.default_rng(seed)
    plan, is_repeated = _plan(grasps, rng)
    measured = measure_world(
        world, grasps, spoil=lambda case, true: PLANTS[plan[case]](true, rng) if case in plan else true.force_n
    )
    cases = _cases(measured)
    flags: dict[_Case, set[Kind]] = {}
    for anomaly in _found(measured):
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


def _found(measured: WorldTraces) -> "list[Anomaly]":
    from fast.models.traces.anomalies import find_anomalies

    return find_anomalies(measured.features, _labels(measured))


def _clean_rows(world: "World", grasps: list[WorldGrasp]) -> Rows:
    """How often p-values against repeats are small, and grasps flagged, when nothing is wrong; a row per measure."""
    from fast.models.traces.anomalies import evidence_of, find_anomalies

    measured = measure_world(world, grasps)
    features, labels = measured.features, _labels(measured)
    n_flags = len({anomaly.place for anomaly in find_anomalies(features, labels)})
    rows: Rows = []
    for name, evidence in evidence_of(features, labels).items():
        below = {f"p_below_{limit:g}": float((evidence.p_of_repeats < limit).mean()) for limit in QUANTILES}
        rows.append({"measure": name, "n": len(evidence.p_value), "n_flagged": n_flags, **below})
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


def _by_measure(rows: Rows) -> Rows:
    """Means over worlds."""
    found: Rows = []
    for name in dict.fromkeys(row["measure"] for row in rows):
        own = [row for row in rows if row["measure"] == name]
        line = {"measure": name, "grasps": sum(row["n"] for row in own)}
        line |= {key: float(np.mean([row[key] for row in own])) for key in own[0] if key.startswith("p_below")}
        found.append(line | {"flagged_per_1000": 1e3 * sum(row["n_flagged"] for row in own) / line["grasps"]})
    return found
