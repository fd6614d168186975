"""The page of a test: its routes behind the gate, asked as a browser asks."""

from typing import Any

from starlette.testclient import TestClient

from fast.flows.page.app import make_app
from fast.flows.page.web import make_token
from fast.flows.server.access import Role, own_login, role_login, session_of
from fast.flows.server.gate import add_gate
from fast.lake.store import Lake

ADDRESS = "http://127.0.0.1:4210"


class Browser:
    """A browser with a link of a role, whose person said a name (or none)."""

    def __init__(self, lake: Lake, role: Role = Role.MOVE, name: str = "ada", app: Any = None) -> None:
        login = own_login(lake.root)
        self.token = make_token(login)
        self.app = app or add_gate(make_app(lake, login), login, "127.0.0.1", Role)
        self.client = TestClient(self.app, base_url=ADDRESS)
        self.client.cookies.set("fast-4210", session_of(role_login(login, role)))
        if name:
            self.client.cookies.set("fast-name-4210", name)

    def see(self, path: str) -> str:
        """A page as text; one that cannot be shown fails."""
        answer = self.client.get(path)
        assert answer.status_code == 200, answer.text
        return answer.text

    def say(self, path: str, form: dict[str, Any], **headers: str) -> tuple[int, str]:
        """Status of a form that was sent, and the sentence that the page says."""
        answer = self.client.post(path, data=form, headers={"X-Fast-Token": self.token, **headers})
        return answer.status_code, answer.headers.get("HX-Trigger", "") or answer.text

    def drop(self, campaign_id: str, name: str, content: bytes) -> tuple[int, str]:
        """Status and words of a file that was dropped."""
        where = {"campaign": campaign_id, "name": name}
        answer = self.client.post(
            "/todo/told/look", params=where, content=content, headers={"X-Fast-Token": self.token}
        )
        return answer.status_code, answer.text
