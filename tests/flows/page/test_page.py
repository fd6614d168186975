"""The page's routes: what they show of a lake, what they write, and whom they refuse."""

import re
from datetime import UTC, datetime
from types import SimpleNamespace
from urllib.parse import quote

import pytest

from fast.flows.campaign.status import read_status
from fast.flows.page import by_hand, configs, jobs, start
from fast.flows.page.web import write_clock
from fast.flows.server.access import Role
from fast.flows.server.environment import FOLDER_VARIABLE
from fast.flows.server.server import address_for_others
from fast.hardware.parts.safe_state import Verb
from fast.lake.leases import exclusive
from fast.lake.store import Lake
from fast.lake.tables.campaign import EventRow, GraspRow, ToolRow
from fast.tasks.campaign.campaign import Campaign
from fast.tasks.campaign.config import load_config
from fast.tasks.campaign.present_run import read_present_run
from fast.tasks.campaign.requests import STARTED, append_event, lease_name
from fast.tasks.campaign.setup import register
from fast.tasks.templates import render
from tests.flows.cli.cli_lakes import QUICK, ROOT, WORLD, Fast, proposed_lake, write_config
from tests.flows.page.lab_page import ADDRESS, Browser
from tests.flows.synthetic_lake import build

PEOPLE = ROOT / "tests" / "data" / "cases" / "people"


@pytest.fixture
def lake(tmp_path):
    """A campaign whose first batch is proposed and not printed."""
    return Lake.open(proposed_lake(tmp_path))


@pytest.fixture
def told(tmp_path, capsys):
    """A campaign on a bench of one's own whose first batch is asked for."""
    answer = Fast(capsys)("ask", PEOPLE / "pull.toml", "--lake", tmp_path / "lake")
    assert answer.status == 0, answer
    return Lake.open(tmp_path / "lake")


def campaign_of(lake):
    return lake.query("SELECT campaign_id FROM campaigns")["campaign_id"][0].as_py()


def find_slots(text):
    return sorted(set(map(int, re.findall(r'name="fate-(\d+)"', text))))


def test_an_empty_lake_says_what_to_do(tmp_path):
    browser = Browser(Lake.open(tmp_path / "lake", create=True))
    assert "no campaign" in browser.see("/")
    for path in ("/todo", "/results", "/gap", "/start", "/people"):
        browser.see(path)


def test_a_campaign_that_cannot_be_read_is_said_and_the_page_stands(tmp_path):
    lake = build(Lake.open(tmp_path / "lake", create=True))  # its config has no bench
    assert "This campaign cannot be shown" in Browser(lake).see("/")
    assert "demo/B01T0" in Browser(lake).see("/results")


def test_of_many_chosen_tools_six_are_laid_over_each_other_and_that_is_said(tmp_path):
    lake = build(Lake.open(tmp_path / "lake", create=True))
    tools = [f"demo/B{batch:02d}T{slot}" for batch in (1, 2) for slot in (0, 1, 2)] + ["demo/B01T0"]
    text = Browser(lake).see(f"/results/compare?tool={'&tool='.join(tools)}")
    assert "the first six of 7 tools that were chosen" in text
    assert f"<h1>{', '.join(tools[:6])}</h1>" in text


def test_the_picture_of_a_simulated_grasp_is_not_shrunk_to_a_phone():
    """Its letters were 4 pixels high at 390."""
    found = {
        "title": "B01T0 on cube (2)",
        "picture": "data:,",
        "peak_force_n": 9.0,
        "peak_sd_n": None,
        "measured_n": [],
    }
    text = render("flows/page/simulated.html.j2", found=found | {"traces": [], "version_id": "V1"})
    assert re.search(r'<div class="scroll" tabindex="0"[^>]*><img class="picture" src="data:,"', text)
    assert "between prints and mountings" not in text
    found |= {"peak_sd_n": 1.27, "sd_is_of": "offset z 0.2 mm", "traces": [], "version_id": "V1"}
    text = render("flows/page/simulated.html.j2", found=found)
    assert "9.0 N (sd 1.3 N between prints and mountings) simulated" in text
    assert "sd: standard deviation, of offset z 0.2 mm." in text
    assert ".scroll > .picture { width: 1080px; max-width: none; }" in (
        ROOT / "flows" / "page" / "assets" / "page.css"
    ).read_text(encoding="utf-8")


@pytest.mark.parametrize("path", ["/", "/todo", "/results", "/gap", "/start"])
def test_a_campaign_that_the_lake_lacks_is_not_shown_as_another(lake, path):
    answer = Browser(lake).client.get(path, params={"campaign": "no<such"}, headers={"Accept": "text/html"})
    assert answer.status_code == 409
    assert "This lake has no campaign `no&lt;such` of its own; choose one above." in answer.text
    assert "Print and mount" not in answer.text


def test_a_person_is_asked_for_prints_and_the_same_rows_are_written_as_by_the_command(lake):
    browser, name = Browser(lake), campaign_of(lake)
    assert "You are needed now: 1 to do" in browser.see("/")
    text = browser.see("/todo")
    slots = find_slots(text)
    assert len(slots) >= 3
    form = {"campaign": name, "batch": "1", "material_lot": "L7", **{f"fate-{slot}": "printed" for slot in slots}}
    form[f"fate-{slots[0]}"] = "rejected"
    status, words = browser.say("/todo/print", form)
    assert (status, "say why" in words) == (409, True)
    assert lake.rows(ToolRow) == []
    form |= {f"reason-{slots[0]}": "tip torn", f"front-{slots[1]}": "0"}
    status, words = browser.say("/todo/print", form)
    assert (status, f"B01T{slots[1]} front wall: 0 mm, it must be above 0 mm" in words) == (409, True)
    form[f"front-{slots[1]}"] = "4.7"
    status, words = browser.say("/todo/print", form)
    assert status == 409
    assert "so it is" in words
    del form[f"front-{slots[1]}"]
    status, words = browser.say("/todo/print", form)
    assert (status, f"{len(slots) - 1} tools mounted, 1 rejected" in words) == (204, True)
    rows = {row["slot"]: row for row in lake.rows(ToolRow)}
    assert rows[slots[0]]["status"] == "rejected"
    assert rows[slots[0]]["reason"] == "tip torn"
    assert {row["operator"] for row in rows.values()} == {"ada"}
    assert {row["material_lot"] for row in rows.values()} == {"L7"}
    # Somebody who still has the old page differs visibly; the first word counts.
    status, words = Browser(lake, name="grace").say("/todo/print", {**form, f"fate-{slots[0]}": "printed"})
    assert (status, "confirmed elsewhere" in words) == (409, True)
    assert {row["operator"] for row in lake.rows(ToolRow)} == {"ada"}
    assert "print" not in read_status(lake, name)["waiting_for_print"]


def test_two_who_confirm_at_once_each_keep_what_the_other_has_not_said(lake):
    name, (first, second) = campaign_of(lake), (Browser(lake), Browser(lake, name="grace"))
    slots = find_slots(first.see("/todo"))
    whole = {"campaign": name, "batch": "1", **{f"fate-{slot}": "printed" for slot in slots}}
    again = {**whole, f"fate-{slots[-1]}": "again", f"reason-{slots[-1]}": "warped"}
    assert first.say("/todo/print", again)[0] == 204
    status, words = second.say("/todo/print", whole)
    assert (status, f"{len(slots) - 1} of those shown were confirmed by somebody else" in words) == (204, True)
    assert {row["slot"]: row["operator"] for row in lake.rows(ToolRow)} == {
        slot: "grace" if slot == slots[-1] else "ada" for slot in slots
    }


@pytest.mark.usefixtures("unsimulated")
def test_a_tenfold_number_in_a_dropped_table_is_asked_about_and_can_be_taken_back(told):
    browser = Browser(told)
    status, words = browser.drop("pull", "tenfold.csv", (PEOPLE / "tenfold.csv").read_bytes())
    assert status == 200
    assert "49.8 N beside 5.17 N and 4.98 N, a decimal point? It would be 4.98 N." in words
    upload = re.search(r'name="upload" value="([^"]+)"', words)[1]
    status, words = browser.say("/todo/told/write", {"campaign": "pull", "upload": upload})
    assert (status, "so it is" in words, told.rows(GraspRow)) == (409, True, [])
    status, words = browser.drop("pull", "minus.csv", (PEOPLE / "good.csv").read_bytes().replace(b",5.23,", b",-5.23,"))
    assert '<p class="fault">minus.csv row 2: the peak is -5.23 N' in words  # not where it is kept meanwhile
    status, words = browser.drop("pull", "good.csv", (PEOPLE / "good.csv").read_bytes())
    assert "It would be: 48 grasps written" in words
    upload = re.search(r'name="upload" value="([^"]+)"', words)[1]
    status, words = browser.say("/todo/told/write", {"campaign": "pull", "upload": upload})
    assert (status, "48 grasps written" in words) == (204, True)
    assert {row["status"] for row in told.rows(GraspRow)} == {"ok"}
    status, words = browser.say("/todo/told/undo", {"campaign": "pull"})
    assert (status, "48 grasps taken back" in words) == (204, True)


@pytest.mark.usefixtures("unsimulated")
def test_a_file_of_a_testing_machine_is_guessed_and_its_format_shown(told):
    browser, pull = Browser(told), PEOPLE.parent / "machine-summary" / "B01T0_2_0.csv"
    status, words = browser.drop("pull", pull.name, pull.read_bytes())
    assert status == 200
    assert "name = &#34;Load&#34;" in words
    assert "1 grasp written (1 with a trace" in words


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("photo.png", b"\x89PNG", "is no table"),
        ("results.csv", b"", "is empty"),
        ("../../etc/x.csv", b"a,b\n1,2\n", "x.csv"),
    ],
)
@pytest.mark.usefixtures("unsimulated")
def test_what_is_no_table_is_refused(told, name, content, words):
    status, answer = Browser(told).drop("pull", name, content)
    assert words in answer
    assert status in (200, 409)
    assert told.rows(GraspRow) == []


def test_a_file_that_is_too_large_is_refused_before_it_is_read(told):
    browser = Browser(told)
    where = {"campaign": "pull", "name": "big.csv"}
    headers = {"X-Fast-Token": browser.token, "Content-Length": "900000000"}
    answer = browser.client.post("/todo/told/look", params=where, content=b"a,b", headers=headers)
    assert (answer.status_code, "900.0 MB" in answer.text) == (409, True)


def test_an_order_is_given_once_and_refused_when_the_run_is_another(lake):
    name, browser = campaign_of(lake), Browser(lake)
    status, words = browser.say("/orders/pause", {"campaign": name, "run": ""})
    assert (status, "is not running" in words) == (409, True)
    with exclusive(lake.storage, lease_name(name), "busy") as lease:
        append_event(lake, name, STARTED, "started", run=lease.token)
        assert "Finish this grasp" in browser.see("/strip")
        status, words = browser.say("/orders/pause", {"campaign": name, "run": "an older run"})
        assert (status, "was started again since" in words) == (409, True)
        assert read_present_run(lake, name).verb is None
        for _ in range(2):
            status, words = browser.say("/orders/pause", {"campaign": name, "run": lease.token})
            assert (status, "ends after the current grasp" in words) == (204, True)
        asked = lake.records(EventRow, kind=str(Verb.PAUSE))
        assert [row.message for row in asked] == ["pause asked for by ada on the lab's page"]
        assert "pausing" in browser.see("/strip")
        # A stop is never blocked: a pause is pending, and this page is of an older run.
        status, words = browser.say("/orders/stop", {"campaign": name, "run": "an older run"})
        assert (status, read_present_run(lake, name).verb) == (204, Verb.STOP)
        assert "stopping" in browser.see("/strip")
    assert "stopped" in browser.see("/strip")


def test_roles_name_and_token_are_asked_for_on_every_write(lake):
    name = campaign_of(lake)
    writes = [
        route.path for route in inner(Browser(lake).app).routes if "POST" in (getattr(route, "methods", None) or ())
    ]
    words = [path for path in writes if not path.startswith("/api/")]
    assert len(words) > 12
    for path in words:
        path = path.replace("{verb}", "stop")
        assert Browser(lake).client.post(path, data={"campaign": name}).status_code == 403, path
        evil = {"Origin": "http://evil.example"}
        assert Browser(lake).say(path, {"campaign": name}, **evil)[0] == 403, path
    status, sentence = Browser(lake, name="").say("/todo/print", {"campaign": name, "batch": "1", "fate-0": "printed"})
    assert (status, "Say your name first" in sentence) == (403, True)
    status, sentence = Browser(lake, Role.LOOK).say("/todo/print", {"campaign": name, "batch": "1"})
    assert (status, "lets you look" in sentence) == (403, True)
    for path in ("/orders/stop", "/start/campaign", "/start/job", "/start/continue"):
        status, sentence = Browser(lake, Role.SAY).say(path, {"campaign": name})
        assert (status, "lets you say" in sentence) == (403, True), path
    assert lake.rows(ToolRow) == []


def inner(gated):
    """The application behind the gate."""
    return next(cell.cell_contents for cell in gated.__closure__ if hasattr(cell.cell_contents, "routes"))


def test_links_of_roles_are_told_to_those_who_may_move_alone(lake):
    text = Browser(lake).see("/people")
    links = dict(zip(("look", "say", "move"), re.findall(rf"{ADDRESS}/\?key=([\w-]+)", text), strict=True))
    assert len(set(links.values())) == 3
    assert "?key=" not in Browser(lake, Role.SAY).see("/people")
    client = Browser(lake).client
    client.cookies.clear()
    assert client.get("/").status_code == 401
    client.get(f"/?key={links['look']}")
    assert "lets you look" in client.get("/people").text


def test_names_of_the_lake_are_never_markup(tmp_path):
    lake = Lake.open(tmp_path / "lake", create=True)
    browser = Browser(lake, name="<script>alert(1)</script>")
    for path in (
        "/",
        "/people",
        "/results/sql?q=SELECT '<img src=x onerror=alert(1)>' AS \"<b>x\"",
        "/results/tool?id=<b>",
    ):
        answer = browser.client.get(path)
        assert "<script>alert" not in answer.text
        assert "<img src=x" not in answer.text
        if answer.headers["content-type"].startswith("text/html"):
            assert "<b>" not in answer.text.replace("<b></b>", "")
            assert "script-src 'self'" in answer.headers["content-security-policy"]


def test_sql_has_the_limits_of_the_command(lake):
    browser = Browser(lake)
    assert "campaigns" in browser.see("/results/sql?q=SELECT count(*) AS campaigns FROM campaigns")
    for bad in ("DROP TABLE grasps", "SELECT * FROM read_csv('/etc/passwd')", "COPY grasps TO '/tmp/x'"):
        text = browser.see(f"/results/sql?q={bad}")
        assert 'class="fault"' in text
        assert browser.client.get("/results/sql.csv", params={"q": bad}).status_code == 409
    csv = browser.client.get("/results/sql.csv", params={"q": "SELECT 1 AS a, 2.5 AS b"})
    assert csv.text.splitlines() == ['"a","b"', "1,2.5"]


def test_files_of_the_outputs_run_no_script(lake):
    (lake.root / "outputs" / "x").mkdir(parents=True)
    (lake.root / "outputs" / "x" / "a.html").write_text("<script>fetch('/orders/stop')</script>")
    answer = Browser(lake).client.get("/outputs/x/a.html")
    assert answer.status_code == 200
    assert answer.headers["content-security-policy"].startswith("sandbox allow-same-origin allow-downloads;")
    assert Browser(lake).client.get("/outputs/../.state/key").status_code == 404


def test_a_config_shows_its_faults_beside_the_line_and_keeps_what_was_typed(lake):
    browser = Browser(lake)
    text = (ROOT / "campaigns" / "quick.toml").read_text().replace('name = "quick"', 'name = "mine"')
    base = {"base": "quick.toml"}
    good = browser.client.post("/start/check", data={**base, "text": text}, headers={"X-Fast-Token": browser.token})
    assert "12 tools in 3 stages, 96 grasps" in good.text
    wrong = text.replace("initial_tools = 4 ", "initial_tools = -4 ")
    bad = browser.client.post("/start/check", data={**base, "text": wrong}, headers={"X-Fast-Token": browser.token})
    number = next(n for n, line in enumerate(wrong.splitlines(), 1) if "initial_tools" in line)
    assert f'class="bad">{number}: initial_tools = -4' in bad.text
    broken = browser.client.post(
        "/start/check", data={**base, "text": 'name = "x"\nseed = = 1'}, headers={"X-Fast-Token": browser.token}
    )
    assert 'class="bad">2: seed = = 1' in broken.text
    status, words = browser.say("/start/campaign", {**base, "text": text})
    assert (status, "run `fast serve`" in words) == (409, True)
    assert not list((lake.root / "outputs" / "configs").glob("*.toml"))
    (lake.root / "outputs" / "configs" / ".check-1.toml").write_text(text)  # another's, while it is looked at
    assert not [name for name in configs.list_configs(lake) if "check" in name]


def test_a_campaign_is_not_started_under_the_name_of_another_nor_twice(lake):
    """The worker would refuse both, where nobody looks, and the other's config would be written over."""
    browser, name = Browser(lake), campaign_of(lake)
    text = (ROOT / "campaigns" / "quick.toml").read_text()
    status, words = browser.say("/start/campaign", {"base": "quick.toml", "text": text})
    assert (status, f"campaign `{name}` was started with another config (" in words) == (409, True)
    own = {"base": "quick.toml", "text": text.replace('name = "quick"', 'name = "mine"')}
    with exclusive(lake.storage, lease_name("mine"), "busy"):
        status, words = browser.say("/start/campaign", own)
    assert (status, "campaign mine is being run already (process" in words) == (409, True)


def test_a_config_that_is_started_again_as_it_is_is_the_same(lake):
    folder = lake.root / "outputs" / "configs"
    folder.mkdir(parents=True)
    text = write_config(folder).read_text()
    of_lake = "/".join(["lake", "quick.toml"])
    assert start.check_config(lake, text, of_lake).faults == ()
    (fault,) = start.check_config(lake, re.sub(r"(?m)^seed = \d+", "seed = 77", text), of_lake).faults
    assert "was started with another config (seed 1 -> 77);" in fault.sentence


def test_a_file_that_is_not_there_is_named_as_the_person_wrote_it(lake, tmp_path):
    text = write_config(tmp_path).read_text().replace('"world.toml"', '"none/world.toml"')
    (fault,) = start.check_config(lake, text, "").faults
    assert "world file `none/world.toml` does not exist" in fault.sentence
    assert "outputs" not in fault.sentence


def test_configs_of_the_folder_of_the_lab_are_offered_before_those_of_the_program(tmp_path, monkeypatch):
    (tmp_path / "campaigns").mkdir()
    (tmp_path / "worlds").mkdir()
    text = (ROOT / "campaigns" / "quick.toml").read_text().replace("worlds/quick", "worlds/ours")
    for name in ("ours", "quick"):
        (tmp_path / "campaigns" / f"{name}.toml").write_text(text)
    (tmp_path / "worlds" / "ours.toml").write_text((ROOT / "worlds" / "quick.toml").read_text())
    lake = Lake.open(tmp_path / "lake", create=True)
    assert start.check_config(lake, text, "quick.toml").faults  # the program has no such world
    monkeypatch.setenv(FOLDER_VARIABLE, str(tmp_path))
    assert {"ours.toml", "quick.toml", "paper.toml"} <= set(names := configs.list_configs(lake))
    assert len(names) == len(set(names))
    assert configs.read_config(lake, "quick.toml") == text
    assert configs.read_config(lake, "paper.toml") == (ROOT / "campaigns" / "paper.toml").read_text()
    for base in ("ours.toml", ""):
        assert start.check_config(lake, f"{text}\n", base).faults == ()
    (tmp_path / "campaigns" / "latin.toml").write_bytes("# Köln".encode("latin-1"))
    assert configs.find_same(lake, f"{text}\n") == tmp_path / "campaigns" / "quick.toml"


def test_own_objects_of_a_config_are_found_where_it_names_them(tmp_path, monkeypatch):
    """They stand in a list of several lines, and as keys where their numbers are told."""
    folder = tmp_path / "campaigns"
    (folder / "rods").mkdir(parents=True)
    for name, length_mm in (("thin", 30), ("rods/lab's", 40)):
        part = f'shape = "cylinder"\ndiameter_mm = 20\nlength_mm = {length_mm}\n'
        (folder / f"{name}.toml").write_text(f'name = "rod {length_mm}"\n[[parts]]\n{part}')
    files = 'ids = [2]\nfiles = [\n  "rods/lab\'s.toml",  # not "quick.toml"\n  \'thin.toml\',\n]'
    quick = (ROOT / "campaigns" / "quick.toml").read_text().replace("../worlds/quick.toml", str(WORLD))
    text = re.sub(r"(?m)^ids = .*", lambda _: files, quick)
    (folder / "own.toml").write_text(text)
    numbers = load_config(folder / "own.toml").objects.file_ids
    text += "[objects.file_ids]\n" + "".join(f'"{name}" = {number}\n' for name, number in numbers.items())
    monkeypatch.setenv(FOLDER_VARIABLE, str(tmp_path))
    lake = Lake.open(tmp_path / "lake", create=True)
    assert start.check_config(lake, text, "own.toml").faults == ()
    path = configs.keep_config(lake, text, "own.toml", "mine")
    kept = load_config(path).objects
    assert kept.files == (str(folder / "rods" / "lab's.toml"), str(folder / "thin.toml"))
    assert kept.file_ids == dict(zip(kept.files, numbers.values(), strict=True))
    name = f"lake/{path.name}"
    assert start.check_config(lake, configs.read_config(lake, name), name).faults == ()


def test_the_virtual_bench_is_that_of_the_campaign_else_of_the_lab(tmp_path, monkeypatch):
    lake = Lake.open(proposed_lake(tmp_path))
    monkeypatch.setenv(FOLDER_VARIABLE, str(tmp_path))
    (tmp_path / "campaigns").mkdir()
    for name in ("lab", "mine"):
        (tmp_path / f"{name}.toml").write_text(WORLD.read_text())
    (tmp_path / "campaigns" / "quick.toml").write_text(QUICK.replace("world.toml", "../lab.toml"))
    (tmp_path / "begun.toml").write_text(QUICK.replace("world.toml", "mine.toml"))
    assert configs.find_world(lake, "") == tmp_path / "lab.toml"
    append_event(lake, campaign_of(lake), STARTED, "begun", run="R1", config=str(tmp_path / "begun.toml"))
    assert configs.find_world(lake, campaign_of(lake)) == tmp_path / "mine.toml"
    orders = []
    monkeypatch.setattr(by_hand, "start_on_worker", lambda *order: orders.append(order))
    form = {"verb": "take", "session": "", "campaign": campaign_of(lake)}
    status, words = Browser(lake).say("/bench/order", form)
    assert (status, "mine.toml" in words) == (204, True)
    assert [order[2]["world"] for order in orders] == [str(tmp_path / "mine.toml")]


def test_a_campaign_of_a_terminal_grows_on_the_page_which_writes_its_config_elsewhere(tmp_path):
    lake, text = Lake.open(tmp_path / "lake", create=True), (ROOT / "campaigns" / "quick.toml").read_text()
    register(Campaign(lake, load_config(ROOT / "campaigns" / "quick.toml")), text)
    more = re.sub(r"(?m)^guided_batches = \d+", "guided_batches = 9", text)
    assert more != text
    assert start.check_config(lake, more, "quick.toml").faults == ()
    (fault,) = start.check_config(lake, more.replace("worlds/quick", "worlds/paper"), "quick.toml").faults
    assert "bench.world" in fault.sentence


def test_no_print_is_forecast_of_a_campaign_that_nobody_runs(lake):
    browser, name = Browser(lake), campaign_of(lake)
    slots = find_slots(browser.see("/todo"))
    browser.say("/todo/print", {"campaign": name, "batch": "1", **{f"fate-{slot}": "printed" for slot in slots}})
    assert "Nothing is measured now, the campaign is interrupted" in browser.see("/")


def test_a_campaign_that_is_complete_leads_to_its_results():
    load = SimpleNamespace(grasps_done=8, grasps_total=8, simulated_done=4, simulated_total=4)
    shown = {"version": "V1", "effects": "", "misses": "", "best": None, "tiles": (), "as_of": None, "ticks": ()}
    pace = {"batches_done": 1, "batches_total": 1, "left": "all is done", "s_per_grasp": 12.34}
    now = SimpleNamespace(load=load, is_complete=True, need="", **shown, **pace)
    around = {"todos": [], "strip": None, "campaign": "quick", "quote": quote, "clock": write_clock}
    text = render("flows/page/now_part.html.j2", now=now, **around)
    assert 'All is measured: <a href="/results?campaign=quick">look at the results</a>' in text
    assert ", 12 s each" in text


def test_the_queue_says_what_waits_in_words_of_ours(lake, monkeypatch):
    told = {"config": "/srv/b1.toml", "lake": address_for_others(lake)}
    waiting = {"name": "sage-petrel", "auto_scheduled": False, "expected_start_time": None}
    runs = [{"id": "1", "flow_id": "f", "parameters": told, "state": {"type": "SCHEDULED", "name": "Late"}, **waiting}]
    answers = {"/flow_runs/filter": runs, "/flows/filter": [{"id": "f", "name": "run-campaign"}]}
    monkeypatch.setattr(jobs, "find_any_server", lambda lake: object())
    monkeypatch.setattr(
        jobs, "ask_server", lambda api, path, body: [] if "END" in body.get("sort", "") else answers[path]
    )
    assert [(job.name, job.state) for job in jobs.list_jobs(lake)] == [("campaign b1", "late")]


def test_the_queue_says_why_a_job_failed_until_one_of_its_kind_succeeds(lake, monkeypatch):
    def ended(campaign, kind, message):
        told = {"campaign": campaign, "lake": address_for_others(lake)}
        return {
            "name": "sage-petrel",
            "flow_id": "f",
            "parameters": told,
            "state": {"type": kind, "name": kind.title(), "message": message},
            "end_time": "2026-03-01T10:30:00+00:00",
        }

    def answer(api, path, body):
        if path == "/flows/filter":
            return [{"id": "f", "name": "report"}]
        return runs if body["sort"] == "END_TIME_DESC" else []

    runs = [ended("b1", "FAILED", "the disk is full."), ended("b1", "COMPLETED", "report x")]
    runs += [ended("b2", "COMPLETED", "report y"), ended("b2", "CRASHED", "gone")]
    monkeypatch.setattr(jobs, "find_any_server", lambda lake: object())
    monkeypatch.setattr(jobs, "ask_server", answer)
    assert [(job.name, job.state, job.reason) for job in jobs.list_jobs(lake)] == [
        ("report of b1", "failed", "the disk is full.")
    ]
    assert "the disk is full." in Browser(lake).see("/start")


def test_a_campaign_that_failed_and_was_begun_again_since_is_no_news(lake, monkeypatch):
    told = {"config": "/lab/campaigns/b1.toml", "lake": address_for_others(lake)}
    state = {"type": "FAILED", "name": "Failed", "message": "the bench stopped."}
    run = {"name": "sage-petrel", "flow_id": "f", "parameters": told, "state": state}
    run["end_time"] = datetime.now(UTC).isoformat()
    answers = {"/flows/filter": [{"id": "f", "name": "run-campaign"}], "END_TIME_DESC": [run]}
    monkeypatch.setattr(jobs, "find_any_server", lambda lake: object())
    monkeypatch.setattr(jobs, "ask_server", lambda api, path, body: answers.get(body.get("sort", path), []))
    append_event(lake, "b2", STARTED, "begun", config="/lab/campaigns/b2.toml")
    assert [(job.name, job.reason) for job in jobs.list_jobs(lake)] == [("campaign b1", "the bench stopped.")]
    append_event(lake, "b1", STARTED, "begun", config="/lab/campaigns/b1.toml")
    assert jobs.list_jobs(lake) == []


def test_notes_and_photos_stay_with_a_tool(lake):
    browser, name = Browser(lake), campaign_of(lake)
    slots = find_slots(browser.see("/todo"))
    browser.say("/todo/print", {"campaign": name, "batch": "1", **{f"fate-{slot}": "printed" for slot in slots}})
    tool = f"{name}/B01T{slots[0]}"
    assert browser.say("/results/note", {"about": tool, "text": "tip <i>frays</i>"})[0] == 204
    photo = browser.client.post(
        "/results/photo",
        params={"about": tool},
        content=b"\x89PNG\r\n\x1a\n...",
        headers={"X-Fast-Token": browser.token},
    )
    assert photo.status_code == 204
    wrong = browser.client.post(
        "/results/photo", params={"about": tool}, content=b"<svg/>", headers={"X-Fast-Token": browser.token}
    )
    assert (wrong.status_code, "no JPEG" in wrong.text) == (409, True)
    assert [row.message for row in lake.records(EventRow, kind="note")] == ["tip <i>frays</i>", "photo"]
