"""What the routes of the page share: the lake, what was read of it a moment ago, and how a tab is shown."""

import threading
import time
from collections.abc import Callable
from typing import Any

from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import Response

from fast.flows.page.by_hand import describe_holder, mark_lent
from fast.flows.page.live import LiveHub, read_marks
from fast.flows.page.now import Now, NowReader
from fast.flows.page.proposals import list_open
from fast.flows.page.strip import Strip, read_strip
from fast.flows.page.todo import BenchTodo, Todo, list_campaigns, read_todos
from fast.flows.page.web import HEADERS, Pages, make_token, read_form, require_write, say
from fast.flows.server.access import Role
from fast.lake.leases import holder_of
from fast.lake.store import Lake
from fast.models.errors import FastError, UsageError
from fast.tasks.bench.lend import LEASE, LentBench, read_lent
from fast.tasks.campaign.requests import lease_name
from fast.tasks.simulation.pool import Worker

ERROR_PAGE = "error.html"
MOST_CPU = 0.02  # of a core: a lake of a million grasps is not read anew for each page that opens
_STALE_S = 30.0  # at most


class Cached:
    """Something that is read from the lake, again when the lake has more; seldom, where that costs much."""

    def __init__(self, lake: Lake, read: Callable[[str], Any]) -> None:
        self._lake, self._read = lake, read
        self._lock = threading.Lock()
        self._known: dict[str, tuple[Any, float, float, Any]] = {}
        self.cost_s = 0.0
        """CPU of the last reading."""

    def get(self, name: str) -> Any:
        """Get the value as it is now, or was a moment ago."""
        with self._lock:
            marks, now_s = read_marks(self._lake), time.monotonic()
            if name in self._known:
                seen, at_s, cost_s, value = self._known[name]
                if seen == marks or now_s - at_s < min(cost_s / MOST_CPU, _STALE_S):
                    return value
            before_s = time.thread_time()
            value = self._read(name)
            self.cost_s = cost_s = time.thread_time() - before_s
            # What was said on this page itself is seen at once.
            self._known[name] = (marks, now_s, cost_s, value)
            return value

    def forget(self) -> None:
        """Read anew next time: this page has written something."""
        with self._lock:
            self._known.clear()


class LabPage:
    """The page of one lake, with what its routes share."""

    def __init__(self, lake: Lake, login: str) -> None:
        self.lake, self.login = lake, login
        self.token = make_token(login)
        self.now = NowReader(lake)
        self.hub = LiveHub(lake, lambda: self._now.cost_s + self._todos.cost_s)
        self.worker = Worker()  # for what computes for seconds, so that others see on
        self.pages = Pages(self.token)
        self._now = Cached(lake, self.now.read)
        self._todos = Cached(lake, lambda _: read_todos(lake))
        self._lent = Cached(lake, lambda _: read_lent(lake))
        self._frames: dict[str, tuple[Any, float, dict[str, Any]]] = {}

    def read_now(self, campaign_id: str) -> Now | None:
        """Read what the tab Now shows of a campaign; None where there is none, or it cannot be read."""
        if not campaign_id:
            return None
        try:
            now: Now = self._now.get(campaign_id)
            return now
        except FastError:
            return None

    def read_todos(self) -> list[Todo]:
        """Read the inbox."""
        todos: list[Todo] = self._todos.get("")
        return todos

    def read_lent(self) -> LentBench | None:
        """Read the bench that is lent, as long as the process that lends it lives."""
        holder = holder_of(self.lake.storage, LEASE)
        if holder is None:
            return None
        lent: LentBench | None = self._lent.get(holder.token)
        return lent

    def forget(self) -> None:
        """Forget what was read, since something was written here."""
        for read in (self._now, self._todos, self._lent):
            read.forget()
        self._frames.clear()

    def choose_campaign(self, request: Request) -> str:
        """Choose the campaign that is asked for; else the one that runs, or the newest; empty where there is none."""
        names, asked = list_campaigns(self.lake), request.query_params.get("campaign", "")
        return asked if asked in names else self._choose(names)

    def _choose(self, names: list[str]) -> str:
        running = [name for name in names if holder_of(self.lake.storage, lease_name(name)) is not None]
        return next(iter([*running, *names]), "")

    def read_strip(self, campaign_id: str, now: Now | None) -> Strip | None:
        """Read the control strip of a campaign."""
        if not campaign_id:
            return None
        own = [todo for todo in self.read_todos() if todo.campaign_id == campaign_id]
        is_waiting, is_asking = bool(own), any(isinstance(todo, BenchTodo) for todo in own)
        is_bench_busy = not is_asking and now is not None and any(slot.state == "left" for slot in now.slots)
        return read_strip(self.lake, campaign_id, now is not None and now.is_complete, is_waiting and not is_bench_busy)

    def frame(self, request: Request, tab: str) -> dict[str, Any]:
        """Return what stands around every tab."""
        lent = self.read_lent()
        bench = {"bench": describe_holder(self.lake, lent), "lent": lent, "bench_mark": mark_lent(lent)}
        return {"tab": tab, **self._read_frame(request.query_params.get("campaign", "")), **bench}

    def _read_frame(self, asked: str) -> dict[str, Any]:
        """Read the same for a campaign that is asked for; kept until a row is written, or a lease changes hands."""
        names = list_campaigns(self.lake)
        asked = asked if asked in names else ""
        owned = [lease_name(name) for name in ([asked] if asked else names)]
        holders = [holder_of(self.lake.storage, name) for name in owned]
        seen = read_marks(self.lake), tuple(holder.token if holder is not None else "" for holder in holders)
        kept = self._frames.get(asked)
        if kept is not None and kept[0] == seen and time.monotonic() - kept[1] < _STALE_S:
            return kept[2]
        campaign_id = asked or self._choose(names)
        now = self.read_now(campaign_id)
        frame = {
            "campaign": campaign_id,
            "campaigns": names,
            "now": now,
            "strip": self.read_strip(campaign_id, now),
            "todos": self.read_todos(),
            "proposals": list_open(self.lake),
            "lake_name": self.lake.root.name,
        }
        self._frames[asked] = seen, time.monotonic(), frame
        return frame

    async def show(self, request: Request, template: str, tab: str, **values: Any) -> Response:
        """Show a tab, or a part of it; of a campaign that the lake lacks an error says so."""
        asked = request.query_params.get("campaign", "")

        def work() -> Response:
            frame = self.frame(request, tab)
            if asked and asked not in frame["campaigns"] and template != ERROR_PAGE:
                raise UsageError(f"This lake has no campaign `{asked}` of its own; choose one above.")
            return self.pages.show(request, template, **frame, **values)

        return await run_in_threadpool(work)

    async def write(self, request: Request, role: Role, work: Callable[[dict[str, str], str], str]) -> Response:
        """Do what a form asks for, and say what was done; `work` gets the form and the person's name."""
        visitor = require_write(request, self.token, role)
        form = await read_form(request)
        try:
            sentence = await run_in_threadpool(work, form, visitor.operator)
        finally:
            self.forget()
        return say(Response(status_code=204, headers=HEADERS), sentence)
