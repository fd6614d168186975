"""What features of traces cost: the compiled pass over generated traces, and the update of a lake, as both grow."""

import tempfile
from functools import partial
from pathlib import Path

import numpy as np

from flows.benchmarks.base import Options, Rows, Tables, timed

SIZES = (1_000, 10_000, 100_000)
N_SAMPLES = 1_200
LIFT_MM = 75.0
N_CLOSING = 120
NOISE_SD_N = 0.12  # as worlds/quick.toml


def measure_features(options: Options) -> Tables:
    """CPU of the features of 1,000, 10,000 and 100,000 generated traces, and of a lake's; --grasps chooses."""
    sizes = options.grasps or SIZES
    return {"traces": _pass_rows(sizes, options), "lake": _lake_rows(sizes, options)}


def _pass_rows(sizes: tuple[int, ...], options: Options) -> Rows:
    """The compiled pass alone, over blocks as the lake's update hands them in; compiling is told apart."""
    from models.traces.batch import features_of_samples
    from tasks.traces.features import AT_ONCE

    lift_mm, force_n, offsets = generated_traces(min(max(sizes), AT_ONCE))
    _, first_s = timed(lambda: features_of_samples(lift_mm, force_n, offsets[:2]))
    options.tell(f"compiled or loaded in {first_s:.1f} s of CPU")
    rows: Rows = []
    for n in sizes:
        blocks = [min(AT_ONCE, n - start) for start in range(0, n, AT_ONCE)]
        passes = [partial(features_of_samples, lift_mm, force_n, offsets[: block + 1]) for block in blocks]
        cpu_s = sum(timed(work)[1] for work in passes)
        rows.append({"n_grasps": n, "samples": N_SAMPLES, "cpu_s": cpu_s, "cpu_s_per_1000": 1e3 * cpu_s / n})
    return rows


def generated_traces(n: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Lifts, forces and offsets of n traces end to end: push, rise, a sloping hold, fall, noise."""
    rng = np.random.default_rng(n)
    lift_mm = np.concatenate([np.zeros(N_CLOSING), np.linspace(0.0, LIFT_MM, N_SAMPLES - N_CLOSING)])
    peak_n, push_n, let_go_mm = rng.uniform(5, 35, (n, 1)), rng.uniform(0, 4, (n, 1)), rng.uniform(15, 50, (n, 1))
    hold = 1.0 / (1.0 + np.exp((lift_mm - let_go_mm) / 1.5))
    rise = 1.0 - np.exp(-lift_mm / 2.0)
    force_n = ((peak_n - 0.1 * lift_mm) * rise - push_n * np.exp(-lift_mm)) * hold
    force_n += rng.normal(0.0, NOISE_SD_N, force_n.shape)
    return np.tile(lift_mm, n), force_n.ravel(), N_SAMPLES * np.arange(n + 1)


def _lake_rows(sizes: tuple[int, ...], options: Options) -> Rows:
    """The update of a lake: reading the samples, the pass, rows, files; and again, when nothing is missing."""
    from flows.benchmarks.made_up_lake import fill
    from lake.store import Lake
    from tasks.traces.features import class_quality, update_features

    rows: Rows = []
    for n in sizes:
        with tempfile.TemporaryDirectory(prefix="fast-lake-") as folder:
            options.tell(f"{n} grasps: making the lake")
            root = Path(folder) / "lake"
            fill(root, n)
            lake = Lake.open(root)
            options.tell(f"{n} grasps: calculating")
            update, cpu_s = timed(partial(update_features, lake))
            _, again_s = timed(partial(update_features, lake))
            _, quality_s = timed(partial(class_quality, lake))
            size = sum(file.stat().st_size for file in root.glob("trace_features/*.parquet"))
            lake.close()
        rows.append(
            {
                "n_grasps": update.n_new,
                "update_cpu_s": cpu_s,
                "cpu_s_per_1000": 1e3 * cpu_s / n,
                "again_cpu_s": again_s,
                "quality_cpu_s": quality_s,
                "bytes_per_grasp": size / n,
            }
        )
    return rows
