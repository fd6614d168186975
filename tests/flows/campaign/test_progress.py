from types import SimpleNamespace

import pytest

from fast.flows.campaign import pace, progress
from fast.flows.campaign.pace import StageLeft
from fast.flows.campaign.progress import MOST_CPU, CampaignProgress, Workload
from fast.flows.progress import UNKNOWN, ProgressReporter


@pytest.fixture
def clock(monkeypatch):
    """Seconds, CPU seconds, and the measured cells of the lake, that the test sets."""
    now = SimpleNamespace(s=0.0, cpu_s=0.0, measured={})
    fake_time = SimpleNamespace(monotonic=lambda: now.s, thread_time=lambda: now.cpu_s)
    monkeypatch.setattr(progress, "time", fake_time)
    monkeypatch.setattr(pace, "time", fake_time)
    state = SimpleNamespace(measured=now.measured)
    monkeypatch.setattr(progress, "at_present", lambda campaign: SimpleNamespace(state=lambda: state))
    return now


@pytest.fixture
def lines():
    return []


@pytest.fixture
def reporter(lines):
    return CampaignProgress(campaign_with(), ProgressReporter(lines.append, lines.append).report)


def campaign_with(gap=False, night=False) -> SimpleNamespace:
    config = SimpleNamespace(gap=SimpleNamespace(active=gap), night=SimpleNamespace(active=night))
    return SimpleNamespace(object_ids=(0, 1), config=config)


def test_share_of_work_done():
    assert Workload(5, 10, 15, 30).fraction == 0.5


def test_the_lake_is_read_seldom_and_grasps_are_counted_between(monkeypatch, clock, lines, reporter):
    """A bench measures for days: what people read of it must not cost more than the rest."""
    n_made, looks = [0], []

    def count(campaign, state) -> Workload:
        clock.cpu_s += 0.12
        looks.append(clock.s)
        return Workload(n_made[0], 1000, 30, 30)

    monkeypatch.setattr(progress, "count_work", count)
    left = lambda campaign, state: [StageLeft(1000 - n_made[0], 0, is_guided=False)]  # noqa: E731
    monkeypatch.setattr(progress, "count_left", left)
    for _ in range(500):
        clock.s += 2.0
        n_made[0] += 1
        reporter.grasp("a grasp", ("T", (n_made[0], 0)))
    assert len(looks) == 9  # at 2 s, and then every 120 s
    assert clock.cpu_s / clock.s == pytest.approx(MOST_CPU, rel=0.1)
    assert len(lines) == 167  # every 6 s, the first grasp after five
    assert lines[-1].endswith("grasps 499/1000, simulated 30/30  |  17 min left")
    reporter.simulated("a design")
    assert len(looks) == 10
    assert "grasps 500/1000" in lines[-1]


def test_grasps_that_the_schedule_does_not_owe_are_not_counted(monkeypatch, clock, lines, reporter):
    monkeypatch.setattr(progress, "count_work", lambda campaign, state: Workload(0, 9, 0, 0))
    monkeypatch.setattr(progress, "count_left", lambda campaign, state: [StageLeft(9, 0, is_guided=False)])
    reporter.simulated("a design")
    monkeypatch.setattr(reporter, "_next_look_s", 1e9)
    for owed in (("T", (0, 0)), None, ("T", (0, 1))):
        clock.s += 10.0
        reporter.grasp("a grasp", owed)
    assert [line.split("grasps ")[1].split(",")[0] for line in lines] == ["0/9", "1/9", "1/9", "2/9"]


def test_a_grasp_that_a_look_has_found_already_is_not_counted_again(monkeypatch, clock, lines, reporter):
    """Its row is in the lake before the bench tells of it, and a design that is simulated in between looks there."""
    n_found = lambda: sum(map(len, clock.measured.values()))  # noqa: E731
    monkeypatch.setattr(progress, "count_work", lambda campaign, state: Workload(n_found(), 9, 0, 0))
    monkeypatch.setattr(progress, "count_left", lambda campaign, state: [StageLeft(9 - n_found(), 0, is_guided=False)])
    clock.measured["T"] = {(0, 0), (0, 1)}
    reporter.simulated("a design")
    monkeypatch.setattr(reporter, "_next_look_s", 1e9)
    for cell in ((0, 1), (1, 0)):
        clock.s += 10.0
        reporter.grasp("a grasp", ("T", cell))
    assert [line.split("grasps ")[1].split(",")[0] for line in lines] == ["2/9", "2/9", "3/9"]


def test_a_break_is_no_part_of_the_pace_of_the_grasps(monkeypatch, clock, lines, reporter):
    """The simulations of the stage are done, half of the grasps are left, and their first came after a print."""
    grasps = [0]
    monkeypatch.setattr(progress, "count_work", lambda campaign, state: Workload(grasps[0], 20, 30, 30))
    monkeypatch.setattr(progress, "count_left", lambda campaign, state: [StageLeft(20 - grasps[0], 0, is_guided=False)])
    for at_s, done in ((0.0, 8), (10.0, 9), (20.0, 10), (4000.0, 11), (4010.0, 12)):
        clock.s, grasps[0] = at_s, done
        reporter.grasp("a grasp", ("T", (0, done)))
    said = [line.rpartition("  |  ")[2] for line in lines]
    assert said == [UNKNOWN, "2 min left", "2 min left", "2 min left", "80 s left"]


@pytest.mark.parametrize(
    ("gap", "night", "words"),
    [(True, False, ", without gap searches"), (True, True, ", without gap searches and nights"), (False, False, "")],
)
def test_what_nobody_can_time_is_no_part_of_the_time_left_and_is_said(monkeypatch, clock, lines, gap, night, words):
    grasps = [0]
    monkeypatch.setattr(progress, "count_work", lambda campaign, state: Workload(grasps[0], 20, 4, 4))
    monkeypatch.setattr(progress, "count_left", lambda campaign, state: [StageLeft(20 - grasps[0], 0, is_guided=False)])
    reporter = CampaignProgress(campaign_with(gap, night), ProgressReporter(lines.append, lines.append).report)
    for _ in range(10):
        grasps[0] += 1
        clock.s += 30.0
        reporter.grasp("a grasp", ("T", (0, grasps[0])))
    assert lines[0].endswith(UNKNOWN)
    assert lines[-1].endswith(f"5 min left{words}")
