"""What the page shows: for each address a template, the tab it is of, and what is read for it."""

from collections.abc import Callable, Mapping
from typing import Any

from fastapi import FastAPI
from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import JSONResponse, Response, StreamingResponse

from fast.flows.page import by_hand, results
from fast.flows.page.configs import list_configs, read_config
from fast.flows.page.jobs import list_jobs
from fast.flows.page.lab import LabPage
from fast.flows.page.todo import list_campaigns
from fast.flows.page.web import HEADERS, until_gone, visitor_of
from fast.flows.server.access import Role, role_login
from fast.lake.query.catalogue import catalogue
from fast.lake.query.sql import csv_bytes, run_sql
from fast.models.errors import FastError
from fast.models.objects.catalogue import list_known

Read = Callable[[LabPage, Request], dict[str, Any]]


def add_shown(app: FastAPI, page: LabPage) -> None:
    """Add all that is only looked at."""

    async def give_csv(request: Request) -> Response:
        table = await run_in_threadpool(run_sql, page.lake, request.query_params.get("q", ""), results.LIMITS)
        headers = {**HEADERS, "Content-Disposition": 'attachment; filename="answer.csv"'}
        return Response(csv_bytes(table), 200, headers, "text/csv")

    async def follow(request: Request) -> Response:
        campaign_id = await run_in_threadpool(page.choose_campaign, request)
        headers = {**HEADERS, "X-Accel-Buffering": "no"}
        return StreamingResponse(until_gone(page.hub.follow(campaign_id)), 200, headers, "text/event-stream")

    for path, (template, tab, read) in PAGES.items():
        _add_page(app, page, path, template, tab, read)
    for path, read in NUMBERS.items():
        _add_numbers(app, page, path, read)
    for path, handler in {"/results/sql.csv": give_csv, "/events": follow}.items():
        app.add_api_route(path, handler, methods=["GET"], include_in_schema=False)


def _add_page(app: FastAPI, page: LabPage, path: str, template: str, tab: str, read: Read) -> None:
    async def handle(request: Request) -> Response:
        return await page.show(request, template, tab, **await run_in_threadpool(read, page, request))

    app.add_api_route(path, handle, methods=["GET"], include_in_schema=False)


def _add_numbers(app: FastAPI, page: LabPage, path: str, read: Read) -> None:
    async def handle(request: Request) -> Response:
        return JSONResponse(await run_in_threadpool(read, page, request), headers=HEADERS)

    app.add_api_route(path, handle, methods=["GET"], include_in_schema=False)


def _read_results(page: LabPage, _: Request) -> dict[str, Any]:
    return {
        "lines": results.list_campaign_summaries(page.lake),
        "tools": results.list_tools(page.lake),
        "calibrations": results.list_calibrations(page.lake),
    }


def _read_tool(page: LabPage, request: Request) -> dict[str, Any]:
    return {"tool": results.read_tool(page.lake, request.query_params.get("id", ""))}


def _read_tool_of_grasp(page: LabPage, request: Request) -> dict[str, Any]:
    return {"tool": results.read_tool(page.lake, results.find_tool_of(page.lake, request.query_params.get("id", "")))}


def _compare(page: LabPage, request: Request) -> dict[str, Any]:
    tools = request.query_params.getlist("tool")
    return {"tools": tools, "found": results.compare_tools(page.lake, tools)}


def _query_sql(page: LabPage, request: Request) -> dict[str, Any]:
    question, answer, fault = request.query_params.get("q", ""), None, ""
    try:
        answer = results.query_sql(page.lake, question) if question else None
    except FastError as error:
        fault = str(error)
    return {"question": question or "FROM tool_quality", "answer": answer, "fault": fault, "catalogue": catalogue()}


def _read_searches(page: LabPage, _: Request) -> dict[str, Any]:
    from fast.flows.report.gap.sentences import describe_findings

    return {"searches": results.list_searches(page.lake), "describe": describe_findings}


def _read_start(page: LabPage, request: Request) -> dict[str, Any]:
    names = list_configs(page.lake)
    base = request.query_params.get("base", "")
    base = base if base in names else next(iter(names), "")
    return {
        "jobs": list_jobs(page.lake),
        "configs": names,
        "base": base,
        "text": read_config(page.lake, base) if base else "",
        "tools": results.list_tools(page.lake),
        "objects": list_known(),
    }


def _make_links(page: LabPage, request: Request) -> dict[str, Any]:
    if visitor_of(request).role is not Role.MOVE:
        return {"links": {}}
    base = str(request.base_url)
    return {"links": {role: f"{base}?key={role_login(page.login, role).partition(':')[2]}" for role in Role}}


def _read_simulated(page: LabPage, request: Request) -> dict[str, Any]:
    query = request.query_params
    campaign_id, tool_id, object_id = query.get("campaign", ""), query.get("tool", ""), query.get("object", "")
    if campaign_id not in list_campaigns(page.lake) or not object_id.isdecimal():
        return {"lift_mm": [], "force_n": []}
    return page.now.simulated(campaign_id, tool_id, int(object_id))


def _read_bench(page: LabPage, _: Request) -> dict[str, Any]:
    return by_hand.read_bench(page.lake, page.read_lent())


def _read_nothing(page: LabPage, _: Request) -> dict[str, Any]:
    """Read nothing: what stands around every tab is all."""
    return {}


PAGES: Mapping[str, tuple[str, str, Read]] = {
    "/": ("now.html", "now", _read_nothing),
    "/now/part": ("now_part.html", "now", _read_nothing),
    "/now/map": ("map_part.html", "now", _read_nothing),
    "/strip": ("strip.html", "strip", _read_nothing),
    "/todo": ("todo.html", "todo", _read_nothing),
    "/people": ("people.html", "people", _make_links),
    "/results": ("results.html", "results", _read_results),
    "/results/tool": ("tool.html", "results", _read_tool),
    "/results/grasp": ("tool.html", "results", _read_tool_of_grasp),
    "/results/compare": ("compare.html", "results", _compare),
    "/results/sql": ("sql.html", "results", _query_sql),
    "/gap": ("gap.html", "gap", _read_searches),
    "/start": ("start.html", "start", _read_start),
    "/bench": ("by_hand.html", "start", _read_nothing),
}
NUMBERS: Mapping[str, Read] = {"/now/simulated": _read_simulated, "/bench/reading": _read_bench}
