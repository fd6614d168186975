"""When a person is needed next, on a campaign whose lake is written by hand."""

import time
from datetime import UTC, datetime

import pytest

from fast.flows.campaign.pace import Forecast, forecast
from fast.flows.page.now import _say_need
from fast.tasks.bench.print import PrintConfirmation, confirm_print
from fast.tasks.campaign.campaign import Campaign
from fast.tasks.campaign.settings import NightSettings
from fast.tasks.scientist.propose import propose_initial
from tests.tasks.campaign.small_campaign import small_campaign
from tests.tasks.simulation.made_up import append_grasp, append_simulation

NOW = datetime(2026, 11, 21, 4, 0, tzinfo=UTC)


@pytest.fixture
def campaign(tmp_path):
    return small_campaign(tmp_path)


@pytest.fixture
def zone(request, monkeypatch):
    """The zone of this computer: UTC, or what a test names."""
    monkeypatch.setenv("TZ", getattr(request, "param", "UTC"))
    time.tzset()
    yield
    monkeypatch.undo()
    time.tzset()


def look(campaign, s_per_grasp=15.0, s_per_simulation=100.0):
    return forecast(campaign, campaign.state(), s_per_grasp, s_per_simulation)


def test_a_campaign_needs_a_person_now_then_when_bench_and_simulations_are_done(campaign):
    propose_initial(campaign)
    assert look(campaign) == Forecast(1, 0.0)
    confirm_print(campaign.lake, "small", 1, PrintConfirmation(operator="ada"))
    # Two tools on two objects twice, 8 grasps; two designs and two tools on two objects, 8 simulations.
    assert look(campaign) == Forecast(2, pytest.approx(800.0), is_proposed=False)
    assert look(campaign, s_per_grasp=None).in_s is None
    state = campaign.state()
    for design in [*(p.design for p in state.simulations), *(t.design for t in state.tools)]:
        for object_id in campaign.object_ids:
            append_simulation(campaign, design, object_id, 10.0)
    append_grasp(campaign, state.tools_of(1)[0], 4, 0, 5.0)
    n_proposed = len(state.simulations_of(1))
    left_s = (2 - n_proposed) * 2 * 100.0
    assert look(campaign) == Forecast(2, pytest.approx(max(7 * 15.0, left_s)), is_proposed=False)


def test_when_a_night_ends_is_not_known(campaign):
    propose_initial(campaign)
    confirm_print(campaign.lake, "small", 1, PrintConfirmation(operator="ada"))
    config = campaign.config.model_copy(update={"night": NightSettings(active=True)})
    assert look(Campaign(campaign.lake, config)) == Forecast(2, None, is_proposed=False)


@pytest.mark.parametrize(
    ("seen", "words"),
    [
        (Forecast(2, 9600.0), "Next time a person is needed: 06:40 UTC, for B02."),
        (Forecast(2, 30 * 3600.0), "Next time a person is needed: 10:00 UTC on Sunday, 22 November, for B02."),
        (Forecast(2, 0.0), "A person is needed now: print and mount B02."),
        (Forecast(2, 0.0, is_proposed=False), "FAST is choosing the tools of B02; then a person is needed."),
        (Forecast(2, None), "A person is needed for B02; when is not known yet."),
        (Forecast(None, None), "No person is needed any more."),
    ],
)
def test_a_forecast_is_a_sentence(seen, words, zone):
    assert seen.in_words(NOW) == words


@pytest.mark.parametrize("zone", ["Europe/Berlin"], indirect=True)
def test_the_hour_that_comes_twice_is_told_by_its_zone(zone):
    """At 03:00 of 25 October 2026 clocks go back to 02:00; in an hour it is as late as now."""
    now = datetime(2026, 10, 25, 0, 50, tzinfo=UTC).astimezone()
    assert f"{now:%H:%M %Z}" == "02:50 CEST"
    assert Forecast(2, 3600.0).in_words(now) == "Next time a person is needed: 02:50 CET, for B02."
    assert _say_need(Forecast(2, 3600.0), now) == "You are needed in 60 min (02:50 CET): print B02"
