"""A stranger at the gate: a page of another site, a name that was pointed here, another user of the computer."""

import asyncio
import base64
import os
import socket
from types import SimpleNamespace

import psutil
import pytest

from fast.flows.server.access import (
    Api,
    Role,
    address_for_person,
    addresses_for_person,
    key_path,
    own_login,
    role_login,
    session_of,
)
from fast.flows.server.gate import ROLE, add_gate
from fast.models.errors import FastError

LOGIN = "fast:open"
BASIC = f"Basic {base64.b64encode(LOGIN.encode()).decode()}"
HOST = "127.0.0.1:4200"
COOKIE = f"fast-4200={session_of(LOGIN)}"
SAME_ORIGIN = {"origin": f"http://{HOST}", "sec-fetch-site": "same-origin", "sec-fetch-mode": "cors"}


async def inside(scope, receive, send):
    if scope["type"] == "websocket":
        await send({"type": "websocket.accept"})
        return
    await send({"type": "http.response.start", "status": 200, "headers": []})
    await send({"type": "http.response.body", "body": b"inside"})


def ask(headers, path="/api/flows/", method="POST", host="127.0.0.1", kind="http", app=None):
    """Status (or `accepted`, `closed` of a web socket), headers and body of the answer."""
    said = []

    async def send(message):
        said.append(message)

    async def receive():
        return {"type": "websocket.connect" if kind == "websocket" else "http.request", "body": b"", "more_body": False}

    path, _, query = path.partition("?")
    pairs = {"host": HOST, **headers}.items()
    scope = {"type": kind, "method": method, "path": path, "raw_path": path.encode(), "query_string": query.encode(),
             "server": ("127.0.0.1", 4200), "headers": [(k.encode(), v.encode()) for k, v in pairs]}  # fmt: skip
    asyncio.run((app or add_gate(inside, LOGIN, host))(scope, receive, send))
    if kind == "websocket":
        return said[-1]["type"].removeprefix("websocket."), {}, ""
    return said[0]["status"], {k.decode(): v.decode() for k, v in said[0]["headers"]}, said[-1]["body"].decode()


STRANGERS = {
    "page of another site": ({"origin": "http://evil.example", "authorization": BASIC}, 403),
    "page with a cookie of ours": ({"origin": "http://evil.example", "cookie": COOKIE}, 403),
    "page of another port here": ({"origin": "http://127.0.0.1:8888", "cookie": COOKIE}, 403),
    "page from a file": ({"origin": "null", "cookie": COOKIE}, 403),
    "picture of another site": ({"sec-fetch-site": "same-site", "sec-fetch-mode": "no-cors", "cookie": COOKIE}, 403),
    "name pointed at 127.0.0.1": ({"host": "evil.example:4200", "cookie": COOKIE, "authorization": BASIC}, 403),
    "no host at all": ({"host": "", "authorization": BASIC}, 403),
    "strange host": ({"host": "[::1", "authorization": BASIC}, 403),
    "another user": ({}, 401),
    "another user, wrong key": ({"authorization": "Basic ZmFzdDpzaHV0"}, 401),
    "another user, no code": ({"authorization": "Basic ***"}, 401),
    "another user, old cookie": ({"cookie": f"fast-4200={session_of('fast:old')}"}, 401),
    "another user, torn cookie": ({"cookie": 'fast-4200="; =; \x7f'}, 401),
}


@pytest.mark.parametrize("name", STRANGERS)
def test_a_stranger_is_refused(name):
    headers, status = STRANGERS[name]
    found, answer, body = ask(headers)
    assert found == status
    assert "inside" not in body
    assert "access-control-allow-origin" not in answer
    assert ask(headers, kind="websocket")[0] == "close"
    preflight = {**headers, "access-control-request-method": "POST"}
    assert ask(preflight, method="OPTIONS")[0] == status


def test_a_proxy_with_tls_is_let_in_by_the_name_that_was_said(monkeypatch):
    through = {"host": "lab.example.org", "origin": "https://lab.example.org", "cookie": COOKIE}
    status, _, words = ask(through)
    assert status == 403
    assert "if it is yours, start the server with it in FAST_NAMES" in words
    monkeypatch.setenv("FAST_NAMES", "other.example.org Lab.example.org")
    assert ask(through)[::2] == (200, "inside")
    assert ask({**through, "origin": "https://evil.example"})[0] == 403
    assert ask({**through, "host": "evil.example"})[0] == 403


@pytest.mark.parametrize("headers", [{"authorization": BASIC}, {"cookie": COOKIE}, {"cookie": COOKIE, **SAME_ORIGIN},
                                     {"host": "localhost:4200", "authorization": BASIC}])  # fmt: skip
def test_who_has_the_key_is_let_in(headers):
    assert ask(headers)[::2] == (200, "inside")
    assert ask(headers, kind="websocket")[0] == "accept"


def test_a_browser_gets_its_cookie_once_from_the_printed_address():
    status, answer, _ = ask({}, "/runs?tab=2&key=open", "GET")
    assert (status, answer["location"]) == (303, "/runs?tab=2")
    assert answer["set-cookie"].startswith(COOKIE)
    assert "HttpOnly" in answer["set-cookie"]
    assert ask({}, "/?key=shut", "GET")[0] == 401
    assert ask({}, "/?key=open", "POST")[0] == 401
    assert ask({}, "//evil.example/?key=open", "GET")[1]["location"] == "/evil.example/"
    assert "open" not in session_of(LOGIN)


def test_a_person_without_the_key_reads_what_to_do_and_a_password_gives_a_cookie():
    status, answer, body = ask({"accept": "text/html"}, "/", "GET")
    assert (status, answer["www-authenticate"]) == (401, 'Basic realm="FAST"')
    assert "fast serve" in body
    assert ask({"accept": "text/html", "authorization": BASIC}, "/", "GET")[1]["set-cookie"].startswith(COOKIE)
    assert ask({"cookie": COOKIE}, "/", "GET")[1]["x-frame-options"] == "SAMEORIGIN"


def test_where_others_reach_the_server_its_addresses_are_names_of_it_and_no_others():
    asked = {"authorization": BASIC}
    assert ask({**asked, "host": "192.168.1.7:4200"}, host="0.0.0.0")[0] == 200
    assert ask({**asked, "host": f"{os.uname().nodename}:4200"}, host="0.0.0.0")[0] == 200
    assert ask({**asked, "host": "evil.example:4200"}, host="0.0.0.0")[0] == 403
    assert ask({**asked, "host": "192.168.1.7:4200"})[0] == 403


def test_the_key_is_made_once_for_its_owner_alone_and_is_not_printed_by_accident(tmp_path, monkeypatch):
    monkeypatch.delenv("FAST_PASSWORD", raising=False)
    login = own_login(tmp_path)
    assert own_login(tmp_path) == login
    assert key_path(tmp_path).stat().st_mode & 0o777 == 0o600
    assert len(login) > 32
    api = Api("http://127.0.0.1:4200/api", login)
    assert login.removeprefix("fast:") not in repr(api)
    assert address_for_person(api) == f"http://127.0.0.1:4200/?key={login.removeprefix('fast:')}"
    monkeypatch.setenv("FAST_PASSWORD", "sesame")
    assert own_login(tmp_path) == "fast:sesame"
    assert address_for_person(Api(api.url, "fast:sesame")) == "http://127.0.0.1:4200"


def test_a_person_is_told_the_addresses_that_can_be_opened_from_elsewhere(monkeypatch):
    """`fast serve --host 0.0.0.0` named 127.0.0.1, which is the phone itself on a phone."""
    monkeypatch.setenv("FAST_PASSWORD", "sesame")
    ours, other = Api("http://127.0.0.1:4210/api", LOGIN), Api("http://flows.lab:4200/api")
    assert addresses_for_person(ours, "127.0.0.1") == ["http://127.0.0.1:4210"]
    assert addresses_for_person(ours, "192.168.7.2") == ["http://192.168.7.2:4210"]
    assert addresses_for_person(other, "192.168.7.2") == ["http://flows.lab:4200"]
    cards = {"lo": ["127.0.0.1"], "eth0": ["192.168.7.2"], "wlan0": ["10.0.0.2"]}
    seen = {
        name: [SimpleNamespace(family=socket.AF_INET, address=one) for one in held]
        + [SimpleNamespace(family=socket.AF_INET6, address="fe80::1")]
        for name, held in cards.items()
    }
    monkeypatch.setattr(psutil, "net_if_addrs", lambda: seen)
    assert addresses_for_person(ours, "0.0.0.0") == ["http://192.168.7.2:4210", "http://10.0.0.2:4210"]
    monkeypatch.setattr(psutil, "net_if_addrs", lambda: {"lo": seen["lo"]})
    assert addresses_for_person(ours, "0.0.0.0") == ["http://127.0.0.1:4210"]


def test_an_empty_key_is_said(tmp_path, monkeypatch):
    monkeypatch.delenv("FAST_PASSWORD", raising=False)
    key_path(tmp_path).parent.mkdir()
    key_path(tmp_path).touch()
    with pytest.raises(FastError, match="is empty; delete it"):
        own_login(tmp_path)


def test_a_link_of_a_role_lets_in_with_that_role_and_tells_no_other():
    keys = {role: role_login(LOGIN, role) for role in Role}
    assert keys[Role.MOVE] == LOGIN
    assert len(set(keys.values())) == 3
    for role, login in keys.items():
        seen = []

        async def look(scope, receive, send, seen=seen):
            seen.append(scope[ROLE])
            await inside(scope, receive, send)

        cookie = {"cookie": f"fast-4200={session_of(login)}"}
        assert ask(cookie, method="GET", app=add_gate(look, LOGIN, "127.0.0.1", Role))[0] == 200
        assert seen == [role]
        # A server with one key knows no other.
        assert ask(cookie, method="GET")[0] == (200 if role is Role.MOVE else 401)
        status, headers, _ = ask(
            {}, f"/?key={login.partition(':')[2]}", "GET", app=add_gate(look, LOGIN, "127.0.0.1", Role)
        )
        assert (status, session_of(login) in headers["set-cookie"]) == (303, True)
    assert Role.MOVE.may(Role.SAY)
    assert not Role.LOOK.may(Role.SAY)
