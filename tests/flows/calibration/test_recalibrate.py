"""Scheduled recalibration on a real Prefect server: runs, does nothing, is triggered by a campaign's event."""

from importlib.metadata import version

import pytest

from fast.flows.server.server import server
from fast.lake.tables.campaign import CalibrationRow, FlowRunRow
from tests.flows.server.on_server import asked, python
from tests.tasks.calibration.calibration_lake import calibration_lake
from tests.waiting import wait_for

# Made before SQLAlchemy was held below 2.1, with which Prefect's scheduler fails.
IS_OLD_ENVIRONMENT = version("sqlalchemy") >= "2.1"
pytestmark = [pytest.mark.slow, pytest.mark.timeout(600)]


def worker(url, root, *words):
    return python(url, root, "-m", "tests.flows.calibration.recalibrate_process", root, *words)


@pytest.fixture(scope="module")
def lake(tmp_path_factory):
    return calibration_lake(tmp_path_factory.mktemp("measured") / "lake", n_points=30)


@pytest.fixture(scope="module")
def url(lake):
    with pytest.MonkeyPatch.context() as patch:
        patch.delenv("FAST_PREFECT_API_URL", raising=False)
        with server(lake.root) as found:
            yield found


def test_a_run_calibrates_or_says_that_nothing_is_new(lake, url):
    first, second, third = worker(url, lake.root, "run", "run", "measure", "run").splitlines()
    rows = sorted(lake.rows(CalibrationRow), key=lambda row: row["created_at"])
    older, newer = (row["calibration_id"] for row in rows)
    assert first.startswith(f"COMPLETED: calibration {older} of 90 grasps of 15 tools")
    assert second.startswith(f"COMPLETED: nothing new since calibration {older}")
    assert third.startswith(f"COMPLETED: calibration {newer} of 120 grasps of 20 tools")
    assert all((lake.root / "outputs" / name / "report" / "index.html").is_file() for name in lake.ids(CalibrationRow))
    runs = lake.records(FlowRunRow, flow="recalibrate")
    assert [run.reason.split(" ")[0] for run in runs] == ["calibration", "nothing", "calibration"]
    messages = [run["state"]["message"] for run in asked(url, "/flow_runs/filter") if not run["deployment_id"]]
    assert sorted(messages) == sorted(run.reason for run in runs)  # what the pages show


def test_the_deployment_is_scheduled_and_a_campaign_triggers_it(lake, url):
    worker(url, lake.root, "pool")
    python(url, lake.root, "-m", "prefect", "--no-prompt", "deploy", "--name", "recalibrate")
    (deployment,) = asked(url, "/deployments/filter")
    assert [s["schedule"]["cron"] for s in deployment["schedules"]] == ["0 6 * * *"]
    worker(url, lake.root, "announce")

    def runs_on(address):
        runs = asked(url, "/flow_runs/filter")
        return [run for run in runs if run["deployment_id"] and run["parameters"].get("lake") == address]

    (run,) = wait_for(lambda: runs_on(str(lake.root)))
    assert run["deployment_id"] == deployment["id"]
    if not IS_OLD_ENVIRONMENT:
        planned = wait_for(lambda: runs_on("lake-data"))  # the scheduler plans the next three days
        assert {run["expected_start_time"][11:16] for run in planned} == {"06:00"}
