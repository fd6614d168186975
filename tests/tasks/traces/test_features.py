"""Features in the lake: filled once, continued, calculated anew for a newer trace; quality by class and batch."""

import numpy as np
import pytest

from fast.lake.provenance import Provenance
from fast.lake.store import Lake
from fast.lake.tables.campaign import CampaignRow, GraspRow, TraceFeaturesRow, TraceRow
from fast.models.errors import UsageError
from fast.models.records import Trace
from fast.models.traces.batch import features_of
from fast.models.traces.names import FEATURE_VERSION, FEATURES
from fast.tasks.traces import features
from fast.tasks.traces.features import ALL_OBJECTS, class_quality, update_features
from tests.flows.synthetic_lake import Campaign, build

PROVENANCE = Provenance(code_version="abc", code_dirty=False)
N_VALID = 2 * 3 * 4 * 3 - 2  # batches, tools, objects, repeats; two failed


@pytest.fixture
def lake(tmp_path) -> Lake:
    return build(Lake.open(tmp_path / "lake", create=True))


def test_every_grasp_with_a_trace_is_calculated_once(lake):
    assert update_features(lake) == (N_VALID, N_VALID, 0)
    files = sorted((lake.root / "trace_features").iterdir())
    assert update_features(lake) == (N_VALID, 0, 0)
    assert sorted((lake.root / "trace_features").iterdir()) == files
    assert lake.ids(TraceFeaturesRow) == {
        TraceFeaturesRow.make_id(k, FEATURE_VERSION) for k in lake.ids(GraspRow, status="ok")
    }


def test_rows_are_the_features_of_their_traces(lake, monkeypatch):
    monkeypatch.setattr(features, "AT_ONCE", 7)  # blocks that do not divide the grasps
    said: list[str] = []
    update_features(lake, tell=said.append)
    assert said[0] == f"7 of {N_VALID} grasps"
    assert said[-1] == f"{N_VALID} of {N_VALID} grasps"
    for row in lake.records(TraceFeaturesRow)[::9]:
        expected = features_of([lake.trace(row.grasp_id)])
        stored = [getattr(row, name) for name in FEATURES]
        assert stored == list(expected.row(0).values())
        assert list(row.profile_n) == expected.profile_n[0].tolist()
    joined = "SELECT max(abs(f.{0} - g.{0})) AS far FROM trace_features AS f JOIN grasps AS g USING (grasp_id)"
    for name in ("peak_force_n", "work_j", "initial_force_n"):
        assert lake.query(joined.format(name)).to_pylist()[0]["far"] < 1e-9


def test_only_what_is_missing_is_calculated(lake, monkeypatch):
    update_features(lake)
    tool = lake.records(GraspRow, status="ok")[0]
    new = tool.model_copy(update={"grasp_id": GraspRow.make_id(tool.tool_id, 0, 9), "repeat": 9})
    lake.append([new, TraceRow.of(new.grasp_id, lake.trace(tool.grasp_id))], PROVENANCE)
    assert update_features(lake) == (N_VALID + 1, 1, 0)
    monkeypatch.setattr(features, "FEATURE_VERSION", FEATURE_VERSION + 1)
    assert update_features(lake).n_new == N_VALID + 1


def test_a_newer_trace_supersedes_the_features_of_the_old_one(lake):
    update_features(lake)
    grasp = lake.records(GraspRow, status="ok")[0]
    old = lake.trace(grasp.grasp_id)
    lake.append([TraceRow.of(grasp.grasp_id, Trace(old.time_s, old.lift_mm, 2 * old.force_n))], PROVENANCE)
    before = lake.records(TraceFeaturesRow, grasp_id=grasp.grasp_id)[0].peak_force_n
    assert update_features(lake).n_new == 1
    (after,) = lake.records(TraceFeaturesRow, grasp_id=grasp.grasp_id)
    assert after.peak_force_n == pytest.approx(2 * before)


def test_repeatability_is_that_of_numpy(lake):
    update_features(lake)
    row = lake.query("FROM repeatability ORDER BY tool_id, object_id LIMIT 1 OFFSET 5").to_pylist()[0]
    where = f"WHERE tool_id = '{row['tool_id']}' AND object_id = {row['object_id']}"
    repeats = lake.query(f"SELECT peak_force_n, work_j, profile_n FROM feature_summary {where}").to_pylist()
    assert row["n_repeats"] == len(repeats) == 3
    for name, cv in (("peak_force_n", "peak_cv"), ("work_j", "work_cv")):
        values = np.array([repeat[name] for repeat in repeats])
        assert row[cv] == pytest.approx(values.std(ddof=1) / values.mean())
    profiles = np.array([repeat["profile_n"] for repeat in repeats])
    assert row["trace_distance_n"] == pytest.approx(np.sqrt(profiles.var(axis=0, ddof=1).mean()))


def test_quality_of_the_first_batch_against_the_last(lake):
    update_features(lake)
    rows = {(row.measure, row.object_class): row for row in class_quality(lake)}
    assert set(rows) == {(m, c) for m in features.MEASURES for c in (ALL_OBJECTS, "made up")}
    quality = rows["tool_quality_n", ALL_OBJECTS]
    tools = lake.query("SELECT batch, tool_quality_n FROM tool_quality").to_pylist()
    means = [np.mean([t["tool_quality_n"] for t in tools if t["batch"] == batch]) for batch in (1, 2)]
    assert (quality.first.mean, quality.last.mean) == pytest.approx(means)
    assert quality.change.mean == pytest.approx(means[1] - means[0])
    assert quality.first.lower < quality.first.mean < quality.first.upper
    assert (quality.first_batch, quality.last_batch, quality.first.n) == (1, 2, 3)


def test_one_batch_has_nothing_to_compare(tmp_path):
    lake = build(Lake.open(tmp_path / "one", create=True), Campaign(n_batches=1, n_measured_batches=1, n_tools=1))
    update_features(lake)
    (quality, *_) = class_quality(lake)
    assert (quality.last, quality.change) == (None, None)
    assert np.isnan(quality.first.lower)  # one tool


def test_a_lake_without_usable_traces_says_so(tmp_path):
    lake = Lake.open(tmp_path / "lake", create=True)
    with pytest.raises(UsageError, match=r"the lake .* has no measured grasp with a trace.*`fast lake import DIR`\.$"):
        update_features(lake)
    build(lake)
    lake.append([CampaignRow(campaign_id="empty", name="", config_toml="")], PROVENANCE)
    with pytest.raises(UsageError, match="campaign empty has no measured grasp with a trace"):
        update_features(lake, "empty")


def test_traces_without_a_lift_are_counted_and_if_all_are_refused(lake):
    closed = Trace(np.arange(9.0), np.zeros(9), np.ones(9))
    ids = sorted(lake.ids(GraspRow, status="ok"))
    lake.append([TraceRow.of(grasp_id, closed) for grasp_id in ids[:2]], PROVENANCE)
    assert update_features(lake) == (N_VALID - 2, N_VALID - 2, 2)
    lake.append([TraceRow.of(grasp_id, closed) for grasp_id in ids], PROVENANCE)
    with pytest.raises(UsageError, match=r"none of \d+ traces lifts by 3 mm"):
        update_features(lake)
