from types import SimpleNamespace

import pytest

from flows.campaign import progress
from flows.campaign.progress import MOST_CPU, ProgressReporter, RateEstimate, Workload, in_words


def test_time_left_follows_the_rate():
    rate = RateEstimate()
    for second in range(0, 50, 10):
        rate.update(second // 5, float(second))
    assert rate.seconds_left(20) == pytest.approx(100.0)


def test_nothing_is_known_before_the_second_unit():
    rate = RateEstimate()
    rate.update(0, 0.0)
    assert rate.seconds_left(5) is None


def test_waiting_for_a_person_does_not_slow_the_estimate():
    rate = RateEstimate()
    for done, now_s in [(0, 0.0), (1, 10.0), (2, 20.0), (2, 400.0), (3, 3600.0), (4, 3610.0)]:
        rate.update(done, now_s)
    assert rate.seconds_left(3) == pytest.approx(30.0)


@pytest.mark.parametrize(
    ("seconds", "words"), [(40, "40 s"), (600, "10 min"), (12000, "3 h 20 min"), (367200, "4 d 6 h")]
)
def test_durations_read_as_people_say_them(seconds, words):
    assert in_words(seconds) == words


def test_share_of_work_done():
    assert Workload(5, 10, 15, 30).fraction == 0.5


def test_lines_that_cost_much_come_seldom(monkeypatch):
    """A bench measures for days: what people read of it must not cost more than the rest."""
    clock, cpu_s, lines = [0.0], [0.0], []
    monkeypatch.setattr(progress, "time", SimpleNamespace(
        monotonic=lambda: clock[0], thread_time=lambda: cpu_s[0], strftime=lambda form: "12:00:00",
    ))  # fmt: skip
    monkeypatch.setattr(progress, "at_present", lambda campaign: SimpleNamespace(state=lambda: None))

    def count(campaign, state) -> Workload:
        cpu_s[0] += 0.03
        return Workload(1, 2, 3, 4)

    monkeypatch.setattr(progress, "workload", count)
    reporter = ProgressReporter(SimpleNamespace(), lines.append)
    for _ in range(200):
        clock[0] += 1.0
        reporter.line("a grasp")
    assert len(lines) == 7  # at 1 s, and then every 30 s
    assert cpu_s[0] / clock[0] == pytest.approx(MOST_CPU, rel=0.1)
    reporter.line("a design", force=True)
    assert len(lines) == 8
