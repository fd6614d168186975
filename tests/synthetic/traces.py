"""Made-up traces with a known answer: a closed-form grasp whose force has a frictional and a normal part.

The frictional part holds from the start of the lift, the normal part pushes the object out or draws it in late, so
that traces tell friction from modulus and their peaks hardly do: the structure of the simulator's own traces.
"""

from dataclasses import dataclass

import numpy as np

from models.calibration.traces.problem import TraceProblem, numerical_shares
from models.calibration.traces.theta_grid import ThetaGrid
from models.records import Trace
from models.traces.step_features import FEATURES, features_of_steps, step_means
from models.traces.step_noise import SensorNoise, feature_noise

MODULUS_MPA = 10.0
LIFT_SPEED_MM_PER_S = 5.0
_LIFT_MM = np.linspace(0.0, 60.0, 241)


@dataclass(frozen=True)
class TraceTruth:
    """What made-up measurements hide; scatters are relative."""

    theta: tuple[float, float, float] = (9.2, 0.62, 0.43)
    tool_sd: float = 0.04
    object_sd: float = 0.0
    cell_sd: float = 0.0
    repeat_sd: float = 0.01
    noise: SensorNoise = SensorNoise(sd_n=0.12, correlation_s=0.05, rate_hz=80.0)


def made_up_traces(
    n_tools: int,
    n_objects: int,
    seed: int,
    truth: TraceTruth = TraceTruth(),
    *,
    n_repeats: int = 3,
) -> TraceProblem:
    """A problem with the grid's simulations of every tool and object and noisy repeats of the truth."""
    rng = np.random.default_rng(seed)
    shapes = np.random.default_rng(1).uniform(size=(n_tools, n_objects, 4))
    grid = np.array(ThetaGrid().points)
    simulated = np.array([_steps(shapes, np.array([MODULUS_MPA, *point])) for point in grid])
    modulus = truth.theta[0] * np.exp(truth.tool_sd * rng.standard_normal((n_tools, 1)))
    true = _steps(shapes, np.array(truth.theta)) / truth.theta[0] * modulus[..., None]
    amplitude = np.abs(true).max(axis=-1, keepdims=True)
    offsets = truth.object_sd * _smooth(rng, (1, n_objects)) + truth.cell_sd * _smooth(rng, (n_tools, n_objects))
    true = true + amplitude * offsets
    bias, noise = _noise(true, truth.noise)
    measured = []
    for _ in range(n_repeats):
        factor = np.exp(truth.repeat_sd * rng.standard_normal((n_tools, n_objects, 1)))
        measured.append(features_of_steps(factor * true + _sensor(rng, true.shape, truth.noise)) - bias)
    return TraceProblem(
        tools=tuple(f"T{tool}" for tool in range(n_tools)),
        objects=tuple(str(number) for number in range(n_objects)),
        features=FEATURES,
        grid=grid,
        modulus_mpa=MODULUS_MPA,
        simulated=np.moveaxis(features_of_steps(simulated), 0, 2),
        measured=np.stack(measured, axis=2),
        noise=noise,
        n_averaged=np.ones((n_tools, n_objects), dtype=int),
        numerical=numerical_shares(FEATURES),
    )


def _steps(shapes: np.ndarray, theta: np.ndarray) -> np.ndarray:
    """Step means of the traces (... x 120) of shapes (... x 4) at theta."""
    return np.array([[step_means(made_up_trace(shape, theta)) for shape in row] for row in shapes])


def made_up_trace(shape: np.ndarray, theta: np.ndarray) -> Trace:
    """Lift of a made-up grasp: `shape` (4) in the unit cube is what tool and object make of it; theta as `THETA`."""
    modulus_mpa, friction, ratio = theta
    stiffness = modulus_mpa / 10.0 * (4.0 + 16.0 * shape[0]) * (1.0 + 0.5 * (ratio - 0.35)) / (1.0 - ratio**2)
    z, length = _LIFT_MM, 30.0 + 20.0 * shape[1]
    hold = np.clip(1.0 - z / length, 0.0, None) ** (0.3 + shape[2])
    push = np.exp(-(((z - 0.7 * length) / 6.0) ** 2)) * (0.5 + ratio) - 0.3 * (1.0 - 2 * shape[3]) * np.exp(-z / 5.0)
    force = stiffness * hold * friction / (0.6 + friction) - 0.3 * stiffness * push * (z < length)
    return Trace(np.arange(len(z), dtype=float), z, force)


def _smooth(rng: np.random.Generator, shape: tuple[int, int]) -> np.ndarray:
    """Smooth random curves over the steps with unit standard deviation, shape x 120."""
    draws = rng.standard_normal((*shape, 5))
    phase = np.linspace(0.0, np.pi, 120) * np.arange(5)[:, None]
    return np.asarray(draws @ np.cos(phase) / np.sqrt(3.0))


def _noise(steps_n: np.ndarray, noise: SensorNoise) -> tuple[np.ndarray, np.ndarray]:
    t, o, n = steps_n.shape
    bias, covariance = feature_noise(steps_n.reshape(-1, n), noise, LIFT_SPEED_MM_PER_S)
    return bias.reshape(t, o, -1), covariance.reshape(t, o, *covariance.shape[1:])


def _sensor(rng: np.random.Generator, shape: tuple[int, ...], noise: SensorNoise) -> np.ndarray:
    """Sensor noise of step means."""
    covariance = noise.step_covariance(shape[-1], LIFT_SPEED_MM_PER_S)
    return rng.multivariate_normal(np.zeros(shape[-1]), covariance, size=shape[:-1], method="cholesky")
