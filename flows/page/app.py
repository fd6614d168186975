"""The routes of the page: what is shown, and what is done with what people say."""

import asyncio
import mimetypes
from collections.abc import AsyncIterator, Awaitable, Callable
from types import ModuleType
from typing import Any

from fastapi import FastAPI
from starlette.concurrency import run_in_threadpool
from starlette.middleware.gzip import GZipMiddleware
from starlette.requests import Request
from starlette.responses import JSONResponse, PlainTextResponse, RedirectResponse, Response, StreamingResponse
from starlette.staticfiles import StaticFiles

from fast.flows.campaign.status import read_campaign
from fast.flows.page.interface import VERSION, add_interface, refuse_program
from fast.flows.page.lab import LabPage
from fast.flows.page.proposals import settle_proposal
from fast.flows.page.shown import add_bench, add_results, add_start
from fast.flows.page.todo import list_campaigns
from fast.flows.page.web import (
    HEADERS,
    MOST_FILE_BYTES,
    clean_name,
    keep_name,
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
from fast.lake.store import Lake
from fast.models.errors import FastError, UsageError
from fast.tasks.bench.leave_out import leave_out as leave_part_out
from fast.tasks.bench.questions import answer_question
from fast.tasks.campaign.left_out import Part
from fast.tasks.campaign.orders import give_order
from fast.tasks.campaign.simulator_versions import at_present

_OUTPUTS_POLICY = "sandbox; default-src 'self' data:; style-src 'self' 'unsafe-inline'; script-src 'none'"
Handler = Callable[[Request], Awaitable[Response]]


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
        answer = await page.show(request, "error.html", "results", sentence=str(error))
        answer.status_code = 409
        return answer

    app.add_exception_handler(FastError, show_error)
    app.add_middleware(GZipMiddleware, minimum_size=2000)
    _add_looks(app, page)
    _add_words(app, page)
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

    async def leave_out(request: Request) -> Response:
        def work(form: dict[str, str], operator: str) -> str:
            campaign = at_present(read_campaign(page.lake, _campaign_of(page, form)))
            try:
                part = Part.model_validate_json(form.get("part", ""))
            except ValueError as error:
                raise UsageError("Choose what is left out; nothing was changed.") from error
            return leave_part_out(campaign, part, form.get("reason", ""), operator, is_out="back" not in form)

        return await page.write(request, Role.MOVE, work)

    async def say_printed(request: Request) -> Response:
        def work(form: dict[str, str], operator: str) -> str:
            return _answers().answer_print(page.lake, _campaign_of(page, form), _whole(form, "batch"), form, operator)

        return await page.write(request, Role.SAY, work)

    async def say_mounted(request: Request) -> Response:
        def work(form: dict[str, str], operator: str) -> str:
            return _answers().answer_mount(page.lake, _campaign_of(page, form), form.get("search", ""), form, operator)

        return await page.write(request, Role.SAY, work)

    async def say_reading(request: Request) -> Response:
        def work(form: dict[str, str], operator: str) -> str:
            return _answers().answer_reading(
                page.lake, form.get("campaign", ""), form.get("search", ""), form, operator
            )

        return await page.write(request, Role.SAY, work)

    async def say_to_bench(request: Request) -> Response:
        def work(form: dict[str, str], operator: str) -> str:
            values = {name.removeprefix("field-"): text for name, text in form.items() if name.startswith("field-")}
            name, asked = _campaign_of(page, form), form.get("question", "")
            return answer_question(page.lake, name, asked, form.get("choice", ""), values, operator)

        return await page.write(request, Role.MOVE, work)

    async def decide(request: Request) -> Response:
        def work(form: dict[str, str], operator: str) -> str:
            text = form.get("config", "").replace("\r\n", "\n")
            return settle_proposal(page.lake, form.get("proposal", ""), form.get("accept") == "yes", text, operator)

        return await page.write(request, Role.MOVE, work)

    async def look_at_file(request: Request) -> Response:
        require_write(request, page.token, Role.SAY)
        campaign_id = _campaign_of(page, dict(request.query_params))
        content = await read_body(request, MOST_FILE_BYTES)

        def work() -> Response:
            upload = _answers().keep_upload(page.lake, request.query_params.get("name", ""), content)
            dropped = page.worker.call(_answers().look_at_upload, page.lake, campaign_id, upload)
            return page.pages.show(request, "dropped.html", dropped=dropped, campaign=campaign_id)

        return await run_in_threadpool(work)

    async def write_file(request: Request) -> Response:
        def work(form: dict[str, str], operator: str) -> str:
            write = _answers().write_upload
            return str(page.worker.call(write, page.lake, _campaign_of(page, form), form, operator))

        return await page.write(request, Role.SAY, work)

    async def undo_file(request: Request) -> Response:
        def work(form: dict[str, str], operator: str) -> str:
            return _answers().undo_told(page.lake, _campaign_of(page, form), operator)

        return await page.write(request, Role.SAY, work)

    async def undo_reading(request: Request) -> Response:
        def work(form: dict[str, str], operator: str) -> str:
            campaign_id, search_id = form.get("campaign", ""), form.get("search", "")
            return _answers().undo_reading(page.lake, campaign_id, search_id, form.get("kind", ""), operator)

        return await page.write(request, Role.SAY, work)

    routes: dict[str, Handler] = {
        "/who": give_name,
        "/orders/leave-out": leave_out,
        "/orders/{verb}": order,
        "/todo/print": say_printed,
        "/todo/mount": say_mounted,
        "/todo/reading": say_reading,
        "/todo/reading/undo": undo_reading,
        "/todo/proposal": decide,
        "/todo/question": say_to_bench,
        "/todo/told/look": look_at_file,
        "/todo/told/write": write_file,
        "/todo/told/undo": undo_file,
    }
    for path, handler in routes.items():
        app.add_api_route(path, handler, methods=["POST"], include_in_schema=False)


def _answers() -> ModuleType:
    """What writes answers: seconds of imports, which whoever only looks does not wait for."""
    from fast.flows.page import answers

    return answers


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
