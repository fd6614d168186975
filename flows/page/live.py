"""News for open pages, as server-sent events: the force of the present grasp, and that the lake has something new.

One watcher looks for all pages that show a campaign, and none looks where no page is open.
"""

import asyncio
import json
from collections.abc import AsyncIterator, Callable, Iterable
from typing import Any

from fast.lake.leases import holder_of
from fast.lake.store import Lake
from fast.lake.tables.campaign import EventRow, FlowRunRow, GraspRow, ProposalRow, SimulationRow, ToolRow
from fast.lake.tables.row import Row
from fast.models.errors import FastError
from fast.models.objects.catalogue import name_object
from fast.tasks.bench.live import LiveGrasp, live_path, read_live
from fast.tasks.campaign.requests import GANTRY_LEASE, Requests, lease_name

FORCE_S = 0.15  # between looks at the present grasp: seven a second
NEWS_S = 1.5  # between looks at the lake
_PING_S = 15.0
SIMULATED_S = 3.0  # at least, between news that are of simulations alone, of which there is one every second
_SIMULATED_CPU = 0.01  # of a core, that they may cost to show
_SELDOM = (EventRow, FlowRunRow, GraspRow, ProposalRow, ToolRow)  # written seldom, and news to a person
_MOST_LOOKS = 5
_LONGEST_QUEUE = 200  # a page that takes nothing for so long gets everything anew when it comes again


def read_marks(lake: Lake, tables: Iterable[type[Row]] = (*_SELDOM, SimulationRow)) -> tuple[Any, ...]:
    """Read how far the tables that the page shows go."""
    return tuple(lake.mark(table) for table in tables)


class LiveHub:
    """Followers of campaigns, by campaign."""

    def __init__(self, lake: Lake, cost_s: Callable[[], float] = lambda: 0.0) -> None:
        """Make a hub for a lake; `cost_s`: CPU that the news cost to show, the last time."""
        self._lake, self._cost_s = lake, cost_s
        self._watchers: dict[str, _Watcher] = {}

    async def follow(self, campaign_id: str) -> AsyncIterator[str]:
        """Yield events for one page, until it is closed: the present grasp whole, then what comes."""
        watcher = self._watchers.get(campaign_id)
        if watcher is None:
            watcher = self._watchers[campaign_id] = _Watcher(self._lake, campaign_id, self._cost_s)
        queue = watcher.add()
        try:
            yield "retry: 2000\n\n"
            while True:
                try:
                    yield await asyncio.wait_for(queue.get(), _PING_S)
                except TimeoutError:
                    yield "event: ping\ndata: {}\n\n"  # a comment would not reach the script of the page
        finally:
            watcher.remove(queue)

    @property
    def n_followers(self) -> int:
        """How many pages follow."""
        return sum(len(watcher.queues) for watcher in self._watchers.values())


class _Watcher:
    """Looks at one campaign as long as somebody follows it."""

    def __init__(self, lake: Lake, campaign_id: str, cost_s: Callable[[], float]) -> None:
        self._lake, self._campaign_id, self._cost_s = lake, campaign_id, cost_s
        self.path = live_path(lake, campaign_id)
        self._requests = Requests(lake, campaign_id)
        self.queues: set[asyncio.Queue[str]] = set()
        self._place = ""  # in the present grasp, up to which all followers have it
        self._task: asyncio.Task[None] | None = None

    def add(self) -> "asyncio.Queue[str]":
        """Add a follower, who gets the present grasp whole, up to where the others have it."""
        queue: asyncio.Queue[str] = asyncio.Queue()
        whole = self._send_new()
        for _ in range(_MOST_LOOKS):  # a sample may come between two looks
            whole = read_live(self.path)
            if whole is None or whole.place == self._place:
                break
            self._send_new()
        if whole is not None:
            queue.put_nowait(format_force(whole))
        self.queues.add(queue)
        if self._task is None or self._task.done():
            self._task = asyncio.get_running_loop().create_task(self._watch())
        return queue

    def remove(self, queue: "asyncio.Queue[str]") -> None:
        """Remove a follower; the last one takes the watcher with it."""
        self.queues.discard(queue)
        if not self.queues and self._task is not None:
            self._task.cancel()
            self._task, self._place = None, ""

    async def _watch(self) -> None:
        known, next_look_s, simulated, next_simulated_s = None, 0.0, None, 0.0
        clock = asyncio.get_running_loop()
        while True:
            self._send_new()
            if clock.time() >= next_look_s:
                if clock.time() >= next_simulated_s:  # new files are opened for this, one every second
                    simulated = await asyncio.to_thread(self._lake.mark, SimulationRow)
                    next_simulated_s = clock.time() + max(SIMULATED_S, self._cost_s() / _SIMULATED_CPU)
                pulse = await asyncio.to_thread(self._pulse, simulated)
                if known is not None and pulse is not None and pulse != known:
                    self._send(f"event: {'standing' if pulse[0] != known[0] else 'news'}\ndata: {{}}\n\n")
                known = pulse or known
                next_look_s = clock.time() + NEWS_S
            await asyncio.sleep(FORCE_S)

    def _pulse(self, simulated: Any) -> tuple[Any, ...] | None:
        """Return what changes when there is something new to show; None while the lake cannot be read."""
        try:
            holder = holder_of(self._lake.storage, lease_name(self._campaign_id))
            gantry = holder_of(self._lake.storage, GANTRY_LEASE)
            held = tuple(one.token if one is not None else "" for one in (holder, gantry))
            return (held, self._requests.verb()), read_marks(self._lake, _SELDOM), simulated
        except FastError:
            return None

    def _send_new(self) -> LiveGrasp | None:
        """Send all followers what is new of the present grasp: a stat and a short read, which no thread is worth."""
        found = read_live(self.path, self._place)
        if found is not None:
            self._place = found.place
            self._send(format_force(found))
        return found

    def _send(self, message: str) -> None:
        for queue in list(self.queues):
            if queue.qsize() < _LONGEST_QUEUE:
                queue.put_nowait(message)


def format_force(found: LiveGrasp) -> str:
    """Format new samples of the present grasp as an event."""
    data = {
        "isOther": found.is_other,
        "tool": found.tool_id,
        "object": found.object_id,
        "name": name_object(found.object_id) if found.object_id >= 0 else "no object",
        "repeat": found.repeat,
        "purpose": found.purpose,
        "lift": found.lift_mm,
        "force": found.force_n,
    }
    return f"event: force\ndata: {json.dumps(data, separators=(',', ':'))}\n\n"
