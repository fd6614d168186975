"""Grasps at several setups in one fit: what a second speed and a wait tell that grasps of one kind cannot."""

from dataclasses import replace

import numpy as np
import pytest

from fast.models.gap.data import GapData
from fast.models.gap.fit.recalibrate import recalibrate
from fast.models.records import EffectValue, GraspSetup
from fast.models.traces.step_features import N_STEPS
from tests.synthetic.gap import made_up_gap

THETA = np.array([9.2, 0.66, 0.43])
FASTER, WAITING = GraspSetup(lift_speed_mm_per_s=20.0), GraspSetup(dwell_s=10.0)


def measured(effect: EffectValue, *others: GraspSetup) -> GapData:
    """Grasps of five tools on five objects by the surrogate itself, with noise; every third at one of the others."""
    data = made_up_gap(5, 5, 0)
    grasps = data.grasps
    n, rng = len(grasps.tool), np.random.default_rng(3)
    setup = np.where(np.arange(n) % 3 == 0, 1 + np.arange(n) % len(others), 0) if others else grasps.setup
    grasps = replace(grasps, setups=(*grasps.setups, *others), setup=setup)
    steps_n = replace(data, grasps=grasps).surrogate.predict_steps(THETA, [effect])
    for number, own in enumerate(grasps.setups):
        covariance = grasps.noise.step_covariance(N_STEPS, own.lift_speed_mm_per_s)
        rows = np.flatnonzero(setup == number)
        steps_n[rows] += rng.multivariate_normal(np.zeros(N_STEPS), covariance, len(rows))
    return replace(data, grasps=replace(grasps, steps_n=steps_n))


@pytest.mark.parametrize(
    ("effect", "other", "at_most"),
    [
        (EffectValue(effect="load_cell_lag", parameters={"time_constant_s": 0.1}), FASTER, 0.7),
        (
            EffectValue(effect="stress_relaxation", parameters={"relaxed_share": 0.15, "time_constant_s": 8.0}),
            WAITING,
            0.7,
        ),
    ],
)
def test_another_setting_shortens_the_interval(effect: EffectValue, other: GraspSetup, at_most: float) -> None:
    """As many grasps, a third of them otherwise: the effect's first parameter is known better, and rightly."""
    start = effect.model_copy(update={"parameters": {k: 0.7 * v for k, v in effect.parameters.items()}})
    sds = []
    for others in ((), (other,)):
        fit = recalibrate(measured(effect, *others).training, [start])
        place = len(fit.columns) - fit.n_effect_columns
        sds.append(float(np.sqrt(fit.deflated_covariance[place, place])))
    assert sds[1] < at_most * sds[0]
    name, true = next(iter(effect.parameters.items()))
    assert fit.effects[0].parameters[name] == pytest.approx(true, rel=0.15)
