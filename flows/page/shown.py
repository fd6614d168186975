"""Routes of the tabs Results, Gap and Start."""

from typing import Any

from fastapi import FastAPI
from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import JSONResponse, Response

from fast.flows.page import by_hand, results, start
from fast.flows.page.configs import list_configs, read_config
from fast.flows.page.jobs import list_jobs
from fast.flows.page.lab import LabPage
from fast.flows.page.notes import MOST_PHOTO_BYTES, keep_note, keep_photo
from fast.flows.page.todo import list_campaigns
from fast.flows.page.web import HEADERS, read_body, read_form, require_token, require_write, say
from fast.flows.server.access import Role
from fast.flows.server.server import address_for_others
from fast.lake.query.catalogue import catalogue
from fast.lake.query.sql import csv_bytes, run_sql
from fast.models.errors import FastError, UsageError
from fast.models.objects.catalogue import list_known


def add_results(app: FastAPI, page: LabPage) -> None:
    """What was found."""
    lake = page.lake

    async def show_results(request: Request) -> Response:
        def read() -> dict[str, object]:
            return {
                "lines": results.list_campaign_lines(lake),
                "tools": results.list_tools(lake),
                "calibrations": results.list_calibrations(lake),
            }

        return await page.show(request, "results.html", "results", **await run_in_threadpool(read))

    async def show_tool(request: Request) -> Response:
        tool = await run_in_threadpool(results.read_tool, lake, request.query_params.get("id", ""))
        return await page.show(request, "tool.html", "results", tool=tool)

    async def show_grasp(request: Request) -> Response:
        def read() -> results.ToolPage:
            return results.read_tool(lake, results.find_tool_of(lake, request.query_params.get("id", "")))

        return await page.show(request, "tool.html", "results", tool=await run_in_threadpool(read))

    async def compare(request: Request) -> Response:
        tools = request.query_params.getlist("tool")
        found = await run_in_threadpool(results.compare_tools, lake, tools)
        return await page.show(request, "compare.html", "results", tools=tools, found=found)

    async def ask(request: Request) -> Response:
        question, answer, fault = request.query_params.get("q", ""), None, ""
        try:
            answer = await run_in_threadpool(results.answer_sql, lake, question) if question else None
        except FastError as error:
            fault = str(error)
        shown = {"question": question or "FROM tool_quality", "answer": answer, "fault": fault}
        return await page.show(request, "sql.html", "results", catalogue=catalogue(), **shown)

    async def give_csv(request: Request) -> Response:
        table = await run_in_threadpool(run_sql, lake, request.query_params.get("q", ""), results.LIMITS)
        headers = {**HEADERS, "Content-Disposition": 'attachment; filename="answer.csv"'}
        return Response(csv_bytes(table), 200, headers, "text/csv")

    async def show_gap(request: Request) -> Response:
        from fast.flows.report.gap.answer import describe_answer

        searches = await run_in_threadpool(results.list_searches, lake)
        return await page.show(request, "gap.html", "gap", searches=searches, describe=describe_answer)

    async def note(request: Request) -> Response:
        return await page.write(request, Role.SAY, lambda form, who: keep_note(lake, form, who))

    async def photo(request: Request) -> Response:
        visitor = require_write(request, page.token, Role.SAY)
        content = await read_body(request, MOST_PHOTO_BYTES)
        about = request.query_params.get("about", "")
        sentence = await run_in_threadpool(keep_photo, lake, about, content, visitor.operator)
        return say(Response(status_code=204, headers=HEADERS), sentence)

    looks = {
        "/results": show_results,
        "/results/tool": show_tool,
        "/results/grasp": show_grasp,
        "/results/compare": compare,
        "/results/sql": ask,
        "/results/sql.csv": give_csv,
        "/gap": show_gap,
    }
    for path, handler in looks.items():
        app.add_api_route(path, handler, methods=["GET"], include_in_schema=False)
    for path, handler in {"/results/note": note, "/results/photo": photo}.items():
        app.add_api_route(path, handler, methods=["POST"], include_in_schema=False)


def add_start(app: FastAPI, page: LabPage) -> None:
    """What can be started."""
    lake = page.lake

    async def show_start(request: Request) -> Response:
        def read() -> dict[str, object]:
            names = list_configs(lake)
            base = request.query_params.get("base", "")
            base = base if base in names else next(iter(names), "")
            text = read_config(lake, base) if base else ""
            tools = results.list_tools(lake)
            return {"jobs": list_jobs(lake), "configs": names, "base": base, "text": text, "tools": tools}

        shown = await run_in_threadpool(read)
        return await page.show(request, "start.html", "start", objects=list_known(), **shown)

    async def check(request: Request) -> Response:
        require_token(request, page.token)
        form = await read_form(request)
        text = form.get("text", "").replace("\r\n", "\n")
        checked = await run_in_threadpool(start.check_config, lake, text, form.get("base", ""))
        return page.pages.show(request, "checked.html", checked=checked)

    async def begin(request: Request) -> Response:
        return await page.write(request, Role.MOVE, lambda form, who: start.start_campaign(lake, form, who))

    async def go_on(request: Request) -> Response:
        def work(form: dict[str, str], operator: str) -> str:
            if form.get("campaign", "") not in list_campaigns(lake):
                raise UsageError("This lake has no such campaign; load the page again.")
            return start.continue_campaign(lake, form["campaign"], form.get("run", ""), operator)

        return await page.write(request, Role.MOVE, work)

    async def take_way(request: Request) -> Response:
        def work(form: dict[str, str], operator: str) -> str:
            if form.get("campaign", "") not in list_campaigns(lake):
                raise UsageError("This lake has no such campaign; load the page again.")
            return start.go_on_after_fault(lake, form, operator)

        return await page.write(request, Role.MOVE, work)

    async def job(request: Request) -> Response:
        def work(form: dict[str, str], operator: str) -> str:
            return start.start_job(lake, form.get("job", ""), form.get("campaign", ""), operator)

        return await page.write(request, Role.MOVE, work)

    async def simulate(request: Request) -> Response:
        require_token(request, page.token)
        form = await read_form(request)
        number = form.get("object", "")
        if not number.isdecimal():
            raise UsageError("Choose an object.")
        address, tool_id, object_id = address_for_others(lake), form.get("tool", ""), int(number)

        def work() -> dict[str, Any]:
            return page.worker.call(start.simulate_one, address, tool_id, object_id)

        found = await run_in_threadpool(work)
        return page.pages.show(request, "simulated.html", found=found)

    app.add_api_route("/start", show_start, methods=["GET"], include_in_schema=False)
    for path, handler in {
        "/start/check": check,
        "/start/campaign": begin,
        "/start/continue": go_on,
        "/start/way": take_way,
        "/start/job": job,
        "/start/simulate": simulate,
    }.items():
        app.add_api_route(path, handler, methods=["POST"], include_in_schema=False)


def add_bench(app: FastAPI, page: LabPage) -> None:
    """The bench that is moved by hand: its card, what it reads, and orders to it."""

    async def show_bench(request: Request) -> Response:
        return await page.show(request, "by_hand.html", "start")

    async def show_reading(_: Request) -> Response:
        def work() -> dict[str, Any]:
            return by_hand.read_bench(page.lake, page.read_lent())

        return JSONResponse(await run_in_threadpool(work), headers=HEADERS)

    async def order_bench(request: Request) -> Response:
        return await page.write(request, Role.MOVE, lambda form, who: by_hand.order_bench(page.lake, form, who))

    app.add_api_route("/bench", show_bench, methods=["GET"], include_in_schema=False)
    app.add_api_route("/bench/reading", show_reading, methods=["GET"], include_in_schema=False)
    app.add_api_route("/bench/order", order_bench, methods=["POST"], include_in_schema=False)
