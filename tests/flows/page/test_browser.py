"""The page in a real browser: on a phone and a screen, what moves, what is asked, a server that goes and comes back."""

import itertools
import threading
from contextlib import ExitStack

import pytest

from fast.lake.leases import exclusive
from fast.lake.store import Lake
from fast.lake.tables.campaign import GraspRow, ToolRow
from fast.tasks.bench.live import live_path, show_live
from fast.tasks.campaign.campaign import Campaign
from fast.tasks.campaign.config import load_config
from fast.tasks.campaign.present_run import read_present_run
from fast.tasks.campaign.requests import STARTED, append_event, lease_name
from fast.tasks.campaign.setup import register
from fast.tasks.scientist.propose import propose_initial
from tests.flows.cli.cli_lakes import QUICK, ROOT, Fast, proposed_lake, write_config
from tests.flows.page.served import CHROMIUM, open_browser, say_name, serve
from tests.flows.page.test_live import Measuring

pytest.importorskip("playwright")
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not CHROMIUM.exists(), reason="no chromium: apt-get install chromium"),
]
PEOPLE = ROOT / "tests" / "data" / "cases" / "people"


def test_a_batch_is_confirmed_on_a_phone(tmp_path):
    lake = Lake.open(proposed_lake(tmp_path))
    with serve(lake) as address, open_browser(address, 390) as page:
        assert page.evaluate("() => document.documentElement.scrollWidth") == 390
        page.click("#need a")
        page.click("button:has-text('Printed and mounted')")
        assert "Say your name first" in page.inner_text("#said:visible")
        say_name(page, "Ada")
        page.click("nav a:has-text('To do')")
        page.fill("input[name='reason-0']", "tip torn")
        with page.expect_response("**/todo?campaign=quick"):  # the part is drawn anew, and what was typed stays
            page.click("button:has-text('Printed and mounted')")
            page.wait_for_selector("#said.wrong:has-text('is said to be good, and why it is not')")
        page.wait_for_timeout(500)
        assert page.input_value("input[name='reason-0']") == "tip torn"
        page.check("input[name='fate-0'][value='rejected']")
        page.dblclick("button:has-text('Printed and mounted')")
        page.wait_for_selector("text=Nothing is asked of you")
        page.wait_for_timeout(500)
        assert "3 tools mounted, 1 rejected." in page.inner_text("#said")
        assert page.evaluate("() => document.documentElement.scrollWidth") == 390
    rows = {row["slot"]: row for row in lake.rows(ToolRow)}
    assert (rows[0]["status"], rows[0]["reason"], rows[0]["operator"]) == ("rejected", "tip torn", "Ada")
    assert {row["status"] for slot, row in rows.items() if slot} == {"printed"}


def test_the_first_campaign_of_a_lake_shows_on_pages_that_were_open_before(tmp_path):
    lake = Lake.open(tmp_path / "lake", create=True)
    with serve(lake) as address, open_browser(address) as page:
        now = page.context.new_page()
        now.goto(address.partition("?")[0])
        page.click("nav a:has-text('Start')")
        page.fill("#config", "# being written")
        assert "nothing yet" in page.inner_text("#strip")
        with exclusive(lake.storage, lease_name("quick"), "busy"):
            campaign = Campaign(lake, load_config(write_config(tmp_path)))
            register(campaign, QUICK)
            page.wait_for_selector("#word:has-text('running')")
            now.wait_for_selector("#map")
            propose_initial(campaign)
            for one in (page, now):
                one.wait_for_selector("#word:has-text('waiting')")
                one.wait_for_selector("#n-todos:has-text('1')")
        assert page.input_value("#config") == "# being written"


def test_a_report_shows_its_pictures_and_runs_no_script(tmp_path):
    lake = Lake.open(proposed_lake(tmp_path))
    folder = lake.root / "outputs" / "quick" / "report"
    folder.mkdir(parents=True)
    (folder / "a.svg").write_text('<svg xmlns="http://www.w3.org/2000/svg" width="40" height="30"/>')
    (folder / "index.html").write_text("<title>quiet</title><img src='a.svg'><script>document.title = 'loud'</script>")
    with serve(lake) as address, open_browser(address) as page:
        page.goto(f"{address.partition('?')[0]}outputs/quick/report/index.html")
        assert page.locator("img").evaluate("one => one.naturalWidth") == 40
        assert page.title() == "quiet"


def test_no_tab_is_wider_than_a_small_phone(tmp_path):
    lake = Lake.open(proposed_lake(tmp_path))
    (lake.root / "outputs" / "configs").mkdir(parents=True)
    (lake.root / "outputs" / "configs" / f"{'x' * 41}.toml").write_text("")
    with serve(lake) as address, open_browser(address, 360) as page:
        for tab in ("Now", "To do", "Results", "Gap", "Start"):
            page.click(f"nav a:has-text('{tab}')")
            page.wait_for_selector(f"nav a[aria-current]:has-text('{tab}')")
            assert page.evaluate("() => document.documentElement.scrollWidth") == 360, tab


def test_the_force_moves_on_the_screen_and_a_reload_shows_the_whole_grasp(tmp_path):
    lake, bench, is_over = Lake.open(proposed_lake(tmp_path)), Measuring(), threading.Event()
    bench.begin("quick/B01T1", 2)

    def measure():
        for _ in itertools.takewhile(lambda _: not is_over.wait(0.0125), range(4000)):
            bench.add(1)

    with serve(lake) as address, show_live(live_path(lake, "quick"), bench), open_browser(address) as page:
        bencher = threading.Thread(target=measure)
        bencher.start()
        try:
            page.wait_for_selector("#live-title:has-text('B01T1 on large sphere (2), repeat 0')")
            page.evaluate(
                """() => { window.changes = 0; new MutationObserver(() => { window.changes += 1; })
                    .observe(document.querySelector("#live-force"), { childList: true }); }"""
            )
            page.wait_for_timeout(3000)
            assert page.evaluate("() => window.changes") >= 15
            assert page.locator(".map .place[data-object='2'].here").count() == 1
        finally:
            is_over.set()
            bencher.join()
        page.wait_for_timeout(500)
        page.reload()
        page.wait_for_selector("#live canvas")
        assert page.inner_text("#live-force") == f"{bench.force_n[-1]:.1f} N"
        highest_mm = page.evaluate("() => document.querySelector('#live').dataset.lift")
        assert float(highest_mm) == pytest.approx(bench.lift_mm[-1], abs=0.01)


def test_a_server_that_falls_silent_counts_as_lost_and_is_asked_again(tmp_path):
    with serve(Lake.open(proposed_lake(tmp_path))) as address, open_browser(address) as page:
        page.clock.install()
        page.route("**/events*", lambda route: None)  # never answered: a hung server, or a network that is gone
        page.reload()
        page.wait_for_selector("#lost", state="hidden")
        page.clock.fast_forward(42_000)
        page.wait_for_selector("#lost:has-text('does not answer')")
        page.unroute("**/events*")
        page.clock.fast_forward(42_000)
        page.wait_for_selector("#lost", state="hidden")


def test_a_stop_asks_once_and_two_screens_see_the_same(tmp_path):
    lake = Lake.open(proposed_lake(tmp_path))
    with exclusive(lake.storage, lease_name("quick"), "busy") as lease:
        append_event(lake, "quick", STARTED, "started", run=lease.token)
        with serve(lake) as address, open_browser(address) as page:
            say_name(page, "Ada")
            other = page.context.new_page()
            other.goto(page.url)
            page.click("button:has-text('Finish this grasp')")
            page.wait_for_selector("#word:has-text('pausing')")
            other.wait_for_selector("#word:has-text('pausing')")
            other.click(".orders button:has-text('Stop now')")
            other.click("#ask-no")
            assert read_present_run(lake, "quick").verb == "pause"
            other.keyboard.press("Tab")
            other.focus(".orders button:has-text('Stop now')")
            other.keyboard.press("Enter")
            other.focus("#ask-yes")
            other.keyboard.press("Enter")
            other.wait_for_selector("#word:has-text('stopping')")
            assert read_present_run(lake, "quick").verb == "stop"
            page.wait_for_selector("#word:has-text('stopping')")


def test_a_server_that_is_lost_is_said_and_comes_back(tmp_path):
    lake = Lake.open(proposed_lake(tmp_path))
    with ExitStack() as first:
        address = first.enter_context(serve(lake))
        port = int(address.partition("/?")[0].rpartition(":")[2])
        with open_browser(address) as page:
            page.wait_for_timeout(500)
            assert not page.is_visible("#lost")
            first.close()
            page.wait_for_selector("#lost:visible")
            with serve(lake, port):
                page.wait_for_selector("#lost", state="hidden", timeout=20_000)


@pytest.mark.usefixtures("unsimulated")
def test_a_dropped_table_with_a_tenfold_number_is_asked_about(tmp_path, capsys):
    assert Fast(capsys)("ask", PEOPLE / "pull.toml", "--lake", tmp_path / "lake").status == 0
    lake = Lake.open(tmp_path / "lake")
    with serve(lake) as address, open_browser(address) as page:
        say_name(page, "Ada")
        page.click("nav a:has-text('To do')")
        page.set_input_files(".drop input", PEOPLE / "tenfold.csv")
        page.wait_for_selector(".dropped:has-text('a decimal point? It would be 4.98 N')")
        page.click("button:has-text('Write it')")  # the box is not checked: the browser refuses
        assert lake.rows(GraspRow) == []
        page.click("button:has-text('Not this file')")
        page.set_input_files(".drop input", PEOPLE / "good.csv")
        page.click("button:has-text('Write it')")
        page.wait_for_selector("#said:has-text('48 grasps written')")
    assert len(lake.rows(GraspRow)) == 48
