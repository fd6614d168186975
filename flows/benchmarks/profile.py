"""Where the time of a grasp goes: own time of every function of the simulator."""

import cProfile
import pstats
from pathlib import Path
from typing import Any

import models
from flows.benchmarks.base import Options, Rows, Tables
from flows.benchmarks.tiers import version_of
from models.design.space import numbered_design
from models.objects.catalogue import get_object

TIERS = ("production", "screening")
N_DESIGNS = 3
PROFILE_OBJECTS = (1, 14, 24, 30)  # sphere, tube, cone, cube
SHOWN_SHARE = 0.01


def measure_profile(options: Options) -> Tables:
    """CPU time of a grasp by function: compiled kernels count for the function that calls them."""
    return {tier: _functions(options, tier) for tier in options.tiers or TIERS}


def _functions(options: Options, tier: str) -> Rows:
    from models.simulation.grasp import simulate_grasp

    version, objects = version_of(tier), [get_object(number) for number in options.objects or PROFILE_OBJECTS]
    designs = [numbered_design(number) for number in range(options.designs or N_DESIGNS)]
    simulate_grasp(designs[0], objects[0], version)  # compiled kernels are loaded once
    profiler = cProfile.Profile()
    profiler.enable()
    for design in designs:
        for obj in objects:
            simulate_grasp(design, obj, version)
    profiler.disable()
    return _rows(pstats.Stats(profiler), len(designs) * len(objects))


def _rows(stats: pstats.Stats, n_grasps: int) -> Rows:
    """Own time of the functions of `models` above `SHOWN_SHARE`; everything else (numpy, Python) in one row."""
    root = Path(models.__file__).parent
    times = [(own_s, file, name, calls) for (file, _, name), (_, calls, own_s, _, _) in _entries(stats).items()]
    total_s = sum(entry[0] for entry in times)
    rows: Rows = [
        {
            "module": str(Path(file).relative_to(root.parent)),
            "function": name,
            "calls": calls / n_grasps,
            "ms": 1e3 * own_s / n_grasps,
            "share": own_s / total_s,
        }
        for own_s, file, name, calls in sorted(times, reverse=True)
        if file.startswith(str(root)) and own_s >= SHOWN_SHARE * total_s
    ]
    rest = 1.0 - sum(row["share"] for row in rows)
    total_ms = 1e3 * total_s / n_grasps
    rows.append({"module": "", "function": "all else", "calls": None, "ms": rest * total_ms, "share": rest})
    return [*rows, {"module": "", "function": "all", "calls": None, "ms": total_ms, "share": 1.0}]


def _entries(stats: pstats.Stats) -> dict[tuple[str, int, str], tuple[int, int, float, float, Any]]:
    """(file, line, function) -> (primitive calls, calls, own s, cumulated s, callers); not in the type stubs."""
    return vars(stats)["stats"]
