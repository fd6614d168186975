"""Stand-ins for bench and simulator that answer at once, so that strategies can be compared over many seeds.

A landscape has a true mean force over the objects of every design, measured with noise, and a simulated one that is
related to it: scaled, shifted and with hills of its own, as a simulator with missing effects is.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from models.design.space import PARAMETERS, random_unit, snap
from models.scientist.acquisition.candidates import mutate, with_all_rib_counts
from models.scientist.surrogate.fit import fit_surrogate
from models.scientist.surrogate.observations import REAL, ObservationSet

N_DIMS = len(PARAMETERS)
Force = Callable[[np.ndarray], np.ndarray]  # m x 9 unit-cube points to m forces, N

_N_WAVES = 3
_N_FEATURES = 400
_SEARCH_SCALES = (0.2, 0.1, 0.05, 0.02, 0.01)


@dataclass(frozen=True)
class Landscape:
    """A world to search. Forces in N at unit-cube points (m x 9) whose rib counts are on a level.

    `real`: true mean force. `simulated`: what the simulator says. `noise_sd_n`: of one measured design.
    `failing_share`: of simulations that give nothing. `best_n`: largest true force, found by search.
    """

    name: str
    real: Force
    simulated: Force
    noise_sd_n: float
    failing_share: float
    best_n: float

    def fails(self, x: np.ndarray) -> np.ndarray:
        """Which designs the simulator cannot do, m: always the same ones."""
        phases = np.modf(np.abs(np.sin(x @ np.arange(1.0, N_DIMS + 1.0)) * 43758.5453))[0]
        return np.asarray(phases < self.failing_share)


def synthetic_landscape(seed: int, *, noise_sd_n: float = 0.5, failing_share: float = 0.03) -> Landscape:
    """Two hills on rough ground in nine dimensions, and a simulator that moves them and adds a false one.

    Made harder than smooth test functions on purpose: the better hill is the narrower one, the simulator's best designs
    are mediocre in reality, and its correlation with reality over random designs is 0.3 to 0.7.
    """
    rng = np.random.default_rng([seed, 20_262])
    centres = snap(rng.uniform(0.15, 0.85, (3, N_DIMS)))
    narrow, wide, false = (_metric(rng, width) for width in (1.9, 1.35, 1.5))
    shift = rng.normal(0.0, 0.12, N_DIMS)
    ground, simulated_ground = _waves(rng), _waves(rng)

    def real(x: np.ndarray) -> np.ndarray:
        return np.asarray(
            11.0 + 16.0 * _hill(x, centres[0], narrow) + 9.0 * _hill(x, centres[1], wide) + 0.8 * ground(x)
        )

    def simulated(x: np.ndarray) -> np.ndarray:
        hills = 12.0 * _hill(x, centres[0] - shift, 0.85 * narrow) + 7.0 * _hill(x, centres[1] + shift, wide)
        return np.asarray(4.0 + 0.55 * (hills + 13.0 * _hill(x, centres[2], false) + 0.8 * simulated_ground(x)))

    best_n = _largest(real, np.concatenate([centres, random_unit(20_000, rng)]), rng)
    return Landscape(f"synthetic {seed}", real, simulated, noise_sd_n, failing_share, best_n)


def emulated_landscape(data: ObservationSet, seed: int, *, noise_sd_n: float = 0.3) -> Landscape:
    """An emulator of simulated designs (`data`) as the simulator, and a smooth random gap as what reality adds.

    Reality saturates, as grippers of limited force do, and differs by a draw of a Gaussian process whose standard
    deviation is half the spread of the simulations.
    """
    rng = np.random.default_rng([seed, 36])
    as_real = ObservationSet(data.x, np.full(len(data), REAL), data.y, data.noise_variance)
    emulator = fit_surrogate(as_real)
    centre, spread = float(np.mean(data.y)), float(np.std(data.y))
    gap = _process_draw(rng, lengthscale=0.7)

    def simulated(x: np.ndarray) -> np.ndarray:
        return emulator.mean(x, REAL)

    def real(x: np.ndarray) -> np.ndarray:
        saturated = centre + 1.5 * spread * np.tanh((simulated(x) - centre) / (1.5 * spread))
        return np.asarray(0.8 * saturated + 0.5 * spread * gap(x))

    best_n = _largest(real, random_unit(20_000, rng), rng)
    return Landscape(f"emulated {seed}", real, simulated, noise_sd_n, 0.0, best_n)


def _metric(rng: np.random.Generator, width: float) -> np.ndarray:
    """Inverse widths of a hill as a slightly turned 9 x 9 matrix; some parameters hardly matter."""
    relevance = width * np.exp(rng.normal(0.0, 0.45, N_DIMS))
    turn = np.eye(N_DIMS) + 0.1 * rng.normal(size=(N_DIMS, N_DIMS))
    return np.asarray(turn * relevance)


def _hill(x: np.ndarray, centre: np.ndarray, metric: np.ndarray) -> np.ndarray:
    return np.asarray(np.exp(-0.5 * (((x - centre) @ metric.T) ** 2).sum(axis=1)))


def _waves(rng: np.random.Generator) -> Force:
    directions, phases = rng.normal(0.0, 0.5, (_N_WAVES, N_DIMS)), rng.uniform(0.0, 2.0 * np.pi, _N_WAVES)
    return lambda x: np.asarray(np.sin(2.0 * np.pi * x @ directions.T + phases).sum(axis=1))


def _process_draw(rng: np.random.Generator, lengthscale: float) -> Force:
    """A draw of a squared-exponential process with unit variance, by random Fourier features."""
    directions, phases = rng.normal(size=(N_DIMS, _N_FEATURES)) / lengthscale, rng.uniform(0, 2 * np.pi, _N_FEATURES)
    weights = rng.normal(size=_N_FEATURES) * np.sqrt(2.0 / _N_FEATURES)
    return lambda x: np.asarray(np.cos(x @ directions + phases) @ weights)


def _largest(force: Force, starts: np.ndarray, rng: np.random.Generator) -> float:
    """Largest force found by climbing from the best starts with shrinking steps."""
    best = starts[np.argsort(-force(starts))[:12]]
    for scale in np.repeat(_SEARCH_SCALES, 12):
        children = mutate(np.repeat(best, 60, axis=0), np.full(60 * len(best), scale), rng).reshape(len(best), 60, -1)
        ribs = with_all_rib_counts(best).reshape(len(best), -1, N_DIMS)
        litter = np.concatenate([best[:, None], children, ribs], axis=1)
        forces = force(litter.reshape(-1, N_DIMS)).reshape(len(best), -1)
        best = litter[np.arange(len(best)), forces.argmax(axis=1)]
    return float(force(best).max())
