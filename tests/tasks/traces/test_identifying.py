"""Identification in a lake: learnt from other tools alone, one grasp and its repeats; refusals."""

import pytest

from fast.lake.store import Lake
from fast.lake.tables.campaign import GraspRow
from fast.models.errors import UsageError
from fast.tasks.traces import identify as identifying
from fast.tasks.traces.features import update_features
from fast.tasks.traces.identify import identify
from tests.flows.synthetic_lake import Campaign, build


@pytest.fixture(scope="module")
def lake(tmp_path_factory) -> Lake:
    root = tmp_path_factory.mktemp("identify") / "lake"
    lake = build(Lake.open(root, create=True), Campaign(with_simulations=False))
    update_features(lake)
    return lake


def test_the_answer_is_learnt_from_the_other_tools(lake, monkeypatch):
    monkeypatch.setattr("fast.models.traces.identification.classifier.N_TREES", 30)
    grasp = lake.records(GraspRow, status="ok")[0]
    found = identify(lake, grasp.grasp_id)
    n_own = lake.query("SELECT count(*) AS n FROM feature_summary WHERE tool_id = $t", {"t": grasp.tool_id}).to_pylist()
    n_all = lake.query("SELECT count(*) AS n FROM feature_summary").to_pylist()
    assert (found.n_tools, found.n_learnt) == (5, n_all[0]["n"] - n_own[0]["n"])
    assert found.recorded == f"object {grasp.object_id}"
    assert (found.alone.n_grasps, found.together.n_grasps) == (1, 3)
    for answer in (found.alone, found.together):
        probabilities = [probability for _, probability in answer.objects]
        assert probabilities == sorted(probabilities, reverse=True)
        assert sum(probabilities) <= 1.0 + 1e-3
    assert found.accuracy is not None
    monkeypatch.setattr(identifying, "MOST_GRASPS", 24)
    assert identify(lake, grasp.grasp_id).n_learnt == 24


def test_refusals_say_what_to_do(lake, tmp_path):
    with pytest.raises(UsageError, match="grasp `K0` is not in this lake"):
        identify(lake, "K0")
    failed = lake.records(GraspRow, status="failed")[0]
    with pytest.raises(UsageError, match="has no features: it failed"):
        identify(lake, failed.grasp_id)
    one = Campaign(n_batches=1, n_measured_batches=1, n_tools=1, with_simulations=False)
    single = build(Lake.open(tmp_path / "one", create=True), one)
    update_features(single)
    with pytest.raises(UsageError, match="other tools than .* fewer than 2 objects"):
        identify(single, single.records(GraspRow, status="ok")[0].grasp_id)
