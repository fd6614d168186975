"""A Prefect server of a test: Python run on it, questions to it, waiting for what it does."""

import subprocess
import sys
from pathlib import Path
from typing import Any

from fast.flows.server.access import Api
from fast.flows.server.environment import LOGIN_VARIABLE, SERVER_VARIABLE, make_environment
from fast.flows.server.server import ask_server, state_folder
from tests.flows.cli.cli_lakes import ROOT


def python(api: Api, root: Path, *words: object, **settings: str) -> str:
    """Run Python on a server, with these variables of the environment; returns what it printed."""
    environment = make_environment(api, state_folder(root)) | {
        SERVER_VARIABLE: api.url,
        LOGIN_VARIABLE: api.login or "",
    }
    environment |= {"FAST_CHECKOUT": str(ROOT), "FAST_LAKE": "lake-data", **settings}
    done = subprocess.run(
        [sys.executable, *map(str, words)], cwd=ROOT, env=environment, capture_output=True, text=True, timeout=300
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def asked(api: Api, path: str, **body: Any) -> Any:
    """Answer of a POST to the server."""
    return ask_server(api, path, body, timeout_s=30)
