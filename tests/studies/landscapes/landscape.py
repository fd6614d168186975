"""Stand-ins for bench and simulators that answer at once, so that strategies can be compared over many seeds.

A landscape is a hidden truth of the stored bank: an emulator of the mean peaks that were simulated under it, measured
with scatter and noise, and emulators of the simulators that a strategy may ask.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np

from fast.models.design.space import FIN_RAYS, PARAMETERS, random_unit
from fast.models.scientist.acquisition.candidates import mutate
from fast.models.scientist.surrogate.fit import fit_surrogate
from fast.models.scientist.surrogate.observations import REAL, SIM, ObservationSet
from fast.models.scientist.surrogate.posterior import Surrogate
from tests.studies.landscapes.bank import BELIEVED, TRUE, LandscapeBank, Truth

N_DIMS = len(PARAMETERS)
Force = Callable[[np.ndarray], np.ndarray]  # m x 9 unit-cube points to m forces, N

# Moduli of prints scatter by 4 % (one sd); placement and reading add 0.3 N to a mean over the objects.
PRINT_SD, NOISE_SD_N = 0.04, 0.3
_SEARCH_SCALES = (0.2, 0.1, 0.05, 0.02, 0.01)


@dataclass(frozen=True)
class Landscape:
    """A world to search. Forces in N at unit-cube points (m x 9) whose rib counts are on a level.

    `real`: true mean force. `simulators`: what simulators say, by name. `best_n`: largest true force, found by search.
    """

    name: str
    real: Force
    simulators: Mapping[str, Force]
    best_n: float
    print_sd: float = PRINT_SD
    noise_sd_n: float = NOISE_SD_N

    def measure(self, x: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """Measured mean forces of one print of each design, N."""
        prints, noise = rng.normal(size=(2, len(x)))
        return np.asarray(self.real(x) * np.exp(self.print_sd * prints) + self.noise_sd_n * noise)


@lru_cache(maxsize=8)  # a worker races many seeds on the same landscape
def read_landscape(path: Path, number: int) -> Landscape:
    """The landscape of a truth in a file with a bank, by its number.

    Raises:
        UsageError: the file is no bank.
    """
    return landscape_of(LandscapeBank.read(path), number)


def landscape_of(bank: LandscapeBank, number: int) -> Landscape:
    """The landscape of a truth of the bank, by its number."""
    truth = bank.truths[number]
    believed = emulator_of(bank, None)
    simulators = {BELIEVED: believed, **{name: emulator_of(bank, truth, name) for name in truth.sets if name != TRUE}}
    real = emulator_of(bank, truth, TRUE)
    starts = np.concatenate([bank.believed.x, random_unit(20_000, np.random.default_rng(number))])
    best = find_best(real, starts, np.random.default_rng(number))
    return Landscape(bank.landscape_name(number), real, simulators, float(real(best[None])[0]))


def emulator_of(bank: LandscapeBank, truth: Truth | None, name: str = BELIEVED) -> Force:
    """Mean peaks of a set as a function: the posterior mean of a Gaussian process of their logarithm.

    Sets of a truth share what the more numerous believed simulations show of the designs (two fidelities).
    """
    surrogate = fit_surrogate(observations_of(bank, truth, name))
    return lambda x: _forces_n(surrogate, x)


def observations_of(bank: LandscapeBank, truth: Truth | None, name: str = BELIEVED) -> ObservationSet:
    """Logarithms of the mean peaks of a set, as real; for one of a truth those believed beside them, as simulated."""
    x, believed_n = bank.believed.x, bank.believed.y
    if truth is None:
        parts = [(x, believed_n, REAL)]
    else:
        parts = [(x, believed_n, SIM), (x[: bank.n_common], np.array(truth.sets[name], dtype=float), REAL)]
    all_x, all_n = np.concatenate([part[0] for part in parts]), np.concatenate([part[1] for part in parts])
    s = np.concatenate([np.full(len(part[1]), part[2]) for part in parts])
    usable = np.nan_to_num(all_n) > 0.0
    return ObservationSet(all_x[usable], s[usable], np.log(all_n[usable]), np.zeros(usable.sum()))


def emulator_error(bank: LandscapeBank, number: int, name: str) -> float:
    """Root mean square relative error of an emulator at the designs of its set, each left out in turn."""
    surrogate = fit_surrogate(observations_of(bank, bank.truths[number], name))
    left_out = surrogate.leave_one_out()
    is_real = surrogate.data.s == REAL
    return float(np.sqrt(np.mean((left_out.mean - surrogate.data.y)[is_real] ** 2)))


def _forces_n(surrogate: Surrogate, x: np.ndarray) -> np.ndarray:
    return np.asarray(np.exp(surrogate.mean(x, REAL)))


def find_best(force: Force, starts: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Point (9) of the largest force found by climbing from the best starts with shrinking steps."""
    best = starts[np.argsort(-force(starts))[:12]]
    for scale in np.repeat(_SEARCH_SCALES, 8):
        children = mutate(np.repeat(best, 40, axis=0), np.full(40 * len(best), scale), rng).reshape(len(best), 40, -1)
        ribs = FIN_RAYS.with_all_levels(best)
        litter = np.concatenate([best[:, None], children, ribs], axis=1)
        forces = force(litter.reshape(-1, N_DIMS)).reshape(len(best), -1)
        best = litter[np.arange(len(best)), forces.argmax(axis=1)]
    return np.asarray(best[force(best).argmax()])
