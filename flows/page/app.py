"""The routes of the page: what is shown, and what is done with what people say."""

import mimetypes
from typing import Any

from fastapi import FastAPI
from starlette.middleware.gzip import GZipMiddleware
from starlette.requests import Request
from starlette.responses import PlainTextResponse, RedirectResponse, Response
from starlette.staticfiles import StaticFiles

from fast.flows.page.interface import VERSION, add_interface, refuse_program
from fast.flows.page.lab import ERROR_PAGE, LabPage
from fast.flows.page.shown import add_shown
from fast.flows.page.web import HEADERS, refuse
from fast.flows.page.words import add_words
from fast.flows.server.gate import App
from fast.lake.store import Lake
from fast.models.errors import FastError

# No script and no form; of its own origin, so that its pictures come through the gate, and its tables can be kept.
_OUTPUTS_POLICY = (
    "sandbox allow-same-origin allow-downloads; default-src 'self' data:; style-src 'self' 'unsafe-inline'; "
    "script-src 'none'"
)


def make_app(lake: Lake, login: str) -> App:
    """Make a lake's page, without the gate. `login`: `user:password` of the lake, from which links and token follow."""
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
    add_shown(app, page)
    add_words(app, page)
    add_interface(app, page)
    _add_files(app, page)
    return app


def _add_files(app: FastAPI, page: LabPage) -> None:
    """Add style, scripts, and what the lake has put out for people, which runs no script here."""
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
        """Return a file with the headers."""
        answer = super().file_response(*args, **kwargs)
        answer.headers.update(self._headers)
        return answer
