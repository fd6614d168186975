"""Lost steps in a batch: found at its end, told with the grasps they may have spoilt, and the batch goes on."""

import json
from pathlib import Path

import pytest

from fast.hardware.bench import open_virtual_bench
from fast.hardware.station.lost_steps import LostStepsError
from fast.hardware.virtual.world.file import World
from fast.lake.tables.campaign import EventRow, GraspRow
from fast.tasks.bench.measure import CHECKED, LOST_STEPS
from tests.studies.benchmarks.fingerprints import fingerprint
from tests.studies.benchmarks.made_up_batch import CAMPAIGN_ID, Batch, measure_missing, rack_of

BATCH = Batch(2, (3, 8), 1)
LABELS = [(tool, object_id) for tool, object_id, _ in BATCH.labels]


@pytest.fixture
def campaign(tmp_path: Path):
    return BATCH.make(tmp_path / "lake")


def measure(campaign, after=None, check_tools=0):
    """The same command; after so many grasps of it, the carriage slips half a millimetre."""
    execution = campaign.config.execution.model_copy(update={"position_check_tools": check_tools})
    object.__setattr__(campaign, "config", campaign.config.model_copy(update={"execution": execution}))
    benches, made = [], []

    def open_bench(mounted):
        bench = open_virtual_bench(World(), rack_of(mounted), physics=fingerprint, wires="memory")
        benches.append(bench)
        return _Kept(bench, opened)

    opened = []

    def on_grasp(tool, grasp):
        made.append((tool.tool_id, grasp.object_id))
        if len(made) == after:
            opened[0].virtual.inject("lost_steps")

    measure_missing(campaign, World(), on_grasp, open_bench=open_bench)
    return made


class _Kept:
    """A bench whose insides the test can reach."""

    def __init__(self, bench, opened):
        self._bench, self._opened = bench, opened

    def __enter__(self):
        self._opened.append(self._bench.__enter__())
        return self._opened[0]

    def __exit__(self, *error):
        return self._bench.__exit__(*error)


def events(campaign, kind):
    return [json.loads(row["payload_json"]) for row in campaign.lake.rows(EventRow, campaign_id=CAMPAIGN_ID, kind=kind)]


def grasp_ids(campaign):
    return [row["grasp_id"] for row in sorted(campaign.lake.rows(GraspRow), key=lambda row: row["order"])]


def test_a_batch_ends_with_a_check(campaign):
    assert sorted(measure(campaign)) == sorted(LABELS)
    (event,) = events(campaign, CHECKED)
    assert event == {"batch": 1, "limit_mm": 0.1, "n_grasps": 4, "slip_mm": [0, 0, 0]}


def test_lost_steps_name_the_grasps_since_the_last_check_and_the_batch_goes_on(campaign):
    with pytest.raises(LostStepsError, match=r"stood \+0.4\d mm in x from where it was counted, limit 0.1 mm"):
        measure(campaign, after=3, check_tools=1)
    (good,), (bad,) = events(campaign, CHECKED), events(campaign, LOST_STEPS)
    assert good["n_grasps"] == 2
    assert bad["grasp_ids"] == grasp_ids(campaign)[2:]
    assert bad["slip_mm"][0] == pytest.approx(0.5, abs=0.05)
    assert not events(campaign, "batch_measured")
    assert measure(campaign) == []  # all are there; which of them to make again is a person's choice
