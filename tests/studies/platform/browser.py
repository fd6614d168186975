"""A headless Chromium that a benchmark drives as a person would, over the DevTools protocol."""

import base64
import json
import shutil
import subprocess
import tempfile
import time
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from fast.models.errors import FastError

NAMES = ("chromium", "chromium-browser", "google-chrome")
WAIT_S = 300.0
_FLAGS = (
    "--headless", "--no-sandbox", "--disable-gpu", "--no-first-run", "--disable-background-networking",
    "--disable-component-update", "--disable-sync", "--hide-scrollbars", "--remote-debugging-port=0",
)  # fmt: skip


class Browser:
    """One page. Waits for what it is asked for, since pages draw themselves late."""

    def __init__(self, socket: Any) -> None:
        self._socket = socket
        self._number = 0

    def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        """One command of the protocol; returns its result."""
        self._number += 1
        self._socket.send(json.dumps({"id": self._number, "method": method, "params": parameters}))
        while True:
            answer = json.loads(self._socket.recv(timeout=WAIT_S))
            if answer.get("id") == self._number:
                if "error" in answer:
                    raise FastError(f"the browser refused {method}: {answer['error']['message']}.")
                result: dict[str, Any] = answer["result"]
                return result

    def open(self, url: str) -> None:
        """Go to an address."""
        self.call("Page.navigate", url=url)

    def script(self, code: str) -> Any:
        """Value of a JavaScript expression in the page."""
        found = self.call("Runtime.evaluate", expression=code, returnByValue=True, awaitPromise=True)
        if "exceptionDetails" in found:
            raise FastError(f"the page could not run `{code[:60]}`: {found['exceptionDetails']['text']}.")
        return found["result"].get("value")

    def wait(self, code: str) -> Any:
        """Wait until an expression is true.

        Raises:
            FastError: it did not become true in time.
        """
        deadline = time.monotonic() + WAIT_S
        while time.monotonic() < deadline:
            if found := self.script(code):
                return found
            time.sleep(0.3)
        raise FastError(f"the page did not get as far as `{code[:80]}` within {WAIT_S:.0f} s.")

    def wait_for_words(self, words: str) -> None:
        """Wait until the page shows these words; a page that is just being opened has no body yet."""
        self.wait(f"document.body?.innerText.includes({json.dumps(words)})")

    def click(self, text: str, within: str = "button") -> None:
        """Click the last element that shows exactly this text: a dialog lies over the page it came from."""
        named = f"e => e.innerText.trim() === {json.dumps(text)}"
        found = f"[...document.querySelectorAll({json.dumps(within)})].filter({named})"
        self.wait(f"{found}.some(e => !e.disabled)")
        self.script(f"{found}.at(-1).click()")

    def type_into(self, label: str, text: str, nth: int = 0) -> None:
        """Type into the n-th field whose label starts with this text, in place of what it holds."""
        field = (
            "[...document.querySelectorAll('.p-label')]"
            f".filter(e => e.innerText.trim().startsWith({json.dumps(label)}))[{nth}]?.querySelector('input, textarea')"
        )
        self.wait(f"!!({field})")
        for _ in range(3):  # a page that draws itself anew at that moment drops what is typed
            self.script(f"({field}).focus(); ({field}).select()")
            self.call("Input.insertText", text=text)
            time.sleep(0.5)
            if self.script(f"({field}).value") == text:
                return
        raise FastError(f"the field `{label}` did not take `{text}`.")

    def choose(self, label: str, option: str, nth: int = 0) -> None:
        """Choose an option of the n-th list whose label starts with this text."""
        field = (
            "[...document.querySelectorAll('.p-label')]"
            f".filter(e => e.innerText.trim().startsWith({json.dumps(label)}))[{nth}]?.querySelector('select')"
        )
        self.wait(f"!!({field})")
        set_value = f"s.value = {json.dumps(option)};" + " s.dispatchEvent(new Event('change', {bubbles: true}))"
        self.script(f"(s => {{ {set_value} }})({field})")

    def picture(self, path: Path) -> None:
        """Write what the window shows as a PNG."""
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"]))


@contextmanager
def open_browser(width: int = 1280, height: int = 1000) -> Iterator[Browser]:
    """A browser with one empty page.

    Raises:
        FastError: there is no Chromium, or it did not start.
    """
    from websockets.sync.client import connect

    program = next(filter(None, map(shutil.which, NAMES)), None)
    if program is None:
        raise FastError(f"none of {', '.join(NAMES)} is installed; install one (Debian: `apt-get install chromium`).")
    with tempfile.TemporaryDirectory(prefix="fast-browser-", ignore_cleanup_errors=True) as folder:
        command = [program, *_FLAGS, f"--user-data-dir={folder}", f"--window-size={width},{height}", "about:blank"]
        child = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        try:
            with connect(_page_address(Path(folder), child), max_size=None) as socket:
                browser = Browser(socket)
                browser.call("Page.enable")
                yield browser
        finally:
            child.terminate()
            child.wait(timeout=30)


def _page_address(folder: Path, child: "subprocess.Popen[bytes]") -> str:
    """Address of the first page's debugger, from the port that the browser wrote down."""
    deadline = time.monotonic() + WAIT_S
    while time.monotonic() < deadline and child.poll() is None:
        try:
            port = int((folder / "DevToolsActivePort").read_text().splitlines()[0])
            with urllib.request.urlopen(f"http://127.0.0.1:{port}/json/list", timeout=10) as answer:
                pages = [page for page in json.load(answer) if page["type"] == "page"]
            if pages:
                return str(pages[0]["webSocketDebuggerUrl"])
        except (OSError, ValueError, IndexError):
            pass
        time.sleep(0.2)
    raise FastError("the browser did not start; run it by hand to see why.")
