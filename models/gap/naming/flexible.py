"""A flexible discrepancy: whatever is linear in design, object, order and the simulated force, phase by phase.

It names nothing; it says how much of a gap could be predicted for designs and object classes that were left out, if one
did not ask why. Its columns join those of a fit, so that it is scored as an effect is.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from models.design.space import to_unit
from models.gap.fit.fit import Fit
from models.gap.fit.whiten import IS_LIFT
from models.gap.problem import Grasps
from models.objects.catalogue import get_object
from models.objects.primitives import bounds

COEFFICIENT_SDS = (0.006, 0.0015)  # of the amplitude, for one standard deviation of an input: two stiffnesses


def flexible(fit: Fit) -> Sequence[Fit]:
    """The fit with columns of the flexible discrepancy added, at its two stiffnesses."""
    columns = fit.working.whitened(_columns(fit)) * fit.weight
    nothing = np.zeros(len(columns))
    return [
        replace(
            fit,
            columns=np.concatenate([fit.columns, columns]),
            precision=np.concatenate([fit.precision, np.full(len(columns), sd**-2.0)]),
            pull=np.concatenate([fit.pull, nothing]),
        )
        for sd in COEFFICIENT_SDS
    ]


def inputs_of(grasps: Grasps) -> np.ndarray:
    """What is known of each grasp besides its simulation, standardised, m x inputs, less what never varies.

    Nine design parameters; sizes of the object along x, y, z and its edge radius; whether it is a repeat, which one;
    grasps of the tool before, of the batch before.
    """
    sizes = []
    for number in grasps.objects:
        obj = get_object(number)
        low, high = bounds(obj.primitives)
        sizes.append([*(high - low), obj.parameters.get("rounding_mm", 0.0)])
    order = [[min(c.repeat, 1), c.repeat, c.tool_grasps, c.batch_grasps] for c in grasps.contexts]
    rows = np.concatenate(
        [to_unit(grasps.designs)[grasps.tool], np.array(sizes)[grasps.obj], np.array(order, float)], axis=1
    )
    sd = rows.std(axis=0)
    return np.asarray(((rows - rows.mean(axis=0)) / np.maximum(sd, 1e-12))[:, sd > 1e-9])


def _columns(fit: Fit) -> np.ndarray:
    """Columns (c x m x f), in the units of the features: responses of the force, and phases, times inputs."""
    known = inputs_of(fit.working.predictor.grasps)
    inputs = np.concatenate([np.ones((len(known), 1)), known], axis=1).T
    responses = np.concatenate([_responses(fit), _phases(fit)])
    return np.asarray((responses[:, None] * inputs[None, :, :, None]).reshape(-1, *responses.shape[1:]))


def _responses(fit: Fit) -> np.ndarray:
    """What a force may answer with at every phase, r x m x f: curved in itself, its slope over the lift, a constant."""
    force, amplitude = np.where(IS_LIFT, 0.0, fit.modelled), fit.working.amplitude
    slope = np.where(IS_LIFT, 0.0, np.gradient(force, axis=1))
    constant = np.where(IS_LIFT, 0.0, np.full_like(force, np.median(amplitude)))
    return np.stack([force, force * np.abs(force) / amplitude, slope, constant])


def _phases(fit: Fit) -> np.ndarray:
    """The amplitude of each feature by itself, f x m x f."""
    f = fit.modelled.shape[1]
    return np.eye(f)[:, None, :] * fit.working.amplitude[None]
