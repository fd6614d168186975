"""Identification in a lake: learnt from other tools alone, one grasp and its repeats; refusals."""

from dataclasses import replace

import numpy as np
import pytest

from fast.lake.provenance import current_provenance
from fast.lake.store import Lake
from fast.lake.tables.campaign import GraspRow, ObjectRow, TraceRow
from fast.models.errors import UsageError
from fast.models.objects import catalogue
from fast.models.objects.own import object_of_parts
from fast.models.objects.parts import Sphere
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


def test_own_objects_are_told_apart_as_well(tmp_path, monkeypatch):
    monkeypatch.setattr("fast.models.traces.identification.classifier.N_TREES", 30)
    monkeypatch.setattr(catalogue, "_OWN", {})
    ball = object_of_parts("ball", [Sphere(shape="sphere", diameter_mm=30)], "ball.toml")
    catalogue.register(ball)
    lake = build(Lake.open(tmp_path / "lake", create=True), Campaign(with_simulations=False))
    copied = []
    for row in lake.records(GraspRow, status="ok", object_id=3):
        (samples,) = lake.records(TraceRow, grasp_id=row.grasp_id)
        own_id = GraspRow.make_id(row.tool_id, ball.object_id, row.repeat)
        trace = replace(samples.trace, force_n=0.3 * np.array(samples.trace.force_n))
        own = row.model_copy(update={"object_id": ball.object_id, "grasp_id": own_id})
        copied += [own, TraceRow.of(own_id, trace)]
    lake.append([ObjectRow.of(ball), *copied], current_provenance())
    update_features(lake)
    found = identify(lake, copied[0].grasp_id)
    for answer in (found.alone, found.together):
        assert answer.objects[0][0] == "ball"
        assert answer.classes[0] == answer.sides[0] == answer.orientations[0] == ("own object", answer.objects[0][1])
    assert found.recorded == "ball"
    assert found.accuracy is not None
