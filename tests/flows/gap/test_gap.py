"""Gap discovery from measurements to findings, on made-up traces."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fast.flows.gap import search
from fast.flows.gap.folder import write_folder
from fast.flows.gap.scheduled import markdown
from fast.flows.gap.search import GapRequest, describe_search_cost, run_gap
from fast.flows.progress import ProgressReporter, describe_duration
from fast.lake.query.lineage import Node, find_lineage
from fast.lake.store import Lake
from fast.lake.tables.campaign import (
    CalibrationRow,
    EventRow,
    GapFindingRow,
    SimulationRow,
    SimulatorVersionRow,
    TraceRow,
)
from fast.models.calibration.inference.settings import CalibrationSettings
from fast.models.errors import FastError
from fast.models.gap.bank.bank import NUMERICAL, WIDE
from fast.models.gap.bank.surrogate import Surrogate
from fast.models.gap.evaluation.evaluate import Change, measure_change
from fast.models.gap.evaluation.held_out import HeldOut
from fast.models.gap.findings import Findings
from fast.models.gap.fit import posterior
from fast.models.gap.grasps import Cells
from fast.models.gap.local_bank import MOST_EFFECTS
from fast.models.records import EffectValue
from fast.tasks.calibration.mean_data import TooLittleDataError, read_measured_tools, read_simulated_points
from fast.tasks.campaign.simulator_versions import newest_calibrated
from fast.tasks.gap.bank import BANK, plan_bank
from fast.tasks.gap.cost import choose_largest_bank
from fast.tasks.gap.split import KIND as SPLIT
from fast.tasks.simulation.plan import SimulationPlan
from tests.tasks.calibration.trace_lake import PROVENANCE, normal_draws
from tests.tasks.gap.gap_lake import BASE, DESIGNS, OBJECTS, SETUP, gap_lake, plan_rows

LAG = EffectValue(effect="load_cell_lag", parameters={"time_constant_s": 0.4})
pytestmark = pytest.mark.timeout(600)
ORDER = GapRequest("demo", settings=CalibrationSettings(chains=4, draws=250, tune=50, workers=1))


def silent() -> ProgressReporter:
    return ProgressReporter(lambda _: None, lambda _: None)


@pytest.fixture(autouse=True)
def no_physics(monkeypatch: pytest.MonkeyPatch) -> None:
    """Made-up answers in the place of finite elements, and normal draws in the place of NUTS."""

    def simulate(lake: Lake, plans: Sequence[SimulationPlan], *_: Any) -> None:
        lake.append(plan_rows(plans), PROVENANCE)

    monkeypatch.setattr(search, "simulate_missing", simulate)
    monkeypatch.setattr(posterior, "sample", normal_draws)


@pytest.fixture(scope="module")
def lagging(tmp_path_factory: pytest.TempPathFactory) -> Lake:
    return gap_lake(tmp_path_factory.mktemp("lagging") / "lake", hidden=[LAG])


@pytest.mark.slow
def test_a_hidden_effect_is_named_added_and_shown(lagging: Lake, tmp_path: Path, no_figures: None) -> None:
    said: list[str] = []
    outcome = run_gap(lagging, ORDER, ProgressReporter(said.append, said.append))
    findings = outcome.run.findings
    assert findings.alarm
    assert findings.rounds[0].named.effects == ("load_cell_lag",)
    low, high = findings.rounds[0].named.parameters["time_constant_s"].ci90
    assert low < 0.4 < high
    assert findings.gap.rmse_after_n < 0.6 * findings.gap.rmse_before_n
    assert "found load_cell_lag" in outcome.sentence
    (version,) = lagging.records(SimulatorVersionRow, version_id=findings.rounds[0].version)
    assert [value.effect for value in version.version.effects] == ["load_cell_lag"]
    (calibration,) = lagging.records(CalibrationRow, version_id=version.version_id)
    assert calibration.data == "trace"
    names = {row["parameter"] for row in lagging.query("SELECT DISTINCT parameter FROM posterior_draws").to_pylist()}
    assert "load_cell_lag.time_constant_s" in names
    rows = lagging.records(GapFindingRow, gap_id=outcome.run.gap_id, kind="named", round=1)
    assert [(row.effect, row.calibration_id) for row in rows] == [("load_cell_lag", calibration.calibration_id)]
    with pytest.raises(TooLittleDataError, match="no design that is simulated with a theta of its own"):
        read_simulated_points(
            lagging, BASE, read_measured_tools(lagging, "demo")
        )  # neither bank nor held-out grasps are drawn
    lineage = find_lineage(lagging, version.version_id, limit=10)
    assert {"gap_findings", "calibrations"} <= {node.table for node in lineage.rows}
    assert {"grasps", "simulations"} <= {group.table for group in lineage.groups}
    assert lineage.rows[Node("simulator_versions", outcome.run.base_version_id)] is not None  # not only named
    (event,) = lagging.records(EventRow, kind=BANK)
    bank_plan = outcome.rounds[0].search.bank_plan
    assert json.loads(event.payload_json)["thetas"][0] == bank_plan.centre.model_dump()
    assert bank_plan.centre.young_modulus_mpa == pytest.approx(9.2, rel=0.05)  # the truth's, within a print's scatter
    assert len(bank_plan.effects) <= MOST_EFFECTS
    found = newest_calibrated(lagging, BASE.version_id, "demo")
    assert found is not None
    assert found[0].version_id == version.version_id
    verdict = findings.verdict
    assert verdict is not None
    assert (verdict.present_version_id, verdict.version_id) == (BASE.version_id, version.version_id)
    assert verdict.is_accepted
    assert verdict.rmse_n < 0.6 * verdict.present_rmse_n
    page = write_folder(lagging, outcome, tmp_path / "out")
    assert Findings.model_validate(json.loads((tmp_path / "out" / "findings.json").read_text())) == findings
    assert "load-cell transmitter" in page.read_text()
    assert "load_cell_lag" in markdown(outcome, str(page))
    again = run_gap(lagging, ORDER, silent())
    assert not again.is_new
    assert again.run == outcome.run
    assert again.sentence.startswith("nothing new since gap search")


@pytest.mark.slow
def test_a_name_that_does_not_help_is_in_the_answer_and_in_no_simulator(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Held-out grasps on which a simulator with the lag is worse than one without it."""

    def judge(held_out: HeldOut, before_n: np.ndarray, after_n: np.ndarray, seed: int) -> Change:
        return measure_change(held_out, after_n, before_n, seed)

    monkeypatch.setattr("fast.tasks.gap.rounds.measure_change", judge)
    lake = gap_lake(tmp_path / "lake", hidden=[LAG])
    outcome = run_gap(lake, ORDER, silent())
    (found,) = outcome.run.findings.rounds
    assert found.named.effects == ("load_cell_lag",)
    assert found.version is None
    assert found.refused.startswith("Not added (load_cell_lag): the held-out error goes from ")
    assert outcome.run.after_version_id == outcome.run.before_version_id
    assert "load_cell_lag would explain it, but was not added" in outcome.sentence
    newest = newest_calibrated(lake, BASE.version_id, "demo")
    assert newest is None or newest[0].effects == ()
    refused = [row for row in lake.records(CalibrationRow) if row.status == "failed"]
    assert found.refused in [row.reason for row in refused]


@pytest.mark.study
def test_nothing_is_named_where_nothing_is_hidden(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    built: list[Surrogate] = []
    of = Surrogate.of
    monkeypatch.setattr(Surrogate, "of", staticmethod(lambda *words: built.append(of(*words)) or built[-1]))
    outcome = run_gap(gap_lake(tmp_path / "lake"), ORDER, silent())
    assert [found.named.kind for found in outcome.run.findings.rounds] == ["none"]
    assert not outcome.run.findings.alarm
    assert outcome.run.before_version_id == outcome.run.after_version_id
    assert "no gap beyond noise and numerical error" in outcome.sentence
    assert len(built) == 2  # of the wide bank for what is proposed, of the other for all else


def test_the_cost_is_told_and_nothing_is_searched(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    lake, simulated = gap_lake(tmp_path / "lake", has_bank=False), []

    def simulate(lake: Lake, plans: Sequence[SimulationPlan], *_: Any) -> None:
        rows = [
            row.model_copy(update={"cpu_s": 3.0}) if isinstance(row, SimulationRow) else row for row in plan_rows(plans)
        ]
        simulated.extend(row for row in rows if isinstance(row, SimulationRow))
        lake.append(rows, PROVENANCE)

    monkeypatch.setattr(search, "simulate_missing", simulate)
    sentence = describe_search_cost(lake, ORDER, silent())
    n_wide, n_local = (
        sum(plan.n_grasps for plan in plan_bank(BASE, Cells.full(DESIGNS, OBJECTS, SETUP), of))
        for of in (WIDE, choose_largest_bank())
    )
    n_tried = 4 * (1 + len(NUMERICAL))  # four grasps of the centre and of each variant
    took = describe_duration(3.0 * (n_wide - n_tried + n_local))
    assert sentence == (
        f"96 grasps of 8 tools on 6 objects. To simulate: {n_wide - n_tried} of the {n_wide} grasps of the bank, then "
        f"up to {n_local} around the fitted theta (again if it leaves them); about {took} of CPU, {took} on 1 free "
        "core."
    )
    assert len(simulated) == n_tried  # of the bank, to know how long one takes
    assert describe_search_cost(lake, ORDER, silent()) == sentence
    assert len(simulated) == n_tried
    assert not lake.rows(CalibrationRow)


def test_the_split_is_frozen_before_traces_are_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    lake = gap_lake(tmp_path / "lake")

    def never(*_: Any) -> None:
        raise AssertionError

    monkeypatch.setattr(search, "read_grasps", never)
    with pytest.raises(AssertionError):
        run_gap(lake, ORDER, silent())
    assert len(lake.rows(EventRow, kind=SPLIT)) == 1


def test_a_bank_that_is_not_complete_when_the_budget_ends_is_gone_on_with(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    lake = gap_lake(tmp_path / "lake")
    more = tuple(plan for plan in plan_bank(BASE, Cells.full(DESIGNS, (*OBJECTS, 33), SETUP)))
    monkeypatch.setattr(search, "plan_bank", lambda *_: more)
    monkeypatch.setattr(search, "simulate_missing", lambda *_: None)
    with pytest.raises(FastError, match="the bank lacks .* run the same command again to go on from here"):
        run_gap(lake, ORDER, silent())
    assert lake.rows(TraceRow)
