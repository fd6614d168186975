"""The Prefect server of a lab on a real PostgreSQL database, which this test starts."""

import asyncio
import os
import subprocess
import sys

import pytest

from fast.flows.server.server import ask_server, server, state_folder
from fast.lake.store import Lake
from tests.flows.campaign.test_campaign import CONFIG, ROOT, assert_complete
from tests.flows.server import postgres_server

VARIABLE = "FAST_PREFECT_API_DATABASE_CONNECTION_URL"
pytestmark = [
    pytest.mark.skipif(bool(postgres_server.WHY_NOT), reason=postgres_server.WHY_NOT),
    pytest.mark.timeout(3600),
    pytest.mark.study,  # it needs a real PostgreSQL server
]


@pytest.fixture
def database(monkeypatch):
    monkeypatch.delenv("FAST_PREFECT_API_URL", raising=False)
    with postgres_server.postgres() as url:
        monkeypatch.setenv(VARIABLE, url)
        yield url


def rows_of(url: str, sql: str) -> list:
    import asyncpg

    async def fetch() -> list:
        connection = await asyncpg.connect(url.replace("+asyncpg", ""))
        try:
            return await connection.fetch(sql)
        finally:
            await connection.close()

    return asyncio.run(fetch())


def test_runs_are_kept_in_the_database_and_survive_the_server(tmp_path, database):
    root = Lake.open(tmp_path / "lake", create=True).root
    with server(root) as url:
        flow = ask_server(url, "/flows/", {"name": "campaign"})
        state = {"type": "COMPLETED", "name": "Completed", "message": "kept"}
        run = ask_server(url, "/flow_runs/", {"flow_id": flow["id"], "name": "kept", "state": state})
    ((name, state_name),) = rows_of(database, "SELECT name, state_name FROM flow_run")
    assert (name, state_name) == ("kept", "Completed")
    assert not list(state_folder(root).glob("*.db"))  # nothing went to SQLite
    with server(root) as url:
        assert ask_server(url, f"/flow_runs/{run['id']}")["state"]["message"] == "kept"


def test_a_campaign_runs_on_it(tmp_path, database):
    (tmp_path / "tiny.toml").write_text(CONFIG)
    (tmp_path / "world.toml").write_text((ROOT / "worlds" / "quick.toml").read_text().replace("5.0", "8.0"))
    environment = {k: v for k, v in os.environ.items() if not k.startswith("PREFECT_")} | {VARIABLE: database}
    words = ["campaign", "run", str(tmp_path / "tiny.toml"), "--lake", str(tmp_path / "lake"), "--auto-print"]
    done = subprocess.run(
        [sys.executable, "-m", "fast.flows.cli.main", *words],
        cwd=ROOT, env=environment, capture_output=True, text=True, timeout=3300,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    assert_complete(tmp_path)
    found = rows_of(database, "SELECT state_type::text AS state FROM flow_run")
    assert {row["state"] for row in found} == {"COMPLETED"}
    assert rows_of(database, "SELECT count(*) AS n FROM task_run")[0]["n"] > 0
