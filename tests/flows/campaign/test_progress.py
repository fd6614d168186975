from types import SimpleNamespace

import pytest

from fast.flows.campaign import progress
from fast.flows.campaign.progress import MOST_CPU, CampaignProgress, Workload
from fast.flows.progress import UNKNOWN, ProgressReporter


def test_share_of_work_done():
    assert Workload(5, 10, 15, 30).fraction == 0.5


def test_lines_that_cost_much_come_seldom(monkeypatch):
    """A bench measures for days: what people read of it must not cost more than the rest."""
    clock, cpu_s, lines = [0.0], [0.0], []
    fake_time = SimpleNamespace(monotonic=lambda: clock[0], thread_time=lambda: cpu_s[0])
    monkeypatch.setattr(progress, "time", fake_time)
    monkeypatch.setattr(progress, "at_present", lambda campaign: SimpleNamespace(state=lambda: None))

    def count(campaign, state) -> Workload:
        cpu_s[0] += 0.03
        return Workload(1, 2, 3, 4)

    monkeypatch.setattr(progress, "count_work", count)
    reporter = CampaignProgress(SimpleNamespace(), ProgressReporter(lines.append, lines.append).report)
    for _ in range(200):
        clock[0] += 1.0
        reporter.line("a grasp")
    assert len(lines) == 7  # at 1 s, and then every 30 s
    assert cpu_s[0] / clock[0] == pytest.approx(MOST_CPU, rel=0.1)
    reporter.line("a design", force=True)
    assert len(lines) == 8


def test_after_a_break_no_time_is_said_until_the_rate_of_the_grasps_is_known_again(monkeypatch):
    """The simulations of the stage are done, half of the grasps are left, and their first came after a print."""
    clock, grasps, lines = [0.0], [0], []
    monkeypatch.setattr(progress, "time", SimpleNamespace(monotonic=lambda: clock[0], thread_time=lambda: 0.0))
    monkeypatch.setattr(progress, "at_present", lambda campaign: SimpleNamespace(state=lambda: None))
    monkeypatch.setattr(progress, "count_work", lambda campaign, state: Workload(grasps[0], 20, 30, 30))
    reporter = CampaignProgress(SimpleNamespace(), ProgressReporter(lines.append, lines.append).report)
    for at_s, done in ((0.0, 8), (10.0, 9), (20.0, 10), (4000.0, 11), (4010.0, 12)):
        clock[0], grasps[0] = at_s, done
        reporter.line("a grasp")
    said = [line.rpartition("  |  ")[2] for line in lines]
    assert said == [UNKNOWN, UNKNOWN, "2 min left", UNKNOWN, "80 s left"]
