"""The benchmarks by name: what a user runs on an own machine. Studies of the project are in `tests.studies`."""

from fast.flows.benchmarks.accuracy import measure_accuracy
from fast.flows.benchmarks.base import Benchmark, benchmark
from fast.flows.benchmarks.bench import measure_bench
from fast.flows.benchmarks.calibration import measure_calibration
from fast.flows.benchmarks.grasp import measure_grasp
from fast.flows.benchmarks.lake import measure_lake
from fast.flows.benchmarks.overhead import measure_overhead
from fast.flows.benchmarks.scientist import measure_scientist

_SIMULATED = ("designs", "objects", "results", "limit_minutes", "workers", "tiers")

BENCHMARKS: dict[str, Benchmark] = {
    "grasp": benchmark(measure_grasp, *_SIMULATED),
    "accuracy": benchmark(measure_accuracy, *_SIMULATED, "figure"),
    "scientist": benchmark(measure_scientist),
    "calibration": benchmark(measure_calibration, "n_sim", "n_real", "workers"),
    "bench": benchmark(measure_bench, "designs", "objects"),
    "lake": benchmark(measure_lake, "grasps"),
    "overhead": benchmark(measure_overhead),
}
