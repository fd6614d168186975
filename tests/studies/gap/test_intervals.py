"""The study of intervals: the catalogue's own laws act on true grasps, and intervals are compared with them."""

from pathlib import Path

import numpy as np
import pytest

from fast.flows.challenge.hidden.lab_laws import Moment
from fast.flows.challenge.hidden.panel_file import read_small
from fast.flows.challenge.hidden.worlds import Worlds
from fast.models.calibration.inference.settings import CalibrationSettings
from fast.models.gap.fit import posterior
from fast.models.records import EffectValue, GraspContext, Trace
from tests.studies.gap.intervals import IntervalOutcome, OwnLaw, OwnWorld, draw_value, infer, interval_tables
from tests.tasks.calibration.trace_lake import normal_draws

SMALL = Path(__file__).parents[2] / "data" / "gap-small.npz"
OFFSET = EffectValue(effect="load_cell_offset", parameters={"offset_n": 0.8})


@pytest.fixture(scope="module")
def worlds() -> Worlds:
    return Worlds(*read_small(SMALL), "intervals")


def moment_of(worlds: Worlds, tool_grasps: int) -> Moment:
    lab = worlds.lab(worlds.draw("null", 0))
    at = lab.moment(lab.order()[0])
    context = GraspContext(repeat=0, tool_grasps=tool_grasps, batch_grasps=tool_grasps, clock_s=0.0)
    return Moment(at.design, at.tool_seed, at.object_height_mm, context, at.setup)


def test_an_effect_acts_as_the_catalogue_says(worlds: Worlds) -> None:
    trace = Trace(np.array([0.0, 1.0, 11.0]), np.array([0.0, 0.0, 50.0]), np.array([0.0, 1.0, 2.0]))
    made, moment = OwnLaw(OFFSET).trace(trace, moment_of(worlds, 0)), moment_of(worlds, 40)
    np.testing.assert_allclose(made.force_n, np.interp(made.time_s, trace.time_s, trace.force_n) + 0.8)
    wear = OwnLaw(EffectValue(effect="friction_wear", parameters={"loss": 0.2, "scale_grasps": 40.0}))
    assert wear.friction_factor(moment) == pytest.approx(1.0 - 0.2 * (1.0 - np.exp(-1.0)))
    assert wear.modulus_factor(moment) == 1.0
    droop = OwnLaw(EffectValue(effect="pressure_droop", parameters={"loss_mm": 0.5, "scale_grasps": 40.0}))
    assert droop.wider_mm(moment) == pytest.approx(0.5 * (1.0 - np.exp(-1.0)))


def test_values_come_from_the_priors() -> None:
    rng = np.random.default_rng(0)
    drawn = [draw_value("load_cell_drift", rng).parameters["drift_per_hour_n"] for _ in range(300)]
    assert np.std(drawn) == pytest.approx(0.2, rel=0.15)
    assert max(np.abs(drawn)) <= 1.0


def test_a_world_is_inferred_and_its_gap_closed(worlds: Worlds, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(posterior, "sample", normal_draws)
    key = worlds.draw("null", 1).model_copy(update={"young_modulus_mpa": 9.2})
    settings = CalibrationSettings(chains=2, draws=200, tune=50, workers=1)
    found = infer(OwnWorld(worlds, key, OFFSET, 0.1), None, settings)
    assert found.holds("load_cell_offset.offset_n")
    assert found.after_n < 0.6 * found.before_n + 0.4 * found.twin_n


def test_intervals_are_counted() -> None:
    name = "load_cell_lag.time_constant_s"
    theta, known = {"young_modulus_mpa": 9.0, "friction": 0.5, "poisson_ratio": 0.4}, (0.0, 1.0, 10.0)
    truth = {**theta, name: 0.2}
    common = {"effect": "load_cell_lag", "base": "base-0", "code": "c", "strength": 0.1, "truth": truth}
    held = {"before_n": 1.0, "after_n": 0.6, "twin_n": 0.5}
    outcomes = [
        IntervalOutcome(number=0, intervals=dict.fromkeys(theta, known) | {name: (0.1, 0.2, 0.3)}, **common, **held),
        IntervalOutcome(number=1, intervals=dict.fromkeys(theta, known) | {name: (0.3, 0.4, 0.5)}, **common, **held),
        IntervalOutcome(number=2, **common),
    ]
    tables = interval_tables(outcomes)
    assert (tables["by effect"][0]["number"], tables["by effect"][0]["hold"]) == (2, 1)
    assert [row["hold"] for row in tables["intervals of 90 %"]] == [1, 2, 2, 2]
    assert tables["gap closed"][0]["median"] == pytest.approx(0.8)
