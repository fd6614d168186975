"""The studies by name. Their worker processes need one of them, so nothing but the runner imports this file."""

from tests.studies.benchmarks.accuracy import measure_accuracy
from tests.studies.benchmarks.base import Benchmark, benchmark
from tests.studies.benchmarks.bench import measure_bench
from tests.studies.benchmarks.calibration import measure_calibration
from tests.studies.benchmarks.grasp import measure_grasp
from tests.studies.benchmarks.lake import measure_lake
from tests.studies.benchmarks.overhead import measure_overhead
from tests.studies.benchmarks.scientist import measure_scientist
from tests.studies.calibration.ranks import measure_calibration_ranks
from tests.studies.calibration.traces import measure_calibration_traces
from tests.studies.challenge.study import measure_challenge
from tests.studies.crash.aimed import measure_aimed_kills
from tests.studies.crash.kills import measure_host_kills, measure_kills
from tests.studies.crash.server_kills import measure_server_kills
from tests.studies.gap.ask import measure_asking
from tests.studies.gap.development import measure_gap
from tests.studies.gap.independent import measure_gap_independent
from tests.studies.gap.intervals import measure_gap_intervals
from tests.studies.gap.moduli import measure_moduli
from tests.studies.gap.sealed import measure_gap_sealed
from tests.studies.gap.shapes import measure_gap_shapes
from tests.studies.gap.truth import measure_gap_truth
from tests.studies.landscapes.compare import measure_landscapes
from tests.studies.landscapes.make_bank import measure_landscape_bank
from tests.studies.landscapes.robust import measure_robust
from tests.studies.platform.day import measure_day
from tests.studies.platform.environments import measure_environments
from tests.studies.platform.feature_pairs import measure_feature_pairs
from tests.studies.platform.page_cost import measure_page_cost
from tests.studies.platform.page_pace import measure_page_pace
from tests.studies.platform.page_story import measure_page_story
from tests.studies.platform.paper_schedule import measure_paper_schedule
from tests.studies.platform.pictures import measure_pictures
from tests.studies.scientist.insights import measure_insights
from tests.studies.scientist.lab_world import measure_lab_world
from tests.studies.simulation.robustness import measure_robustness
from tests.studies.simulation.slopes import measure_slopes
from tests.studies.traces.anomalies import measure_anomalies
from tests.studies.traces.identification import measure_identification
from tests.studies.traces.told_slips import measure_told_slips

_KEPT = ("designs", "objects", "results", "limit_minutes")
_SIMULATED = (*_KEPT, "workers", "tiers")

STUDIES: dict[str, Benchmark] = {
    "grasp": benchmark(measure_grasp, *_SIMULATED),
    "accuracy": benchmark(measure_accuracy, *_SIMULATED, "figure"),
    "scientist": benchmark(measure_scientist),
    "calibration": benchmark(measure_calibration, "n_sim", "n_real", "workers"),
    "bench": benchmark(measure_bench, "designs", "objects"),
    "lake": benchmark(measure_lake, "grasps"),
    "overhead": benchmark(measure_overhead),
    "robustness": benchmark(measure_robustness, *_KEPT, "workers"),
    "slopes": benchmark(measure_slopes, "objects", "figure"),
    "gap-truth": benchmark(measure_gap_truth, *_KEPT, "workers"),
    "gap": benchmark(measure_gap, "results", "limit_minutes", "worlds", "workers"),
    "gap-ask": benchmark(measure_asking, "worlds", "results"),
    "gap-independent": benchmark(measure_gap_independent, "results", "limit_minutes", "worlds"),
    "gap-intervals": benchmark(measure_gap_intervals, "results", "limit_minutes", "worlds", "workers"),
    "gap-sealed": benchmark(measure_gap_sealed, "results", "limit_minutes", "worlds", "workers"),
    "gap-shapes": benchmark(measure_gap_shapes, "panel", "results", "worlds", "workers", "n"),
    "gap-moduli": benchmark(measure_moduli, "panel"),
    "challenge": benchmark(measure_challenge, "results", "worlds", "figure"),
    "calibration-ranks": benchmark(
        measure_calibration_ranks, "worlds", "results", "limit_minutes", "workers", "figure"
    ),
    "calibration-traces": benchmark(measure_calibration_traces, *_KEPT, "workers", "figure", "worlds"),
    "insights": benchmark(measure_insights, "n", "results", "limit_minutes"),
    "lab-world": benchmark(measure_lab_world, "designs", "objects", "results", "n"),
    "landscapes": benchmark(measure_landscapes, "n", "results", "workers", "figure"),
    "robust": benchmark(measure_robust, "n", "workers"),
    "landscape-bank": benchmark(measure_landscape_bank, "results", "limit_minutes"),
    "identification": benchmark(measure_identification, *_KEPT, "figure"),
    "anomalies": benchmark(measure_anomalies, *_KEPT, "worlds"),
    "told-slips": benchmark(measure_told_slips, *_KEPT, "worlds"),
    "kills": benchmark(measure_kills, "n"),
    "aimed-kills": benchmark(measure_aimed_kills, "n"),
    "host-kills": benchmark(measure_host_kills, "n"),
    "server-kills": benchmark(measure_server_kills, "n", "results", "limit_minutes"),
    "day": benchmark(measure_day, "figure"),
    "page-cost": benchmark(measure_page_cost),
    "page-pace": benchmark(measure_page_pace, "n"),
    "page-story": benchmark(measure_page_story, "figure"),
    "pictures": benchmark(measure_pictures, "figure"),
    "environments": benchmark(measure_environments, "n", "results", "workers", "limit_minutes"),
    "feature-pairs": benchmark(measure_feature_pairs, "n", "results"),
    "paper-schedule": benchmark(measure_paper_schedule, "results", "limit_minutes", "figure"),
}
