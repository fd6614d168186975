"""The page of a lake served in this process, and a browser of Debian's that is driven to it."""

import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import uvicorn

from fast.flows.page.app import make_app
from fast.flows.server.access import Role, own_login
from fast.flows.server.gate import add_gate
from fast.lake.store import Lake
from tests.waiting import wait_for

CHROMIUM = Path("/usr/bin/chromium")


@contextmanager
def serve(lake: Lake, port: int = 0) -> Iterator[str]:
    """Serve the page until the `with` block ends; gives the address that lets a browser in."""
    login = own_login(lake.root)
    with socket.create_server(("127.0.0.1", port)) as listener:
        number = listener.getsockname()[1]
        app = add_gate(make_app(lake, login), login, "127.0.0.1", Role)
        config = uvicorn.Config(app, log_level="critical", lifespan="off", timeout_graceful_shutdown=1)
        server = uvicorn.Server(config)
        thread = threading.Thread(target=server.run, args=([listener],), daemon=True)
        thread.start()
        try:
            wait_for(lambda: server.started, 30.0)
            yield f"http://127.0.0.1:{number}/?key={login.partition(':')[2]}"
        finally:
            server.should_exit = True
            thread.join()


@contextmanager
def open_browser(address: str, width: int = 1200, scheme: Any = "light") -> Iterator[Any]:
    """A page in a browser that was let in; what its console says ends the test."""
    from playwright.sync_api import sync_playwright

    complaints: list[str] = []
    with sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=str(CHROMIUM), args=["--no-sandbox"])
        context = browser.new_context(viewport={"width": width, "height": 900}, color_scheme=scheme)
        page = context.new_page()
        page.on("pageerror", lambda error: complaints.append(str(error)))
        page.on("request", lambda request: _note_stranger(request.url, address, complaints))
        page.goto(address)
        yield page
        browser.close()
    assert complaints == []


def _note_stranger(url: str, address: str, complaints: list[str]) -> None:
    """Nothing is loaded from elsewhere."""
    if not url.startswith((address.partition("?")[0], "data:")):
        complaints.append(f"{url} is not ours")


def find_barriers(page: Any) -> list[str]:
    """What keeps somebody from reading or using the page as it is now, by axe-core: rule and element."""
    from axe_playwright_python.sync_playwright import Axe

    found = Axe().run(page).response["violations"]
    return [f"{rule['help']}: {node['html']}" for rule in found for node in rule["nodes"]]


def say_name(page: Any, name: str) -> None:
    """Say who works at this browser."""
    page.click(".who")
    page.fill("#name", name)
    page.click("button:has-text('Keep')")
    page.wait_for_selector(f".who:has-text('{name}')")
