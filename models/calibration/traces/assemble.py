"""A trace-level problem from traces: features of what was measured and simulated, and their noise."""

from collections.abc import Mapping, Sequence

import numpy as np

from models.calibration.traces.problem import TraceProblem, numerical_shares
from models.errors import UsageError
from models.records import Trace
from models.traces.step_features import FEATURES, N_STEPS, features_of_steps, step_means
from models.traces.step_noise import SensorNoise, feature_noise

Cell = tuple[str, str]  # (tool, object)
GridPoint = tuple[float, float]  # (friction, Poisson ratio)


def trace_problem(
    measured: Mapping[Cell, Sequence[Trace]],
    simulated: Mapping[Cell, Mapping[GridPoint, Trace]],
    *,
    modulus_mpa: float,
    noise: SensorNoise,
    lift_speed_mm_per_s: float,
) -> TraceProblem:
    """The problem of measured repeats and simulations of the same tools and objects.

    `simulated` are all of Young's modulus `modulus_mpa`, with the tool's design; a grid point without a trace has
    failed. Peaks and dips are freed of the bias that sensor noise gives them.

    Raises:
        UsageError: nothing was measured, a trace has no lift, or a cell has too few simulations.
    """
    tools, objects = sorted({tool for tool, _ in measured}), sorted({name for _, name in measured}, key=_number_first)
    grid = sorted({point for points in simulated.values() for point in points})
    n_repeats = max((len(traces) for traces in measured.values()), default=0)
    if n_repeats == 0 or not grid:
        raise UsageError("there are no measured traces with simulations of the same design and object; make either.")
    shape = (len(tools), len(objects))
    f = len(FEATURES)
    seen, known = np.full((*shape, n_repeats, f), np.nan), np.full((*shape, len(grid), f), np.nan)
    mean_steps = np.zeros((*shape, N_STEPS))
    for t, tool in enumerate(tools):
        for o, name in enumerate(objects):
            repeats, points = measured.get((tool, name), ()), simulated.get((tool, name), {})
            for k, point in enumerate(grid):
                if point in points:
                    known[t, o, k] = _named(tool, name, "simulated", [points[point]])[0][0]
            if repeats:
                seen[t, o, : len(repeats)], mean_steps[t, o] = _named(tool, name, "measured", repeats)
    bias, covariance = feature_noise(mean_steps.reshape(-1, mean_steps.shape[-1]), noise, lift_speed_mm_per_s)
    return TraceProblem(
        tools=tuple(tools),
        objects=tuple(objects),
        features=FEATURES,
        grid=np.array(grid),
        modulus_mpa=modulus_mpa,
        simulated=known,
        measured=seen - bias.reshape(*shape, 1, f),
        noise=covariance.reshape(*shape, f, f),
        n_averaged=np.ones(shape, dtype=int),
        numerical=numerical_shares(FEATURES),
    )


def _named(tool: str, name: str, kind: str, traces: Sequence[Trace]) -> tuple[np.ndarray, np.ndarray]:
    """Features of the traces of a cell (n x f) and the mean of their steps.

    Raises:
        UsageError: as `step_means`, with the name of the cell.
    """
    try:
        steps = np.array([step_means(trace) for trace in traces])
    except UsageError as error:
        raise UsageError(f"{kind} grasps of tool {tool} on object {name}: {error}") from error
    return features_of_steps(steps), steps.mean(axis=0)


def _number_first(name: str) -> tuple[int, str]:
    return (int(name) if name.isdecimal() else 0, name)
