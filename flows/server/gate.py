"""Who is let in by a server of FAST: own pages and programs with the key; no page of another site, no other user.

Three rules, for requests and web sockets alike:
1. `Host` is an address or name of this machine, or one of `FAST_NAMES`. A name of a stranger that was pointed at
   127.0.0.1 is refused.
2. `Origin`, which a browser sends with what a page does, is the server itself; so is what else a browser says of it.
3. The key: in `Authorization`, as programs send it, or in the cookie of a browser that came once with `?key=`.

A server may let in with several keys, each for what its bearer may do (`access.ROLES`); the application finds the role
in the scope.
"""

import base64
import binascii
import hmac
import ipaddress
import os
import socket
from collections.abc import Awaitable, Callable, Iterable, MutableMapping
from http import cookies
from typing import Any
from urllib.parse import parse_qsl, urlencode, urlsplit

from fast.flows.server.access import USER, Role, role_login, session_of
from fast.flows.server.loopback import LOOPBACK_NAMES

Scope = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[MutableMapping[str, Any]]]
Send = Callable[[MutableMapping[str, Any]], Awaitable[None]]
App = Callable[[Scope, Receive, Send], Awaitable[None]]

NAMES_VARIABLE = "FAST_NAMES"  # other names of this machine or of a proxy before it, separated by blanks
_YEAR_S = 365 * 86400
_REFUSED = 1008  # of web sockets: policy violation
_HEADERS = {
    "Cache-Control": "no-store",
    "Content-Security-Policy": "default-src 'none'; style-src 'unsafe-inline'; frame-ancestors 'none'",
    "Referrer-Policy": "no-referrer",
}
_PAGE = """<!doctype html><html lang="en"><meta charset="utf-8"><title>FAST: key needed</title>
<body style="font: 16px/1.5 system-ui, sans-serif; max-width: 36rem; margin: 15vh auto; padding: 0 1rem">
<h1 style="font-size: 1.4rem">This server lets in who has its key</h1>
<p>Open the address that <code>fast serve</code>, <code>fast campaign run</code> or <code>fast view</code> printed in
its terminal. It ends with <code>?key=...</code>; the browser keeps it from then on. <code>fast doctor</code> prints
that of <code>fast serve</code> again.</p>
<p>Where a password was set, reload this page: user <code>fast</code>, and the password.</p></body></html>"""


ROLE = "fast.role"  # key of the scope


def add_gate(app: App, login: str, host: str, roles: Iterable[Role] = (Role.MOVE,)) -> App:
    """Put an application behind the three rules. `login`: `user:password`; `host`: the address the server listens on.

    `roles`: whom the server lets in; the login itself is that of `Role.MOVE`.
    """
    names, logins = _own_names(host), {role_login(login, role): role for role in roles}

    async def gate(scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] == "lifespan":
            await app(scope, receive, send)
            return
        headers = _read_headers(scope)
        if sentence := find_fault(headers, names):
            await _refuse(scope, receive, send, 403, sentence)
            return
        is_get = scope["type"] == "http" and scope["method"] == "GET"
        brought = _find_key(scope, logins) if is_get else None
        known = next((one for one in logins if _knows(headers, one, cookie_name(scope))), None)
        # A link for another role counts, whatever the browser had before.
        if brought and brought != known:
            await _welcome(scope, receive, send, brought)
        elif known is not None:
            scope[ROLE] = logins[known]
            await app(scope, receive, _adding(send, _extras(scope, headers, known)))
        else:
            await _refuse(scope, receive, send, 401, "The key of the lake is needed.")

    return gate


def _extras(scope: Scope, headers: dict[str, str], login: str) -> list[tuple[bytes, bytes]]:
    """Return an answer's headers: no page of others frames ours; a browser that gave a password gets its cookie."""
    extras = [(b"x-frame-options", b"SAMEORIGIN")]
    if scope["type"] == "http" and "authorization" in headers and "text/html" in headers.get("accept", ""):
        extras.append((b"set-cookie", _make_cookie(scope, login).encode()))
    return extras


def _adding(send: Send, extras: list[tuple[bytes, bytes]]) -> Send:
    async def add(message: MutableMapping[str, Any]) -> None:
        if message["type"] == "http.response.start":
            message["headers"] = [*message.get("headers", []), *extras]
        await send(message)

    return add


def _make_cookie(scope: Scope, login: str) -> str:
    return f"{cookie_name(scope)}={session_of(login)}; HttpOnly; Max-Age={_YEAR_S}; Path=/; SameSite=lax"


def cookie_name(scope: Scope) -> str:
    """Return the name of the cookie: browsers share cookies among a machine's ports, so that the port is in it."""
    return f"fast-{(scope.get('server') or ('', 0))[1]}"


def _own_names(host: str) -> frozenset[str]:
    """Return the names by which this machine may be asked; where others reach the server, also its addresses."""
    named = {*LOOPBACK_NAMES, *os.environ.get(NAMES_VARIABLE, "").lower().split()}
    if ipaddress.ip_address(host).is_loopback:
        return frozenset({*named, host})
    name = socket.gethostname().lower()
    return frozenset({*named, name, f"{name}.local", socket.getfqdn().lower(), "*"})


def _read_headers(scope: Scope) -> dict[str, str]:
    return {name.decode("latin-1").lower(): value.decode("latin-1") for name, value in scope["headers"]}


def find_fault(headers: dict[str, str], names: frozenset[str]) -> str | None:
    """Find what makes a request a stranger's, in a sentence."""
    host = headers.get("host", "")
    if not _is_own(host, names):
        return (
            f"This server does not answer to the name {host!r}; if it is yours, start the server with it in FAST_NAMES."
        )
    origin = headers.get("origin")
    if origin is not None and urlsplit(origin).netloc.lower() != host.lower():
        return "A page of another site may not talk to this server."
    site, mode = headers.get("sec-fetch-site", "none"), headers.get("sec-fetch-mode", "navigate")
    if site not in ("none", "same-origin") and mode != "navigate":
        return "A page of another site may not talk to this server."
    return None


def _is_own(host: str, names: frozenset[str]) -> bool:
    try:
        name = urlsplit(f"//{host}").hostname or ""
    except ValueError:
        return False
    if name in names:
        return True
    try:
        return "*" in names and ipaddress.ip_address(name) is not None
    except ValueError:
        return False


def _knows(headers: dict[str, str], login: str, cookie: str) -> bool:
    """Return whether the request carries the login, or the cookie that follows from it."""
    kind, _, code = headers.get("authorization", "").partition(" ")
    if kind == "Basic":
        try:
            return hmac.compare_digest(base64.b64decode(code, validate=True), login.encode())
        except (binascii.Error, ValueError):
            return False
    try:
        kept = cookies.SimpleCookie(headers.get("cookie", "")).get(cookie)
    except cookies.CookieError:
        return False
    return kept is not None and hmac.compare_digest(kept.value.encode(), session_of(login).encode())


def _find_key(scope: Scope, logins: Iterable[str]) -> str | None:
    """Find the login whose key the address ends with."""
    given = dict(parse_qsl(scope["query_string"].decode("latin-1"))).get("key", "")
    return next((one for one in logins if hmac.compare_digest(f"{USER}:{given}".encode(), one.encode())), None)


async def _welcome(scope: Scope, receive: Receive, send: Send, login: str) -> None:
    """Give the browser its cookie, and have it ask again without the key."""
    from starlette.responses import RedirectResponse

    rest = urlencode([pair for pair in parse_qsl(scope["query_string"].decode("latin-1")) if pair[0] != "key"])
    # A path that begins with two slashes would be the address of another server.
    path = f"/{scope['path'].lstrip('/')}"
    answer = RedirectResponse(f"{path}?{rest}" if rest else path, 303, _HEADERS)
    answer.headers["Set-Cookie"] = _make_cookie(scope, login)
    await answer(scope, receive, send)


async def _refuse(scope: Scope, receive: Receive, send: Send, status: int, sentence: str) -> None:
    from starlette.responses import HTMLResponse, PlainTextResponse

    if scope["type"] == "websocket":
        await receive()
        await send({"type": "websocket.close", "code": _REFUSED, "reason": sentence})
        return
    headers = dict(_HEADERS)
    if status == 403:
        await PlainTextResponse(sentence, status, headers)(scope, receive, send)
        return
    is_person = "text/html" in _read_headers(scope).get("accept", "")
    headers["WWW-Authenticate"] = 'Basic realm="FAST"'
    page = HTMLResponse(_PAGE, status, headers) if is_person else PlainTextResponse(sentence, status, headers)
    await page(scope, receive, send)
