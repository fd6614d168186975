"""Orders of people: what was seen decides; the same order twice is one."""

import pytest

from fast.hardware.parts.safe_state import Verb
from fast.lake.leases import exclusive
from fast.lake.store import Lake
from fast.lake.tables.campaign import EventRow
from fast.tasks.campaign.present_run import StaleRequestError, read_present_run, request_verb
from fast.tasks.campaign.requests import STARTED, append_event, lease_name


@pytest.fixture
def lake(tmp_path):
    return Lake.open(tmp_path / "lake", create=True)


def test_an_order_that_nobody_would_hear_is_refused(lake):
    with pytest.raises(StaleRequestError, match="quick is not running, so there is nothing to stop"):
        request_verb(lake, "quick", Verb.STOP, "by ada")
    assert lake.rows(EventRow) == []


def test_a_later_run_does_not_get_the_pause_of_an_earlier_one(lake):
    with exclusive(lake.storage, lease_name("quick"), "busy") as first:
        append_event(lake, "quick", STARTED, "started", run=first.token)
        seen = read_present_run(lake, "quick").run
        assert "ends after the current grasp" in request_verb(lake, "quick", Verb.PAUSE, "by ada", seen)
    with exclusive(lake.storage, lease_name("quick"), "busy") as second:
        append_event(lake, "quick", STARTED, "continued", run=second.token)
        assert read_present_run(lake, "quick").verb is None
        with pytest.raises(StaleRequestError, match="was started again"):
            request_verb(lake, "quick", Verb.PAUSE, "by ada", seen)
        assert "safe state at once" in request_verb(lake, "quick", Verb.STOP, "by ada", seen)
        assert read_present_run(lake, "quick").verb is Verb.STOP


@pytest.mark.parametrize(("first", "then", "n"), [("pause", "pause", 1), ("pause", "stop", 2), ("stop", "pause", 1)])
def test_an_order_is_given_once_and_a_stronger_one_is_heard(lake, first, then, n):
    with exclusive(lake.storage, lease_name("quick"), "busy") as lease:
        append_event(lake, "quick", STARTED, "started", run=lease.token)
        request_verb(lake, "quick", Verb(first), "by ada")
        request_verb(lake, "quick", Verb(then), "by grace")
        verbs = lake.rows(EventRow, kind=["pause", "stop"])
        assert len(verbs) == n
        assert read_present_run(lake, "quick").verb is Verb("stop" if "stop" in (first, then) else "pause")
