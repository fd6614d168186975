"""Once a name is sure, a search asks for a parameter, learns from the answer, and asks nothing twice."""

from pathlib import Path

import pytest

from fast.flows.gap.bench_plan import explain_silence
from fast.lake.tables.requests import GraspRequestRow
from fast.models.gap.ask import refine
from fast.models.records import EffectValue
from fast.tasks.bench.asked import read_open_requests
from fast.tasks.gap.data import read_grasps
from tests.flows.gap.test_ask import go, no_physics  # noqa: F401 - a fixture for every test
from tests.tasks.calibration.trace_lake import PROVENANCE
from tests.tasks.gap.gap_lake import answer_rows, gap_lake

LAG = EffectValue(effect="load_cell_lag", parameters={"time_constant_s": 0.11})  # is named alone
pytestmark = [pytest.mark.slow, pytest.mark.timeout(600)]


def test_a_name_that_is_sure_leaves_a_parameter_to_ask_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(refine, "SURE_SHARE", 1.01)  # no order is ever sure
    lake = gap_lake(tmp_path / "lake", hidden=[LAG])
    named = go(lake).run
    asked, ranking = named.findings.next_experiment, named.findings.ranking
    assert asked is not None
    assert ranking is not None
    assert asked.parameter == ranking.parameter
    assert asked.parameter.startswith("load_cell_lag.")
    assert not ranking.is_settled
    assert "on which the order of the 8 best designs hangs" in asked.sentence
    assert explain_silence(lake, named.gap_id) == ranking.sentence
    requests = [request for request, _ in read_open_requests(lake, search_id=named.gap_id)]
    assert len(requests) == asked.promised_grasps > 0
    assert {row.parameter for row in lake.records(GraspRequestRow, search_id=named.gap_id)} == {asked.parameter}
    assert not go(lake).is_new  # nobody has made them
    before = read_grasps(lake, "demo")
    lake.append(answer_rows(requests, [LAG]), PROVENANCE)
    after = read_grasps(lake, "demo")
    assert len(after.grasps.grasp_ids) == len(before.grasps.grasp_ids) + len(requests)  # learnt from as any other
    told = [0 if measured.answers is None else measured.answers.n_grasps for measured in (before, after)]
    assert told[0] == told[1]
    monkeypatch.setattr(refine, "SURE_SHARE", 0.0)  # any order is
    settled = go(lake).run
    assert settled.split_id == named.split_id
    assert settled.findings.next_experiment is None
    assert settled.findings.ranking is not None
    assert settled.findings.ranking.sentence.startswith("No further grasp: the order of the 8 best designs does not")
    (told,) = settled.findings.asked
    assert (told.promised, told.spent) == (len(requests), len(requests))
    assert told.got_nats > 0.0
    assert explain_silence(lake).startswith("No further grasp")
    assert read_open_requests(lake) == []
    assert not go(lake).is_new
