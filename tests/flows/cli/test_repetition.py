"""Simulated grasps are made again from their row, or from the numbers of a benchmark."""

from contextlib import closing

import pytest

from fast.lake.store import Lake
from fast.lake.tables.campaign import DesignRow, SimulationRow
from fast.models.design.space import numbered_design
from fast.tasks.campaign.campaign import Campaign
from fast.tasks.campaign.config import CampaignConfig
from fast.tasks.simulation.pool import WorkerPool
from fast.tasks.simulation.simulate import simulate_design
from tests.flows.cli.cli_lakes import Fast

CONFIG = {
    "name": "demo",
    "objects": {"ids": [24]},
    "grasp": {"max_lift_mm": 2, "tip_below_mm": 3},
    "simulator": {"theta": {"friction": 0.4}, "mesh": {"edge_mm": 11}},
    "bench": {"world": "world.toml"},
}
DESIGN = numbered_design(5)


@pytest.fixture
def fast(capsys, monkeypatch):
    monkeypatch.delenv("FAST_LAKE", raising=False)
    return Fast(capsys)


@pytest.fixture(scope="module")
def simulated(tmp_path_factory):
    """A lake with one simulation, made by the tasks in a worker."""
    lake = Lake.open(tmp_path_factory.mktemp("repetition") / "lake", create=True)
    campaign = Campaign(lake, CampaignConfig.model_validate(CONFIG))
    lake.append([DesignRow.of(DESIGN)], campaign.provenance())
    with closing(WorkerPool(1)) as pool:
        assert simulate_design(campaign, DESIGN, pool=pool) == 0
    return lake


def test_a_row_is_repeated_to_the_last_bit(fast, simulated):
    (row,) = simulated.rows(SimulationRow)
    again = fast("simulate", "--simulation", row["simulation_id"], "--lake", simulated.root, "--json").json
    for name in ("design_id", "object_id", "version_id", "peak_force_n", "contact_force_n", "work_j"):
        assert again[name] == row[name]


def test_a_numbered_design_and_a_tier_are_taken_by_name(fast):
    words = ["simulate", "--object", "24", "--set", "max_lift_mm=2"]
    named = fast(*words, "--design", "random-5", "--tier", "production", "--json").json
    assert named["design_id"] == DESIGN.design_id
    assert named["version_id"] == fast(*words, "--json").json["version_id"]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--simulation", "S1", "--object", "2"], "--simulation already says what --object would"),
        (["--simulation", "S1"], "simulation `S1` is not in"),
        (["--object", "2", "--tier", "fine"], "there is no tier `fine`"),
        (["--object", "2", "--tier", "production", "--version", "V1"], "--tier already says what --version would"),
        ([], "`fast simulate` needs --object: Number or name of an object"),
    ],
)
def test_wrong_use_is_refused(fast, simulated, words, said):
    assert said in fast.refused("simulate", *words, "--lake", simulated.root)
