"""The benchmarks by name. Apart from the package: a study's worker processes need one of them, and its imports."""

from collections.abc import Callable

from flows.benchmarks.accuracy import measure_accuracy
from flows.benchmarks.anomalies import measure_anomalies
from flows.benchmarks.base import Benchmark, Options, Tables
from flows.benchmarks.bench import measure_bench
from flows.benchmarks.calibration import measure_calibration
from flows.benchmarks.calibration_agreement import measure_calibration_agreement
from flows.benchmarks.calibration_designs import measure_calibration_designs
from flows.benchmarks.calibration_peers import measure_calibration_peers
from flows.benchmarks.calibration_ranks import measure_calibration_ranks
from flows.benchmarks.calibration_traces import measure_calibration_traces
from flows.benchmarks.day import measure_day
from flows.benchmarks.fanout import measure_fanout
from flows.benchmarks.features import measure_features
from flows.benchmarks.gap import measure_gap
from flows.benchmarks.gap_sealed import measure_gap_sealed
from flows.benchmarks.gap_truth import measure_gap_truth
from flows.benchmarks.grasp import measure_grasp
from flows.benchmarks.identification import measure_identification
from flows.benchmarks.kills import measure_host_kills, measure_kills
from flows.benchmarks.lake import measure_lake
from flows.benchmarks.object_store import measure_object_store
from flows.benchmarks.overhead import measure_overhead
from flows.benchmarks.robustness import measure_robustness
from flows.benchmarks.scale import measure_scale
from flows.benchmarks.scientist import measure_scientist
from flows.benchmarks.server_kills import measure_server_kills
from flows.benchmarks.server_size import measure_server_size
from flows.benchmarks.traces import measure_traces

_SAMPLE = frozenset({"designs", "objects"})
_STUDY = _SAMPLE | {"results", "limit_minutes", "workers"}


def _fixed(measure: Callable[[], Tables]) -> Benchmark:
    """A benchmark without options."""
    return Benchmark(lambda options: measure(), about=_first_line(measure))


def _sampled(measure: Callable[[Options], Tables], options: frozenset[str]) -> Benchmark:
    return Benchmark(measure, options, _first_line(measure))


def _first_line(measure: Callable[..., Tables]) -> str:
    return (measure.__doc__ or "").strip().partition("\n")[0]


BENCHMARKS: dict[str, Benchmark] = {
    "grasp": _sampled(measure_grasp, _STUDY | {"tiers"}),
    "accuracy": _sampled(measure_accuracy, _STUDY | {"tiers"}),
    "robustness": _sampled(measure_robustness, _STUDY | {"tiers"}),
    "fanout": _sampled(measure_fanout, _SAMPLE | {"workers"}),
    "gap": _sampled(measure_gap, _SAMPLE | {"results", "limit_minutes", "worlds"}),
    "gap-sealed": _sampled(measure_gap_sealed, _SAMPLE | {"results", "limit_minutes", "worlds"}),
    "gap-truth": _sampled(measure_gap_truth, _STUDY),
    "traces": _sampled(measure_traces, _SAMPLE | {"figure"}),
    "calibration-traces": _sampled(measure_calibration_traces, _STUDY | {"figure", "worlds"}),
    "scientist": _sampled(measure_scientist, frozenset({"figure", "limit_minutes"})),
    "calibration": _sampled(measure_calibration, frozenset({"n_sim", "n_real", "workers"})),
    "calibration-agreement": _sampled(
        measure_calibration_agreement, frozenset({"n_sim", "n_real", "results", "workers"})
    ),
    "calibration-designs": _sampled(measure_calibration_designs, frozenset({"worlds"})),
    "calibration-ranks": _sampled(
        measure_calibration_ranks, frozenset({"worlds", "results", "limit_minutes", "workers", "figure"})
    ),
    "lake": _sampled(measure_lake, frozenset({"grasps"})),
    "features": _sampled(measure_features, frozenset({"grasps"})),
    "identification": _sampled(measure_identification, _SAMPLE | frozenset({"results", "limit_minutes", "figure"})),
    "anomalies": _sampled(measure_anomalies, _SAMPLE | frozenset({"results", "limit_minutes", "worlds"})),
    "object-store": _fixed(measure_object_store),
    "bench": _sampled(measure_bench, _SAMPLE),
    "kills": _sampled(measure_kills, frozenset({"n"})),
    "calibration-peers": _sampled(measure_calibration_peers, frozenset({"results", "worlds"})),
    "host-kills": _sampled(measure_host_kills, frozenset({"n"})),
    "day": _sampled(measure_day, frozenset({"figure"})),
    "scale": _sampled(measure_scale, frozenset({"workers"})),
    "overhead": _sampled(measure_overhead, frozenset()),
    "server-size": _sampled(measure_server_size, frozenset({"n"})),
    "server-kills": _sampled(measure_server_kills, frozenset({"n", "results", "limit_minutes"})),
}
