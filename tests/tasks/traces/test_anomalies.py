"""Flags in the lake: written once, changed only where a grasp changes, taken back when they no longer stand."""

import numpy as np
import pytest

from fast.lake.provenance import Provenance
from fast.lake.store import Lake
from fast.lake.tables.campaign import AnomalyFlagRow, GraspRow, TraceRow
from fast.models.records import Trace
from fast.tasks.traces.anomalies import update_anomalies
from fast.tasks.traces.features import update_features
from tests.flows.synthetic_lake import Campaign, build

PROVENANCE = Provenance(code_version="abc", code_dirty=False)


@pytest.fixture
def lake(tmp_path) -> Lake:
    return build(Lake.open(tmp_path / "lake", create=True), Campaign(with_simulations=False))


def look(lake: Lake) -> set[tuple[str, str]]:
    update_features(lake)
    return {(row["grasp_id"], row["kind"]) for row in update_anomalies(lake)}


def test_a_lost_object_is_flagged_and_the_flag_taken_back(lake):
    before = look(lake)
    grasp = lake.records(GraspRow, status="ok")[30]
    sound = lake.trace(grasp.grasp_id)
    still_held = sound.lift_mm < 10.0
    lake.append(
        [TraceRow.of(grasp.grasp_id, Trace(sound.time_s, sound.lift_mm, np.where(still_held, sound.force_n, 0.0)))],
        PROVENANCE,
    )
    assert look(lake) - before == {(grasp.grasp_id, "early_loss")}
    (row,) = lake.query("FROM anomalies WHERE grasp_id = $id", {"id": grasp.grasp_id}).to_pylist()
    assert row["reason"].startswith("the object is lost")
    assert row["p_value"] < 3e-4
    files = sorted((lake.root / "anomaly_flags").iterdir())
    look(lake)
    assert sorted((lake.root / "anomaly_flags").iterdir()) == files  # nothing changed, nothing written
    lake.append([TraceRow.of(grasp.grasp_id, sound)], PROVENANCE)
    assert (grasp.grasp_id, "early_loss") not in look(lake)
    (stored,) = lake.records(AnomalyFlagRow, grasp_id=grasp.grasp_id)
    assert (stored.is_flagged, stored.p_value) == (False, None)
