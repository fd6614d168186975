"""Settings for another Prefect, proxies and files of the working folder do not reach what FAST starts."""

import os
import subprocess
import sys
import time

import pytest

from fast.flows.server.access import Api
from fast.flows.server.environment import list_ignored, make_environment, named_server
from fast.flows.server.loopback import spare_loopback
from fast.lake.store import Lake
from fast.lake.tables.campaign import GraspRow
from tests.flows.cli.cli_lakes import ROOT

OTHERS = {
    "PREFECT_API_URL": "http://127.0.0.1:9/api",
    "PREFECT_API_KEY": "pnu_other",
    "PREFECT_API_AUTH_STRING": "a:b",
    "PREFECT_SERVER_API_AUTH_STRING": "a:b",
    "PREFECT_PROFILE": "other",
    "PREFECT_SERVER_DATABASE_CONNECTION_URL": "sqlite+aiosqlite:////nowhere/x.db",
    "PREFECT_LOGGING_LEVEL": "nonsense",
    "PREFECT_TASK_DEFAULT_RETRIES": "x",
}
PROXIES = dict.fromkeys(("HTTP_PROXY", "HTTPS_PROXY", "ALL_PROXY", "http_proxy"), "http://127.0.0.1:9")
TINY = """
name = "tiny"
[schedule]
initial_tools = 3
tools_per_batch = 1
guided_batches = 0
initial_simulations = 0
simulations_per_batch = 0
[objects]
ids = [2]
repeats = 1
[simulator]
simulate_tools = false
[bench]
world = "world.toml"
"""


def test_settings_for_another_prefect_are_left_aside_and_those_for_fast_are_taken(tmp_path):
    mine = {"FAST_PREFECT_LOGGING_LEVEL": "DEBUG", "HOME": "ada"}
    api = Api("http://127.0.0.1:4200/api", "fast:key")
    found = make_environment(api, tmp_path, OTHERS | mine)
    assert found["PREFECT_API_URL"] == api.url
    assert found["PREFECT_API_AUTH_STRING"] == "fast:key"
    assert found["PREFECT_LOGGING_LEVEL"] == "DEBUG"
    assert found["HOME"] == "ada"
    left = {name: value for name, value in OTHERS.items() if found.get(name) == value}
    assert left == {}
    assert list_ignored(OTHERS | mine) == sorted(OTHERS)


def test_a_server_is_named_by_one_setting(monkeypatch):
    monkeypatch.setenv("PREFECT_API_URL", "http://127.0.0.1:9/api")
    monkeypatch.delenv("FAST_PREFECT_API_URL", raising=False)
    assert named_server() is None
    monkeypatch.setenv("FAST_PREFECT_API_URL", "http://127.0.0.1:8/api/")
    monkeypatch.setenv("FAST_PREFECT_API_AUTH_STRING", "a:b")
    assert named_server() == Api("http://127.0.0.1:8/api", "a:b")


def test_this_machine_is_asked_without_a_proxy_and_others_as_before():
    environment = {"NO_PROXY": "lab.example, localhost"}
    spare_loopback(environment)
    assert environment["NO_PROXY"] == "lab.example,localhost,127.0.0.1,::1"
    assert environment["no_proxy"] == "127.0.0.1,localhost,::1"


@pytest.mark.slow
def test_a_campaign_runs_among_settings_of_others(tmp_path):
    """Variables, a profile, `prefect.toml`, `.env`, a proxy that nobody answers, no cache, C locale, few files."""
    (tmp_path / "tiny.toml").write_text(TINY)
    (tmp_path / "world.toml").write_text((ROOT / "worlds" / "quick.toml").read_text())
    (tmp_path / "prefect.toml").write_text('[api]\nurl = "http://127.0.0.1:9/api"\n[server.database]\nx = 1\n')
    (tmp_path / ".env").write_text("PREFECT_API_URL=http://127.0.0.1:9/api\nPREFECT_LOGGING_LEVEL=nonsense\n")
    (tmp_path / ".prefect").mkdir()
    profile = 'active = "other"\n[profiles.other]\nPREFECT_API_URL = "http://127.0.0.1:9/api"\n'
    (tmp_path / ".prefect" / "profiles.toml").write_text(profile)
    kept = {name: value for name, value in os.environ.items() if not name.startswith("PREFECT_")}
    strange = {"HOME": str(tmp_path), "NUMBA_CACHE_DIR": "/proc/nothing", "LC_ALL": "POSIX", "COLUMNS": "20"}
    words = ["campaign", "run", "tiny.toml", "--lake", "lake of Zoë", "--auto-print"]
    started_s = time.monotonic()
    done = subprocess.run(
        ["bash", "-c", 'ulimit -n 256; exec "$@"', "-", sys.executable, "-m", "fast.flows.cli.main", *words],
        cwd=tmp_path, env=kept | OTHERS | PROXIES | strange | {"PYTHONPATH": str(ROOT)},
        capture_output=True, text=True, timeout=280, check=False,
    )  # fmt: skip
    said = done.stdout + done.stderr
    assert done.returncode == 0, said
    assert "Traceback" not in said
    assert f"left aside, since FAST brings its own Prefect server: {', '.join(sorted(OTHERS))}" in said
    assert "NUMBA_CACHE_DIR is /proc/nothing, which cannot be written" in said
    assert len(Lake.open(tmp_path / "lake of Zoë").rows(GraspRow)) == 3
    assert time.monotonic() - started_s < 200
