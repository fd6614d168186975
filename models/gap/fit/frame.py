"""Theta, tools and numerical error calibrated again on training grasps: the frame in which a gap is looked at."""

from collections.abc import Sequence

import numpy as np

from models.gap.bank.predict import Predictor
from models.gap.fit.fit import Fit, Fitter
from models.gap.fit.whiten import working
from models.gap.problem import GapProblem
from models.records import EffectValue

_N_FRICTION, _N_RATIO = 9, 4
_ROUNDS = 2  # errors are judged at the first estimate, then at the fit


def recalibrated(problem: GapProblem, effects: Sequence[EffectValue] = ()) -> Fit:
    """The fit of theta, tools, numerical error and the parameters of effects to a training problem."""
    predictor = Predictor.of(problem)
    theta = first_estimate(predictor, effects)
    tool_factor = np.ones(len(problem.grasps.tools))
    starts = [theta, _middle(predictor, effects)]
    for _ in range(_ROUNDS):
        predicted_n = predictor.with_lead(theta, effects, tool_factor)
        data = working(problem, predictor, predicted_n, theta[0] / predictor.centre.young_modulus_mpa)
        fit = min((Fitter(data, start, effects).fit() for start in starts), key=lambda found: found.loss)
        theta, tool_factor, effects = fit.theta, fit.tool_factor, fit.effects
        starts = [theta]
    return fit


def first_estimate(predictor: Predictor, effects: Sequence[EffectValue] = ()) -> np.ndarray:
    """Least squares of step means over a lattice of friction and Poisson ratio, with the best modulus at each (3)."""
    lower, upper = predictor.surfaces.lower, predictor.surfaces.upper
    lattice = [
        _with_modulus(predictor, effects, friction, ratio)
        for friction in np.linspace(lower[0], upper[0], _N_FRICTION)
        for ratio in np.linspace(lower[1], upper[1], _N_RATIO)
    ]
    return min(lattice, key=lambda found: found[1])[0]


def _middle(predictor: Predictor, effects: Sequence[EffectValue]) -> np.ndarray:
    """The bank's friction and Poisson ratio with the best modulus (3): what is plausible, however large the gap."""
    centre = predictor.centre
    return _with_modulus(predictor, effects, centre.friction, centre.poisson_ratio)[0]


def _with_modulus(
    predictor: Predictor, effects: Sequence[EffectValue], friction: float, ratio: float
) -> tuple[np.ndarray, float]:
    """Theta with the modulus that fits the step means best, and the squares that are left."""
    measured, modulus_mpa = predictor.grasps.steps_n, predictor.centre.young_modulus_mpa
    scale = np.abs(measured).max(axis=1, keepdims=True)
    weight = 1.0 / np.maximum(scale, 0.2 * np.median(scale)) ** 2
    predicted = predictor.steps(np.array([modulus_mpa, friction, ratio]), effects)
    gain = max(float((weight * measured * predicted).sum() / (weight * predicted**2).sum()), 1e-3)
    left = float((weight * (measured - gain * predicted) ** 2).sum())
    return np.array([gain * modulus_mpa, friction, ratio]), left
