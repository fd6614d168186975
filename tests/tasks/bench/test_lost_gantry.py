"""A host that lost the gantry to another one: it stops before its next motion, and writes nothing more."""

import json

import pytest

from fast.lake import leases
from fast.lake.store import Lake
from fast.lake.tables.campaign import GraspRow
from fast.models.errors import LostLeaseError
from tests.studies.benchmarks.fingerprints import fingerprint_world
from tests.studies.benchmarks.made_up_batch import Batch, lockstep_bench, measure_missing

BATCH = Batch(n_tools=2, object_ids=(3, 29), n_repeats=2)
WORLD = fingerprint_world(BATCH.labels)


@pytest.fixture
def benches(monkeypatch):
    """Benches that were opened, and every motion that their gantries were asked for and made."""
    monkeypatch.setattr(leases, "CHECKED_S", 0.0)
    return []


def take_over(lake: Lake) -> None:
    path = max((lake.root / "leases" / "gantry").glob("*.json"))
    other = path.with_name(f"{int(path.stem) + 1:08d}.json")
    text = json.loads(path.read_text()) | {"machine": "another", "host": "bench-2", "pid": 99}
    other.write_text(json.dumps(text))


def test_a_host_that_lost_the_gantry_stops_before_its_next_motion(tmp_path, benches, monkeypatch):
    campaign = BATCH.make(tmp_path / "lake")
    moved = []

    def watched(mounted):
        opened = lockstep_bench(WORLD, mounted)

        class Watched:
            def __enter__(self):
                bench = opened.__enter__()
                driver = bench.gantry._driver
                for name in ("move", "start_jog", "home", "slip_mm"):
                    act = getattr(driver, name)
                    monkeypatch.setattr(driver, name, lambda *a, act=act, name=name: (moved.append(name), act(*a))[1])
                benches.append(bench)
                return bench

            def __exit__(self, *error):
                return opened.__exit__(*error)

        return Watched()

    def on_grasp(tool, grasp):
        take_over(campaign.lake)
        moved.clear()

    with pytest.raises(LostLeaseError, match="no longer owns the gantry .* taken over by process 99 on bench-2"):
        measure_missing(campaign, WORLD, on_grasp, open_bench=watched)
    assert moved == []
    assert not benches[0].supervisor.is_ok
    assert len(campaign.lake.ids(GraspRow)) == 1
    path = max((campaign.lake.root / "leases" / "gantry").glob("*.json"))
    assert json.loads(path.read_text())["is_released"] is False, "it is the other's"
