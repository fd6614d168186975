"""The bench by hand on the page, and a campaign that is started there on a bench that a terminal lends."""

import pytest

from fast.flows.server.access import Role
from fast.lake.leases import exclusive
from fast.lake.store import Lake
from fast.tasks.bench.lend import read_lent
from fast.tasks.campaign.requests import GANTRY_LEASE
from tests.flows.cli.cli_lakes import QUICK, WORLD, proposed_lake
from tests.flows.page.lab_page import Browser
from tests.flows.page.served import CHROMIUM, find_barriers, open_browser, say_name, serve
from tests.tasks.bench.lent_bench import lent
from tests.waiting import wait_for

BENCH_FILE = 'serial_port = "/dev/pts/9"\nplc_host = "127.0.0.1"\ntransmitter_host = "127.0.0.1"\n'


@pytest.fixture
def lake(tmp_path):
    return Lake.open(proposed_lake(tmp_path))


def order(browser, verb, **more):
    found = read_lent(browser.lake)
    return browser.say("/bench/order", {"session": found.session if found else "", "verb": verb, **more})


@pytest.fixture
def browsers(lake):
    """Ada and Grace at two screens, and somebody who may only say what was printed."""
    found = [Browser(lake), Browser(lake, name="grace"), Browser(lake, role=Role.SAY, name="tim")]
    for browser in found:
        browser.lake = lake
    return found


def test_two_screens_see_one_holder_and_a_take_over_asks(lake, browsers):
    ada, grace, tim = browsers
    assert "Take a virtual bench" in ada.see("/start")
    assert order(ada, "take") == (
        409,
        "No worker is running, so nothing was started: run `fast serve`, and use its page.",
    )
    with lent(lake):
        assert "with leave to move given in the terminal beside it" in grace.see("/start")
        assert order(tim, "take")[0] == 403
        assert order(ada, "take")[0] == 204
        wait_for(lambda: "z_mm" in ada.client.get("/bench/reading").json(), 30.0)
        wait_for(lambda: "ada moves the bench by hand" in grace.see("/strip"), 10.0)
        wait_for(lambda: "Ask ada for it" in grace.see("/bench"), 10.0)
        assert "Stop now" in grace.see("/bench")  # whoever sees a bench move may stop it
        assert order(grace, "step", step="home") == (409, "ada holds the bench, not grace; nothing was moved.")
        assert order(grace, "want")[0] == 204
        wait_for(lambda: "grace asks you for the bench" in ada.see("/bench"), 10.0)  # read anew within a moment
        assert order(ada, "keep")[0] == 204
        assert order(grace, "want")[0] == 204
        assert order(ada, "give")[0] == 204
        wait_for(lambda: "Ask grace for it" in ada.see("/bench"), 10.0)
        before = ada.client.get("/bench/reading").json()
        assert order(grace, "step", step="jog", axis="z", distance_mm="-10")[0] == 204
        wait_for(lambda: grace.client.get("/bench/reading").json().get("z_mm", 999) < before["z_mm"] - 9, 30.0)
        assert order(grace, "step", step="fly")[0] == 409
        assert order(grace, "release")[0] == 204
        wait_for(lambda: read_lent(lake).said == "grace gave turin back", 30.0)
    wait_for(lambda: "bench:" not in ada.see("/strip"), 10.0)


def test_a_campaign_is_started_on_the_bench_that_a_terminal_lends_and_on_no_other(lake, browsers, tmp_path):
    ada, file = browsers[0], tmp_path / "turin.toml"
    file.write_text(BENCH_FILE)
    named = QUICK.replace('name = "quick"', 'name = "real"').replace('"world.toml"', f'"{WORLD}"\nreal = "{file}"')
    form = {"text": named, "base": "quick.toml", "on": "real"}
    status, words = ada.say("/start/campaign", form)
    assert (status, f"fast gantry lend --real {file}" in words) == (409, True)
    with lent(lake, file=tmp_path / "other.toml"):
        status, words = ada.say("/start/campaign", form)
        assert (status, "is for the bench turin" in words) == (409, True)
    with lent(lake, file=file) as runs:
        assert "on the real bench" in ada.see("/start")
        with exclusive(lake.storage, GANTRY_LEASE, "busy"):
            assert "a campaign moves the bench" in ada.say("/start/campaign", form)[1]
        assert ada.say("/start/campaign", {**form, "text": QUICK, "on": "real"})[0] == 409  # it names no bench
        assert runs == []
        status, words = ada.say("/start/campaign", form)
        assert (status, "ada has turin run real.toml" in words) == (204, True)
        wait_for(lambda: len(runs) == 1, 30.0)
        assert runs[0].endswith("outputs/configs/real.toml")


@pytest.mark.slow
@pytest.mark.skipif(not CHROMIUM.exists(), reason="no chromium: apt-get install chromium")
def test_a_bench_is_moved_on_a_phone(lake):
    pytest.importorskip("playwright")
    with lent(lake), serve(lake) as address, open_browser(address, 390, "dark") as page:
        say_name(page, "Ada")
        page.click("nav a:has-text('Start')")
        page.click("#by-hand button:has-text('Take the bench')")
        page.wait_for_selector("#bench-place:has-text('z 180.0 mm')", timeout=60_000)
        page.focus("#by-hand button[aria-label='z -10 mm']")
        page.keyboard.press("Enter")
        page.wait_for_selector("#bench-place:has-text('z 170.0 mm')", timeout=60_000)
        assert page.evaluate("() => document.activeElement.getAttribute('aria-label')") == "z -10 mm"
        assert page.evaluate("() => document.documentElement.scrollWidth") == 390
        assert find_barriers(page) == []
        page.click("#by-hand button:has-text('Close')")
        page.wait_for_selector("#bench-said:has-text('no tool is locked')")
        page.click("#by-hand button:has-text('Give the bench back')")
        page.wait_for_selector("#by-hand button:has-text('Take the bench')", timeout=60_000)
