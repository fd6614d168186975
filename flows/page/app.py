"""The routes of the page: what is shown, and what is done with what people say."""

import asyncio
import mimetypes
from collections.abc import AsyncIterator
from typing import Any

from fastapi import FastAPI
from starlette.concurrency import run_in_threadpool
from starlette.middleware.gzip import GZipMiddleware
from starlette.requests import Request
from starlette.responses import JSONResponse, PlainTextResponse, RedirectResponse, Response, StreamingResponse
from starlette.staticfiles import StaticFiles

from fast.flows.page.interface import VERSION, add_interface, refuse_program
from fast.flows.page.lab import ERROR_PAGE, LabPage
from fast.flows.page.shown import add_bench, add_results, add_start
from fast.flows.page.todo import list_campaigns
from fast.flows.page.web import HEADERS, refuse, visitor_of
from fast.flows.page.words import add_words
from fast.flows.server.access import Role, role_login
from fast.flows.server.gate import App
from fast.lake.store import Lake
from fast.models.errors import FastError

_OUTPUTS_POLICY = "sandbox; default-src 'self' data:; style-src 'self' 'unsafe-inline'; script-src 'none'"


def make_app(lake: Lake, login: str) -> App:
    """The page of a lake, without the gate. `login`: `user:password` of the lake, from which links and token follow."""
    page = LabPage(lake, login)
    app = FastAPI(
        title="FAST: a lab's page", version="1", docs_url=None, redoc_url=None, openapi_url="/api/v1/openapi.json"
    )

    async def show_error(request: Request, error: Exception) -> Response:
        if not isinstance(error, FastError):
            raise error
        if request.url.path.startswith(f"{VERSION}/"):
            return refuse_program(error)
        is_page = request.method == "GET" and "text/html" in request.headers.get("accept", "")
        if not is_page or "hx-request" in request.headers:
            return refuse(error)
        answer = await page.show(request, ERROR_PAGE, "results", sentence=str(error))
        answer.status_code = 409
        return answer

    app.add_exception_handler(FastError, show_error)
    app.add_middleware(GZipMiddleware, minimum_size=2000)
    _add_looks(app, page)
    add_words(app, page)
    add_results(app, page)
    add_start(app, page)
    add_bench(app, page)
    add_interface(app, page)
    _add_files(app, page)
    return app


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


def _add_files(app: FastAPI, page: LabPage) -> None:
    """Style, scripts, and what the lake has put out for people, which runs no script here."""
    mimetypes.add_type("text/javascript", ".js")
    folder = page.lake.root / "outputs"
    folder.mkdir(parents=True, exist_ok=True)
    app.mount("/assets", _Files({"Cache-Control": "no-cache"}, packages=[("fast.flows.page", "assets")]))
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
