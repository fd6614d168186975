"""A lent bench: one person holds it, who wants it asks, orders are for one process, and a stop is never refused."""

from datetime import UTC, datetime, timedelta

import pytest

from fast.hardware.hand import HandStep
from fast.lake.leases import exclusive
from fast.lake.store import Lake
from fast.lake.tables.campaign import EventRow
from fast.models.errors import UsageError
from fast.tasks.bench.lend import DONE, REQUESTED, BenchRequest, read_lent, reading_path, send_request
from fast.tasks.campaign.present_run import StaleRequestError
from fast.tasks.campaign.requests import GANTRY_LEASE
from tests.tasks.bench.lent_bench import lent
from tests.waiting import wait_for


@pytest.fixture
def lake(tmp_path):
    return Lake.open(tmp_path / "lake", create=True)


def order(lake, verb, operator="ada", **more):
    return send_request(lake, BenchRequest(session=read_lent(lake).session, operator=operator, verb=verb, **more))


def wait_said(lake, words):
    wait_for(lambda: read_lent(lake) is None or words in read_lent(lake).said, 30.0)


def test_a_bench_is_taken_moved_and_given_back_by_one_person_at_a_time(lake):
    with lent(lake):
        up = HandStep(verb="jog", axis="z", distance_mm=-5)
        with pytest.raises(UsageError, match="nobody holds the bench, not ada"):
            order(lake, "step", step=up)
        assert order(lake, "take") == "ada takes turin by hand."
        wait_said(lake, "turin is connected")
        wait_for(reading_path(lake).exists, 10.0)
        assert order(lake, "step", step=up) == "ada: jog z -5 mm."
        wait_said(lake, "the head is at")
        order(lake, "step", step=HandStep(verb="jog", axis="z", distance_mm=90))
        wait_said(lake, "at most 20 mm")
        for verb, more, words in (
            ("take", {}, "ada holds the bench; ask for it first"),
            ("step", {"step": up}, "ada holds the bench, not grace"),
            ("run", {"config": "x.toml"}, "ada moves the bench by hand"),
        ):
            with pytest.raises(UsageError, match=words):
                order(lake, verb, "grace", **more)
        order(lake, "want", "grace")
        assert not read_lent(lake).may_take("grace")
        assert read_lent(lake).may_take("grace", datetime.now(UTC) + timedelta(seconds=61))
        order(lake, "give")
        assert (read_lent(lake).holder, read_lent(lake).wanted_by) == ("grace", "")
        with pytest.raises(UsageError, match="grace holds the bench, not ada"):
            order(lake, "step", step=up)
        order(lake, "stop", "ada")
        order(lake, "step", "grace", step=up)
        wait_said(lake, "A person asked to stop")
        order(lake, "step", "grace", step=HandStep(verb="recover"))
        wait_said(lake, "the safe state is ended")
        order(lake, "release", "grace")
        wait_said(lake, "grace gave turin back")
        assert read_lent(lake).holder == ""
        assert not reading_path(lake).exists()
    assert read_lent(lake) is None
    operators = {row.payload["operator"] for row in lake.records(EventRow, kind=REQUESTED)}
    assert operators == {"ada", "grace"}


def test_a_campaign_that_moves_the_bench_is_not_disturbed(lake):
    with lent(lake) as runs:
        with (
            exclusive(lake.storage, GANTRY_LEASE, "busy"),
            pytest.raises(UsageError, match="a campaign moves the bench"),
        ):
            order(lake, "take")
        order(lake, "run", config="quick.toml")
        wait_said(lake, "ran")
        assert runs == ["quick.toml"]


def test_orders_for_a_process_that_has_ended_are_heard_by_nobody(lake):
    with lent(lake):
        old = read_lent(lake).session
    with pytest.raises(StaleRequestError):
        send_request(lake, BenchRequest(session=old, operator="ada", verb="take"))
    with lent(lake):
        with pytest.raises(StaleRequestError, match="is not lent any more"):
            send_request(lake, BenchRequest(session=old, operator="ada", verb="take"))
        assert read_lent(lake).holder == ""


def test_a_bench_that_cannot_be_opened_is_free_again_and_says_why(lake):
    def refuse(may_vent):
        raise UsageError(f"the gripper is closed, leave to open it: {may_vent}")

    with lent(lake, open_it=refuse):
        order(lake, "take", may_vent=True)
        wait_said(lake, "the gripper is closed, leave to open it: True")
        assert read_lent(lake).holder == ""
        assert lake.records(EventRow, kind=DONE)[-1].payload["is_over"]


def test_a_bench_that_is_lent_for_one_person_ends_with_that_person(lake):
    with lent(lake, "ada"):
        wait_said(lake, "turin is connected")
        order(lake, "release")
        wait_for(lambda: read_lent(lake) is None, 30.0)
    assert "ada gave turin back" in [row.payload["sentence"] for row in lake.records(EventRow, kind=DONE)]
