"""What every route of the page shares: who asks, what they may, forms, templates, and answers in one sentence."""

import asyncio
import hashlib
import hmac
import json
from collections.abc import AsyncIterator
from dataclasses import dataclass
from datetime import datetime
from typing import Any
from urllib.parse import parse_qsl, quote, unquote

from starlette.requests import Request
from starlette.responses import HTMLResponse, PlainTextResponse, Response

from fast.flows.server.access import Role
from fast.flows.server.gate import ROLE
from fast.models.errors import FastError, UsageError
from fast.tasks.templates import render

# Names from the lake are text, never markup, and nothing is loaded from elsewhere; `data:` is of small pictures.
POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self' 'unsafe-inline'; img-src 'self' data:; "
    "connect-src 'self'; form-action 'self'; frame-ancestors 'none'; base-uri 'none'"
)
HEADERS = {
    "Content-Security-Policy": POLICY,
    "Cache-Control": "no-store",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
}
TOKEN_HEADER = "x-fast-token"
LONGEST_NAME = 60
MOST_FILE_BYTES = 20_000_000  # of a dropped file
_FORM_BYTES = 200_000
_YEAR_S = 365 * 86400


class NotAllowedError(FastError):
    """A write without the page's token, or beyond what the visitor's link allows."""


@dataclass(frozen=True)
class Visitor:
    """Who asks: what their link allows, and the name that they gave; empty before."""

    role: Role
    operator: str


def visitor_of(request: Request) -> Visitor:
    """Return who asks, from what the gate found and the browser keeps."""
    role = Role(request.scope.get(ROLE, Role.LOOK))
    name = unquote(request.cookies.get(name_cookie(request), ""))
    return Visitor(role, clean_name(name))


def clean_name(text: str) -> str:
    """Clean a person's name: put it on one line, cut to `LONGEST_NAME` letters."""
    printable = "".join(letter for letter in text if letter.isprintable())
    return " ".join(printable.split())[:LONGEST_NAME]


def name_cookie(request: Request) -> str:
    """Name the cookie with the person's name: browsers share cookies among the ports of a machine."""
    return f"fast-name-{(request.scope.get('server') or ('', 0))[1]}"


def keep_name(request: Request, response: Response, name: str) -> None:
    """Have the browser keep who works at it."""
    response.set_cookie(name_cookie(request), quote(name), max_age=_YEAR_S, httponly=True, samesite="lax")


def make_token(login: str) -> str:
    """Make what a write carries besides the cookie: the page tells it to those whom the gate lets in."""
    return hmac.new(login.encode(), b"write", hashlib.sha256).hexdigest()[:32]


def require_write(request: Request, token: str, role: Role) -> Visitor:
    """Return who writes.

    Raises:
        NotAllowedError: the token is missing or old, the link allows less, or nobody said a name.
    """
    require_token(request, token)
    visitor = visitor_of(request)
    if not visitor.role.may(role):
        words = {Role.SAY: "say what was done", Role.MOVE: "start, pause or stop"}
        raise NotAllowedError(f"This link lets you {visitor.role}, not {words[role]}; ask for the other link.")
    if not visitor.operator:
        raise NotAllowedError("Say your name first (top right); the lake keeps who did what. Nothing was changed.")
    return visitor


def require_token(request: Request, token: str) -> None:
    """Raise NotAllowedError: the request does not carry what the page tells those whom the gate lets in."""
    if not hmac.compare_digest(request.headers.get(TOKEN_HEADER, "").encode(), token.encode()):
        raise NotAllowedError(
            "This page is of an earlier server, or of a stranger; nothing was changed: load it again."
        )


async def read_body(request: Request, most_bytes: int) -> bytes:
    """Read the body of a request.

    Raises:
        UsageError: it is larger; the rest was not read.
    """
    told = request.headers.get("content-length", "")
    limit = f"at most {most_bytes / 1e6:g} MB are taken; nothing was written"
    if told.isdecimal() and int(told) > most_bytes:
        raise UsageError(f"This file has {int(told) / 1e6:.1f} MB, {limit}.")
    parts, n = [], 0
    async for part in request.stream():
        n += len(part)
        if n > most_bytes:
            raise UsageError(f"This file is too large: {limit}.")
        parts.append(part)
    return b"".join(parts)


async def read_form(request: Request) -> dict[str, str]:
    """Read the fields of a form, without those that are empty.

    Raises:
        UsageError: too many, or no text.
    """
    body = await read_body(request, _FORM_BYTES)
    try:
        return {name: value.strip() for name, value in parse_qsl(body.decode("utf-8"), strict_parsing=bool(body))}
    except ValueError as error:
        raise UsageError("The form could not be read; load the page again.") from error


@dataclass(frozen=True)
class Pages:
    """The templates of the page, filled; `token` is what a write carries."""

    token: str

    def show(self, request: Request, template: str, **values: Any) -> HTMLResponse:
        """Show a page, or a part of one."""
        text = render(
            f"flows/page/{template}.j2",
            visitor=visitor_of(request),
            token=self.token,
            path=request.url.path,
            quote=quote,
            clock=write_clock,
            **values,
        )
        return HTMLResponse(text, headers=HEADERS)


def write_clock(moment: datetime | None) -> str:
    """Write a time of the lab's day, with its zone."""
    return "" if moment is None else moment.astimezone().strftime("%H:%M %Z")


def say(response: Response, sentence: str) -> Response:
    """Have the page say a sentence beside what it shows."""
    response.headers["HX-Trigger"] = json.dumps({"said": sentence, "changed": True})
    return response


def refuse(error: FastError) -> Response:
    """Return an error as its sentence."""
    status = 403 if isinstance(error, NotAllowedError) else 409
    return PlainTextResponse(str(error), status, HEADERS)


async def until_gone(events: AsyncIterator[str]) -> AsyncIterator[str]:
    """Yield events until the browser is gone, which Starlette tells by cancelling."""
    try:
        async for event in events:
            yield event
    except asyncio.CancelledError:
        return
