"""The routes of the page: what is shown, and what is done with what people say."""

import asyncio
import mimetypes
import threading
import time
from collections.abc import AsyncIterator, Awaitable, Callable
from datetime import datetime
from typing import Any
from urllib.parse import quote

from fastapi import FastAPI
from starlette.concurrency import run_in_threadpool
from starlette.middleware.gzip import GZipMiddleware
from starlette.requests import Request
from starlette.responses import JSONResponse, PlainTextResponse, RedirectResponse, Response, StreamingResponse
from starlette.staticfiles import StaticFiles

from fast.flows.page import answers
from fast.flows.page.interface import add_interface
from fast.flows.page.live import LiveHub, read_marks
from fast.flows.page.now import Now, NowReader
from fast.flows.page.shown import add_results, add_start
from fast.flows.page.standing import Strip, read_strip
from fast.flows.page.todo import Todo, list_campaigns, read_todos
from fast.flows.page.web import (
    HEADERS,
    Pages,
    clean_name,
    keep_name,
    make_token,
    read_body,
    read_form,
    refuse,
    require_token,
    require_write,
    say,
    visitor_of,
)
from fast.flows.server.access import Role, role_login
from fast.flows.server.gate import App
from fast.hardware.parts.safe_state import Verb
from fast.lake.leases import holder_of
from fast.lake.store import Lake
from fast.models.errors import FastError, UsageError
from fast.tasks.campaign.orders import give_order
from fast.tasks.campaign.requests import lease_name

MOST_CPU = 0.02  # of a core: a lake of a million grasps is not read anew for each page that opens
_STALE_S = 30.0  # at most
_OUTPUTS_POLICY = "sandbox; default-src 'self' data:; style-src 'self' 'unsafe-inline'; script-src 'none'"
Handler = Callable[[Request], Awaitable[Response]]


class Cached:
    """Something that is read from the lake, again when the lake has more; seldom, where that costs much."""

    def __init__(self, lake: Lake, read: Callable[[str], Any]) -> None:
        self._lake, self._read = lake, read
        self._lock = threading.Lock()
        self._known: dict[str, tuple[Any, float, float, Any]] = {}

    def get(self, name: str) -> Any:
        """As it is now, or was a moment ago."""
        with self._lock:
            marks, now_s = read_marks(self._lake), time.monotonic()
            if name in self._known:
                seen, at_s, cost_s, value = self._known[name]
                if seen == marks or now_s - at_s < min(cost_s / MOST_CPU, _STALE_S):
                    return value
            before_s = time.thread_time()
            value = self._read(name)
            cost_s = time.thread_time() - before_s
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
        self.hub = LiveHub(lake)
        self.pages = Pages(self.token, {"quote": quote, "clock": _clock})
        self._now = Cached(lake, self.now.read)
        self._todos = Cached(lake, lambda _: read_todos(lake))

    def read_now(self, campaign_id: str) -> Now | None:
        """What the tab Now shows of a campaign; None where there is none, or it cannot be read."""
        if not campaign_id:
            return None
        try:
            return self._now.get(campaign_id)  # type: ignore[no-any-return]
        except FastError:
            return None

    def read_todos(self) -> list[Todo]:
        """The inbox."""
        return self._todos.get("")  # type: ignore[no-any-return]

    def forget(self) -> None:
        """Something was written here."""
        self._now.forget()
        self._todos.forget()

    def choose_campaign(self, request: Request) -> str:
        """The campaign that is asked for; else the one that runs, or the newest; empty where there is none."""
        names = list_campaigns(self.lake)
        asked = request.query_params.get("campaign", "")
        if asked in names:
            return asked
        running = [name for name in names if holder_of(self.lake.storage, lease_name(name)) is not None]
        return next(iter([*running, *names]), "")

    def read_strip(self, campaign_id: str, now: Now | None) -> Strip | None:
        """The control strip of a campaign."""
        if not campaign_id:
            return None
        is_waiting = any(todo.campaign_id == campaign_id for todo in self.read_todos())
        is_bench_busy = now is not None and any(slot.state == "left" for slot in now.slots)
        return read_strip(self.lake, campaign_id, now is not None and now.is_complete, is_waiting and not is_bench_busy)

    def frame(self, request: Request, tab: str) -> dict[str, Any]:
        """What stands around every tab."""
        campaign_id = self.choose_campaign(request)
        now = self.read_now(campaign_id)
        return {
            "tab": tab,
            "campaign": campaign_id,
            "campaigns": list_campaigns(self.lake),
            "now": now,
            "strip": self.read_strip(campaign_id, now),
            "todos": self.read_todos(),
            "lake_name": self.lake.root.name,
        }

    async def show(self, request: Request, template: str, tab: str, **values: Any) -> Response:
        """A tab, or a part of it."""

        def work() -> Response:
            return self.pages.show(request, template, **self.frame(request, tab), **values)

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


def make_app(lake: Lake, login: str) -> App:
    """The page of a lake, without the gate. `login`: `user:password` of the lake, from which links and token follow."""
    page = LabPage(lake, login)
    app = FastAPI(
        title="FAST: a lab's page", version="1", docs_url=None, redoc_url=None, openapi_url="/api/v1/openapi.json"
    )
    app.add_exception_handler(FastError, _show_error)
    app.add_middleware(GZipMiddleware, minimum_size=2000)
    _add_looks(app, page)
    _add_words(app, page)
    add_results(app, page)
    add_start(app, page)
    add_interface(app, page)
    _add_files(app, page)
    return app


async def _show_error(_: Request, error: Exception) -> Response:
    if not isinstance(error, FastError):
        raise error
    return refuse(error)


def _add_looks(app: FastAPI, page: LabPage) -> None:
    """What everybody may look at."""

    async def show_now(request: Request) -> Response:
        return await page.show(request, "now.html", "now")

    async def show_now_part(request: Request) -> Response:
        return await page.show(request, "now_part.html", "now")

    async def show_map(request: Request) -> Response:
        return await page.show(request, "map_part.html", "now")

    async def show_strip(request: Request) -> Response:
        return await page.show(request, "strip.html", "strip")

    async def show_todo(request: Request) -> Response:
        return await page.show(request, "todo.html", "todo")

    async def show_simulated(request: Request) -> Response:
        query = request.query_params
        campaign_id, tool_id, object_id = query.get("campaign", ""), query.get("tool", ""), query.get("object", "")
        if campaign_id not in list_campaigns(page.lake) or not object_id.isdecimal():
            return JSONResponse({"lift_mm": [], "force_n": []}, headers=HEADERS)
        found = await run_in_threadpool(page.now.simulated, campaign_id, tool_id, int(object_id))
        return JSONResponse(found, headers=HEADERS)

    async def follow(request: Request) -> Response:
        campaign_id = await run_in_threadpool(page.choose_campaign, request)
        headers = {**HEADERS, "X-Accel-Buffering": "no"}
        return StreamingResponse(_until_gone(page.hub.follow(campaign_id)), 200, headers, "text/event-stream")

    async def show_people(request: Request) -> Response:
        links = {}
        if visitor_of(request).role is Role.MOVE:
            base = str(request.base_url)
            links = {role: f"{base}?key={role_login(page.login, role).partition(':')[2]}" for role in Role}
        return await page.show(request, "people.html", "people", links=links)

    for path, handler in {
        "/": show_now,
        "/now/part": show_now_part,
        "/now/map": show_map,
        "/strip": show_strip,
        "/todo": show_todo,
        "/now/simulated": show_simulated,
        "/events": follow,
        "/people": show_people,
    }.items():
        app.add_api_route(path, handler, methods=["GET"], include_in_schema=False)


async def _until_gone(events: AsyncIterator[str]) -> AsyncIterator[str]:
    """Events until the browser is gone, which Starlette tells by cancelling."""
    try:
        async for event in events:
            yield event
    except asyncio.CancelledError:
        return


def _add_words(app: FastAPI, page: LabPage) -> None:
    """What people say and order."""

    async def give_name(request: Request) -> Response:
        require_token(request, page.token)
        form = await read_form(request)
        name = clean_name(form.get("name", ""))
        if not name:
            raise UsageError("Say a name, so that the lake can keep who did what.")
        answer = say(Response(status_code=204, headers=HEADERS), f"Hello {name}.")
        answer.headers["HX-Refresh"] = "true"
        keep_name(request, answer, name)
        return answer

    async def order(request: Request) -> Response:
        verb = {"pause": Verb.PAUSE, "stop": Verb.STOP}.get(request.path_params["verb"])
        if verb is None:
            raise UsageError("There is no such order.")

        def work(form: dict[str, str], operator: str) -> str:
            who = f"by {operator} on the lab's page"
            return give_order(page.lake, _campaign_of(page, form), verb, who, form.get("run"))

        return await page.write(request, Role.MOVE, work)

    async def say_printed(request: Request) -> Response:
        def work(form: dict[str, str], operator: str) -> str:
            return answers.answer_print(page.lake, _campaign_of(page, form), _whole(form, "batch"), form, operator)

        return await page.write(request, Role.SAY, work)

    async def say_mounted(request: Request) -> Response:
        def work(form: dict[str, str], operator: str) -> str:
            return answers.answer_mount(page.lake, _campaign_of(page, form), form.get("search", ""), form, operator)

        return await page.write(request, Role.SAY, work)

    async def say_reading(request: Request) -> Response:
        def work(form: dict[str, str], operator: str) -> str:
            return answers.answer_reading(page.lake, form.get("campaign", ""), form.get("search", ""), form, operator)

        return await page.write(request, Role.SAY, work)

    async def look_at_file(request: Request) -> Response:
        visitor = require_write(request, page.token, Role.SAY)
        campaign_id = _campaign_of(page, dict(request.query_params))
        content = await read_body(request, answers.MOST_BYTES)

        def work() -> Response:
            upload = answers.keep_upload(page.lake, request.query_params.get("name", ""), content)
            dropped = answers.look_at_upload(page.lake, campaign_id, upload, visitor.operator)
            return page.pages.show(request, "dropped.html", dropped=dropped, campaign=campaign_id)

        return await run_in_threadpool(work)

    async def write_file(request: Request) -> Response:
        def work(form: dict[str, str], operator: str) -> str:
            return answers.write_upload(page.lake, _campaign_of(page, form), form, operator)

        return await page.write(request, Role.SAY, work)

    async def undo_file(request: Request) -> Response:
        def work(form: dict[str, str], operator: str) -> str:
            return answers.undo_told(page.lake, _campaign_of(page, form), operator)

        return await page.write(request, Role.SAY, work)

    async def undo_reading(request: Request) -> Response:
        def work(form: dict[str, str], operator: str) -> str:
            campaign_id, search_id = form.get("campaign", ""), form.get("search", "")
            return answers.undo_reading(page.lake, campaign_id, search_id, form.get("kind", ""), operator)

        return await page.write(request, Role.SAY, work)

    routes: dict[str, Handler] = {
        "/who": give_name,
        "/orders/{verb}": order,
        "/todo/print": say_printed,
        "/todo/mount": say_mounted,
        "/todo/reading": say_reading,
        "/todo/reading/undo": undo_reading,
        "/todo/told/look": look_at_file,
        "/todo/told/write": write_file,
        "/todo/told/undo": undo_file,
    }
    for path, handler in routes.items():
        app.add_api_route(path, handler, methods=["POST"], include_in_schema=False)


def _add_files(app: FastAPI, page: LabPage) -> None:
    """Style, scripts, and what the lake has put out for people, which runs no script here."""
    mimetypes.add_type("text/javascript", ".js")
    folder = page.lake.root / "outputs"
    folder.mkdir(parents=True, exist_ok=True)
    app.mount("/assets", _Files({"Cache-Control": "max-age=3600"}, packages=[("fast.flows.page", "assets")]))
    outputs = {**HEADERS, "Content-Security-Policy": _OUTPUTS_POLICY, "Cache-Control": "no-cache"}
    app.mount("/outputs", _Files(outputs, directory=folder, html=True))

    async def explain(request: Request, error: Exception) -> Response:
        return PlainTextResponse("There is no such page.", 404, HEADERS)

    async def show_icon(_: Request) -> Response:
        return RedirectResponse("/assets/icon.svg", 303)

    app.add_exception_handler(404, explain)
    app.add_api_route("/favicon.ico", show_icon, methods=["GET"], include_in_schema=False)


class _Files(StaticFiles):
    """Files with these headers."""

    def __init__(self, headers: dict[str, str], **where: Any) -> None:
        super().__init__(**where)
        self._headers = headers

    def file_response(self, *args: Any, **kwargs: Any) -> Response:
        """A file with the headers."""
        answer = super().file_response(*args, **kwargs)
        answer.headers.update(self._headers)
        return answer


def _campaign_of(page: LabPage, form: dict[str, str]) -> str:
    """The campaign that a form names.

    Raises:
        UsageError: the lake has none of that name.
    """
    campaign_id = form.get("campaign", "")
    if campaign_id not in list_campaigns(page.lake):
        raise UsageError(f"This lake has no campaign `{campaign_id}`; load the page again.")
    return campaign_id


def _whole(form: dict[str, str], name: str) -> int:
    text = form.get(name, "")
    if not text.isdecimal():
        raise UsageError(f"`{name}` of the form is not a whole number; load the page again.")
    return int(text)


def _clock(moment: datetime | None) -> str:
    """A time of the lab's day."""
    return "" if moment is None else moment.astimezone().strftime("%H:%M")
