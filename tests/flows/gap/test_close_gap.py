"""Scheduled gap discovery on a real Prefect server: it searches, tells people, or says that nothing is new."""

import pytest

from fast.flows.server.server import server
from fast.lake.tables.campaign import FlowRunRow
from fast.models.records import EffectValue
from tests.flows.server.local_server import local_server
from tests.flows.server.on_server import asked, python
from tests.tasks.gap.gap_lake import gap_lake
from tests.waiting import wait_for

LAG = EffectValue(effect="load_cell_lag", parameters={"time_constant_s": 0.4})
pytestmark = [pytest.mark.slow, pytest.mark.timeout(600)]


def worker(url, root, *words, **settings):
    return python(url, root, "-m", "tests.flows.gap.gap_process", root, *words, **settings)


@pytest.fixture(scope="module")
def lake(tmp_path_factory):
    return gap_lake(tmp_path_factory.mktemp("lagging") / "lake", hidden=[LAG], bench="real")


@pytest.fixture(scope="module")
def url(lake):
    with pytest.MonkeyPatch.context() as patch:
        patch.delenv("FAST_PREFECT_API_URL", raising=False)
        with server(lake.root) as found:
            yield found


def test_a_run_tells_people_what_it_found_and_the_next_one_has_nothing_new(lake, url):
    with local_server(lambda request: (200, {})) as (address, inbox):
        first, second = worker(
            url, lake.root, "run", "run", FAST_NOTIFY=address.replace("http://", "json://")
        ).splitlines()
    assert first.startswith("COMPLETED: gap search A")
    assert "found load_cell_lag" in first
    assert second.startswith("COMPLETED: nothing new since gap search A")
    (message,) = inbox  # the second run is silent
    assert message.body["title"] == f"FAST found a gap: {lake.address}"
    assert "round 1, effect: First-order lag of the load-cell transmitter" in message.body["message"]
    runs = lake.records(FlowRunRow, flow="close-gap")
    assert [f"COMPLETED: {run.reason}" for run in runs] == [first, second]
    assert list((lake.root / "outputs").glob("A*/findings.json"))


@pytest.mark.study
def test_the_deployment_is_scheduled_and_a_new_calibration_triggers_it(lake, url):
    worker(url, lake.root, "pool", "deploy")
    (deployment,) = asked(url, "/deployments/filter")
    assert [s["schedule"]["cron"] for s in deployment["schedules"]] == ["0 8 * * *"]
    worker(url, lake.root, "announce")

    def triggered():
        runs = asked(url, "/flow_runs/filter")
        return [run for run in runs if run["deployment_id"] and run["parameters"].get("lake") == str(lake.root)]

    (run,) = wait_for(triggered)
    assert run["deployment_id"] == deployment["id"]
