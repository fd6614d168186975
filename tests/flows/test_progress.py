import pytest

from fast.flows.progress import UNKNOWN, RateEstimate, describe_duration, describe_time_left


def test_time_left_follows_the_rate():
    rate = RateEstimate()
    for second in range(0, 50, 10):
        rate.update(second // 5, float(second))
    assert rate.seconds_left(20) == pytest.approx(100.0)


def test_nothing_is_known_before_the_second_unit_that_was_seen_to_end():
    rate = RateEstimate()
    for done, now_s in ((0, 9.0), (1, 10.0)):  # it began long before the first look
        rate.update(done, now_s)
        assert rate.seconds_left(5) is None
    rate.update(2, 30.0)
    assert rate.seconds_left(5) == pytest.approx(100.0)


def test_waiting_for_a_person_does_not_slow_the_estimate():
    rate = RateEstimate()
    for done, now_s in [(0, 0.0), (1, 10.0), (2, 20.0), (2, 400.0), (3, 3600.0), (4, 3610.0)]:
        rate.update(done, now_s)
    assert rate.seconds_left(3) == pytest.approx(30.0)


@pytest.mark.parametrize(
    ("seconds", "words"), [(40, "40 s"), (600, "10 min"), (12000, "3 h 20 min"), (367200, "4 d 6 h")]
)
def test_durations_read_as_people_say_them(seconds, words):
    assert describe_duration(seconds) == words


def test_nothing_left_takes_no_time_at_any_rate():
    assert RateEstimate().seconds_left(0) == 0.0


def test_the_time_left_is_said_only_when_all_of_it_is_known():
    assert describe_time_left(60.0, 600.0) == "10 min left"
    assert describe_time_left(0.0, 0.0) == "0 s left"
    assert describe_time_left(0.0, None) == UNKNOWN
