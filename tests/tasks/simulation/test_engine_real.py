"""Production grasps on a real Dask scheduler with two workers, their rows in an object store: nothing is made up."""

from concurrent.futures import ThreadPoolExecutor

import pytest

from fast.lake.store import Lake
from fast.lake.tables.campaign import SimTraceRow, SimulationRow
from fast.models.design.space import BEST_PUBLISHED, numbered_design
from fast.tasks.campaign.campaign import Campaign
from fast.tasks.campaign.config import CampaignConfig
from fast.tasks.simulation.engine import Engine, open_engine
from fast.tasks.simulation.simulate import simulate_design
from tests.lake.storage.object_server import BUCKET, ObjectServer
from tests.tasks.simulation.dask_cluster import cluster

pytest.importorskip("distributed", reason="the extra `scale` is not installed")
OBJECTS = (0, 14, 30)
DESIGNS = [BEST_PUBLISHED, numbered_design(3)]
LIMIT_S = 600.0
NUMBERS = ("simulation_id", "status", "peak_force_n", "contact_force_n", "work_j", "n_dof", "n_newton")


@pytest.fixture
def object_store(tmp_path, monkeypatch):
    server = ObjectServer(tmp_path / "objects")
    server.start()
    for name, value in {**server.environment(), "XDG_STATE_HOME": str(tmp_path / "state")}.items():
        monkeypatch.setenv(name, value)
    yield f"s3://{BUCKET}/labs/real"
    server.kill()


def campaign_at(address: str) -> Campaign:
    simulator = {"tier": "production", "grasp_deadline_s": LIMIT_S}
    data = {"name": "real", "objects": {"ids": OBJECTS}, "simulator": simulator, "bench": {"world": ""}}
    return Campaign(Lake.open(address, create=True), CampaignConfig.model_validate(data))


def simulate_all(campaign: Campaign, engine: Engine, n_workers: int) -> None:
    try:
        with ThreadPoolExecutor(n_workers) as threads:
            assert sum(threads.map(lambda design: simulate_design(campaign, design, pool=engine), DESIGNS)) == 0
    finally:
        engine.close()


def numbers_of(campaign: Campaign) -> list[tuple[object, ...]]:
    return sorted(tuple(row[name] for name in NUMBERS) for row in campaign.lake.rows(SimulationRow))


@pytest.mark.study
@pytest.mark.timeout(1800)
def test_a_cluster_and_an_object_store_give_the_numbers_of_this_machine(object_store, tmp_path):
    here, there = campaign_at(str(tmp_path / "here")), campaign_at(object_store)
    # This machine first: its worker compiles the kernels, which those of the cluster load.
    simulate_all(here, open_engine("local", 1, LIMIT_S), 1)
    with cluster(tmp_path, 2) as found:
        simulate_all(there, open_engine(found.address, 2, LIMIT_S), 2)
    assert numbers_of(there) == numbers_of(here)
    assert len(numbers_of(there)) == len(DESIGNS) * len(OBJECTS)
    last = there.lake.rows(SimulationRow)[-1]["simulation_id"]
    assert there.lake.trace(last, SimTraceRow).force_n.max() > 0
