"""Which inputs matter: permutation relevance, beside inverse lengthscales.

An inverse lengthscale says how fast a process bends along an input, and overrates inputs that bend it without moving
it far (Paananen et al. 2019). The relevance here is the share of the variance of the posterior mean f that is lost
when an input is known no more:

    R_j = E[(f(z) - f(z with column j permuted))^2] / (2 Var f(z)).

For independent inputs it is the total Sobol index (Jansen 1999), and the VAR relevance of Paananen et al. averaged over
the data; shares add up to more than 1 where inputs act together.
"""

from collections.abc import Callable

import numpy as np

from models.calibration.means.predict import DrawnModel

N_POINTS = 256


def permutation_relevance(
    predict: Callable[[np.ndarray], np.ndarray], inputs: np.ndarray, rng: np.random.Generator
) -> np.ndarray:
    """Relevance of each column of `inputs` (n x d) for a function of them that returns n values, d."""
    values = predict(inputs)
    spread = float(np.var(values))
    relevance = np.zeros(inputs.shape[1])
    if spread <= 0:
        return relevance
    for column in range(inputs.shape[1]):
        shuffled = inputs.copy()
        # A shift in a random order leaves no row in its place.
        order = rng.permutation(len(inputs))
        shuffled[order, column] = inputs[np.roll(order, 1), column]
        relevance[column] = 0.5 * np.mean((values - predict(shuffled)) ** 2) / spread
    return relevance


def emulator_relevance(model: DrawnModel, rng: np.random.Generator) -> np.ndarray:
    """Relevance of the simulator's inputs at up to `N_POINTS` of the simulations, d: nine of a design, then theta."""
    z = model.emulator.data.z_sim
    points = z[rng.permutation(len(z))[:N_POINTS]]
    return permutation_relevance(model.emulator.mean, points, rng)


def discrepancy_relevance(model: DrawnModel, rng: np.random.Generator) -> np.ndarray:
    """Relevance of the design's parameters for the discrepancy, at the measured designs, 9."""
    return permutation_relevance(model.discrepancy_mean, model.emulator.data.x_real, rng)
