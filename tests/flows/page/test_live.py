"""The force of the present grasp on its way to the page: a file that is written while a bench measures."""

import asyncio
import json
from datetime import UTC, datetime

import numpy as np
import pytest

from fast.flows.page.live import LiveHub
from fast.hardware.station.recorder import GraspInView, read_samples
from fast.lake.store import Lake
from fast.tasks.bench.live import live_path, read_live, show_live
from tests.waiting import wait_for


class Measuring:
    """A bench whose present grasp grows."""

    def __init__(self):
        self.time_s, self.lift_mm, self.force_n = [], [], []
        self.view = None

    def begin(self, tool_id, object_id=3, repeat=0):
        channels = self.time_s, self.lift_mm, self.force_n = [], [], []
        self.view = GraspInView(tool_id, object_id, repeat, datetime.now(UTC), lambda n: read_samples(*channels, n))

    def add(self, n):
        for _ in range(n):
            i = len(self.force_n)
            self.time_s.append(i / 80)
            self.lift_mm.append(i / 10)
            self.force_n.append(float(i % 7))

    def present_grasp(self):
        return self.view


@pytest.fixture
def path(tmp_path):
    return tmp_path / "live" / "quick.jsonl"


def test_a_page_reads_on_and_one_that_comes_late_gets_the_whole_grasp(path):
    bench = Measuring()
    with show_live(path, bench):
        bench.begin("quick/B01T0")
        bench.add(10)
        first = wait_for(lambda: read_live(path), 10.0)
        wait_for(lambda: len(read_live(path).force_n) == 10, 10.0)
        first = read_live(path)
        assert (first.tool_id, first.object_id, first.repeat, first.is_other) == ("quick/B01T0", 3, 0, True)
        assert read_live(path, first.place) is None
        bench.add(5)
        rest = wait_for(lambda: read_live(path, first.place), 10.0)
        assert not rest.is_other
        assert rest.force_n == [float(i % 7) for i in range(10, 15)]
        assert read_live(path).force_n == [float(i % 7) for i in range(15)]
        bench.begin("quick/B01T0", repeat=1)
        wait_for(lambda: read_live(path).repeat == 1, 10.0)
        bench.add(3)
        other = wait_for(lambda: (found := read_live(path, rest.place)) and found.force_n and found, 10.0)
        assert other.is_other
        assert other.force_n == [0.0, 1.0, 2.0]
    assert read_live(path).force_n == [0.0, 1.0, 2.0]  # what came last stays


def test_a_line_that_is_being_written_is_read_next_time(path):
    path.parent.mkdir()
    head = {"tool_id": "a/B01T0", "object_id": 1, "repeat": 0, "started_at": "", "purpose": ""}
    path.write_text(f"{json.dumps(head)}\n[[0.0],[0.0],[1.5]]\n[[0.1],[0.0")
    first = read_live(path)
    assert first.force_n == [1.5]
    with path.open("a") as file:
        file.write("],[2.5]]\n")
    assert read_live(path, first.place).force_n == [2.5]
    path.write_text("no grasp")
    assert read_live(path) is None


def test_a_file_that_cannot_be_written_ends_no_grasp(tmp_path, caplog):
    (tmp_path / "live").write_text("a file in the place of the folder")
    bench = Measuring()
    bench.begin("quick/B01T0")
    with show_live(tmp_path / "live" / "x.jsonl", bench):
        bench.add(3)
    assert "is not shown" in caplog.text


def test_a_page_hears_from_the_server_also_when_there_is_no_news(tmp_path, monkeypatch):
    monkeypatch.setattr("fast.flows.page.live._PING_S", 0.01)

    async def hear():
        events = LiveHub(Lake.open(tmp_path / "lake", create=True)).follow("quick")
        heard = [await anext(events), await anext(events)]
        await events.aclose()
        return heard

    assert asyncio.run(hear())[1].startswith("event: ping\ndata: ")


def test_pages_get_the_force_at_least_five_times_a_second_and_one_watcher_serves_all(tmp_path):
    lake = Lake.open(tmp_path / "lake", create=True)
    bench = Measuring()
    bench.begin("quick/B01T0")
    bench.add(4)

    async def follow(hub, n, found):
        async for event in hub.follow("quick"):
            if event.startswith("event: force"):
                found.append((asyncio.get_running_loop().time(), json.loads(event.partition("data: ")[2])))
            if len(found) >= n:
                return

    async def look():
        hub, first, second = LiveHub(lake), [], []
        pages = [asyncio.ensure_future(follow(hub, 12, found)) for found in (first, second)]
        while not all(page.done() for page in pages):
            bench.add(2)
            await asyncio.sleep(0.02)
        await asyncio.gather(*pages)
        await asyncio.sleep(0)
        return first, second, hub

    with show_live(live_path(lake, "quick"), bench):
        wait_for(lambda: read_live(live_path(lake, "quick")), 10.0)
        first, second, hub = asyncio.run(look())
    assert hub.n_followers == 0
    for found in (first, second):
        assert found[0][1]["isOther"]
        shown = [force for _, data in found for force in data["force"]]
        assert shown == [float(i % 7) for i in range(len(shown))]  # nothing twice, nothing left out
        gaps_s = np.diff([at_s for at_s, _ in found[1:]])
        assert np.median(gaps_s) <= 0.2
