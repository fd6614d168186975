"""The tables of what was inferred, as a person would query them."""

import numpy as np
import pytest
from pydantic import ValidationError

from fast.lake.provenance import Provenance
from fast.lake.store import Lake
from fast.lake.tables.campaign import (
    CalibrationRow,
    EffectRow,
    EventRow,
    GapFindingRow,
    PosteriorDrawsRow,
    SimulatorVersionRow,
)
from fast.lake.tables.catalogue_rows import missing_version_rows, version_rows
from fast.models.errors import ConfigError
from fast.models.records import EffectValue, Theta
from fast.models.simulation.version import SimulatorVersion

SLIP = SimulatorVersion(
    effects=(
        EffectValue(effect="load_cell_lag", parameters={"time_constant_s": 0.2}),
        EffectValue(effect="static_kinetic_friction", parameters={"kinetic_ratio": 0.7}),
    )
)


def calibration(calibration_id: str = "C1") -> CalibrationRow:
    return CalibrationRow(
        calibration_id=calibration_id,
        base_version_id="V1",
        data="design_mean",
        status="ok",
        n_designs=12,
        n_objects=36,
        n_simulations=200,
        n_chains=2,
        n_draws=500,
        n_tune=500,
        sampler="nuts",
        young_modulus_median_mpa=9.5,
        friction_median=0.57,
    )


def draws(calibration_id: str = "C1", n: int = 500) -> list[PosteriorDrawsRow]:
    rng = np.random.default_rng(3)
    parameters = ("young_modulus_mpa", "friction", "static_kinetic_friction.slip_scale_mm")
    return [
        PosteriorDrawsRow.of(calibration_id, chain, parameter, place + chain + rng.random(n))
        for chain in range(2)
        for place, parameter in enumerate(parameters)
    ]


def test_a_version_has_a_row_per_effect_with_all_its_parameters(lake: Lake, provenance: Provenance):
    lake.append(version_rows(SLIP), provenance)
    sql = """SELECT place, effect, code, layer, map(parameters, parameter_values)['slip_scale_mm'] AS slip_scale_mm
        FROM effects JOIN simulator_versions USING (version_id) ORDER BY place"""
    assert lake.query(sql).to_pylist() == [
        {"place": 0, "effect": "load_cell_lag", "code": "S4", "layer": "sensor", "slip_scale_mm": None},
        {"place": 1, "effect": "static_kinetic_friction", "code": "C1", "layer": "contact", "slip_scale_mm": 1.0},
    ]
    assert missing_version_rows(lake, SLIP) == []


def test_the_effects_of_a_version_from_before_the_table_are_added(lake: Lake, provenance: Provenance):
    lake.append([SimulatorVersionRow.of(SLIP)], provenance)
    assert {type(row) for row in missing_version_rows(lake, SLIP)} == {EffectRow}
    assert missing_version_rows(lake, SimulatorVersion()) == [SimulatorVersionRow.of(SimulatorVersion())]


def test_an_unknown_effect_has_no_row():
    with pytest.raises(ConfigError, match="Unknown effect `wind`"):
        version_rows(SimulatorVersion(effects=(EffectValue(effect="wind"),)))


def test_draws_are_joint_and_summed_up_in_sql(lake: Lake, provenance: Provenance):
    rows = draws()
    lake.append([*rows, calibration()], provenance)
    sql = """SELECT parameter, any_value(unit) AS unit, avg(draw) AS mean, quantile_cont(draw, 0.95) AS q95
        FROM (SELECT parameter, unit, unnest(draws) AS draw FROM posterior_draws WHERE calibration_id = 'C1')
        GROUP BY parameter ORDER BY parameter"""
    found = {row["parameter"]: row for row in lake.query(sql).to_pylist()}
    assert [row["unit"] for row in found.values()] == [None, "mm", "MPa"]
    stiffness = np.concatenate([row.draws for row in rows if row.parameter == "young_modulus_mpa"])
    assert found["young_modulus_mpa"]["mean"] == pytest.approx(stiffness.mean())
    assert found["young_modulus_mpa"]["q95"] == pytest.approx(np.quantile(stiffness, 0.95))
    joint = lake.query(
        """SELECT chain, unnest(e.draws) AS young_modulus_mpa, unnest(f.draws) AS friction
        FROM posterior_draws AS e JOIN posterior_draws AS f USING (calibration_id, chain)
        WHERE e.parameter = 'young_modulus_mpa' AND f.parameter = 'friction' ORDER BY chain"""
    )
    assert joint.num_rows == 1000
    theta = lake.query("SELECT * FROM posterior('C1') ORDER BY chain, draw")
    assert theta.column_names == ["chain", "draw", "young_modulus_mpa", "friction", "poisson_ratio"]
    assert theta["draw"].to_pylist() == 2 * list(range(1, 501))
    assert theta["friction"].to_pylist() == joint["friction"].to_pylist()
    assert theta["poisson_ratio"].null_count == 1000  # it was not inferred
    assert np.array_equal(joint["young_modulus_mpa"].to_numpy(), stiffness)


def test_draws_must_be_finite():
    with pytest.raises(ValidationError, match="finite"):
        PosteriorDrawsRow.of("C1", 0, "friction", np.array([0.5, np.inf]))


def test_the_answer_of_a_round_is_found(lake: Lake, provenance: Provenance):
    def finding(kind: str, place: int, **values: object) -> GapFindingRow:
        finding_id = GapFindingRow.make_id("G1", 1, kind, place)
        given = {"finding_id": finding_id, "gap_id": "G1", "round": 1, "kind": kind, "place": place}
        return GapFindingRow.model_validate({**given, "base_version_id": "V1", **values})

    rows = [
        finding("where", 0, phase="lift", stratum="object wider than 40 mm", size_n=-1.5, ci90_lower_n=-2.0),
        finding("candidate", 0, effect="load_cell_lag", probability=0.6, evidence_nats=4.0),
        finding("named", 0, answer="set", effect="load_cell_lag", probability=0.95, rmse_before_n=2.0),
        finding("named", 1, answer="set", effect="static_kinetic_friction", probability=0.95, rmse_before_n=2.0),
    ]
    lake.append(rows, provenance)
    sql = """SELECT answer, list(effect ORDER BY place) AS effects, any_value(probability) AS probability
        FROM gap_findings WHERE kind = 'named' GROUP BY gap_id, round, answer"""
    (row,) = lake.query(sql).to_pylist()
    assert row == {"answer": "set", "effects": ["load_cell_lag", "static_kinetic_friction"], "probability": 0.95}
    with pytest.raises(ValidationError, match="less than or equal to 1"):
        finding("named", 0, answer="effect", probability=1.5)


def test_ids_follow_from_what_decides_the_result():
    one = CalibrationRow.make_id("V1", "trace", ["K2", "K1"], "{}", 7)
    assert one == CalibrationRow.make_id("V1", "trace", ["K1", "K2"], "{}", 7)
    assert one != CalibrationRow.make_id("V1", "trace", ["K1"], "{}", 7)
    assert PosteriorDrawsRow.of("C1", 0, "rho", np.ones(1)).draws_id == draws_id("C1", 0)
    assert draws_id("C1", 0) != draws_id("C1", 1)


def draws_id(calibration_id: str, chain: int) -> str:
    return PosteriorDrawsRow.of(calibration_id, chain, "rho", np.zeros(2)).draws_id


def test_a_record_is_kept_once_under_its_key(lake: Lake, provenance: Provenance) -> None:
    for value in (Theta(friction=0.3), Theta(friction=0.4)):
        lake.append([EventRow.of(["told", 7], "told", "a word", value, None)], provenance)
    (kept,) = lake.records(EventRow, event_id=EventRow.make_id("told", 7))
    assert Theta.model_validate(kept.payload) == Theta(friction=0.4)
    assert (kept.kind, kept.message, kept.campaign_id) == ("told", "a word", "")
