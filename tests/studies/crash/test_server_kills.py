"""Flow process, worker and server killed at random moments of a campaign that goes on by itself; and its judge."""

import pytest

from fast.lake.store import Lake
from fast.tasks.campaign.config import load_config
from tests.studies.benchmarks.base import Options
from tests.studies.benchmarks.made_up_campaign import config_of, labels_of, write_files
from tests.studies.crash.server_kill_judge import judge_campaign, judge_server
from tests.studies.crash.server_kills import TARGETS, Kill, measure_server_kills, summary


@pytest.mark.study
@pytest.mark.parametrize("n", [1, 100])
@pytest.mark.timeout(6 * 3600)
def test_nothing_is_lost_or_made_twice_and_no_run_or_lock_is_stuck(n, monkeypatch):
    monkeypatch.delenv("FAST_PREFECT_API_URL", raising=False)
    tables = measure_server_kills(Options(n=n))
    assert tables["problems"] == [{"problem": "none"}]
    total = tables["kills"][-1]
    assert (total["killed"], total["kills"], total["second_owner_let_in"]) == ("all", n, 0)


def test_the_files_of_a_made_up_campaign_say_what_its_config_says(tmp_path):
    written = load_config(write_files(tmp_path, "kills-1"))
    assert written.schedule == config_of("kills-1").schedule
    assert written.objects == config_of("kills-1").objects
    assert len(labels_of("kills-1")) == written.schedule.initial_tools * written.objects.n_grasps


def test_a_campaign_without_its_rows_is_not_accepted(tmp_path):
    lake = Lake.open(tmp_path / "lake", create=True)
    problems = judge_campaign(lake, "kills-1")
    assert sum("is missing" in problem for problem in problems) == len(labels_of("kills-1"))
    assert any("0 different simulations of 150" in problem for problem in problems)


def test_an_active_run_is_a_problem():
    runs = [{"name": "campaign kills-1", "state": {"name": "Running"}}]
    assert judge_server(lambda path, body: runs) == ["the flow run campaign kills-1 is still Running"]


def test_the_summary_counts_what_was_hit_and_how_long_it_took():
    kill = Kill(number=1, campaign="kills-1", targets=TARGETS[0], alive=("flow",), is_early=False, rows_before=3)
    kills = [
        kill.model_copy(update={"continued_after_s": 20.0, "second_refused": True}),
        kill.model_copy(update={"is_early": True, "alive": ()}),
        kill.model_copy(update={"targets": TARGETS[3], "continued_after_s": 40.0, "problem": "too late"}),
    ]
    rows = {row["killed"]: row for row in summary(kills)}
    assert rows["flow"]["kills"] == 2
    assert (rows["all"]["flow_killed"], rows["all"]["early"], rows["all"]["problems"]) == (2, 1, 1)
    assert (rows["flow"]["median_wait_s"], rows["all"]["longest_wait_s"]) == (20.0, 40.0)
    assert rows["server"]["median_wait_s"] is None
