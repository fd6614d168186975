"""Theta, tools and numerical error calibrated again on training grasps: the frame in which a gap is looked at."""

from collections.abc import Sequence

import numpy as np

from models.gap.fit import Fit, Fitter
from models.gap.predict import Predictor
from models.gap.problem import GapProblem
from models.gap.working import working
from models.records import EffectValue

_N_FRICTION, _N_RATIO = 9, 4
_ROUNDS = 2  # errors are judged at the first estimate, then at the fit


def recalibrated(problem: GapProblem, effects: Sequence[EffectValue] = ()) -> Fit:
    """The fit of theta, tools, numerical error and the parameters of effects to a training problem."""
    predictor = Predictor.of(problem)
    theta = first_estimate(problem, predictor, effects)
    tool_factor = np.ones(len(problem.grasps.tools))
    for _ in range(_ROUNDS):
        predicted_n = predictor.steps(theta, effects, tool_factor)
        data = working(problem, predictor, predicted_n, theta[0] / predictor.centre.young_modulus_mpa)
        fit = Fitter(data, theta, effects).fit()
        theta, tool_factor, effects = fit.theta, fit.tool_factor, fit.effects
    return fit


def first_estimate(problem: GapProblem, predictor: Predictor, effects: Sequence[EffectValue] = ()) -> np.ndarray:
    """Least squares of step means over a lattice of friction and Poisson ratio, with the best modulus at each (3)."""
    measured, surfaces = problem.grasps.steps_n, predictor.surfaces
    scale = np.abs(measured).max(axis=1, keepdims=True)
    weight = 1.0 / np.maximum(scale, 0.2 * np.median(scale)) ** 2
    best, lowest = np.array([predictor.centre.young_modulus_mpa, *surfaces.lower]), np.inf
    for friction in np.linspace(surfaces.lower[0], surfaces.upper[0], _N_FRICTION):
        for ratio in np.linspace(surfaces.lower[1], surfaces.upper[1], _N_RATIO):
            predicted = predictor.steps(np.array([predictor.centre.young_modulus_mpa, friction, ratio]), effects)
            gain = max(float((weight * measured * predicted).sum() / (weight * predicted**2).sum()), 1e-3)
            misfit = float((weight * (measured - gain * predicted) ** 2).sum())
            if misfit < lowest:
                best, lowest = np.array([gain * predictor.centre.young_modulus_mpa, friction, ratio]), misfit
    return best
