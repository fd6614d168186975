"""When the campaign's page is written: soon after something happened, seldom otherwise, and never dearly."""

import socket
import time
from functools import partial
from types import SimpleNamespace

import pytest
from prefect.settings import PREFECT_API_URL, PREFECT_CLIENT_MAX_RETRIES, temporary_settings

from fast.flows.campaign import page as campaign_page
from fast.flows.campaign.page import INTERVAL_S, QUIET_S, CampaignPage
from fast.flows.campaign.progress import MOST_CPU


class Clock:
    def __init__(self):
        self.now_s = self.cpu_s = 1000.0

    def monotonic(self) -> float:
        return self.now_s

    def thread_time(self) -> float:
        return self.cpu_s


@pytest.fixture
def clock(monkeypatch):
    clock = Clock()
    monkeypatch.setattr(campaign_page, "time", clock)
    return clock


@pytest.fixture
def page(clock, monkeypatch):
    """A page that was made at 1000 s, with news at any time; `written` says when it was written."""
    monkeypatch.setattr(campaign_page, "create_progress_artifact", lambda *words: "progress")
    monkeypatch.setattr(campaign_page, "create_markdown_artifact", lambda *words: "page")
    monkeypatch.setattr(CampaignPage, "text", lambda self, *, with_picture=True: "text")
    page = CampaignPage(SimpleNamespace(campaign_id="quick", lake=SimpleNamespace(mark=lambda table: clock.now_s)))
    page.written, page.cost_s = [], 0.0

    def write():
        page.written.append(clock.now_s)
        clock.cpu_s += page.cost_s

    monkeypatch.setattr(page, "_write", write)
    return page


def watch(page, clock, for_s: float) -> list[float]:
    """Seconds after the start at which the page was written, looked at every other second."""
    began_s = clock.now_s
    while clock.now_s < began_s + for_s:
        clock.now_s += 2.0
        page.update()
    return [at_s - began_s for at_s in page.written]


def test_news_are_shown_within_a_minute(page, clock):
    assert watch(page, clock, 200.0) == [INTERVAL_S, 2 * INTERVAL_S, 3 * INTERVAL_S]


def test_without_news_the_page_only_says_that_it_is_alive(page, clock, monkeypatch):
    monkeypatch.setattr(page._campaign.lake, "mark", lambda table: 0)
    first, second = watch(page, clock, 2.0 * QUIET_S)
    assert first == INTERVAL_S
    assert QUIET_S <= second - first <= QUIET_S + INTERVAL_S


def test_a_page_that_costs_much_comes_seldom_but_comes(page, clock):
    page.cost_s = 120.0 * MOST_CPU
    assert watch(page, clock, 290.0) == pytest.approx([60.0, 180.0], abs=4.0)
    page.cost_s, page.written = 1e3, []
    assert len(watch(page, clock, 3 * QUIET_S)) in (2, 3)


def test_the_end_is_shown_at_once(page, clock):
    page.update(now=True)
    assert page.written == [clock.now_s]


def test_a_server_that_does_not_answer_harms_no_campaign(page, clock, monkeypatch, caplog):
    def fail():
        raise OSError("gone")

    monkeypatch.setattr(page, "_write", fail)
    page.update(now=True)
    assert "the campaign's page was not written: gone" in caplog.text


def test_a_server_that_is_gone_holds_up_no_campaign(page, clock, monkeypatch, caplog):
    """Prefect's client tries again for four minutes, in which a campaign heard nobody."""
    monkeypatch.setattr(page, "_write", partial(CampaignPage._write, page))
    page._load = SimpleNamespace(fraction=0.5)
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
    settings = {PREFECT_API_URL: f"http://127.0.0.1:{port}/api", PREFECT_CLIENT_MAX_RETRIES: 7}
    began_s = time.monotonic()
    with temporary_settings(settings):
        page.update(now=True)
    assert time.monotonic() - began_s < 20.0
    assert "the campaign's page was not written: [Errno 111] Connection refused" in caplog.text
